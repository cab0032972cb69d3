"""The picture: a simulated flight over a construction site, with what was decoded laid over it.

The paper's simulation has such a figure. `construction_site` (the default scenario), full fidelity, is read by source,
tracker and decoder from a cold start up to AT_S; the cell keeps what the picture shows of that moment, so that it is
drawn again without being run again::

    view        the camera's own view, grey, every second pixel (zlib, base64; (rows, columns) uint8)
    events      [x, y, on] of the last EVENTS_US
    beacons     [name, x, y, radius, visible]: the truth
    tracks      [x, y, vx, vy]: as the tracker had them last
    identified  [name, x, y, right]: states that hold, where the decoder says they are

Right is whoever bears the name of the nearest true beacon within max(5 px, its radius) at the state's own time.
"""

from __future__ import annotations

import base64
import tempfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.messages import Identification, Tracks
from heliograph.streams import Events, Image
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.paths import TruePaths, true_paths
from heliograph_services.cli.studies.running import Setting, opened
from heliograph_services.cli.studies.study import Cell, Counts, Done, Figure, Parameters, Row, Size, Study, Table
from heliograph_services.cli.studies.verdicts import gates_px
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.event_source.simulation.world.load import load_scenario, site_beacons
from heliograph_services.tracker.config import TrackerConfig

SCENARIO: Final = "construction_site"
AT_S: Final = 4.0
QUICK_S: Final = 1.5
EVENTS_US: Final = 20_000
IMAGE_HZ: Final = 10.0
STRIDE: Final = 2


def cells(size: Size) -> list[Parameters]:
    """Return the only cell."""
    return [{"scenario": SCENARIO, "seconds": QUICK_S if size == "quick" else AT_S}]


def run(cell: Cell) -> Counts:
    """Run the scene and keep its last moment."""
    from heliograph_services.decoder.core import make_core as make_decoder  # noqa: PLC0415 - compiles on import
    from heliograph_services.tracker.core import make_core as make_tracker  # noqa: PLC0415

    seconds = float(cell.parameters["seconds"])
    source = {"fidelity": "full", "image_hz": IMAGE_HZ}
    name = cell.parameters["scenario"]
    # Beyond the moment itself: at the end of a stream all that was named is lost.
    setting = Setting(name, cell.seed, seconds + 0.1, source=source)
    states: dict[str, Identification] = {}
    tracks: Tracks | None = None
    view: npt.NDArray[np.uint8] | None = None
    late: list[list[int]] = []
    with tempfile.TemporaryDirectory(prefix="heliograph-study-") as folder, opened(setting, Path(folder)) as stream:
        camera = stream.camera
        if not isinstance(camera, SimulatedCamera):
            raise TypeError(f"a study's camera must be simulated, not {type(camera).__name__}")
        paths = true_paths(camera.scene, round((seconds + 0.2) * 1e6))
        decoder = make_decoder(DecoderConfig(beacons=tuple(site_beacons(load_scenario(name)))), ONE_PROCESS)
        system = Pipeline(make_tracker(TrackerConfig(), ONE_PROCESS), decoder)
        for step in stream:
            if step.t1_us > seconds * 1e6:
                break
            for message in step.messages:
                if isinstance(message, Image):
                    view = message.grey
                elif isinstance(message, Events) and step.t1_us > seconds * 1e6 - EVENTS_US:
                    batch = message.batch
                    late += np.stack([batch.x_px, batch.y_px, batch.on], axis=1).astype(int).tolist()
            for out in system.feed(step.messages):
                if isinstance(out, Tracks):
                    tracks = out
                elif isinstance(out, Identification):
                    states[out.track] = out
    held = [one for one in states.values() if not one.lost]
    return {
        "view": _packed(view),
        "events": late,
        "beacons": _truth(paths, round(seconds * 1e6)),
        "tracks": [] if tracks is None else _moving(tracks),
        "identified": [[one.beacon, round(one.x_px, 1), round(one.y_px, 1), is_right(one, paths)] for one in held],
    }


def _packed(view: npt.NDArray[np.uint8] | None) -> dict[str, Any] | None:
    if view is None:
        return None
    small = np.ascontiguousarray(view[::STRIDE, ::STRIDE])
    return {"shape": list(small.shape), "zlib": base64.b64encode(zlib.compress(small.tobytes(), 9)).decode()}


def _truth(paths: TruePaths, t_us: int) -> list[list[Any]]:
    x_px, y_px = paths.places([t_us])
    node = int(paths.nodes([t_us])[0][0])
    rows = zip(paths.names, x_px[:, 0], y_px[:, 0], paths.radius_px[:, node], paths.visible[:, node], strict=True)
    return [
        [name, round(float(x), 1), round(float(y), 1), round(float(r), 1), bool(seen)] for name, x, y, r, seen in rows
    ]


