"""What becomes of tracks: late, dead and restarted trackers; identities from acceptance to loss."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import pytest

from heliograph.core import Context
from heliograph.errors import ConfigError, Refusal
from heliograph.events import EventBatch, Flags, Times
from heliograph.messages import Data, Frames, Identification, Link, Message, Status, Tracks
from heliograph.site import Beacon
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from heliograph_services.decoder.links import LinkPlan, TrackLinks
from support.blinkers import (
    FRAME_US,
    Disc,
    Path,
    PulseReceiver,
    messages,
    pulse_only,
    scene,
    still,
    straight,
    tracks,
)

LIVE = Context(instance="decoder", boot="b0", lockstep=False)
CRANE = Beacon(name="crane", protocol="pulse", payload=5, bit_rate=100)
LIFT = Beacon(name="lift", protocol="pulse", payload=2, bit_rate=100)
WIDTH, HEIGHT = 640, 480


def core(*beacons: Beacon, **settings: object) -> DecoderCore:
    config = DecoderConfig(beacons=beacons or (CRANE, LIFT), **settings)  # type: ignore[arg-type]
    return DecoderCore(config, LIVE, modulation_of=pulse_only)


def run(decoder: DecoderCore, batch: EventBatch, told: Iterable[tuple[int, Tracks]], end_us: int) -> list[Message]:
    """Feed 2 ms of events at a time; each Tracks message as soon as the events have reached its time."""
    waiting = sorted(told, key=lambda one: one[0])
    out: list[Message] = []
    for message in messages(batch, 0, end_us, range(0, end_us, 2_000), WIDTH, HEIGHT, end=False):
        while waiting and waiting[0][0] <= message.time_us - 2_000:
            out += decoder.feed(waiting.pop(0)[1])
        out += decoder.feed(message)
    return out


def states(out: Iterable[Message], *changes: str) -> list[Identification]:
    return [one for one in out if isinstance(one, Identification) and (not changes or one.change in changes)]


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


def test_an_unlisted_payload_is_called_by_protocol_and_payload() -> None:
    disc = Disc(7, still(100, 100))
    out = run(core(), scene([disc], 0, 300_000, WIDTH, HEIGHT), [(20_000, tracks(0, [("a-0", disc, 0)]))], 300_000)
    assert states(out)[0].beacon == "pulse:7"
    assert {name for one in out if isinstance(one, Frames) for name in one.beacon} == {None}


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


def test_texts_are_joined_over_the_refreshing_time_and_none_is_lost() -> None:
    disc = Disc(5, still(100, 100))
    says = Beacon(name="crane", protocol="pulse", payload=5, bit_rate=100, options={"says": 1})
    batch = scene([disc], 0, 555_000, WIDTH, HEIGHT)
    decoder = core(says)
    decoder.feed(tracks(0, [("a-0", disc, 0)]))
    out = [one for m in messages(batch, 0, 555_000, range(0, 555_000, 2_000), WIDTH, HEIGHT) for one in decoder.feed(m)]
    data = [one for one in out if isinstance(one, Data)]
    frames = sum(len(one.t_us) for one in out if isinstance(one, Frames))
    assert "".join(one.text or "" for one in data) == "f" * (frames - 2)
    assert [len(one.text or "") for one in data] == [8, 10, 10, 10, 10, 6]
    assert {one.beacon for one in data} == {"crane"}
    assert isinstance(out[-1], Identification)
    assert out[-1].lost


def test_link_quality_is_sent_every_second_for_what_is_read() -> None:
    read, dark = Disc(5, still(100, 100)), Disc(5, still(300, 300), lit_us=(0, 0))
    batch = scene([read, dark], 0, 2_500_000, WIDTH, HEIGHT)
    rows = [("a-0", read, 0), ("a-1", dark, 0)]
    told = [(t + 20_000, tracks(t, rows)) for t in range(0, 2_500_000, 100_000)]
    out = run(core(), batch, told, 2_500_000)
    assert [(one.t_us, one.track) for one in out if isinstance(one, Link)] == [(1_000_000, "a-0"), (2_000_000, "a-0")]


def test_a_contest_of_links_has_one_winner_and_every_frame_once() -> None:
    # Two links that read the same signal equally well: the first listed wins, and what was held of it is released.
    disc = Disc(5, still(100, 100))
    other = Beacon(name="twin", protocol="pulse", payload=5, bit_rate=200)
    out = run(
        core(CRANE, other), scene([disc], 0, 400_000, WIDTH, HEIGHT), [(20_000, tracks(0, [("a-0", disc, 0)]))], 400_000
    )
    assert {one.beacon for one in states(out)} == {"crane"}
    ends = [t for one in out if isinstance(one, Frames) for t in one.t_us]
    assert len(ends) == len(set(ends)) == 40


def test_a_contest_that_nobody_wins_publishes_its_frames_a_second_late() -> None:
    # Payloads that alternate are never an identity.
    discs = [
        Disc(payload, still(100, 100), lit_us=(t, t + FRAME_US))
        for k, t in enumerate(range(0, 1_600_000, FRAME_US))
        for payload in (5 if k % 2 else 2,)
    ]
    batch = scene(discs, 0, 1_600_000, WIDTH, HEIGHT)
    told = [(t + 20_000, tracks(t, [("a-0", discs[0], 0)])) for t in range(0, 1_600_000, 100_000)]
    other = Beacon(name="twin", protocol="pulse", payload=5, bit_rate=200)
    for beacons, delay_us in (((CRANE,), 0), ((CRANE, other), 1_000_000)):
        out = run(core(*beacons), batch, told, 1_600_000)
        assert not states(out)
        late = [one.t1_us - t for one in out if isinstance(one, Frames) for t in one.t_us if t > 100_000]
        assert late
        assert min(late) >= delay_us
        assert max(late) <= delay_us + 5_000


class Flaky(PulseReceiver):
    """Gives up for good after half a second of silence."""

    def verdict(self, now_us: int) -> str:  # type: ignore[override]
        return "invalid" if now_us - max(self._last_us, 1) > 500_000 else super().verdict(now_us)

    def _decide(self, t_us: int, payload: int) -> list:  # type: ignore[type-arg]
        return [] if self._last_us and t_us - self._last_us > 500_000 else super()._decide(t_us, payload)


def test_a_receiver_that_has_given_up_is_made_anew_where_the_track_goes_on() -> None:
    def flaky(name: str, **options: str | int):  # type: ignore[no-untyped-def]
        made = pulse_only(name, **options)
        made.receiver = lambda bit_rate, name="default": Flaky(says=False)  # type: ignore[method-assign]
        return made

    first = Disc(5, still(100, 100), lit_us=(0, 300_000))
    second = Disc(5, still(100, 100), lit_us=(3_500_000, 9_000_000))
    batch = scene([first, second], 0, 4_000_000, WIDTH, HEIGHT)
    decoder = DecoderCore(DecoderConfig(beacons=(CRANE,)), LIVE, modulation_of=flaky)
    told = [(t + 20_000, tracks(t, [("a-0", first, 0)])) for t in range(0, 4_000_000, 100_000)]
    out = run(decoder, batch, told, 4_000_000)
    assert [one.change for one in states(out, "accepted", "lost")] == ["accepted", "lost", "accepted"]
    words = {one.as_of_us: one.status for one in out if isinstance(one, Status)}
    assert words[1_000_000] == ["invalid"]


def test_an_unknown_bit_rate_is_measured_and_nothing_heard_meanwhile_is_lost() -> None:
    disc = Disc(5, still(100, 100), lit_us=(1_500_000, 9_000_000))
    batch = scene([disc, Disc(5, still(100, 100), lit_us=(0, 10_000))], 0, 2_500_000, WIDTH, HEIGHT)
    asked: list[int] = []

    def measure(t_us: Times, on: Flags) -> float | None:
        asked.append(len(t_us))
        return 100.0 if len(t_us) > 200 else None

    config = DecoderConfig(protocol="pulse", bit_rate="auto")
    decoder = DecoderCore(config, LIVE, modulation_of=pulse_only, measure=measure)
    told = [(t + 20_000, tracks(t, [("a-0", disc, 0)])) for t in range(0, 2_500_000, 100_000)]
    out = run(decoder, batch, told, 2_500_000)
    assert decoder.refusals[Refusal.NO_CLOCK] == 1
    assert len(asked) < 10
    ends = [t for one in out if isinstance(one, Frames) for t in one.t_us]
    assert len(ends) == 100
    assert states(out, "accepted")[0].beacon == "pulse:5"


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"protocol": "morse"}, "protocol must be pulse, not 'morse'"),
        ({"protocol": "pulse", "receiver": "paper"}, "receiver of pulse must be default, not 'paper'"),
        (
            {"beacons": (Beacon(name="far", protocol="pulse", payload=99, bit_rate=100),)},
            r"beacon far: payload must be in \[0, 15\], not 99",
        ),
    ],
)
def test_an_operators_mistake_is_one_line(settings: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        DecoderCore(DecoderConfig(**settings), LIVE, modulation_of=pulse_only)  # type: ignore[arg-type]


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


def test_a_status_says_by_a_token_who_a_track_is_held_for() -> None:
    # Two links of one protocol: payload 5 at 100 and at 200 bit/s are two beacons.
    read, dark = Disc(5, still(100, 100)), Disc(5, still(300, 300), lit_us=(0, 0))
    batch = scene([read, dark], 0, 400_000, WIDTH, HEIGHT)
    rows = [("a-0", read, 0), ("a-1", dark, 0)]
    told = [(t + 20_000, tracks(t, rows)) for t in range(0, 400_000, 100_000)]
    twin = Beacon(name="twin", protocol="pulse", payload=5, bit_rate=200)
    for beacons, token in (((CRANE,), "pulse/5"), ((CRANE, twin), "pulse.0/5")):
        out = run(core(*beacons), batch, told, 400_000)
        statuses = {
            one.as_of_us: dict(zip(one.track, one.identity, strict=True)) for one in out if isinstance(one, Status)
        }
        assert statuses[400_000] == {"a-0": token, "a-1": None}
        assert set(statuses[100_000].values()) <= {None, token}


def test_text_has_no_token() -> None:
    plan = LinkPlan(DecoderConfig(protocol="uart"))
    assert plan.token(0, None) is None


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


def test_a_frame_that_is_published_a_second_late_says_where_its_beacon_was() -> None:
    # Two links that nobody wins hold frames; meanwhile the beacon has turned.
    def curve(s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        return 320 + 100 * np.cos(3 * s), 240 + 100 * np.sin(3 * s)

    discs = [
        Disc(payload, curve, lit_us=(t, t + FRAME_US))
        for k, t in enumerate(range(0, 2_000_000, FRAME_US))
        for payload in (5 if k % 2 else 2,)
    ]
    batch = scene(discs, 0, 2_000_000, WIDTH, HEIGHT)
    told = [(t + 20_000, tracks(t, [("a-0", discs[0], 0)])) for t in range(0, 2_000_000, 100_000)]
    out = run(core(CRANE, Beacon(name="twin", protocol="pulse", payload=5, bit_rate=200)), batch, told, 2_000_000)
    rows = [row for one in out if isinstance(one, Frames) for row in zip(one.t_us, one.x_px, one.y_px, strict=True)]
    assert len(rows) > 150
    for t_us, x_px, y_px in rows:
        x, y = curve(np.array([t_us / 1e6]))
        assert np.hypot(x - x_px, y - y_px) < 2.0


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


@pytest.mark.parametrize("measured", [False, True])
def test_fast_links_hear_the_core_slow_ones_the_heart_those_between_the_whole(
    measured: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: dict[float, PulseReceiver] = {}

    def noted(name: str, **options: str | int):  # type: ignore[no-untyped-def]
        kind = pulse_only(name, **options)
        monkeypatch.setattr(
            kind, "receiver", lambda rate, _="default": made.setdefault(rate, PulseReceiver(says=False))
        )
        return kind

    listed = [Beacon(name=f"b{rate}", protocol="pulse", payload=1, bit_rate=rate) for rate in (50, 1_000, 4_000)]
    given = {"protocol": "pulse", "bit_rate": "auto"} if measured else {"beacons": tuple(listed)}
    config = DecoderConfig(core_bit_rate=4_000.0, heart_bit_rate=50.0, **given)
    plan = LinkPlan(config, noted, lambda t_us, on: 4_000.0)
    made.clear()
    links = TrackLinks(plan)
    depth = np.array([0, 1, 2, 0, 1], np.uint8)
    for k in range(2):
        t_us = np.arange(5, dtype=np.int64) * 60_000 + k * 300_000
        links.feed(t_us, np.ones(5, np.bool_), depth, (k + 1) * 300_000)
    heard = {rate: one.heard for rate, one in made.items()}
    assert heard == ({4_000.0: 6} if measured else {50.0: 2, 1_000.0: 10, 4_000.0: 6})


def test_the_papers_receiver_hears_the_whole_at_every_rate() -> None:
    listed = [Beacon(name=f"b{rate}", protocol="seed11", payload=42, bit_rate=rate) for rate in (50, 1_000, 4_000)]
    ours, papers = (LinkPlan(DecoderConfig(beacons=tuple(listed), receiver=name)) for name in ("default", "paper"))
    assert [ours.depth(i, row.key.bit_rate or 0.0) > 0 for i, row in enumerate(ours.rows)] == [True, False, True]
    assert [papers.depth(i, row.key.bit_rate or 0.0) for i, row in enumerate(papers.rows)] == [0, 0, 0]
