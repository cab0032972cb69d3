"""A scene as files: the events as NPZ, the truth as JSON lines.

Each line has a `type`; fields have the names of `heliograph.truth`, one beacon or frame a line::

    scenario   scenario, seed, stream, width, height, duration_us, beacons: [name, protocol, payload, text, bit_rate]
    beacon     t_us, beacon, protocol, x_px, y_px, radius_px, in_view, visible: a state, every 50 ms
    visible    beacon, t0_us, t1_us: it could be seen from t0_us to t1_us (to 50 ms)
    frame      beacon, protocol, frame_t0_us, frame_t1_us, frame_payload, frame_x_px, frame_y_px, frame_visible
    edge       beacon, t_us, on: the LED's change, to a tenth of a microsecond

Lines stand in the order of time of the windows that they end in; `visible` when the interval has ended.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

from heliograph.core import Context
from heliograph.errors import ConfigError, FileError
from heliograph.events import EventBatch
from heliograph.truth import Truth
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.formats.npz import write_npz
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.simulation.scenario import Scenario, load_scenario
from heliograph_services.event_source.simulation.scene import Scene

_WINDOW_US: Final = 10_000
_NOWHERE: Final = Context(instance="simulate", boot="0", lockstep=True)

Field = str | int | float | bool | None | list[dict[str, str | int | float | None]]


@dataclass(frozen=True, slots=True)
class Written:
    """What has been written: number of events and of frames sent, and the stream's name."""

    events: int
    frames: int
    stream: str


def simulate(
    scenario: str, out: Path, truth_file: Path | None = None, seed: int = 0, duration_s: float = 10.0
) -> Written:
    """Write a scene as NPZ, and its truth.

    Args:
        scenario: name of a built-in scenario, or the path of a file.
        out: the NPZ file.
        truth_file: where the truth goes; None: nowhere.
        seed: of the simulation.
        duration_s: length of the scene, rounded up to 10 ms.

    Raises:
        ConfigError: the scenario is none, or the duration is not positive.
        FileError: a file cannot be written.
    """
    if not duration_s > 0:
        raise ConfigError(f"duration must be positive, not {duration_s:g} s")
    config = EventSourceConfig(
        backend="simulated", scenario=scenario, seed=seed, duration_s=duration_s, window_us=_WINDOW_US
    )
    loaded = load_scenario(scenario)
    camera = SimulatedCamera(config, _NOWHERE)
    frames = 0

    with ExitStack() as stack:
        truth = None if truth_file is None else _TruthWriter(_opened(truth_file, stack), Scene(loaded, seed))
        if truth is not None:
            truth.scenario(scenario, seed, camera.stream, -(-round(duration_s * US_PER_S) // _WINDOW_US) * _WINDOW_US)

        def batches() -> Iterator[EventBatch]:
            nonlocal frames
            for window in camera.windows():
                if isinstance(window.truth, Truth):
                    frames += len(window.truth.frame_t1_us)
                    if truth is not None:
                        truth.window(window.truth, end=window.end)
                yield window.batch

        events = write_npz(out, camera.width, camera.height, batches())
    return Written(events, frames, camera.stream)


def _opened(path: Path, stack: ExitStack) -> IO[str]:
    try:
        return stack.enter_context(path.open("w", encoding="utf-8"))
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}") from None


class _TruthWriter:
    """Writes the lines of the module's table."""

    def __init__(self, file: IO[str], scene: Scene) -> None:
        self._file = file
        self._scene = scene
        self._visible_since: dict[str, int] = {}

    def _line(self, kind: str, **fields: Field) -> None:
        self._file.write(json.dumps({"type": kind} | fields, separators=(",", ":")) + "\n")

    def scenario(self, name: str, seed: int, stream: str, duration_us: int) -> None:
        scenario: Scenario = self._scene.scenario
        self._line(
            "scenario",
            scenario=name,
            seed=seed,
            stream=stream,
            width=scenario.width,
            height=scenario.height,
            duration_us=duration_us,
            beacons=[
                {"name": b.name, "protocol": b.protocol, "payload": b.payload, "text": b.text, "bit_rate": b.bit_rate}
                for b in scenario.beacons
            ],
        )

    def window(self, truth: Truth, *, end: bool) -> None:
        self._edges(truth)
        for i in range(len(truth.frame_t1_us)):
            beacon = truth.frame_beacon[i]
            self._line(
                "frame",
                beacon=truth.beacon[beacon],
                protocol=truth.protocol[beacon],
                frame_t0_us=truth.frame_t0_us[i],
                frame_t1_us=truth.frame_t1_us[i],
                frame_payload=truth.frame_payload[i],
                frame_x_px=round(truth.frame_x_px[i], 3),
                frame_y_px=round(truth.frame_y_px[i], 3),
                frame_visible=truth.frame_visible[i],
            )
        for i, name in enumerate(truth.beacon):
            self._line(
                "beacon",
                t_us=truth.t1_us,
                beacon=name,
                protocol=truth.protocol[i],
                x_px=round(truth.x_px[i], 3),
                y_px=round(truth.y_px[i], 3),
                radius_px=truth.radius_px[i],
                in_view=truth.in_view[i],
                visible=truth.visible[i],
            )
            self._seen(name, truth, visible=truth.visible[i], end=end)

    def _edges(self, truth: Truth) -> None:
        edges = [
            (float(t_us), i, bool(on))
            for i, emitter in enumerate(self._scene.emitters)
            for t_us, on in zip(*emitter.edges(truth.t0_us, truth.t1_us), strict=True)
        ]
        for t_us, i, on in sorted(edges):
            self._line("edge", beacon=truth.beacon[i], t_us=round(t_us, 1), on=on)

    def _seen(self, name: str, truth: Truth, *, visible: bool, end: bool) -> None:
        if visible:
            self._visible_since.setdefault(name, truth.t0_us)
        if name in self._visible_since and (end or not visible):
            t1_us = truth.t1_us if visible else truth.t0_us
            self._line("visible", beacon=name, t0_us=self._visible_since.pop(name), t1_us=t1_us)
