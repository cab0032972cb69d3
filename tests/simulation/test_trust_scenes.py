"""What the simulator is trusted for, seen from outside: a scenario in, events out, the laws worked out here again."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from heliograph_services.event_source.simulation.contract import (
    CHUNK_US,
    NODES,
    SHOT_NOISE,
    Floats,
    Ints,
    LightChunk,
    PixelNumbers,
)
from heliograph_services.event_source.simulation.pixel.array import PixelArray
from heliograph_services.event_source.simulation.readout.presets import load_preset
from heliograph_services.event_source.simulation.stream import SceneStream
from heliograph_services.event_source.simulation.world.load import parse_scenario
from support.pixel_scenes import flat_view

FINE = 0.02  # threshold of ln(light) that contrasts and places are read with
F_PX = {3.6: 400.0, 16.0: 16_000 / 9.0}  # of 9 um
SCENE = """
irradiance_w_m2 = {irradiance}
[camera]
sensor = "ideal"
lens = {{ focal_mm = {focal}, f_number = 2.0 }}
path = {{ kind = "still", at_m = {camera} }}
attitude = {{ yaw_deg = {yaw}, pitch_deg = {pitch} }}
[camera.override]
"pixel.threshold_on" = {fine}
"pixel.threshold_off" = {fine}
"readout.queue_events" = 16000000
[[beacon]]
name = "a"
protocol = "seed11"
payload = 42
bit_rate = 500
diameter_m = {diameter}
path = {path}
"""


def events_of(text: str, until_us: int) -> tuple[Floats, Ints, Ints, Ints]:
    """Return times, x, y and +1 or -1 of a scenario's events."""
    parts = []
    for piece in SceneStream(parse_scenario(text, "test"), 1):
        batch = piece.batch
        parts.append(np.stack([batch.t_us, batch.x_px, batch.y_px, np.where(batch.on, 1, -1)]).astype(np.int64))
        if piece.until_us >= until_us:
            break
    table = np.concatenate(parts, axis=1)
    return table[0].astype(np.float64), table[1], table[2], table[3]


def scene(focal: float, camera: tuple[float, float, float], path: str, **more: float) -> str:
    values = {"irradiance": 100.0, "yaw": 0.0, "pitch": -90.0, "diameter": 0.02, "fine": FINE} | more
    return SCENE.format(focal=focal, camera=list(camera), path=path, **values)


def by_hand(focal: float, camera: Floats, yaw_deg: float, pitch_deg: float, point: Floats) -> tuple[float, float]:
    """Return a point's pixel: a pinhole, forward by yaw (from north, clockwise) and pitch, 640 x 480."""
    yaw, pitch = math.radians(yaw_deg), math.radians(pitch_deg)
    forward = np.array([math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)])
    right = np.array([math.cos(yaw), -math.sin(yaw), 0.0])
    ray = point - camera
    depth = ray @ forward
    return 319.5 + F_PX[focal] * (ray @ right) / depth, 239.5 + F_PX[focal] * (ray @ np.cross(forward, right)) / depth


def rises_of(t_us: Floats, sign: Ints) -> list[float]:
    """Return when the LED goes on: its bits begin each 2 ms; a lit LED that moves makes far fewer events in 40 us."""
    counts = [(t, int(((t_us >= t) & (t_us < t + 40.0) & (sign > 0)).sum())) for t in range(2_000, 60_000, 2_000)]
    return [float(t) for t, count in counts if count > 300]


def centroid_errors(
    focal: float, camera: tuple[float, float, float], yaw: float, pitch: float, speed: float
) -> list[float]:
    """Return how far each ON edge's centroid lies from the projection, px, the larger of x and y.

    Each pixel's n events say that its light rose by exp(n th) - 1 of the ground's: that is the weight.
    """
    end = [5.0, 1.0, 0.0]
    path = '{ kind = "still", at_m = [0.17, 0.21, 0.0] }'
    if speed:
        until_s = math.hypot(*end) / speed
        there_and_back = [[0.0, 0.0, 0.0, 0.0], [until_s, *end], [2 * until_s, 0.0, 0.0, 0.0]]
        path = f'{{ kind = "waypoints", points = {there_and_back} }}'
    t_us, x, y, sign = events_of(scene(focal, camera, path, yaw=yaw, pitch=pitch), 60_000)
    errors = []
    for rise_us in rises_of(t_us, sign):
        mine = (t_us >= rise_us) & (t_us < rise_us + 40.0) & (sign > 0)
        n = np.zeros((480, 640))
        np.add.at(n, (y[mine], x[mine]), 1)
        weight = np.expm1(FINE * (n + 0.5)) * (n > 0)
        j, i = np.indices(n.shape)
        seen = np.array([(weight * i).sum(), (weight * j).sum()]) / weight.sum()
        at = np.array([0.17, 0.21, 0.0])
        if speed:
            at = np.array(end) / math.hypot(*end) * speed * rise_us * 1e-6
        errors.append(float(np.abs(seen - by_hand(focal, np.array(camera), yaw, pitch, at)).max()))
    return errors


