"""Tracks against a truth worked by hand: alignment in time, occlusions, acquisition, latency, lag."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from heliograph.messages import Tracks
from heliograph_services.cli.studies.tracking_truth import Sample, Score, quantile, sample, score
from support.truth_scenes import Sent, truth

SECOND = 1_000_000
TRUTH_US = 50_000
CRANE = Sent(vx_px_s=100.0)


def samples(
    beacon: Sent, until_us: int, *, since_us: int = 0, step_us: int = 100_000, late_us: int = 0, track: str = "1"
) -> list[Sample]:
    """Return what a tracker says that sees where the beacon was some time ago."""
    times = range(max(step_us, since_us), until_us + 1, step_us)
    return [Sample(t, (track,), np.array([[beacon.x_at(t - late_us), beacon.y_px]])) for t in times]


def test_a_perfect_tracker_scores_one_and_no_error() -> None:
    found = score(truth([CRANE], SECOND, TRUTH_US), samples(CRANE, SECOND)).row()
    assert (found["mota"], found["idf1"], found["switches"], found["rmse_px"]) == (1.0, 1.0, 0, 0.0)
    assert (found["gospa_px"], found["lag_us"], found["instants"], found["objects"]) == (0, 0, 10, 10)
    assert json.loads(json.dumps(found)) == found
    assert found["latency_median_us"] is None


def test_a_tracker_behind_by_20_ms_lags_by_20_ms() -> None:
    found = score(truth([CRANE], SECOND, TRUTH_US), samples(CRANE, SECOND, late_us=20_000))
    assert found.lag_us == pytest.approx(20_000)
    assert found.clear.rmse_px == pytest.approx(2.0)


def test_between_the_truth_s_times_a_curved_path_is_interpolated_by_a_cubic() -> None:
    messages = truth([CRANE], SECOND, TRUTH_US)

    def x(t_us: int) -> float:
        return 300 * math.sin(3 * t_us / SECOND)

    bent = [msgspec.structs.replace(m, x_px=[x(m.t1_us)]) for m in messages]
    published = [Sample(t, ("1",), np.array([[x(t), CRANE.y_px]])) for t in range(110_000, 940_000, 10_000)]
    # Between ends h apart a cubic is off by at most 3/128 h^4 x'''' = .0036 px, a line by h^2/8 x'' = .84 px.
    assert 0 < score(bent, published).clear.rmse_px < 0.0036


def test_coasting_through_an_occlusion_is_left_out_of_visible_and_scored_in_view() -> None:
    hidden = replace(CRANE, hidden=((400_000, 700_000),))
    messages = truth([hidden], SECOND, TRUTH_US)
    published = samples(hidden, SECOND)
    visible, in_view = score(messages, published, "visible").clear, score(messages, published, "in_view").clear
    # The windows that end at 450 to 700 ms are hidden: instants at 500, 600 and 700.
    assert (visible.objects, visible.false, visible.misses) == (7, 0, 0)
    assert (in_view.objects, in_view.false, in_view.misses) == (10, 0, 0)


def test_a_track_of_nothing_is_false_though_a_hidden_beacon_is_elsewhere() -> None:
    hidden = replace(CRANE, hidden=((0, SECOND),))
    published = [Sample(500_000, ("1", "2"), np.array([[hidden.x_at(500_000), 100.0], [10.0, 10.0]]))]
    counts = score(truth([hidden], SECOND, TRUTH_US), published).clear
    assert (counts.objects, counts.false) == (0, 1)


def test_the_gate_is_five_pixels_or_the_blob_s_radius() -> None:
    for radius_px, misses in ((3.0, 1), (8.0, 0)):
        beacon = Sent(radius_px=radius_px)
        published = [Sample(500_000, ("1",), np.array([[beacon.x_px + 7.0, beacon.y_px]]))]
        assert score(truth([beacon], SECOND, TRUTH_US), published).clear.misses == misses


def acquired(found: Score) -> list[tuple[int, int | None]]:
    return [(a.start_us, a.after_us) for a in found.acquisitions]


def test_acquisition_runs_from_the_begin_of_an_interval_to_the_first_publication_that_has_the_beacon() -> None:
    twice = replace(CRANE, outside=((1_000_000, 1_500_000),))
    messages = truth([twice], 3 * SECOND, TRUTH_US)
    published = [s for s in samples(twice, 3 * SECOND, since_us=300_000) if not 1_000_000 < s.t_us < 1_800_000]
    found = score(messages, published)
    assert acquired(found) == [(0, 300_000), (1_500_000, 300_000)]
    told = [replace(s, published_us=s.t_us + 40_000) for s in published]
    later = score(messages, told)
    assert acquired(later) == [(0, 340_000), (1_500_000, 340_000)]
    assert later.row()["latency_p95_us"] == 40_000


def test_failures_are_kept_and_short_glimpses_are_not_held_against_the_tracker() -> None:
    beacons = [Sent("a"), Sent("b", x_px=200.0), Sent("c", x_px=300.0, outside=((300_000, 2_000_000),))]
    found = score(truth(beacons, 2 * SECOND, TRUTH_US), samples(beacons[0], 2 * SECOND)).row()
    assert found["acquisitions"] == 2
    assert found["never_acquired_in_1_s"] == 0.5
    assert found["acquisition_median_us"] == 100_000
    assert found["acquisition_p95_us"] is None


def test_published_tracks_become_a_sample() -> None:
    tracks = Tracks(
        camera="cam0", as_of_us=100_000, period_us=100_000, track=["x-1"], born_us=[0], seen_us=[95_000],
        x_px=[1.0], y_px=[2.0], vx_px_s=[0.0], vy_px_s=[0.0], x_var_px2=[1.0], x_vx_cov_px2_s=[0.0],
        vx_var_px2_s2=[1.0], y_var_px2=[1.0], y_vy_cov_px2_s=[0.0], vy_var_px2_s2=[1.0], radius_px=[3.0],
        size_px=[20.0], polarity=[0.0], status=["new"],
    )  # fmt: skip
    found = sample(tracks, 120_000)
    assert (found.t_us, found.track, found.xy_px.tolist(), found.published_us) == (
        100_000, ("x-1",), [[1.0, 2.0]], 120_000,
    )  # fmt: skip


def test_truths_with_a_gap_or_other_beacons_are_refused() -> None:
    messages = truth([CRANE], SECOND, TRUTH_US)
    renamed = msgspec.structs.replace(messages[1], beacon=["lift"])
    for wrong in ([], [messages[0], messages[2]], [messages[0], renamed]):
        with pytest.raises(ValueError, match="truths must"):
            score(wrong, [])


def test_without_samples_nothing_is_known() -> None:
    found = score(truth([CRANE], SECOND, TRUTH_US), []).row()
    assert (found["instants"], found["mota"], found["gospa_px"], found["lag_us"]) == (0, None, None, None)
    assert found["never_acquired_in_1_s"] == 1.0


def test_a_quantile_is_the_smallest_value_that_the_share_does_not_exceed() -> None:
    assert quantile([5, 1, 3, 2, 4], 0.5) == 3
    assert quantile([1, 2], 0.5) == 1
    assert quantile([1, 2, math.inf], 0.95) == math.inf
    assert math.isnan(quantile([], 0.5))
