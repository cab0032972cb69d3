"""Where a track is when its beacon comes back, while the camera turns: with the surroundings' motion and without.

    python bench/study_coasting.py [-o bench/results/coasting.json] [--seeds 1000 1001] [--seconds 12]

Twenty beacons (seed11, 1 kbit/s) that are dark for 500 ms every 1.5 s, at times of their own, over textured ground 20 m
below the camera (20 px a metre). Four kinds of motion:

    pan        the camera tilts to and fro, 200 px/s in the image, 280 px each way: it turns round in most dark times
    yaw        the camera turns about its axis by 0.5 rad/s to and fro, every 1.6 s
    constant   the camera flies to and fro at 10 m/s, which are 200 px/s, 24 m each way
    moving     as pan, and the beacons move on their own, 40 px/s, even between turns

At the end of each dark time the place of the track that the beacon had at its beginning is compared with the true one
(the last Tracks before, extrapolated; period 20 ms), and 300 ms later whether it is still that track's name. Counted
are beacons that were tracked (within 5 px, status valid) when they went dark, and in view throughout. Both arms see
the very same events. Intervals, 95 %: bootstrap over blocks of run x beacon (dark times of one are not independent);
the gain is paired. Evidence: simulated. A second of a scene takes about 5 s of a core.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heliograph.link.modulations import modulation
from heliograph.messages import Message, Tracks
from heliograph.shares import difference, share
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.paths import TruePaths, true_paths
from heliograph_services.decoder.__main__ import SERVICE as DECODER
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import open_stream
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core, warm

BEACONS = 20
BIT_US = 1_000
LIT_US, DARK_US = 1_000_000, 500_000
LATER_US = 300_000
PERIOD_US = 20_000
GATE_PX = 5.0
# Of a dark time: its block (seed, beacon), how far off the track was at its end, and whether it was its track again.
Ending = tuple[tuple[int, int], float, bool]
KINDS = {
    # Tilting by 28.6 degrees/s through f = 400 px moves the image by 200 px/s.
    "pan": "points = [[0, 0, -70, 0], [1.4, 0, -110, 0], [2.8, 0, -70, 0]]\nsmooth_s = 0.2",
    "yaw": "points = [[0, -23, -90, 0], [1.6, 23, -90, 0], [3.2, -23, -90, 0]]\nsmooth_s = 0.2",
    "constant": "",
    "moving": "points = [[0, 0, -70, 0], [1.4, 0, -110, 0], [2.8, 0, -70, 0]]\nsmooth_s = 0.2",
}
ARMS: dict[str, dict[str, Any]] = {
    "centroid": {"prediction": "centroid"},
    "both": {"prediction": "both", "flow": "numba"},
}


def scene(kind: str, seed: int, seconds: float, folder: Path) -> tuple[Path, npt.NDArray[np.int64]]:
    """Write a scenario and its edges; return its path and the (k, n) times at which each beacon goes dark."""
    rng = np.random.default_rng((seed, sorted(KINDS).index(kind)))
    path = '{ kind = "still", at_m = [0, 0, 20] }'
    if kind == "constant":
        path = '{ kind = "shuttle", from_m = [-12, 0, 20], to_m = [12, 0, 20], speed_m_s = 10, turn_s = 0.3 }'
    lines = [
        "duration_s = 60", "irradiance_w_m2 = 20.0", "[camera]", f"path = {path}",
        "[camera.attitude]", KINDS[kind],
        "[ground]", 'texture = "site"', "contrast = 1.5", "grain_m = 3.0",
    ]  # fmt: skip
    dark = []
    for k in range(BEACONS):
        begins = np.arange(int(rng.integers(600_000, 600_000 + LIT_US)), round(seconds * 1e6), LIT_US + DARK_US)
        dark.append(np.resize(begins, int(seconds * 1e6 / (LIT_US + DARK_US)) + 1))
        (folder / f"b{k}.csv").write_text(edges(rng, begins, round(seconds * 1e6)))
        x, y = -10.0 + 5.0 * (k % 5) + rng.uniform(-1.5, 1.5), -7.0 + 4.6 * (k // 5) + rng.uniform(-1.5, 1.5)
        where = f'{{ kind = "still", at_m = [{x:.3f}, {y:.3f}, 0.5] }}'
        if kind == "moving":
            a = rng.uniform(0, 2 * np.pi)
            to = f"{x + 2.0 * np.cos(a):.3f}, {y + 2.0 * np.sin(a):.3f}"
            where = f'{{ kind = "shuttle", from_m = [{x:.3f}, {y:.3f}, 0.5], to_m = [{to}, 0.5], speed_m_s = 2.0 }}'
        lines += [
            "[[beacon]]", f'name = "b{k}"', 'protocol = "seed11"', f"bit_rate = {1e6 / BIT_US:g}",
            f'edges = "{folder / f"b{k}.csv"}"', f"path = {where}",
        ]  # fmt: skip
    out = folder / "scene.toml"
    out.write_text("\n".join(lines) + "\n")
    return out, np.stack(dark)


def edges(rng: np.random.Generator, begins: npt.NDArray[np.int64], until_us: int) -> str:
    """Return the edges of a beacon that sends one payload over and over, and is dark from each of the times on."""
    code = modulation("seed11")
    safe = [payload for payload in range(64) if _fit(code, payload)]
    bits = list(code.encode(int(rng.choice(safe))))
    lines, level = ["t_ns,level"], 0
    for i in range(until_us // BIT_US):
        t_us = i * BIT_US
        hidden = bool(((t_us >= begins) & (t_us < begins + DARK_US)).any())
        now = 0 if hidden else int(bits[i % len(bits)])
        if now != level:
            lines.append(f"{t_us * 1000},{now}")
            level = now
    return "\n".join(lines) + "\n"


def _fit(code: Any, payload: int) -> bool:
    try:
        code.encode(payload)
    except ValueError:
        return False
    return code.advice(payload) is None


def tracked(kind: str, seed: int, seconds: float) -> tuple[TruePaths, npt.NDArray[np.int64], dict[str, list[Tracks]]]:
    """Return the truth, when beacons go dark, and what each arm published."""
    with tempfile.TemporaryDirectory() as name:
        path, dark = scene(kind, seed, seconds, Path(name))
        stream = open_stream(
            EventSourceConfig(
                backend="simulated",
                scenario=str(path),
                seed=seed,
                duration_s=seconds,
                window_us=10_000,
                fidelity="live",
            ),
            ONE_PROCESS,
        )
        decoder = DecoderConfig(tracker_period_us=PERIOD_US, protocol="seed11", bit_rate=1e6 / BIT_US)
        arms = {
            arm: Pipeline(
                make_core(TrackerConfig(period_us=PERIOD_US, **settings), ONE_PROCESS),
                DECODER.make(decoder, ONE_PROCESS),
            )
            for arm, settings in ARMS.items()
        }
        said: dict[str, list[Tracks]] = {arm: [] for arm in ARMS}
        for step in stream:
            for arm, pipeline in arms.items():
                out: list[Message] = pipeline.feed(step.messages)
                said[arm] += [message for message in out if isinstance(message, Tracks)]
        camera = stream.camera
        if not isinstance(camera, SimulatedCamera):
            raise TypeError("the camera must be simulated")
        return true_paths(camera.scene, round(seconds * 1e6)), dark, said


def _at(tracks: list[Tracks], t_us: int) -> Tracks:
    """Return the last message that is not later than a time."""
    return tracks[max(0, t_us // PERIOD_US - tracks[0].as_of_us // PERIOD_US)]


def _nearest(message: Tracks, x: float, y: float) -> tuple[str, float, str]:
    """Return the nearest track, its distance and its status."""
    if not message.track:
        return "", np.inf, ""
    away = np.hypot(np.array(message.x_px) - x, np.array(message.y_px) - y)
    i = int(np.argmin(away))
    return message.track[i], float(away[i]), message.status[i]


def scored(paths: TruePaths, dark: npt.NDArray[np.int64], tracks: list[Tracks], until_us: int) -> dict[Any, Any]:
    """Return, by beacon and dark time, how far off the track was at its end (inf: ended), and if it was it again."""
    out: dict[Any, Any] = {}
    for k in range(BEACONS):
        for begin in np.unique(dark[k]).tolist():
            t0, t1, t2 = begin // PERIOD_US * PERIOD_US, begin + DARK_US, begin + DARK_US + LATER_US
            if t2 > until_us - PERIOD_US or not paths.in_view[k, t0 // 1000 : t2 // 1000].all():
                continue
            x, y = paths.places([t0, t1 // PERIOD_US * PERIOD_US, t2 // PERIOD_US * PERIOD_US])
            name, away, status = _nearest(_at(tracks, t0), float(x[k, 0]), float(y[k, 0]))
            if away > GATE_PX or status != "valid":
                continue
            back = _at(tracks, t1)
            off = np.inf
            if name in back.track:
                i = back.track.index(name)
                off = float(np.hypot(back.x_px[i] - x[k, 1], back.y_px[i] - y[k, 1]))
            again, later, _ = _nearest(_at(tracks, t2), float(x[k, 2]), float(y[k, 2]))
            out[k, begin] = (off, again == name and later <= GATE_PX)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1000, 1001])
    parser.add_argument("--seconds", type=float, default=12.0)
    args = parser.parse_args()
    warm(flow="numba")
    rows = []
    for kind in args.kinds:
        pairs: dict[str, list[Ending]] = {arm: [] for arm in ARMS}
        for seed in args.seeds:
            paths, dark, said = tracked(kind, seed, args.seconds)
            each = {arm: scored(paths, dark, said[arm], round(args.seconds * 1e6)) for arm in ARMS}
            common = set.intersection(*(set(one) for one in each.values()))
            for arm in ARMS:
                pairs[arm] += [((seed, event[0]), *each[arm][event]) for event in sorted(common)]
        rows.append(row(kind, args.seeds, args.seconds, pairs))
        print(json.dumps(rows[-1]), flush=True)
        if args.o is not None:
            result = {"study": "coasting/1", "evidence": "simulated", "fidelity": "live", "rows": rows}
            args.o.write_text(json.dumps(result, indent=1) + "\n")


def row(kind: str, seeds: list[int], seconds: float, pairs: dict[str, list[Ending]]) -> dict[str, Any]:
    """Return the figures of a kind of motion."""
    out: dict[str, Any] = {"kind": kind, "seeds": seeds, "seconds": seconds, "n": len(pairs["both"])}
    blocks = sorted({ending[0] for ending in pairs["both"]})
    index = [blocks.index(ending[0]) for ending in pairs["both"]]
    whole = np.bincount(index, minlength=len(blocks))
    kept = {}
    for arm, values in pairs.items():
        off = np.array([value[1] for value in values])
        p95 = float(np.quantile(off, 0.95, method="higher"))
        kept[arm] = np.bincount(index, [value[2] for value in values], len(blocks))
        out[arm] = {
            "off_px_median": round(float(np.median(off)), 2),
            # None: more than 5 % of the tracks had ended.
            "off_px_p95": round(p95, 1) if math.isfinite(p95) else None,
            "ended": int(np.isinf(off).sum()),
            "within_5_px": round(float((off <= GATE_PX).mean()), 3),
            "same": share(kept[arm], whole).row(),
        }
    out["same_gain"] = difference(kept["both"], kept["centroid"], whole).row()
    return out


if __name__ == "__main__":
    main()
