"""Scores of small cases that can be worked by hand; the definitions are those of docs/metrics.md.

Frames of 11 ms end at 11, 22, ... ms. The grace is max(0.5 s, 5 frames): frames that begin at or after 0.5 s count,
and the first such begins at 506 ms (number 46 from 0). In 2 s, frames end 181 times, so 181 - 46 = 135 count.
"""

from __future__ import annotations

from collections import Counter

import msgspec
import pytest

from heliograph.core import Context
from heliograph.messages import Message
from heliograph.site import Beacon
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.core import MetricsCore
from heliograph_services.metrics_sink.rows import AcquisitionRow, SightingRow
from support.truth_scenes import Said, Sent, link, shifted, state, text, tracks, truth

CONTEXT = Context(instance="metrics_sink", boot="b0", lockstep=True)
UNTIL_US = 2_000_000
FRAMES = 181
COUNTED = 135


def run(messages: list[Message], config: MetricsSinkConfig | None = None) -> tuple[Counter[str], MetricsCore]:
    core = MetricsCore(config or MetricsSinkConfig(file=""), CONTEXT)
    out: list[Message] = []
    for message in sorted(messages, key=lambda each: each.time_us):
        out += core.feed(message)
    out += core.close()
    total: Counter[str] = Counter()
    for metrics in out:
        for name, n in metrics.counters.items():  # type: ignore[attr-defined]
            total[name.removeprefix("cam0/")] += n
    return total, core


def test_all_frames_right_is_mar_one() -> None:
    beacon = Sent()
    counts, _ = run([*truth([beacon], UNTIL_US), *Said().all_of(beacon, UNTIL_US).messages()])
    assert counts["frames"] == FRAMES
    assert counts["sent_visible/crane"] == counts["right_visible/crane"] == COUNTED
    assert counts["sent_in_view/crane"] == counts["right_in_view/crane"] == COUNTED
    assert counts["right/seed11"] == FRAMES
    assert counts["wrong/seed11"] == counts["insertions/seed11"] == counts["unscored_frames"] == 0


def test_nothing_published_is_mar_zero() -> None:
    counts, _ = run([*truth([Sent()], UNTIL_US)])
    assert counts["sent_visible/crane"] == COUNTED
    assert counts["right_visible/crane"] == 0
    assert counts["bits_visible/crane"] == 11 * COUNTED
    assert counts["bits_right/crane"] == 0


def test_a_wrong_payload_is_wrong_and_its_bits_count_by_slot() -> None:
    """1110 101010 1 against 1110 101011 0 (payload 43, even parity): 9 of 11 bits are right."""
    said = Said()
    beacon = Sent()
    for number, end in enumerate(beacon.ends(UNTIL_US)):
        said.add(end, 43 if number == 100 else 42)
    counts, _ = run([*truth([beacon], UNTIL_US), *said.messages()])
    assert counts["wrong/seed11"] == 1
    assert counts["wrong_visible/crane"] == 1
    assert counts["right_visible/crane"] == COUNTED - 1
    assert counts["bits_right/crane"] == 11 * COUNTED - 2


def test_a_missing_frame_loses_all_its_bits() -> None:
    beacon = Sent()
    said = Said().all_of(beacon, UNTIL_US)
    del said.rows[100]
    counts, _ = run([*truth([beacon], UNTIL_US), *said.messages()])
    assert counts["right_visible/crane"] == COUNTED - 1
    assert counts["bits_right/crane"] == 11 * (COUNTED - 1)


def test_a_second_copy_of_a_frame_is_an_insertion() -> None:
    beacon = Sent()
    said = Said().all_of(beacon, UNTIL_US).add(beacon.ends(UNTIL_US)[100] + 2_000)
    counts, _ = run([*truth([beacon], UNTIL_US), *said.messages()])
    assert counts["right/seed11"] == FRAMES
    assert counts["insertions/seed11"] == 1


@pytest.mark.parametrize("off_us", [-2_000, 2_000])
def test_of_two_frames_the_one_nearer_in_time_matches(off_us: int) -> None:
    """A wrong copy 2 ms before or after the right one takes nothing from it; so does one nearer in place alone."""
    beacon = Sent()
    end = beacon.ends(UNTIL_US)[100]
    said = Said().all_of(beacon, UNTIL_US).add(end + off_us, 43)
    said.rows = [(*row[:4], row[4] + (2.0 if row[0] == end else 0.0), row[5]) for row in said.rows]
    counts, _ = run([*truth([beacon], UNTIL_US), *said.messages()])
    assert (counts["right/seed11"], counts["wrong/seed11"], counts["insertions/seed11"]) == (FRAMES, 0, 1)


