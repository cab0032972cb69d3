"""A light that turned while it was not seen is found again, and an edge that trembles in place is no light."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.core import Context
from heliograph_services.tracker import recovery, shape
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import TrackerCore
from heliograph_services.tracker.tracks import TrackTable
from support.onset_scenes import Disc, Scene, line
from support.tracker_runs import feed_all, new_core


def table(x_px: list[float], seen_us: list[int], born_us: list[int]) -> TrackTable:
    """Return rows in a line, of radius 3 px."""
    out = TrackTable()
    for i, (x, seen, born) in enumerate(zip(x_px, seen_us, born_us, strict=True)):
        out.append(
            xy_px=np.array([[x, 50.0]]), var_px2=np.ones(1), radius_px=np.array([3.0]), size_px=np.array([29.0]),
            polarity=np.zeros(1), blinks=np.ones(1, np.bool_), sign=np.zeros(1, np.int64), born_us=born, seen_us=seen,
            speed_var=1e4,
        )  # fmt: skip
        out.number[i] = i
    return out


def test_what_turns_by_a_known_acceleration_is_within_reach_and_the_gate_in_pixels_ends_it() -> None:
    rows = table([0.0, 0.0, 0.0], [100_000, 60_000, 0], [0, 0, 0])
    found = recovery.reach_px(rows, np.arange(3), 100_000, TrackerConfig(gate_px=40.0))
    assert found.tolist() == pytest.approx([3.0, 3.0 + 0.5 * 20_000 * 0.04**2, 43.0])


def test_a_birth_is_the_nearest_track_that_was_lost_before_it_began() -> None:
    rows = table([10.0, 18.0, 22.0, 20.0], [50_000, 50_000, 100_000, 100_000], [0, 0, 0, 90_000])
    assert recovery.lost(rows, 3, np.array([0, 1, 2]), TrackerConfig()) == 1
    assert recovery.lost(rows, 3, np.array([2]), TrackerConfig()) is None


@pytest.mark.parametrize(
    ("events", "both", "at_once", "expected"),
    [(20, 0, False, False), (24, 0, False, True), (20, 5, False, True), (20, 4, False, False), (20, 0, True, True)],
)
def test_pixels_that_fire_twice_or_both_ways_or_at_once_are_a_switched_light(
    events: int, both: int, at_once: bool, expected: bool
) -> None:
    found = shape.is_switched(np.array([20]), np.array([events]), np.array([both]), np.array([at_once]))
    assert found.tolist() == [expected]


def test_a_beacon_that_turns_behind_a_post_keeps_its_name() -> None:
    def path(t_s: float) -> tuple[float, float]:
        x, y = line(80, 80, 150.0)(min(t_s, 0.5))
        return x, y + 150.0 * max(0.0, t_s - 0.5)

    scene = Scene((Disc(path, 3.0, 2000.0),), step_us=100, seed=3)
    names: set[str] = set()
    lost = [m for m in scene.onsets(0.9) if not 480_000 <= m.t0_us < 560_000]
    core = TrackerCore(TrackerConfig(), Context("tracker", "0", lockstep=False))
    for m in lost:
        for tracks in core.feed(m):
            names.update(getattr(tracks, "track", []))
    assert len(names) == 1
    assert core.counters["tracks_found_again"] == 1


def test_nothing_is_found_again_where_nothing_was_lost() -> None:
    core = new_core()
    feed_all(core, Scene((Disc(line(60, 60, 100.0), 3.0, 1000.0),), step_us=100).onsets(0.5))
    assert core.counters["tracks_found_again"] == 0