def _moving(tracks: Tracks) -> list[list[float]]:
    rows = zip(tracks.x_px, tracks.y_px, tracks.vx_px_s, tracks.vy_px_s, strict=True)
    return [[round(value, 1) for value in row] for row in rows]


def is_right(state: Identification, paths: TruePaths) -> bool:
    """Return whether a state names the beacon that is there."""
    x_px, y_px = paths.places([state.t_us])
    away = np.hypot(x_px[:, 0] - state.x_px, y_px[:, 0] - state.y_px)
    k = int(np.argmin(away))
    if away[k] > gates_px(paths, [state.t_us])[k, 0]:
        return False
    return state.beacon == paths.names[k]


def tables(done: Sequence[Done]) -> list[Table]:
    """Return how many of the visible beacons are named, and whether rightly."""
    rows = []
    for one in done:
        visible = sum(seen for *_, seen in one.counts["beacons"])
        right = [rightly for *_, rightly in one.counts["identified"]]
        figures = {
            "visible": Figure(float(visible)),
            "named": Figure(float(len(right))),
            "named rightly": Figure(float(sum(right))),
        }
        rows.append(Row(f"{one['scenario']} at {one['seconds']:g} s", "-", figures, "", "1 run"))
    note = "A picture, not a measurement: a beacon that came into view a moment ago has no name yet."
    return [Table("What the picture shows", ("visible", "named", "named rightly"), rows, note)]


def draw(done: Sequence[Done], axis: Any) -> None:
    """Draw the moment on a matplotlib axis."""
    (one,) = done
    counts = one.counts
    width, height = 640, 480
    if counts["view"] is not None:
        rows, columns = counts["view"]["shape"]
        width, height = columns * STRIDE, rows * STRIDE
        grey = np.frombuffer(zlib.decompress(base64.b64decode(counts["view"]["zlib"])), np.uint8).reshape(rows, columns)
        axis.imshow(grey, cmap="gray", extent=(-0.5, width - 0.5, height - 0.5, -0.5), alpha=0.75, vmin=0, vmax=255)
    events = np.array(counts["events"], np.int64).reshape(-1, 3)
    for is_on, colour in ((1, "#e4572e"), (0, "#2e86e4")):
        of = events[events[:, 2] == is_on]
        axis.plot(of[:, 0], of[:, 1], ",", color=colour)
    for _, x_px, y_px, radius_px, seen in counts["beacons"]:
        style = "-" if seen else ":"
        axis.add_patch(_circle(x_px, y_px, max(8.0, 2.0 * radius_px), "w", style))
    for x_px, y_px, vx_px_s, vy_px_s in counts["tracks"]:
        axis.plot([x_px], [y_px], "+", color="#ffd23f", ms=7)
        axis.plot([x_px, x_px + 0.2 * vx_px_s], [y_px, y_px + 0.2 * vy_px_s], "-", color="#ffd23f", lw=1)
    for name, x_px, y_px, rightly in counts["identified"]:
        colour = "#3ddc84" if rightly else "#ff1744"
        axis.add_patch(_circle(x_px, y_px, 5.0, colour, "-"))
        box = {"boxstyle": "round,pad=0.15", "fc": "k", "ec": colour, "alpha": 0.75}
        axis.annotate(name, (x_px, y_px), (7, -11), textcoords="offset points", color=colour, fontsize=8, bbox=box)
    axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="x, px", ylabel="y, px", aspect="equal")
    axis.set_title(
        f"{one['scenario']} at {one['seconds']:g} s: events of {EVENTS_US / 1e3:g} ms, tracks (yellow, .2 s ahead),\n"
        "beacons (white: truth, dotted: not visible), names as decoded (green: right, red: wrong)",
        fontsize=9,
    )


def _circle(x_px: float, y_px: float, radius_px: float, colour: str, style: str) -> Any:
    from matplotlib.patches import Circle  # noqa: PLC0415 - an extra

    return Circle((x_px, y_px), radius_px, fill=False, ec=colour, ls=style, lw=1.2)


STUDY: Final = Study(
    name="scene",
    version=1,
    title="A flight, with what was decoded",
    about=(
        "A drone over a construction site, as in the paper's simulation: the camera's view, its events, tracks, and the"
        " names that the decoder gives; cold start, the scenario's beacons listed."
    ),
    preset="dvxplorer_mini (VARIABLE_5000), 3.6 mm f/2.0",
    evidence="simulated",
    cells=cells,
    run=run,
    tables=tables,
    picture=draw,
)