@pytest.mark.parametrize(("late_us", "matches"), [(5_500, True), (5_501, False), (-5_500, True), (-5_501, False)])
def test_the_end_matches_within_half_a_frame(late_us: int, matches: bool) -> None:
    end = Sent().ends(UNTIL_US)[100]
    counts, _ = run([*truth([Sent()], UNTIL_US), *Said().add(end + late_us).messages()])
    # Half a frame off, it is as near to the next frame's end.
    found = counts["right/seed11"]
    assert found == 1
    alone, _ = run([*only_frame(100), *Said().add(end + late_us).messages()])
    assert alone["right/seed11"] == (1 if matches else 0)
    assert alone["insertions/seed11"] == (0 if matches else 1)


def only_frame(number: int) -> list[Message]:
    """The truth of a beacon that sends one frame in 2 s."""
    end = Sent().ends(UNTIL_US)[number]
    windows = truth([Sent()], UNTIL_US)
    kept: list[Message] = []
    for window in windows:
        keep = [i for i, t1_us in enumerate(window.frame_t1_us) if t1_us == end]
        columns = {name: [getattr(window, name)[i] for i in keep] for name in FRAME_COLUMNS}
        kept.append(msgspec.structs.replace(window, **columns))
    return kept


FRAME_COLUMNS = (
    "frame_beacon",
    "frame_t0_us",
    "frame_t1_us",
    "frame_payload",
    "frame_x_px",
    "frame_y_px",
    "frame_visible",
)


@pytest.mark.parametrize(
    ("radius_px", "off_px", "matches"), [(3.0, 5.0, True), (3.0, 5.01, False), (8.0, 8.0, True), (8.0, 8.01, False)]
)
def test_the_place_matches_within_five_pixels_or_the_radius(radius_px: float, off_px: float, matches: bool) -> None:
    beacon = Sent(radius_px=radius_px)
    said = Said()
    for end in beacon.ends(UNTIL_US):
        said.add(end, x_px=100.0 + off_px)
    counts, _ = run([*truth([beacon], UNTIL_US), *said.messages()])
    assert counts["right/seed11"] == (FRAMES if matches else 0)
    assert counts["insertions/seed11"] == (0 if matches else FRAMES)


def test_a_frame_of_another_protocol_is_an_insertion() -> None:
    beacon = Sent()
    said = Said().all_of(beacon, UNTIL_US).add(beacon.ends(UNTIL_US)[100], protocol="code")
    counts, _ = run([*truth([beacon], UNTIL_US), *said.messages()])
    assert counts["right/seed11"] == FRAMES
    assert counts["insertions/code"] == 1


def test_frames_match_across_the_border_of_a_second() -> None:
    """The frame that ends at 1001 ms is published as having ended at 998 ms, the one at 990 at 989."""
    beacon = Sent()
    said = Said()
    for end in beacon.ends(UNTIL_US):
        said.add(end - (3_000 if end == 1_001_000 else 1_000 if end == 990_000 else 0))
    counts, _ = run([*truth([beacon], UNTIL_US), *said.messages()])
    assert counts["right/seed11"] == FRAMES
    assert counts["insertions/seed11"] == 0


def test_occluded_frames_count_in_view_but_not_as_visible() -> None:
    """Hidden from 1 s to 1.2 s: frames that touch it are not visible, nor those that begin within 0.5 s after it.

    Of the 135, those that end up to 1 s count as visible: the first counted begins at 506 ms (ends 517), the last ends
    at 990 ms: (990 - 517) / 11 + 1 = 44. After it, frames that begin at 1.7 s or later: the first begins at 1.705 s,
    ends at 1.716 s: (1991 - 1716) / 11 + 1 = 26.
    """
    beacon = Sent(hidden=((1_000_000, 1_200_000),))
    counts, _ = run([*truth([beacon], UNTIL_US), *Said().all_of(beacon, UNTIL_US).messages()])
    assert counts["sent_visible/crane"] == 44 + 26
    assert counts["sent_in_view/crane"] == COUNTED


def test_frames_out_of_view_count_nowhere() -> None:
    beacon = Sent(outside=((0, 2_000_000),))
    counts, _ = run([*truth([beacon], UNTIL_US), *Said().all_of(beacon, UNTIL_US).messages()])
    assert counts["sent_visible/crane"] == counts["sent_in_view/crane"] == 0


def test_frames_without_truth_are_not_scored() -> None:
    beacon = Sent()
    windows = [w for w in truth([beacon], UNTIL_US) if not 700_000 <= w.t0_us < 800_000]
    counts, _ = run([*windows, *Said().all_of(beacon, UNTIL_US).messages()])
    ends = [end for end in beacon.ends(UNTIL_US) if 700_000 < end <= 800_000]
    assert counts["unscored_frames"] == len(ends)
    assert counts["insertions/seed11"] == 0
    assert counts["truth_gap_us"] == 100_000