POSES = [
    (3.6, (0.0, 0.0, 5.0), 0.0, -90.0, 0.0),
    (3.6, (0.31, -0.27, 11.5), 33.0, -80.0, 0.0),
    (3.6, (-3.0, -6.0, 8.0), 20.0, -50.0, 2.0),
    (16.0, (0.4, 0.3, 16.0), -140.0, -88.0, 2.0),
]


@pytest.mark.parametrize(("focal", "camera", "yaw", "pitch", "speed"), POSES)
def test_the_centroid_of_each_on_edge_is_where_the_world_projects_the_light(
    focal: float, camera: tuple[float, float, float], yaw: float, pitch: float, speed: float
) -> None:
    errors = centroid_errors(focal, camera, yaw, pitch, speed)
    assert len(errors) >= 4
    assert max(errors) < 0.1


def light_ratio(focal: float, distance_m: float) -> float:
    """Return P_px / P_bg of the middle pixel, as the sum of its events tells it."""
    half_px_m = 0.5 * distance_m / F_PX[focal]
    path = f'{{ kind = "still", at_m = [{half_px_m}, {-half_px_m}, 0.0] }}'
    text = scene(focal, (0.0, 0.0, distance_m), path, diameter=0.001)
    _, x, y, sign = events_of(text, 40_000)
    level = np.cumsum(sign[(x == 320) & (y == 240)])
    # Up and down again, between floor - 1 and floor of the step by the threshold: the step is 0 to 2 thresholds more.
    return math.expm1(FINE * (float(np.ptp(level)) + 1.0))


@pytest.mark.parametrize(("focal", "nearest_m"), [(3.6, 3.0), (16.0, 12.0)])
def test_in_a_scene_light_over_ground_falls_by_4_when_the_distance_doubles(focal: float, nearest_m: float) -> None:
    ratios = [light_ratio(focal, nearest_m * 2**k) for k in range(4)]
    assert ratios[0] > 10.0
    for near, far in pairwise(ratios):
        # A threshold either way: FINE of ln(1 + ratio), for each of the two.
        assert near / far == pytest.approx(4.0, rel=FINE * (2 + 1 / near + 1 / far))


def quiet_chunk(t0_us: int) -> LightChunk:
    none = np.empty((0, NODES + 1))
    return LightChunk(t0_us, none, none, none, none, np.empty(0), np.zeros(1, np.int64), np.empty(0), np.empty(0))


@pytest.mark.parametrize("name", ["davis346", "dvxplorer", "dvxplorer_mini", "genx320", "imx636"])
def test_the_shot_noise_of_a_preset_comes_at_its_rate_and_interval(name: str) -> None:
    law: PixelNumbers = load_preset(name).pixel
    size, seconds = 200, 4
    view = flat_view(law.irradiance_ref_w_m2, size, size)
    pixels = PixelArray(law, size, size, 11, view)
    parts = [
        pixels.interval(t, t + CHUNK_US, view, view, quiet_chunk(t)) for t in range(0, seconds * 1_000_000, CHUNK_US)
    ]
    noise_us = np.concatenate([part.t_us[part.cause == SHOT_NOISE] for part in parts])
    expected = law.shot_noise_hz * seconds * size**2
    assert expected > 4_000
    assert len(noise_us) / expected == pytest.approx(1.0, abs=0.05)
    assert stats.kstest(np.diff(noise_us), "expon", args=(0, seconds * 1e6 / expected)).pvalue > 0.01
