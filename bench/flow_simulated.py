"""Scenes for `bench_flow.py` from the simulator: its pixels, its noise, its read-out, its source's active gate.

A camera looks straight down and moves evenly; 143 px are a metre of the ground. The sensor is a preset with fewer
pixels (160 x 120), which is a cut-out of its view; noise is the preset's shot noise set to a rate a pixel. "discs" are
beacons of 8 px (1 kbit/s, 5 times the plain ground's radiance), "texture" is the site's ground with patches of 14 px.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec
import numpy as np

from heliograph.streams import Events, Onsets
from heliograph_services.cli.pipeline import ONE_PROCESS
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import open_stream

# Pixels of the whole sensor, and its pitch in um.
PRESETS: Final = {"dvxplorer_mini": (640 * 480, 9.0), "imx636": (1280 * 720, 4.86)}
PX_M: Final = 143.0
FOCAL_MM: Final = 3.6
# 10 m/s at 28 m over rough ground (143 px/s, 2.9 Mev/s), ten beacons, 2.1 Mev/s of shot noise.
LOUD: Final = """
irradiance_w_m2 = 100.0
[camera]
sensor = "dvxplorer_mini"
override = { "pixel.shot_noise_hz" = 7.0 }
path = { kind = "shuttle", from_m = [-6.0, 0.0, 28.0], to_m = [6.0, 0.0, 28.0], speed_m_s = 10.0, turn_s = 0.1 }
[ground]
texture = "site"
contrast = 1.5
grain_m = 1.0
[[crowd]]
count = 10
protocol = "seed11"
bit_rate = 2000
area_m = [-14.0, -14.0, 14.0, 14.0]
"""


@dataclass(frozen=True)
class SimulatedScene:
    """What a camera of a preset sees.

    Args:
        preset: of the sensor.
        what: "discs" or "texture".
        speed_px_s: of the image.
        angle_deg: of its motion, from +x towards +y.
        noise_hz: events a second of the whole sensor, of which this is a cut-out; 0: the preset's own noise.
        seed: of the simulation, and of the beacons' places.
        duration_s: of the scene.
    """

    preset: str
    what: str
    speed_px_s: float
    angle_deg: float
    noise_hz: float
    seed: int
    duration_s: float
    width: int = 160
    height: int = 120
    tick_us: int = 5_000
    radius_px: float = 4.0

    @property
    def kind(self) -> str:
        """The scene's kind in the result."""
        return f"{self.preset} {self.what}"

    @property
    def velocity(self) -> tuple[float, float]:
        """Of the image, px/s."""
        turn = np.deg2rad(self.angle_deg)
        return float(self.speed_px_s * np.cos(turn)), float(self.speed_px_s * np.sin(turn))

    def flow(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return the true motion, the same everywhere."""
        del x_px, y_px
        return self.velocity

    def centres(self, t_s: float) -> Any:
        """Return the (n, 2) centres of the beacons, about 4 of them in view at any time."""
        rng = np.random.default_rng([self.seed, 1])
        velocity = np.array(self.velocity)
        length = self.speed_px_s * self.duration_s
        n = 4 + round(4 * length / self.width)
        start = rng.random((n, 2)) * (self.width, self.height) - rng.random((n, 1)) * velocity * self.duration_s
        return start + velocity * t_s

    def toml(self) -> str:
        """Return the scenario."""
        pixels, pitch_um = PRESETS[self.preset]
        height_m = FOCAL_MM * 1e3 / pitch_um / PX_M
        vx, vy = self.velocity
        # East is right, north is up; the ground moves against the camera.
        east, north = -vx / PX_M, vy / PX_M
        end_s = self.duration_s + 1
        end = f"{east * end_s}, {north * end_s}"
        override = {"sensor.width": self.width, "sensor.height": self.height}
        if self.noise_hz:
            override["pixel.shot_noise_hz"] = self.noise_hz / pixels
        lines = [
            f"duration_s = {end_s}",
            "irradiance_w_m2 = 100.0",
            "[camera]",
            f'sensor = "{self.preset}"',
            "override = { " + ", ".join(f'"{name}" = {value}' for name, value in override.items()) + " }",
            f"lens = {{ focal_mm = {FOCAL_MM}, f_number = 2.0 }}",
            f'path = {{ kind = "waypoints", points = [[0, 0, 0, {height_m}], [{end_s}, {end}, {height_m}]] }}',
        ]
        if self.what == "texture":
            return "\n".join([*lines, "[ground]", 'texture = "site"', "contrast = 1.5", "grain_m = 0.1", ""])
        for i, (x, y) in enumerate(self.centres(0.0).tolist()):
            at = (x - (self.width - 1) / 2) / PX_M, -(y - (self.height - 1) / 2) / PX_M
            lines += [
                "[[beacon]]",
                f'name = "b{i}"',
                'protocol = "seed11"',
                f"payload = 42\nbit_rate = 1000\nstart_us = {1000 * (3 * i % 11)}",
                f"intensity_w_sr = 0.1\ndiameter_m = {2 * self.radius_px / PX_M}",
                f'path = {{ kind = "still", at_m = [{at[0]}, {at[1]}, 0.0] }}',
            ]
        return "\n".join([*lines, ""])

    def onsets(self) -> Iterator[Onsets]:
        """Yield the source's messages."""
        yield from sent(self.toml(), self.seed, self.duration_s, onsets_us=self.tick_us)[1]


def simulated_sensor(scenario: str, seed: int, from_s: float, to_s: float) -> tuple[int, list[Onsets]]:
    """Return the events a second of a scenario (its name or text), and its onsets from a time on."""
    events, onsets = sent(scenario, seed, to_s, fidelity="live")
    return round(events / to_s), [message for message in onsets if message.t0_us >= from_s * 1e6]


def sent(scenario: str, seed: int, duration_s: float, **settings: Any) -> tuple[int, list[Onsets]]:
    """Return the number of events and the onsets that a source sends."""
    with TemporaryDirectory(prefix="heliograph-flow-") as folder:
        if "\n" in scenario:
            path = Path(folder) / "scene.toml"
            path.write_text(scenario, encoding="utf-8")
            scenario = str(path)
        given = {
            "backend": "simulated",
            "scenario": scenario,
            "seed": seed,
            "duration_s": duration_s,
            "window_us": 10_000,
            "tick_us": 5_000,
            **settings,
        }
        events, onsets = 0, []
        for step in open_stream(msgspec.convert(given, EventSourceConfig, strict=False), ONE_PROCESS):
            events += sum(len(message.batch) for message in step.messages if isinstance(message, Events))
            onsets += [message for message in step.messages if isinstance(message, Onsets)]
    return events, onsets