def test_close_pairs_are_a_class_of_their_own() -> None:
    """Two beacons of radius 3 px, 12 px apart: within two diameters; 13 px are not."""
    for apart_px, close in ((12.0, COUNTED), (13.0, 0)):
        pair = [Sent(), Sent(name="lift", x_px=100.0 + apart_px, payload=41)]
        counts, _ = run([*truth(pair, UNTIL_US)])
        assert counts["sent_close/crane"] == counts["sent_close/lift"] == close


def test_each_of_two_near_frames_goes_to_the_nearer_beacon() -> None:
    pair = [Sent(), Sent(name="lift", x_px=104.0, payload=41)]
    said = Said().all_of(pair[0], UNTIL_US, "t-0").all_of(pair[1], UNTIL_US, "t-1")
    counts, _ = run([*truth(pair, UNTIL_US), *said.messages()])
    assert counts["right/seed11"] == 2 * FRAMES
    assert counts["wrong/seed11"] == 0


def test_characters_have_an_error_rate_of_their_own() -> None:
    beacon = Sent(name="gate", protocol="uart", payload=ord("a"))
    said = Said().all_of(beacon, UNTIL_US)
    said.rows[100] = (*said.rows[100][:3], ord("b"), *said.rows[100][4:])
    del said.rows[120]
    counts, _ = run([*truth([beacon], UNTIL_US), *said.messages(), text(900_000, "a" * 7)])
    assert (counts["sent_text/uart"], counts["right_text/uart"], counts["wrong_text/uart"]) == (COUNTED, COUNTED - 2, 1)
    assert counts["characters"] == 7


def test_bits_follow_the_options_of_the_site() -> None:
    """With the parity of the paper's text, 42 is 1110 101010 0 and 43 is 1110 101011 1: two bits differ, too."""
    listed = Beacon(name="crane", protocol="seed11", payload=42, bit_rate=1000.0, options={"parity": "paper_text"})
    said = Said()
    for end in Sent().ends(UNTIL_US):
        said.add(end, 43)
    config = MetricsSinkConfig(file="", beacons=(listed,))
    counts, _ = run([*truth([Sent()], UNTIL_US), *said.messages()], config)
    assert counts["bits_right/crane"] == 9 * COUNTED


def test_an_identification_where_no_beacon_is_is_a_false_alarm() -> None:
    counts, _ = run([*truth([Sent()], UNTIL_US), state(700_000, x_px=300.0)])
    assert (counts["judged"], counts["false_alarms"], counts["confusions"]) == (1, 1, 0)


def test_another_beacons_name_is_a_confusion() -> None:
    counts, _ = run([*truth([Sent()], UNTIL_US), state(700_000, beacon="lift", payload=41)])
    assert (counts["judged"], counts["false_alarms"], counts["confusions"]) == (1, 0, 1)


def test_a_beacon_that_the_site_does_not_list_is_known_by_its_payload() -> None:
    for payload, confusions in ((42, 0), (41, 1)):
        name = f"seed11:{payload}"
        counts, _ = run([*truth([Sent()], UNTIL_US), state(700_000, beacon=name, payload=payload)])
        assert (counts["judged"], counts["confusions"]) == (1, confusions)


def test_a_moving_beacon_is_found_between_two_windows() -> None:
    """At 2000 px/s it moves 20 px in a window of 10 ms; the place at the identification's own time counts."""
    beacon = Sent(vx_px_s=2000.0)
    counts, _ = run([*truth([beacon], UNTIL_US), state(705_000, x_px=beacon.x_at(705_000))])
    assert (counts["judged"], counts["false_alarms"]) == (1, 0)


def test_a_refreshed_state_is_no_new_identification() -> None:
    counts, _ = run([*truth([Sent()], UNTIL_US), state(700_000, "refreshed", since_us=600_000, x_px=300.0)])
    assert counts["judged"] == counts["false_alarms"] == 0


def acquisitions(core: MetricsCore) -> list[AcquisitionRow]:
    newest = {(row.beacon, row.began_us): row for row in core.take_rows() if isinstance(row, AcquisitionRow)}
    return sorted(newest.values(), key=lambda row: row.began_us)


