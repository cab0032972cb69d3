"""Two beacons with one ID are both held, and each is told with the other's track; one light in two parts is not."""

from __future__ import annotations

import pytest

from heliograph.link.modulations.seed11 import Seed11
from heliograph.messages import Identification, Message
from heliograph.site import Beacon
from heliograph_services.cli.decode import Tally
from heliograph_services.cli.lines import for_people, lines_of
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from support.blinkers import Disc, coded, merged, scene, still, tracks
from support.decoding import LIVE, core, run, states

WIDTH, HEIGHT = 320, 240
Said = list[tuple[str, list[str]]]


def said(out: list[Message]) -> Said:
    """Return who was told to have a duplicate, in the order of the messages."""
    return [(one.track, one.duplicates) for one in states(out, "duplicate")]


def two(lights: tuple[Disc, Disc], end_us: int = 1_000_000) -> tuple[DecoderCore, list[Message]]:
    batch = scene(lights, 0, end_us, WIDTH, HEIGHT)
    rows = [("a-0", lights[0], 0), ("a-1", lights[1], 0)]
    told = [(t + 20_000, tracks(t, rows)) for t in range(0, end_us, 100_000)]
    decoder = core()
    return decoder, run(decoder, batch, told, end_us, (WIDTH, HEIGHT))


def test_two_beacons_of_one_payload_are_both_held_and_each_names_the_other() -> None:
    decoder, out = two((Disc(5, still(60, 60)), Disc(5, still(200, 160))))
    assert sorted(one.track for one in states(out, "accepted")) == ["a-0", "a-1"]
    assert said(out) == [("a-0", ["a-1"]), ("a-1", ["a-0"])]
    assert decoder.counters["duplicates"] == 1
    refreshed = [one for one in states(out, "refreshed") if one.t_us > 500_000]
    assert all(len(one.duplicates) == 1 for one in refreshed)
    # Both places are on the bus, each on its own track's key.
    assert {(round(one.x_px), round(one.y_px)) for one in refreshed} == {(60, 60), (200, 160)}


def test_a_duplicate_that_goes_is_named_no_more() -> None:
    _, out = two((Disc(5, still(60, 60)), Disc(5, still(200, 160), lit_us=(0, 500_000))), 1_400_000)
    assert [one.track for one in states(out, "lost")] == ["a-1"]
    assert [one.duplicates for one in states(out, "refreshed") if one.track == "a-0"][-1] == []


def test_beacons_of_different_payloads_are_no_duplicates() -> None:
    assert said(two((Disc(5, still(60, 60)), Disc(2, still(200, 160))))[1]) == []


def test_a_beacon_that_is_found_elsewhere_under_a_new_name_is_no_duplicate_of_itself() -> None:
    first, second = Disc(5, still(60, 60), lit_us=(0, 500_000)), Disc(5, still(200, 160), lit_us=(520_000, 9_000_000))
    assert said(two((first, second), 1_500_000)[1]) == []


@pytest.mark.parametrize(("late_us", "expected"), [(0.0, 0), (5_300.0, 2)])
def test_lights_that_touch_are_two_beacons_if_their_words_end_at_different_times(late_us: float, expected: int) -> None:
    # Two discs of 4 px whose regions meet, but whose centres do not lie in each other's: one lamp behind a bar, or two.
    crane = Beacon(name="crane", protocol="seed11", payload=42, bit_rate=1_000)
    places = still(100, 100), still(112, 100)
    word = Seed11().encode(42)
    turned = [*word[round(late_us / 1_000) :], *word[: round(late_us / 1_000)]] if late_us else list(word)
    batch = merged(
        [
            coded(place, 4.0, bits, 1_000.0, 1_000_000, WIDTH, HEIGHT, seed)
            for seed, (place, bits) in enumerate(zip(places, (list(word), turned), strict=True))
        ]
    )
    rows = [(f"a-{i}", Disc(0, place, radius_px=4.0), 0) for i, place in enumerate(places)]
    decoder = DecoderCore(DecoderConfig(beacons=(crane,)), LIVE)
    out = run(decoder, batch, [(t, tracks(t, rows)) for t in range(0, 1_000_000, 100_000)], 1_000_000, (WIDTH, HEIGHT))
    assert {one.track for one in states(out, "accepted")} == {"a-0", "a-1"}
    assert len(said(out)) == expected


def test_what_a_user_sees_of_duplicates() -> None:
    _, out = two((Disc(5, still(60, 60)), Disc(5, still(200, 160))))
    tally = Tally()
    lines = []
    for message in out:
        tally.take(message)
        lines += lines_of(message, frames=False)
    shown = [line for line in lines if line["change"] == "duplicate"]
    assert [(line["track"], line["duplicates"]) for line in shown] == [("a-0", ["a-1"]), ("a-1", ["a-0"])]
    assert "crane" in for_people(shown[0])
    assert for_people(shown[0]).endswith("also a-1")
    assert len(for_people(shown[0])) <= 80


def test_hundreds_of_one_id_are_compared_up_to_a_limit() -> None:
    lights = [Disc(5, still(20 + 40 * (i % 8), 20 + 40 * (i // 8))) for i in range(40)]
    batch = scene(lights, 0, 600_000, WIDTH, HEIGHT)
    rows = [(f"a-{i}", light, 0) for i, light in enumerate(lights)]
    decoder = core()
    out = run(decoder, batch, [(t, tracks(t, rows)) for t in range(0, 600_000, 100_000)], 600_000, (WIDTH, HEIGHT))
    assert len(states(out, "accepted")) == 40
    assert decoder.counters["duplicates"] == 16 * 15 / 2
    assert max(len(one.duplicates) for one in out if isinstance(one, Identification)) == 15
