"""The scene of study 9: four moving beacons with new payloads, twelve that are switched on and off (`appearances`).

The switched ones stand in two rows of six in the middle, 90 px and more apart; two moving ones are above and two below.
So few, because their decoder takes half a core of the two that it shares with all the rest.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch, concatenate
from heliograph.streams import Events
from heliograph.truth import Truth
from heliograph_services.cli.studies.appearances import edges
from heliograph_services.cli.studies.paths import TruePaths, true_paths
from heliograph_services.cli.studies.running import Setting, opened
from heliograph_services.cli.studies.verdicts import Sent, sent_frames
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.event_source.simulation.world.crowd import sendable

SENSOR: Final = (640, 480)
SWITCHED: Final = 12
# Before and after, processes settle, or an appearance has no time.
FIRST_S, LAST_S = 1.5, 1.2

SCENARIO: Final = """about = "switched beacons between moving ones"
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
path = {{ kind = "still", at_m = [0, 0, 5] }}
[[crowd]]
prefix = "above"
count = 2
protocol = "seed11"
fresh = true
bit_rate = {rate}
area_m = [-3.4, 1.2, 3.4, 2.6]
speed_m_s = 0.5
intensity_w_sr = 0.1
diameter_m = 0.01
[[crowd]]
prefix = "below"
count = 2
protocol = "seed11"
fresh = true
bit_rate = {rate}
area_m = [-3.4, -2.6, 3.4, -1.2]
speed_m_s = 0.5
intensity_w_sr = 0.1
diameter_m = 0.01
"""
BEACON: Final = """[[beacon]]
name = "{name}"
protocol = "seed11"
bit_rate = {rate}
edges = "{file}"
intensity_w_sr = 0.1
diameter_m = 0.01
path = {{ kind = "still", at_m = [{x:.3f}, {y:.3f}, 0.02] }}
"""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What is played, and what is true of it.

    Args:
        events: all.
        paths: of all beacons.
        sent: frames of the moving ones.
        appearances: (t_us, payload, x_px, y_px) of the switched ones.
    """

    events: EventBatch
    paths: TruePaths
    sent: Sent
    appearances: list[tuple[float, int, float, float]]


@lru_cache(maxsize=1)
def scene(seed: int, seconds: float, bit_rate: int) -> Scene:
    """Simulate the scene of a seed."""
    rng = np.random.default_rng([seed, 9])
    payloads = rng.permutation(sendable("seed11", {}))[:SWITCHED].tolist()
    with tempfile.TemporaryDirectory(prefix="heliograph-study-") as name:
        text, switched = SCENARIO.format(rate=bit_rate), dict[str, tuple[int, npt.NDArray[np.float64]]]()
        for i, payload in enumerate(payloads):
            x, y = (i % 6 - 2.5) * 1.2 + rng.uniform(-0.1, 0.1), (-0.45, 0.45)[i // 6] + rng.uniform(-0.1, 0.1)
            file = Path(name) / f"s{i:02d}.csv"
            lines = edges(payload, seconds, rng, bit_rate)
            file.write_text(lines, encoding="utf-8")
            text += BEACON.format(name=file.stem, rate=bit_rate, file=file, x=x, y=y)
            edge_us = np.array([float(line.partition(",")[0]) for line in lines.splitlines()[1:]]) / 1e3
            switched[file.stem] = payload, edge_us[np.diff(edge_us, prepend=-1e9) > 1e6]
        truths: list[Truth] = []
        batches: list[EventBatch] = []
        with opened(Setting(text, seed, seconds, source={"fidelity": "live"}), Path(name)) as stream:
            camera = stream.camera
            if not isinstance(camera, SimulatedCamera):
                raise TypeError(f"a study's camera must be simulated, not {type(camera).__name__}")
            paths = true_paths(camera.scene, round((seconds + 0.01) * 1e6))
            for step in stream:
                truths += [message for message in step.messages if isinstance(message, Truth)]
                batches += [message.batch for message in step.messages if isinstance(message, Events)]
    wanted = [
        (float(t_us), payload, float(paths.x_px[k, 0]), float(paths.y_px[k, 0]))
        for k, beacon in enumerate(paths.names)
        if beacon in switched
        for payload, starts in (switched[beacon],)
        for t_us in starts
        if FIRST_S * 1e6 <= t_us <= (seconds - LAST_S) * 1e6
    ]
    return Scene(concatenate(batches), paths, sent_frames(truths, paths), sorted(wanted))
