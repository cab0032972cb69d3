"""Scenes of the tracker's benches, as texts of scenario files, and as recordings that a source can play.

All numbers are assumed; a lens of 3.6 mm before a DVXplorer Mini sees 400 px per metre of range.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.events import EventBatch, concatenate
from heliograph.streams import Events
from heliograph_services.cli.pipeline import ONE_PROCESS
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import open_stream

SENSOR = "dvxplorer_mini"
MODE = "VARIABLE_15000"
PIXELS = 640 * 480

# The camera flies to and fro at 10 m/s, 28 m above a rough ground: its texture moves at 143 px/s.
BUSY = """
irradiance_w_m2 = 100.0
[camera]
sensor = "dvxplorer_mini"
mode = "VARIABLE_15000"
override = {{ "pixel.shot_noise_hz" = {noise_hz} }}
path = {{ kind = "shuttle", from_m = [-6.0, 0.0, 28.0], to_m = [6.0, 0.0, 28.0], speed_m_s = 10.0, turn_s = 0.1 }}
[ground]
texture = "site"
contrast = {contrast}
grain_m = 1.0
[[crowd]]
count = 20
protocol = "seed11"
bit_rate = 2000
area_m = [-14.0, -10.0, 14.0, 10.0]
"""
# Nothing but noise: the ground is plain and still.
NOISE = """
irradiance_w_m2 = 100.0
[camera]
sensor = "{sensor}"
override = {{ "pixel.shot_noise_hz" = {noise_hz} }}
path = {{ kind = "still", at_m = [0.0, 0.0, 5.0] }}
"""


def busy() -> str:
    """Return the scene of 5 Mev/s: half noise, nearly half moving texture, the rest 20 beacons at 2 kbit/s."""
    return BUSY.format(noise_hz=8.0, contrast=1.35)


def noise(events_hz: float) -> str:
    """Return a scene of noise alone, uniform over a DVXplorer Mini."""
    return NOISE.format(sensor=SENSOR, noise_hz=events_hz / PIXELS)


def events_of(scenario: str, seed: int, duration_s: float, **settings: Any) -> list[EventBatch]:
    """Return the events of a scenario's text or name, simulated, in batches of 20 ms.

    Raises:
        ConfigError: the scenario or a setting is wrong.
    """
    with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as folder:
        name = scenario
        if "\n" in scenario:
            path = Path(folder) / "scenario.toml"
            path.write_text(scenario, encoding="utf-8")
            name = str(path)
        config = EventSourceConfig(
            backend="simulated", scenario=name, seed=seed, duration_s=duration_s,
            window_us=20_000, max_events=1_000_000, **settings,
        )  # fmt: skip
        return [
            message.batch
            for step in open_stream(config, ONE_PROCESS)
            for message in step.messages
            if isinstance(message, Events)
        ]


def write_recording(path: Path, batches: list[EventBatch], width: int, height: int) -> None:
    """Write events as the NPZ that a source plays."""
    every = concatenate(batches)
    np.savez(path, t=every.t_us, x=every.x_px, y=every.y_px, on=every.on, width=width, height=height)
