"""Paths and angles as functions of time, against what a slow sum or common sense says."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph_services.event_source.simulation.world.spec import (
    Attitude,
    Circle,
    Path,
    Shake,
    Shuttle,
    Sine,
    Still,
    Waypoints,
)
from heliograph_services.event_source.simulation.world.trajectory import Angles, Paths, positions

Floats = npt.NDArray[np.float64]
KINDS: list[Path] = [
    Still(at_m=(1.0, 2.0, 3.0)),
    Sine(at_m=(0.0, 1.0, 2.0), amplitude_m=(1.0, -0.5, 0.1), period_s=(2.0, 3.0, 5.0), phase_deg=(10.0, 90.0, 0.0)),
    Circle(centre_m=(1.0, 0.0, 1.0), radius_m=2.0, turn_s=4.0),
    Circle(centre_m=(0.0, 0.0, 0.0), radius_m=0.25, turn_s=-2.0, fastest_turn_s=-0.2, ramp_s=3.0, phase_deg=30.0),
    Shuttle(from_m=(-1.0, 0.0, 0.0), to_m=(2.0, 4.0, 0.0), speed_m_s=2.0, turn_s=0.5),
    Waypoints(points=((0.0, 0.0, 0.0, 1.0), (2.0, 4.0, 0.0, 1.0), (5.0, 0.0, 3.0, 2.0), (6.0, 0.0, 0.0, 1.0))),
    Waypoints(
        points=((0.0, 0.0, 0.0, 1.0), (2.0, 4.0, 0.0, 1.0), (5.0, 0.0, 3.0, 2.0), (6.0, 0.0, 0.0, 1.0)), smooth_s=1.0
    ),
]


def at(path: Path, *t_s: float) -> Floats:
    return positions(path, np.array(t_s, np.float64) * 1e6)


def speeds(path: Path, t_s: Floats, dt_s: float = 1e-4) -> Floats:
    step = positions(path, (t_s + dt_s / 2) * 1e6) - positions(path, (t_s - dt_s / 2) * 1e6)
    return np.asarray(np.linalg.norm(step, axis=1) / dt_s)


def test_many_paths_together_are_each_where_it_is_alone() -> None:
    t_us = np.linspace(0.0, 37e6, 101)
    together = Paths(KINDS).at(t_us)
    assert together.shape == (len(KINDS), 101, 3)
    for path, places in zip(KINDS, together, strict=True):
        np.testing.assert_array_equal(places, positions(path, t_us))


@given(st.integers(0, len(KINDS) - 1), st.lists(st.floats(0.0, 1e9), min_size=1, max_size=5))
@settings(max_examples=60, deadline=None)
def test_a_time_has_one_place_whatever_else_is_asked(kind: int, t_us: list[float]) -> None:
    whole = positions(KINDS[kind], np.array(t_us))
    for i, t in enumerate(t_us):
        np.testing.assert_array_equal(whole[i], positions(KINDS[kind], np.array([t]))[0])


def test_a_sine_is_its_formula() -> None:
    places = at(KINDS[1], 0.5)
    expected = [
        np.sin(np.pi / 2 + np.radians(10)),
        1.0 - 0.5 * np.sin(np.pi / 3 + np.pi / 2),
        2 + 0.1 * np.sin(0.2 * np.pi),
    ]
    np.testing.assert_allclose(places[0], expected, atol=1e-12)


def test_a_circle_begins_in_the_north_and_goes_clockwise() -> None:
    places = at(Circle(centre_m=(0.0, 0.0, 1.0), radius_m=2.0, turn_s=4.0), 0.0, 1.0, 2.0)
    np.testing.assert_allclose(places, [[0, 2, 1], [2, 0, 1], [0, -2, 1]], atol=1e-12)


def test_a_circle_speeds_up_evenly_and_slows_down_again() -> None:
    path = Circle(centre_m=(0.0, 0.0, 0.0), radius_m=0.25, turn_s=2.0, fastest_turn_s=0.1142, ramp_s=20.0)
    t_s = np.array([0.001, 10.0, 19.999, 30.0, 39.999])
    hz = np.array([0.5, (0.5 + 1 / 0.1142) / 2, 1 / 0.1142, (0.5 + 1 / 0.1142) / 2, 0.5])
    np.testing.assert_allclose(speeds(path, t_s), 2 * np.pi * 0.25 * hz, rtol=2e-3)
    # 200 px of radius in an image of 800 px a metre: the speed that the scenario promises.
    assert speeds(path, t_s)[2] * 800.0 == pytest.approx(11_000.0, rel=2e-3)


def test_a_shuttle_stands_until_it_starts_and_keeps_its_speed_between_the_turns() -> None:
    path = Shuttle(from_m=(-1.0, 0.0, 0.0), to_m=(2.0, 4.0, 0.0), speed_m_s=2.0, turn_s=0.5, start_s=3.0)
    one_way = 5.0 / 2.0 + 0.25
    places = at(path, 0.0, 3.0, 3.0 + one_way, 3.0 + 2 * one_way, 3.0 + 1001 * one_way)
    ends = [path.from_m, path.from_m, path.to_m, path.from_m, path.to_m]
    np.testing.assert_allclose(places, np.array(ends, np.float64), atol=1e-9)
    between = np.linspace(3.0 + 0.26, 3.0 + one_way - 0.26, 50)
    np.testing.assert_allclose(speeds(path, between), 2.0, rtol=1e-9)


def test_a_shuttle_turns_with_constant_acceleration() -> None:
    path = Shuttle(from_m=(0.0, 0.0, 0.0), to_m=(5.0, 0.0, 0.0), speed_m_s=2.0, turn_s=0.5)
    turn_at = 5.0 / 2.0 + 0.25
    t_s = turn_at + np.linspace(-0.24, 0.24, 49)
    x = positions(path, t_s * 1e6)[:, 0]
    np.testing.assert_allclose(np.diff(x, 2) / 0.01**2, -2 * 2.0 / 0.5, rtol=1e-6)


def test_rounded_waypoints_are_the_moving_average_of_the_straight_ones() -> None:
    sharp, smooth = KINDS[5], KINDS[6]
    for t_s in (0.0, 0.2, 1.7, 2.0, 3.1, 5.4, 5.9, 604.3):
        window = np.linspace(t_s + 6.0 - 0.5, t_s + 6.0 + 0.5, 20_001)
        middle = (window[1:] + window[:-1]) / 2
        np.testing.assert_allclose(at(smooth, t_s)[0], at(sharp, *middle).mean(axis=0), atol=1e-6)


def test_rounding_leaves_straight_lines_as_they_are() -> None:
    np.testing.assert_allclose(at(KINDS[6], 1.0, 3.5), at(KINDS[5], 1.0, 3.5), atol=1e-9)
    np.testing.assert_allclose(at(KINDS[5], 1.0, 3.5), [[2.0, 0.0, 1.0], [2.0, 1.5, 1.5]], atol=1e-9)


def test_waypoints_rounded_and_not_may_be_computed_together() -> None:
    t_us = np.linspace(0.0, 20e6, 77)
    both = Paths([KINDS[5], KINDS[6]]).at(t_us)
    np.testing.assert_allclose(both[0], positions(KINDS[5], t_us), atol=1e-12)
    np.testing.assert_allclose(both[1], positions(KINDS[6], t_us), atol=1e-12)


def test_the_last_point_need_not_be_the_first_and_then_the_thing_jumps() -> None:
    path = Waypoints(points=((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0)))
    np.testing.assert_allclose(at(path, 0.999, 1.001)[:, 0], [0.999, 0.001], atol=1e-9)


def test_a_whole_turn_between_the_last_angle_and_the_first_is_no_jump() -> None:
    angles = Angles(Attitude(points=((0.0, 0.0, -90.0, 0.0), (10.0, 360.0, -90.0, 0.0)), smooth_s=2.0), None, 0)
    t_us = np.linspace(0.0, 40e6, 4001)
    yaw = angles.at(t_us)[:, 0]
    np.testing.assert_allclose(np.diff(np.unwrap(yaw)), 2 * np.pi / 1000, atol=1e-9)


def test_yaw_turns_and_swings_as_the_file_says() -> None:
    angles = Angles(
        Attitude(yaw_deg=10.0, yaw_rate_deg_s=30.0, yaw_swing_deg=5.0, yaw_swing_s=4.0, roll_deg=3.0), None, 0
    )
    yaw, pitch, roll = np.degrees(angles.at(np.array([1e6]))[0])
    assert (yaw, pitch, roll) == pytest.approx((10 + 30 + 5, -90, 3))


def test_shake_has_the_rms_and_the_band_of_the_file_on_each_axis() -> None:
    shake = Shake(rms_deg=0.3, low_hz=2.0, high_hz=9.0)
    t_us = np.arange(0, 200_000_000, 10_000, dtype=np.float64)
    deg = np.degrees(Angles(Attitude(), shake, 5).at(t_us)) - [0, -90, 0]
    np.testing.assert_allclose(deg.std(axis=0), 0.3, rtol=0.02)
    power = np.abs(np.fft.rfft(deg, axis=0)) ** 2
    hz = np.fft.rfftfreq(len(t_us), 0.01)
    inside = (hz > 1.9) & (hz < 9.1)
    assert (power[inside].sum(axis=0) / power.sum(axis=0) > 0.99).all()
    assert abs(np.corrcoef(deg.T)[0, 1]) < 0.1


def test_shake_depends_on_the_seed_alone() -> None:
    shake = Shake(rms_deg=0.3)
    t_us = np.linspace(0, 1e6, 50)
    first = Angles(Attitude(), shake, 1).at(t_us)
    np.testing.assert_array_equal(first, Angles(Attitude(), shake, 1).at(t_us))
    assert not np.allclose(first, Angles(Attitude(), shake, 2).at(t_us))
