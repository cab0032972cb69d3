"""Fast movers: the time within a window, and curves."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph_services.tracker import turning
from heliograph_services.tracker.tracks import TrackTable
from support.onset_scenes import Disc, Scene, circle, line
from support.tracker_runs import feed, new_core


def moving(turn_rad_s: float, v_px_s: float = 1000.0) -> TrackTable:
    table = TrackTable()
    one = np.ones(1)
    table.append(
        xy_px=np.zeros((1, 2)), var_px2=one, radius_px=one, size_px=one, polarity=one, blinks=one > 0,
        sign=np.ones(1, np.int64), born_us=0, seen_us=0, speed_var=1.0, v_px_s=np.array([[v_px_s, 0.0]]),
    )  # fmt: skip
    table.turn_rad_s[:] = turn_rad_s
    return table


@pytest.mark.parametrize("turn_rad_s", [-20.0, 0.01, 20.0])
def test_a_turning_track_goes_round_its_circle_and_then_straight_on(turn_rad_s: float) -> None:
    table = moving(turn_rad_s)
    until_us = turning.ON_US + 10_000
    state = table.state.copy()
    state[:, :2] += state[:, 2:] * until_us / 1e6
    turning.turn(table, state, 0, until_us)
    radius_px, angle = 1000.0 / turn_rad_s, turn_rad_s * turning.ON_US / 1e6
    v = 1000.0 * np.array([np.cos(angle), np.sin(angle)])
    place = radius_px * np.array([np.sin(angle), 1 - np.cos(angle)]) + 0.01 * v
    np.testing.assert_allclose(state[0], [*place, *v], rtol=1e-6, atol=1e-3)


def test_the_turn_rate_is_learnt_from_corrections_across_the_course() -> None:
    table = moving(0.0)
    for k in range(60):
        # Expected to have turned by what is known of 15 rad/s; the correction turns it by the rest.
        rest = (15.0 - table.turn_rad_s[0]) * 0.005
        table.state[:, 2:] = 1000.0 * np.array([[np.cos(rest), np.sin(rest)]])
        turning.learn(table, np.arange(1), np.array([[1000.0, 0.0]]), (k + 1) * 5_000, 0.005)
        table.seen_us[:] = (k + 1) * 5_000
    assert table.turn_rad_s[0] == pytest.approx(15.0, abs=1.0)


@pytest.mark.parametrize("tick_us", [1_000, 5_000])
def test_a_fast_beacon_is_followed_on_a_line_and_round_a_circle(tick_us: int) -> None:
    paths = (line(20, 20, 700, 300), circle(160, 120, 60, 900))
    scene = Scene(tuple(Disc(path, 3.0) for path in paths), step_us=100, seed=3, tick_us=tick_us)
    out = feed(new_core(period_us=20_000), scene.onsets(0.35))
    worst = 0.0
    for message in [m for m in out if m.as_of_us >= 200_000]:
        assert len(message.track) == 2
        for path in paths:
            x_px, y_px = path(message.as_of_us / 1e6)
            worst = max(worst, float(np.hypot(np.array(message.x_px) - x_px, np.array(message.y_px) - y_px).min()))
    assert worst < (0.6 if tick_us == 1_000 else 2.5)