def test_acquisition_runs_from_the_first_visible_bit_to_the_first_right_state() -> None:
    beacon = Sent(hidden=((1_000_000, 1_600_000),))
    states = [state(55_000)] + [state(t, "refreshed", since_us=55_000) for t in range(100_000, UNTIL_US, 100_000)]
    _, core = run([*truth([beacon], UNTIL_US), *Said().all_of(beacon, UNTIL_US).messages(), *states])
    first, again = acquisitions(core)
    assert (first.began_us, first.lasted_us, first.occluded_us, first.acquired_us) == (0, 1_000_000, None, 55_000)
    # A state that was merely held through the occlusion acquires nothing: the first right frame afterwards ends at
    # 1.617 s (the one before began in the dark), the next state comes at 1.7 s.
    assert (again.began_us, again.occluded_us, again.acquired_us) == (1_600_000, 600_000, 100_000)


def test_a_beacon_that_is_never_identified_is_kept_as_a_failure() -> None:
    _, core = run([*truth([Sent()], UNTIL_US), *Said().all_of(Sent(), UNTIL_US).messages()])
    (row,) = acquisitions(core)
    assert (row.lasted_us, row.acquired_us) == (UNTIL_US, None)


def test_a_sighting_lasts_from_acceptance_to_loss_and_counts_its_frames() -> None:
    states = [state(55_000), state(155_000, "refreshed", since_us=55_000, x_px=110.0), state(900_000, "lost")]
    _, core = run([*Said().all_of(Sent(), UNTIL_US).messages(), *states])
    newest = {(r.track, r.first_us): r for r in core.take_rows() if isinstance(r, SightingRow)}
    (row,) = newest.values()
    assert (row.beacon, row.first_us, row.last_us, row.ended) == ("crane", 55_000, 900_000, True)
    assert row.frames == len([end for end in Sent().ends(UNTIL_US) if 55_000 <= end <= 900_000])


def test_another_beacon_on_the_same_track_is_another_sighting() -> None:
    states = [state(55_000), state(700_000, "changed", beacon="lift", payload=41)]
    _, core = run([*states, *Said().all_of(Sent(), UNTIL_US).messages()])
    newest = {(r.track, r.first_us): r for r in core.take_rows() if isinstance(r, SightingRow)}
    assert [(r.beacon, r.ended) for r in newest.values()] == [("crane", True), ("lift", True)]


def test_an_identity_that_is_accepted_anew_is_another_sighting() -> None:
    """Its `lost` never came; the new `since_us` tells."""
    states = [state(55_000), state(700_000), state(800_000, "refreshed", since_us=700_000)]
    _, core = run([*states, *Said().all_of(Sent(), UNTIL_US).messages()])
    newest = {(r.track, r.first_us): r for r in core.take_rows() if isinstance(r, SightingRow)}
    assert [(r.first_us, r.last_us, r.ended) for r in newest.values()] == [
        (55_000, 55_000, True),
        (700_000, 800_000, True),
    ]


def test_without_truth_there_are_counts_and_no_score() -> None:
    said = Said(refused={"parity": 2}).all_of(Sent(), UNTIL_US)
    counts, _ = run([*said.messages(), link(500_000, 0.5), link(1_500_000, None), tracks(100_000, ("a", "b"))])
    assert counts["frames"] == FRAMES
    assert counts["refused/parity"] == 2 * len(said.messages())
    assert (counts["mar_estimates"], counts["mar_estimate_ppm"]) == (1, 500_000)
    assert (counts["observed_us"], counts["track_us"]) == (100_000, 200_000)
    assert not any(name.startswith(("sent", "right", "wrong", "insertions", "unscored")) for name in counts)


def test_two_cameras_keep_two_books() -> None:
    beacon = Sent()
    core = MetricsCore(MetricsSinkConfig(file=""), CONTEXT)
    messages: list[Message] = [w for camera in ("cam0", "cam1") for w in truth([beacon], UNTIL_US, camera=camera)]
    for message in [*messages, *Said().all_of(beacon, UNTIL_US).messages(camera="cam1")]:
        core.feed(message)
    counts: Counter[str] = Counter()
    for metrics in core.close():
        counts.update(metrics.counters)  # type: ignore[attr-defined]
    assert counts["cam0/right_visible/crane"] == 0
    assert counts["cam1/right_visible/crane"] == COUNTED


def test_a_stream_that_begins_anew_is_an_epoch_of_its_own() -> None:
    beacon = Sent()
    far_us = 10_000_000
    core = MetricsCore(MetricsSinkConfig(file=""), CONTEXT)
    windows = truth([beacon], UNTIL_US)
    for message in [*(shifted(window, far_us) for window in windows), *windows]:
        core.feed(message)
    core.close()
    epochs = {row.epoch for row in core.take_rows() if isinstance(row, AcquisitionRow)}
    assert epochs == {0, 1}
    assert sum(core.refusals.values()) == 1
