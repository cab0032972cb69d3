"""Beacons that come into view at random instants: the scene of `study_acquisition`, and when they do.

24 beacons of `seed11` at 2 kbit/s are switched on for ON_S, dark for DARK_S between; 12 more send all the time and come
out from under two boards that pass over them. Each sends a payload of its own.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from heliograph.link.modulations import modulation
from heliograph_services.event_source.simulation.world.crowd import sendable
from heliograph_services.event_source.simulation.world.load import load_scenario

BIT_RATE: Final = 2_000
SWITCHED, COVERED = 24, 12
ON_S, DARK_S = 0.8, (3.0, 4.2)
BOARD_SPEED_M_S: Final = 2.5
# Before and after, processes warm up, or an appearance has no time.
FIRST_S, LAST_S = 2.0, 1.2

# A field of 7 x 6 places 0.9 m (72 px) apart, under boards 7 m long that run along two of its rows.
BOARD: Final = """
[[asset]]
name = "board{i}"
size_m = [7.0, 0.5]
path = {{ kind = "shuttle", from_m = [{begin}, {y}, 0.3], to_m = [{end}, {y}, 0.3], speed_m_s = {speed}, turn_s = 0.1 }}
"""
CAMERA: Final = """
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
mode = "VARIABLE_15000"
path = { kind = "still", at_m = [0.0, 0.0, 5.0] }
"""
BEACON: Final = """
[[beacon]]
name = "b{i:02d}"
protocol = "seed11"
bit_rate = {rate}
{sends}
intensity_w_sr = 0.1
diameter_m = 0.01
path = {{ kind = "still", at_m = [{x:.3f}, {y:.3f}, 0.02] }}
"""


@dataclass(frozen=True, slots=True)
class Appearance:
    """A beacon comes into view at t_us of the camera, for so long."""

    payload: int
    kind: str
    t_us: float
    until_us: float
    x_px: float
    y_px: float


def scene(seed: int, seconds: float, folder: Path) -> Path:
    """Write the scenario and the switched beacons' edges; return its file."""
    rng = np.random.default_rng([seed, 2_000])
    payloads = rng.permutation(sendable("seed11", {}))[: SWITCHED + COVERED]
    text = [CAMERA]
    for i, y in enumerate((-1.35, 1.35)):
        # Each begins beside the field, at either end.
        text.append(BOARD.format(i=i, y=y, begin=-8.0 + 16.0 * i, end=8.0 - 16.0 * i, speed=BOARD_SPEED_M_S))
    rows = {"switched": (-2.25, -0.45, 0.45, 2.25), "covered": (-1.35, 1.35)}
    places = [(kind, x, y) for kind, ys in rows.items() for y in ys for x in (np.arange(6) - 2.5) * 1.2]
    for i, ((kind, x, y), payload) in enumerate(zip(places, payloads, strict=True)):
        sends = f"payload = {payload}\nstart_us = {rng.integers(0, 5_500)}"
        if kind == "switched":
            file = folder / f"b{i:02d}.csv"
            file.write_text(edges(int(payload), seconds, rng, BIT_RATE))
            sends = f'edges = "{file}"'
        jitter = rng.uniform(-0.1, 0.1, 2) * (kind == "switched", kind == "switched")
        text.append(BEACON.format(i=i, rate=BIT_RATE, sends=sends, x=x + jitter[0], y=y + jitter[1]))
    path = folder / "scene.toml"
    path.write_text("".join(text))
    (folder / "payloads.json").write_text(json.dumps([int(p) for p in payloads]))
    return path


def edges(payload: int, seconds: float, rng: np.random.Generator, bit_rate: int) -> str:
    """Return a beacon's edges: off, then frames for ON_S from a random instant on, again and again."""
    bits = np.array(modulation("seed11").encode(payload))
    frames = round(ON_S * bit_rate / len(bits))
    level = np.concatenate([[0], np.tile(bits, frames), [0]])
    change = np.flatnonzero(np.diff(level)) + 1
    lines, t_s = ["t_ns,level"], float(rng.uniform(0.5, 4.5))
    while t_s < seconds:
        lines += [f"{round(1e9 * (t_s + (k - 1) / bit_rate))},{level[k]}" for k in change]
        t_s += ON_S + float(rng.uniform(*DARK_S))
    return "\n".join(lines)


def appearances(path: Path, seed: int, seconds: float) -> list[Appearance]:
    """Return the appearances that a run is scored by, from the simulation's own world."""
    world = _world(path, seed)
    payloads = json.loads((path.parent / "payloads.json").read_text())
    t_us = np.arange(0.0, seconds * 1e6, 1_000.0)
    seen = world.seen_all(t_us)
    found: list[Appearance] = []
    for i, payload in enumerate(payloads):
        x, y = float(seen.x_px[i, 0]), float(seen.y_px[i, 0])
        if i < SWITCHED:
            lines = (path.parent / f"b{i:02d}.csv").read_text().splitlines()[1:]
            edge_us = np.array([float(line.partition(",")[0]) for line in lines]) / 1e3
            first = np.flatnonzero(np.diff(edge_us, prepend=-1e9) > 1e6)
            last = np.append(first[1:], len(edge_us)) - 1
            found += [
                Appearance(payload, "switched", a, b, x, y) for a, b in zip(edge_us[first], edge_us[last], strict=True)
            ]
        else:
            clear = np.asarray(seen.visible[i]).astype(np.int8)
            step = np.diff(clear, prepend=1, append=0)
            begins, ends = np.flatnonzero(step == 1), np.flatnonzero(step == -1)
            found += [
                Appearance(payload, "uncovered", float(t_us[a]), float(t_us[ends[ends > a][0] - 1]), x, y)
                for a in begins
            ]
    chosen = [a for a in found if FIRST_S * 1e6 <= a.t_us <= (seconds - LAST_S) * 1e6]
    return sorted(chosen, key=lambda a: a.t_us)


def _world(path: Path, seed: int) -> Any:
    from heliograph_services.event_source.simulation.stream import SceneStream  # noqa: PLC0415 - compiles

    return SceneStream(load_scenario(str(path)), seed, "full", 0.0, lambda _: None).world
