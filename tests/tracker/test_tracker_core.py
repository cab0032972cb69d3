"""What the tracker publishes, when, and under which names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as changed

from heliograph.errors import Refusal
from heliograph.messages import Status, Tracks
from heliograph.streams import Onsets
from heliograph_services.tracker.core import RESYNC_AFTER
from support.onset_scenes import Disc, Scene, line
from support.tracker_runs import PERIOD, TWO, bodies, cut, feed, feed_all, late_start, new_core, silence


@pytest.mark.parametrize(
    ("window_us", "period_us"), [(5_000, PERIOD), (10_000, PERIOD), (10_000, 13_000), (5_000, 1_000)]
)
@settings(max_examples=15)
@given(sizes=st.lists(st.integers(1, 60), min_size=1, max_size=6))
def test_any_cut_of_the_stream_gives_the_same_bytes(window_us: int, period_us: int, sizes: list[int]) -> None:
    wanted = bodies(feed_all(new_core(cluster_window_us=window_us, period_us=period_us), late_start()))
    assert len(wanted) >= 4
    core = new_core(cluster_window_us=window_us, period_us=period_us)
    assert bodies(feed_all(core, cut(late_start(), sizes))) == wanted


def test_in_lockstep_a_period_shorter_than_a_window_does_not_depend_on_the_cut_either() -> None:
    onsets = list(replace(TWO, tick_us=1_000).onsets(0.3))
    wanted = bodies(feed_all(new_core(lockstep=True, period_us=1_000), onsets))
    assert len(wanted) == 300
    assert bodies(feed_all(new_core(lockstep=True, period_us=1_000), cut(onsets, [1, 2]))) == wanted


def test_between_two_windows_a_period_of_a_millisecond_extrapolates() -> None:
    scene = Scene((Disc(line(60, 60, 200, -100)),))
    out = [m for m in feed(new_core(period_us=1_000), scene.onsets(0.5)) if m.as_of_us > 400_000]
    assert len(out) == 100
    x_px, vx_px_s = np.array([(m.x_px[0], m.vx_px_s[0]) for m in out]).T
    at_s = np.array([m.as_of_us for m in out]) / 1e6
    assert np.abs(x_px - (60 + 200 * at_s)).max() < 0.5
    inside = np.diff(vx_px_s) == 0
    assert inside.sum() >= 79
    assert np.diff(x_px)[inside] == pytest.approx(vx_px_s[1:][inside] / 1e3, abs=0.0021)


def test_live_a_birth_is_published_at_the_end_of_the_window_that_confirms_it_and_in_lockstep_with_the_period() -> None:
    scene = Scene((Disc(line(60, 60), dark_s=((0.0, 0.022),)),))
    first, second, *_ = feed_all(new_core(), scene.onsets(0.2))
    assert (first.track, first.born_us) == (["b00t-0"], [20_000])
    assert first.as_of_us == first.seen_us[0] == 35_000  # the third window with events
    assert first.period_us == PERIOD
    assert second.as_of_us == PERIOD
    assert [m.as_of_us for m in feed_all(new_core(lockstep=True), scene.onsets(0.2))] == [PERIOD, 2 * PERIOD]


def test_a_birth_that_is_confirmed_as_a_period_ends_is_published_once() -> None:
    scene = Scene((Disc(line(60, 60), dark_s=((0.0, 0.0855),)),))
    out = feed_all(new_core(), scene.onsets(0.2))
    assert [m.as_of_us for m in out if m.track] == [PERIOD, 2 * PERIOD]
    assert out[0].seen_us == [PERIOD]


def test_what_is_born_after_its_time_was_published_in_silence_is_published_after_that() -> None:
    scene = Scene((Disc(line(60, 60), dark_s=((0.0, 0.022),)),))
    core = new_core()
    onsets = list(scene.onsets(0.2))
    early = feed_all(core, onsets[:2])
    assert [m.as_of_us for m in core.tick(200_000)] == [PERIOD]  # type: ignore[attr-defined]
    late = feed_all(core, onsets[2:])
    assert not early
    assert [m.as_of_us for m in late] == [PERIOD + 1, 2 * PERIOD]


def test_two_ticks_a_window_are_clustered_together() -> None:
    scene = replace(TWO, tick_us=2_500)
    core = new_core(cluster_window_us=5_000)
    out = feed(core, scene.onsets(0.5))
    assert len(out[-1].track) == 2
    assert core.counters["windows"] == 100


def test_one_message_for_each_multiple_of_the_period_also_when_nothing_is_there() -> None:
    out = feed(new_core(), [silence(30_000, 130_000), silence(130_000, 1_000_000)])
    assert [m.as_of_us for m in out] == list(range(PERIOD, 1_000_001, PERIOD))
    assert all(m.period_us == PERIOD and not m.track for m in out)


def test_the_end_of_a_stream_publishes_a_period_that_it_reached_and_no_other() -> None:
    assert [m.as_of_us for m in feed(new_core(), [silence(0, 200_000, end=True)])] == [PERIOD, 2 * PERIOD]
    assert feed(new_core(), [silence(0, 95_000, end=True)]) == []


def test_tracks_are_named_by_boot_and_number_or_in_lockstep_by_stream(two: list[Onsets]) -> None:
    assert feed(new_core(), two)[-1].track == ["b00t-0", "b00t-1"]
    assert feed(new_core(lockstep=True), two)[-1].track == ["scene-0", "scene-1"]


def test_a_name_fits_a_key_whatever_the_stream_is_called() -> None:
    scene = replace(TWO, stream="s" * 64)
    names = feed(new_core(lockstep=True), scene.onsets(0.2))[-1].track
    assert names
    assert all(len(name) <= 64 for name in names)


def test_a_track_is_born_with_its_first_window_and_published_after_the_third() -> None:
    # Dark until 42 ms: the first window with events is [40, 45) ms.
    scene = Scene((Disc(line(60, 60), dark_s=((0.0, 0.0425),)),))
    first = feed(new_core(), scene.onsets(0.1))[0]
    assert first.born_us == [40_000]
    assert first.seen_us == [100_000]
    assert first.status == ["new"]
    for hits, wanted in ((11, 1), (13, 0)):
        published = feed(new_core(confirm_hits=hits), scene.onsets(0.1))[0]
        assert len(published.track) == wanted


def test_columns_tell_place_size_and_uncertainty(two: list[Onsets]) -> None:
    last = feed(new_core(), two)[-1]
    assert last.x_px == pytest.approx([60, 250], abs=0.5)
    assert last.y_px == pytest.approx([60, 120], abs=0.5)
    assert last.vx_px_s == pytest.approx([0, 50], abs=5)
    assert last.size_px == pytest.approx([29, 29], abs=3)  # pixels of a disc of radius 3
    assert last.radius_px == pytest.approx([3.3, 3.3], abs=0.5)
    assert all(0 < v < 1 for v in last.x_var_px2 + last.y_var_px2)
    assert all(-1 <= p <= 1 for p in last.polarity)


def test_a_new_stream_ends_all_tracks_and_numbers_go_on(two: list[Onsets]) -> None:
    core = new_core()
    feed(core, two)
    again = feed(core, replace(TWO, stream="other").onsets(0.3))
    assert again[0].as_of_us == PERIOD
    assert again[-1].track == ["b00t-2", "b00t-3"]
    assert not core.refusals


def test_a_stream_that_ended_and_starts_over_under_its_name_is_a_new_one(two: list[Onsets]) -> None:
    core = new_core()
    feed(core, two)
    assert feed(core, two)[-1].track == ["b00t-2", "b00t-3"]
    assert not core.refusals


def test_a_camera_of_one_pixel_is_one_track_from_the_first_message_on() -> None:
    scene = Scene((Disc(line(0, 0), bit_rate=500.0),), width=1, height=1, t0_us=25_000)
    core = new_core(lockstep=True)
    out = feed(core, [*scene.onsets(0.5), silence(525_000, 9_000_000, side=1)][:-1])
    assert [m.as_of_us for m in out] == [100_000, 200_000, 300_000, 400_000, 500_000]
    for m in out:
        assert (m.track, m.born_us, m.x_px, m.y_px, m.radius_px) == (["scene-0"], [25_000], [0.0], [0.0], [0.5])
    assert all(m.as_of_us - 50_000 < m.seen_us[0] <= m.as_of_us for m in out)


def test_the_one_pixel_track_outlives_silence_and_an_invalid_verdict() -> None:
    core = new_core()
    feed(core, [silence(0, 100_000, side=1)])
    core.feed(
        Status(camera="cam0", as_of_us=100_000, track=["b00t-0"], status=["invalid"], accepted_us=[-1], identity=[None])
    )
    out = feed(core, [silence(100_000, 9_000_000, side=1)])
    assert out[-1].track == ["b00t-0"]
    assert out[-1].status == ["invalid"]


# -- time --


def test_onsets_that_run_backwards_are_dropped_and_counted(two: list[Onsets]) -> None:
    core = new_core()
    wanted = bodies(feed(new_core(), two))
    out = []
    for i, m in enumerate(two):
        out += feed(core, [m])
        if i in {20, 50} and not m.end:
            assert feed(core, [two[i - 3]]) == []
    assert bodies(out) == wanted
    assert core.refusals[Refusal.TIME_BACKWARDS] == 2


def test_a_source_that_stays_behind_is_believed_after_a_while() -> None:
    core = new_core()
    feed(core, [silence(10**12, 10**12 + 100_000)])
    out = feed(core, [silence(t, t + 10_000) for t in range(0, 1_000_000, 10_000)])
    assert core.refusals[Refusal.TIME_BACKWARDS] == RESYNC_AFTER
    assert out[-1].as_of_us == 1_000_000


def test_a_lost_message_is_coasted_through(two: list[Onsets]) -> None:
    core = new_core()
    out = feed(core, [m for m in two if not 300_000 <= m.t0_us < 500_000])
    assert [m.as_of_us for m in out] == list(range(PERIOD, 1_000_001, PERIOD))
    assert {tuple(m.track) for m in out} == {("b00t-0", "b00t-1")}
    assert not core.refusals


@pytest.mark.parametrize("gap_us", [1_500_000, 3_600_000_000, 10**15])
def test_a_jump_yields_one_message_and_ends_what_is_too_old(two: list[Onsets], gap_us: int) -> None:
    core = new_core()
    feed(core, [m for m in two if m.t1_us <= 900_000])
    out = feed(core, [silence(900_000 + gap_us, 1_000_000 + gap_us)])
    assert core.refusals[Refusal.TIME_JUMP] == 1
    assert [m.as_of_us for m in out] == [900_000 + gap_us, 1_000_000 + gap_us]
    assert not out[0].track


def test_a_valid_track_coasts_through_a_jump_shorter_than_its_patience(two: list[Onsets]) -> None:
    core = new_core()
    feed(core, [m for m in two if m.t1_us <= 900_000])
    core.feed(
        Status(camera="cam0", as_of_us=900_000, track=["b00t-1"], status=["valid"], accepted_us=[1], identity=[None])
    )
    out = feed(core, [silence(2_400_000, 2_500_000)])
    assert [m.track for m in out] == [["b00t-1"], ["b00t-1"]]
    assert out[0].x_px[0] == pytest.approx(200 + 50 * 2.4, abs=3)


def test_a_message_of_hours_is_refused_and_a_busy_core_answers_at_once() -> None:
    core = new_core()
    assert feed(core, [silence(0, 3_600_000_000)]) == []
    assert core.refusals[Refusal.TIME_JUMP] == 1


# -- bad input --


def test_messages_of_another_camera_or_geometry_are_refused(two: list[Onsets]) -> None:
    core = new_core()
    feed(core, two[:10])
    other, wider = changed(two[10], camera="cam9"), changed(two[10], width=640)
    assert feed(core, [other, wider]) == []
    assert core.refusals == {Refusal.OTHER_CAMERA: 1, Refusal.OTHER_GEOMETRY: 1}
    core.feed(Status(camera="cam9", as_of_us=0, track=[], status=[], accepted_us=[], identity=[]))
    assert core.refusals[Refusal.OTHER_CAMERA] == 2


def test_pixels_off_the_sensor_are_refused(two: list[Onsets]) -> None:
    core = new_core()
    assert feed(core, [changed(two[0], x_px=two[0].x_px + np.uint16(400))]) == []
    assert core.refusals == {Refusal.OFF_SENSOR: 1}


def test_a_flood_is_skipped_and_tracks_coast_through_it(two: list[Onsets]) -> None:
    core = new_core(max_active_pixels=2_000)
    rng = np.random.default_rng(0)
    flooded: list[Onsets] = []
    for m in two:
        if not 300_000 <= m.t0_us < 400_000:
            flooded.append(m)
            continue
        pixel = np.sort(rng.choice(320 * 240, 50_000, replace=False))
        flooded.append(
            changed(
                m,
                tick=np.zeros(len(pixel), np.uint16),
                x_px=(pixel % 320).astype(np.uint16),
                y_px=(pixel // 320).astype(np.uint16),
                on_count=np.ones(len(pixel), np.uint8),
                off_count=np.zeros(len(pixel), np.uint8),
            )
        )
    out = feed(core, flooded)
    assert core.counters["windows_flooded"] == 10
    assert {tuple(m.track) for m in out} == {("b00t-0", "b00t-1")}


# -- the decoder's word --


def test_a_silent_source_is_bridged_by_extrapolated_tracks_and_late_onsets_still_count(two: list[Onsets]) -> None:
    core, plain = new_core(), new_core()
    before = [m for m in two if m.t1_us <= 500_000]
    after = [m for m in two if m.t1_us > 500_000]
    out = feed(core, before)
    assert core.tick(550_000) == []
    bridged = core.tick(820_000)
    assert [m.time_us for m in bridged] == [600_000, 700_000]
    assert isinstance(bridged[1], Tracks)
    assert bridged[1].x_px[1] == pytest.approx(235, abs=2)
    out = feed(core, after)
    assert [m.as_of_us for m in out] == [800_000, 900_000, 1_000_000]
    assert bodies(out) == bodies(feed(plain, two))[-3:]


def test_tracks_that_ended_in_silence_are_left_out_but_come_back_with_late_onsets(two: list[Onsets]) -> None:
    core = new_core()
    feed(core, [m for m in two if m.t1_us <= 500_000])
    bridged = core.tick(1_300_000)
    assert [len(m.track) for m in bridged if isinstance(m, Tracks)] == [2, 2, 2, 0, 0, 0, 0]
    late = feed(core, [changed(m, end=False) for m in two if m.t1_us > 500_000] + [silence(1_000_000, 1_300_000)])
    assert late[-1].track == ["b00t-0", "b00t-1"]


def test_ticks_are_bounded_and_silent_in_lockstep_before_a_stream_and_after_its_end(two: list[Onsets]) -> None:
    assert new_core().tick(10**12) == []
    core = new_core(lockstep=True)
    feed(core, two[:-1])
    assert core.tick(1_500_000) == []
    core = new_core()
    feed(core, two[:-1])
    assert core.tick(10**15) == []
    assert len(core.tick(5_000_000)) == 40
    feed(core, two[-1:])
    assert core.tick(6_000_000) == []
