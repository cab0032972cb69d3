"""What becomes of tracks: late, dead and restarted trackers, names that move; identities from acceptance to loss."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from heliograph.messages import Frames, Message, Status
from support.blinkers import FRAME_US, Disc, Path, messages, scene, still, straight, tracks
from support.decoding import HEIGHT, WIDTH, core, run, states


def curve(s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """200 px/s on a circle of 120 px."""
    return 320 + 120 * np.cos(s / 0.6), 240 + 120 * np.sin(s / 0.6)


def test_a_late_track_costs_no_frame_since_its_birth() -> None:
    disc = Disc(5, straight(100, 100, 150, 40))
    batch = scene([disc], 0, 400_000, WIDTH, HEIGHT)
    # Born at 55 ms, known at 390 ms as it was at 300 ms, its velocity 40 % wrong: 15 px off at its birth.
    decoder = core()
    out = run(decoder, batch, [(390_000, tracks(300_000, [("t-0", disc, 55_000)], speed=0.6))], 400_000)
    ends = [t for one in out if isinstance(one, Frames) for t in one.t_us]
    assert [round(t / FRAME_US) for t in ends] == list(range(6, 40))
    for one in out:
        if isinstance(one, Frames):
            x, y = disc.path(np.array(one.t_us) / 1e6)
            assert np.all(np.hypot(x - one.x_px, y - one.y_px) < 1.5)
    accepted = states(out, "accepted")
    assert [one.beacon for one in accepted] == ["crane"]
    assert accepted[0].since_us < 90_000
    assert not decoder.refusals


def test_with_a_dead_tracker_identifications_go_on_being_refreshed_where_the_beacons_are() -> None:
    discs = [Disc(5, curve), Disc(2, straight(50, 50, 120, 90))]
    batch = scene(discs, 0, 3_000_000, WIDTH, HEIGHT, noise_hz=2e4)
    rows = [("a-0", discs[0], 0), ("a-1", discs[1], 0), ("a-2", Disc(1, still(600, 60)), 0)]
    alive = [(t + 30_000, tracks(t, rows, speed=0.95)) for t in range(100_000, 500_001, 100_000)]
    out = run(core(), batch, alive, 3_000_000)
    for name, disc in (("a-0", discs[0]), ("a-1", discs[1])):
        mine = [one for one in states(out, "refreshed") if one.track == name]
        assert [one.t_us for one in mine] == list(range(200_000, 3_000_001, 100_000))
        for one in mine:
            x, y = disc.path(np.array([one.t_us / 1e6]))
            assert np.hypot(one.x_px - x[0], one.y_px - y[0]) < 2.0
    assert not states(out, "lost")
    # What is not read ends 2 s after the tracker's last word.
    statuses = [one for one in out if isinstance(one, Status)]
    gone = next(one.as_of_us for one in statuses if one.as_of_us > 500_000 and "a-2" not in one.track)
    assert gone == 2_600_000


def test_a_restarted_tracker_renames_what_is_followed_and_no_receiver_starts_anew() -> None:
    disc = Disc(5, straight(100, 100, 60, 0))
    batch = scene([disc], 0, 2_000_000, WIDTH, HEIGHT)
    told = [
        *((t + 20_000, tracks(t, [("a-0", disc, 0)])) for t in range(100_000, 500_001, 100_000)),
        # Back after 0.9 s: at first with nothing, then with the same beacon under a new name.
        (1_420_000, tracks(1_400_000, [])),
        *((t + 20_000, tracks(t, [("b-0", disc, 1_410_000)])) for t in range(1_500_000, 2_000_000, 100_000)),
    ]
    decoder = core()
    out = run(decoder, batch, told, 2_000_000)
    changes = [(one.track, one.change, one.since_us) for one in states(out, "accepted", "changed", "lost")]
    since_us = changes[0][2]
    assert changes == [("a-0", "accepted", since_us), ("a-0", "lost", since_us), ("b-0", "accepted", since_us)]
    refreshed = [(one.t_us, one.track) for one in states(out, "refreshed")]
    assert [t for t, _ in refreshed] == list(range(200_000, 2_000_001, 100_000))
    assert {track for t, track in refreshed if t <= 1_500_000} == {"a-0"}
    assert {track for t, track in refreshed if t > 1_500_000} == {"b-0"}
    assert states(out, "refreshed")[-1].frames_used == 2_000_000 // FRAME_US
    assert decoder.counters["tracks_adopted"] == 1
    assert decoder.counters["tracks_begun"] == 1
    ends = [t for one in out if isinstance(one, Frames) for t in one.t_us]
    assert len(ends) == len(set(ends)) == 2_000_000 // FRAME_US


def test_two_followed_beacons_are_adopted_each_by_the_nearest_new_name() -> None:
    discs = [Disc(5, still(100, 100)), Disc(2, still(109, 100))]
    batch = scene(discs, 0, 800_000, WIDTH, HEIGHT)
    told = [
        (20_000, tracks(0, [("a-0", discs[0], 0), ("a-1", discs[1], 0)])),
        (420_000, tracks(400_000, [("b-0", discs[1], 0), ("b-1", discs[0], 0)])),
    ]
    out = run(core(), batch, told, 800_000)
    last = {one.track: one.beacon for one in states(out, "refreshed") if one.t_us > 500_000}
    assert last == {"b-0": "lift", "b-1": "crane"}


def test_a_track_that_is_not_read_ends_with_the_message_that_lacks_it() -> None:
    read, dark = Disc(5, still(100, 100)), Disc(5, still(300, 300), lit_us=(0, 0))
    batch = scene([read, dark], 0, 600_000, WIDTH, HEIGHT)
    told = [(20_000, tracks(0, [("a-0", read, 0), ("a-1", dark, 0)])), (320_000, tracks(300_000, []))]
    out = run(core(), batch, told, 600_000)
    seen = {one.as_of_us: one.track for one in out if isinstance(one, Status)}
    assert seen[300_000] == ["a-0", "a-1"]
    assert seen[400_000] == ["a-0"]
    assert not states(out, "lost")


def test_an_identity_that_nothing_supports_is_lost_after_its_time_and_found_again() -> None:
    disc = Disc(5, still(100, 100), lit_us=(0, 500_000))
    again = Disc(5, still(100, 100), lit_us=(3_000_000, 4_000_000))
    batch = scene([disc, again], 0, 3_500_000, WIDTH, HEIGHT)
    told = [(t + 20_000, tracks(t, [("a-0", disc, 0)])) for t in range(0, 3_500_000, 100_000)]
    out = run(core(loss_us=1_000_000), batch, told, 3_500_000)
    changes = [(one.change, one.lost) for one in states(out, "accepted", "changed", "lost")]
    assert changes == [("accepted", False), ("lost", True), ("accepted", False)]
    lost = states(out, "lost")[0]
    assert 1_490_000 <= lost.t_us <= 1_500_000
    assert max(one.t_us for one in states(out, "refreshed") if one.t_us < 2_000_000) < lost.t_us


def test_another_payload_is_a_change() -> None:
    first = Disc(5, still(100, 100), lit_us=(0, 500_000))
    second = Disc(2, still(100, 100), lit_us=(500_000, 2_000_000))
    batch = scene([first, second], 0, 900_000, WIDTH, HEIGHT)
    out = run(core(), batch, [(20_000, tracks(0, [("a-0", first, 0)]))], 900_000)
    assert [(one.beacon, one.change) for one in states(out, "accepted", "changed", "lost")] == [
        ("crane", "accepted"),
        ("lift", "changed"),
    ]


def test_events_between_two_regions_go_to_the_nearer() -> None:
    # 8 px apart, reach 7: the regions overlap, the discs do not.
    discs = [Disc(5, still(100, 100)), Disc(2, still(108, 100))]
    batch = scene(discs, 0, 1_000_000, WIDTH, HEIGHT)
    told = [(20_000, tracks(0, [("a-0", discs[0], 0), ("a-1", discs[1], 0)]))]
    out = run(core(), batch, told, 1_000_000)
    last = {one.track: one for one in states(out, "refreshed")}
    assert {name: one.beacon for name, one in last.items()} == {"a-0": "crane", "a-1": "lift"}
    assert last["a-0"].x_px == pytest.approx(100, abs=0.5)
    assert last["a-1"].x_px == pytest.approx(108, abs=0.5)


def test_one_pixel_hears_everything() -> None:
    path: Path = still(0, 0)
    disc = Disc(5, path, radius_px=0.5)
    batch = scene([disc], 0, 500_000, 1, 1)
    assert len(batch) > 50
    decoder = core()
    out: list[Message] = []
    for k, message in enumerate(messages(batch, 0, 500_000, range(0, 500_000, 10_000), 1, 1)):
        if k == 20:
            decoder.feed(tracks(100_000, [("s-0", disc, 0)]))
        out += decoder.feed(message)
    assert decoder.counters["events"] == len(batch)
    assert [one.beacon for one in states(out, "accepted")] == ["crane"]
    assert {(one.x_px, one.y_px) for one in states(out)} == {(0.0, 0.0)}


def test_names_that_the_tracker_exchanges_take_receiver_identity_and_region_along() -> None:
    discs = [Disc(5, straight(100, 100, 60, 0)), Disc(2, straight(420, 100, -60, 3))]
    batch = scene(discs, 0, 1_200_000, WIDTH, HEIGHT)
    before = [(t + 20_000, tracks(t, [("a-0", discs[0], 0), ("a-1", discs[1], 0)])) for t in range(0, 600_000, 100_000)]
    after = [
        (t + 20_000, tracks(t, [("a-1", discs[0], 0), ("a-0", discs[1], 0)]))
        for t in range(600_000, 1_200_000, 100_000)
    ]
    decoder = core()
    out = run(decoder, batch, [*before, *after], 1_200_000)
    changes = [(one.track, one.beacon, one.change) for one in states(out, "accepted", "changed", "lost")]
    assert sorted(changes[:2]) == [("a-0", "crane", "accepted"), ("a-1", "lift", "accepted")]
    assert sorted(changes[2:]) == [("a-0", "lift", "changed"), ("a-1", "crane", "changed")]
    tokens = {one.as_of_us: dict(zip(one.track, one.identity, strict=True)) for one in out if isinstance(one, Status)}
    assert tokens[1_200_000] == {"a-0": "pulse/2", "a-1": "pulse/5"}
    # No frame is lost to it, and none comes twice.
    ends = [(t, p) for one in out if isinstance(one, Frames) for t, p in zip(one.t_us, one.payload, strict=True)]
    assert len(ends) == len(set(ends)) == 2 * 1_200_000 // FRAME_US
    assert decoder.counters["tracks_begun"] == 2


def test_a_name_taken_over_from_a_coasting_track_goes_on_without_a_hole() -> None:
    # Hidden for half a second, the beacon comes back elsewhere: first as a-1, which the tracker then calls a-0 again.
    first = Disc(5, straight(100, 100, 100, 0), lit_us=(0, 500_000))
    second = Disc(5, straight(300, 200, 60, 0), lit_us=(1_000_000, 9_000_000))
    batch = scene([first, second], 0, 2_000_000, WIDTH, HEIGHT)
    told = [
        *((t + 20_000, tracks(t, [("a-0", first, 0)])) for t in range(0, 1_100_000, 100_000)),
        *(
            (t + 20_000, tracks(t, [("a-0", first, 0), ("a-1", second, 1_000_000)]))
            for t in range(1_100_000, 1_400_000, 100_000)
        ),
        *((t + 20_000, tracks(t, [("a-0", second, 0)])) for t in range(1_400_000, 2_000_000, 100_000)),
    ]
    out = run(core(), batch, told, 2_000_000)
    changes = [(one.track, one.change) for one in states(out, "accepted", "changed", "lost")]
    # Of two names that are held for one beacon the one that is not read is lost; it is held again with the beacon.
    assert changes == [
        ("a-0", "accepted"),
        ("a-0", "lost"),
        ("a-1", "accepted"),
        ("a-1", "lost"),
        ("a-0", "accepted"),
    ]
    late = [one for one in states(out, "refreshed") if one.t_us > 1_500_000]
    assert {one.track for one in late} == {"a-0"}
    assert late[-1].x_px == pytest.approx(second.path(np.array([late[-1].t_us / 1e6]))[0][0], abs=1.0)
    ends = [t for one in out if isinstance(one, Frames) for t in one.t_us]
    assert len(ends) == len(set(ends)) == (500_000 + 1_000_000) // FRAME_US


def test_a_message_between_two_of_the_grid_takes_effect_with_the_next_window() -> None:
    disc = Disc(5, still(100, 100))
    batch = scene([disc], 0, 200_000, WIDTH, HEIGHT)
    decoder = core()
    told = [
        (0, tracks(0, [])),
        (51_000, tracks(45_000, [("a-0", disc, 0)])),
        (101_000, tracks(100_000, [("a-0", disc, 0)])),
    ]
    out = run(decoder, batch, told, 200_000)
    first = next(one for one in out if isinstance(one, Frames) and one.t_us)
    assert first.t0_us <= 55_000
    assert not decoder.refusals


def test_a_track_of_the_clutter_on_a_beacon_takes_no_frame_and_reads_none_twice() -> None:
    disc = Disc(5, straight(100, 100, 100, 0))
    ghost = Disc(1, straight(103, 100, 100, 0))
    batch = scene([disc], 0, 1_500_000, WIDTH, HEIGHT)
    told = [
        *((t + 20_000, tracks(t, [("a-0", disc, 0)])) for t in range(0, 500_000, 100_000)),
        *(
            (t + 20_000, tracks(t, [("a-0", disc, 0), ("a-1", ghost, 400_000)]))
            for t in range(500_000, 1_500_000, 100_000)
        ),
    ]
    out = run(core(), batch, told, 1_500_000)
    ends = [(t, name) for one in out if isinstance(one, Frames) for t, name in zip(one.t_us, one.track, strict=True)]
    assert len(ends) == 1_500_000 // FRAME_US
    assert {name for _, name in ends} == {"a-0"}


def test_a_region_that_is_lost_catches_up_from_where_the_tracker_saw_the_beacon() -> None:
    disc = Disc(5, straight(100, 100, 300, 0))
    batch = scene([disc], 0, 700_000, WIDTH, HEIGHT)
    wrong = Disc(5, still(400, 400))
    told = [(20_000, tracks(0, [("a-0", wrong, 0)])), (320_000, tracks(200_000, [("a-0", disc, 0)]))]
    decoder = core()
    out = run(decoder, batch, told, 700_000)
    assert decoder.counters["tracks_relocated"] == 1
    assert states(out, "accepted")[0].beacon == "crane"
    ends = [t for one in out if isinstance(one, Frames) for t in one.t_us]
    assert len(ends) >= (700_000 - 325_000) // FRAME_US - 1
