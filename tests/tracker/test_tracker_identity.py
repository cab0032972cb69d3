"""Names follow what is read: swaps are undone, and who comes back has the old name."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.messages import Status, Tracks
from heliograph_services.tracker.core import TrackerCore
from heliograph_services.tracker.identity import ADOPT_US, HOLD_US, UNSEEN_US, Identities, Renaming
from support.onset_scenes import Disc, Scene, line
from support.tracker_runs import PERIOD, feed_all, new_core

NOBODY = Renaming({}, frozenset())


def judged(who: Identities, reads: dict[int, str | None], at_us: int, *unseen: int) -> Renaming:
    return who.judge(reads, {number: UNSEEN_US if number in unseen else 0 for number in reads}, at_us)


def known(**more: str) -> Identities:
    """Return who has read a at 0 and b at 1."""
    who = Identities()
    assert judged(who, {0: "a", 1: "b"}, 0) == NOBODY
    assert judged(who, {0: "a", 1: "b"}, PERIOD) == NOBODY
    return who


def test_tracks_that_read_each_others_tokens_exchange_numbers_once() -> None:
    who = known()
    assert judged(who, {0: "b", 1: "a"}, 200_000) == Renaming({0: 1, 1: 0}, frozenset())
    # What the decoder said before it heard of it.
    assert judged(who, {0: "b", 1: "a"}, 300_000) == NOBODY
    assert judged(who, {0: "a", 1: "b"}, 400_000) == NOBODY
    assert judged(who, {0: "b", 1: "a"}, 500_000) == Renaming({0: 1, 1: 0}, frozenset())


def test_a_decoder_that_never_follows_is_believed_after_the_hold() -> None:
    who = known()
    judged(who, {0: "b", 1: "a"}, 200_000)
    assert judged(who, {0: "b", 1: "a"}, 199_999 + HOLD_US) == NOBODY
    assert judged(who, {0: "b", 1: "a"}, 200_000 + HOLD_US).number == {0: 1, 1: 0}


def test_one_of_two_that_have_changed_places_is_enough_if_the_other_no_longer_reads_its_own() -> None:
    assert judged(known(), {0: "b", 1: None}, 200_000).number == {0: 1, 1: 0}
    assert judged(known(), {0: "b", 1: "z"}, 200_000).number == {0: 1, 1: 0}


def test_two_that_are_seen_and_read_one_token_keep_their_names() -> None:
    who = known()
    assert judged(who, {0: "b", 1: "b"}, 200_000) == NOBODY
    assert judged(who, {0: "b", 1: "b"}, 9_000_000) == NOBODY
    assert judged(who, {0: "a", 1: "b"}, 9_100_000) == NOBODY


def test_a_reflection_does_not_take_the_name_of_what_is_not_read_for_a_moment() -> None:
    who = known()
    assert judged(who, {0: "a", 1: None, 2: "b"}, 200_000) == NOBODY
    assert judged(who, {0: "a", 1: "b", 2: "b"}, 300_000) == NOBODY


def test_who_comes_back_has_its_old_number_and_the_new_one_ends() -> None:
    who = known()
    assert judged(who, {0: "a", 1: "b", 2: None}, 200_000, 1) == NOBODY
    assert judged(who, {0: "a", 1: "b", 2: "b"}, 300_000, 1) == Renaming({1: 2, 2: 1}, frozenset({1}))
    # The name that has gone may still be spoken of.
    assert who.judge({0: "a", 1: "b", 2: "b"}, {0: 0, 1: 0}, 400_000) == NOBODY
    assert len(who) == 2


def test_a_known_track_that_reads_the_token_of_one_not_seen_exchanges_with_it() -> None:
    assert judged(known(), {0: "b", 1: "b"}, 200_000, 1) == Renaming({0: 1, 1: 0}, frozenset())


def test_a_new_track_takes_the_name_of_one_that_has_gone_over_to_another_beacon() -> None:
    assert judged(known(), {0: "a", 1: "z", 2: "b"}, 200_000).number == {1: 2, 2: 1}


def test_a_beacon_with_a_new_payload_keeps_its_track_and_owns_the_payload_after_a_while() -> None:
    who = known()
    assert judged(who, {0: "z", 1: "b"}, 200_000) == NOBODY
    assert judged(who, {0: "z", 1: "b"}, 200_000 + ADOPT_US) == NOBODY
    # Another that now sends the old payload is another.
    assert judged(who, {0: "z", 1: "b", 2: "a"}, 300_000 + ADOPT_US) == NOBODY
    assert judged(who, {0: "b", 1: "z", 2: "a"}, 400_000 + ADOPT_US).number == {0: 1, 1: 0}


def test_a_stranger_that_proves_to_be_a_swap_with_a_track_not_yet_read_is_undone() -> None:
    who = Identities()
    judged(who, {0: "a", 1: None}, 0)
    assert judged(who, {0: "z", 1: None}, 100_000) == NOBODY
    assert judged(who, {0: "z", 1: "a"}, 200_000).number == {0: 1, 1: 0}


def test_a_decoder_that_starts_anew_and_reads_nothing_changes_no_name() -> None:
    who = known()
    assert judged(who, {0: None, 1: None}, 200_000) == NOBODY
    assert judged(who, {0: "a", 1: None}, 300_000) == NOBODY
    assert judged(who, {0: "a", 1: "b"}, 400_000) == NOBODY


@given(st.permutations(range(6)))
def test_any_permutation_of_the_tracks_is_undone(order: list[int]) -> None:
    who = Identities()
    tokens = [f"seed11/{i}" for i in range(6)]
    judged(who, dict(enumerate(tokens)), 0)
    reads = {row: tokens[i] for row, i in enumerate(order)}
    renaming = judged(who, dict(reads), PERIOD)
    assert {renaming.number.get(row, row): token for row, token in reads.items()} == dict(enumerate(tokens))
    assert not renaming.ended


@given(
    st.lists(
        st.tuples(
            st.lists(st.sampled_from(["a", "b", "c", None]), min_size=5, max_size=5),
            st.sets(st.integers(0, 4)),
            st.integers(0, 700_000),
        ),
        max_size=12,
    )
)
def test_whatever_is_said_no_name_is_lost_or_doubled(steps: list[tuple[list[str | None], set[int], int]]) -> None:
    who, numbers, at_us = Identities(), list(range(5)), 0
    for tokens, unseen, dt_us in steps:
        at_us += dt_us
        reads = dict(zip(numbers, tokens, strict=False))
        renaming = judged(who, reads, at_us, *(numbers[i] for i in unseen if i < len(numbers)))
        assert sorted(renaming.number) == sorted(renaming.number.values())
        numbers = [renaming.number.get(n, n) for n in numbers if n not in renaming.ended]
        assert len(set(numbers)) == len(numbers)
        assert len(who) <= 5


# -- in the tracker --


def status(as_of_us: int, reads: dict[str, str | None]) -> Status:
    n = len(reads)
    return Status(
        camera="cam0",
        as_of_us=as_of_us,
        track=list(reads),
        status=["valid"] * n,
        accepted_us=[0] * n,
        identity=list(reads.values()),
    )


def place(m: Tracks) -> dict[str, tuple[float, float]]:
    return {name: (round(x), round(y)) for name, x, y in zip(m.track, m.x_px, m.y_px, strict=True)}


def run(scene: Scene, core: TrackerCore, reads: dict[int, dict[str, str | None]], until_s: float) -> list[Tracks]:
    """Feed a scene, and statuses after the messages that end at their times."""
    out: list[Tracks] = []
    for onsets in scene.onsets(until_s):
        out += feed_all(core, [onsets])
        if onsets.t1_us in reads:
            out += [m for m in core.feed(status(onsets.t1_us, reads[onsets.t1_us])) if isinstance(m, Tracks)]
    return out


STILL = Scene((Disc(line(60, 60)), Disc(line(200, 120))))


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_swap_that_is_read_is_undone_at_once_or_in_lockstep_with_the_period_after_the_next(lockstep: bool) -> None:
    a, b = ("scene-0", "scene-1") if lockstep else ("b00t-0", "b00t-1")
    core = new_core(lockstep=lockstep)
    reads: dict[int, dict[str, str | None]] = {
        200_000: {a: "seed11/1", b: "seed11/2"},
        300_000: {a: "seed11/2", b: "seed11/1"},
    }
    out = run(replace(STILL, discs=(STILL.discs[0], replace(STILL.discs[1], dark_s=((0, 0.05),)))), core, reads, 0.6)
    first_us = min(m.as_of_us for m in out if len(m.track) == 2 and place(m)[a] == (200, 120))
    assert first_us == (500_000 if lockstep else 300_001)
    assert all((place(m)[a] == (200, 120)) == (m.as_of_us >= first_us) for m in out if len(m.track) == 2)
    # A name keeps its birth.
    assert {tuple(m.born_us) for m in out if len(m.track) == 2} == {(0, 50_000)}
    assert core.counters["tracks_renamed"] == 2


def test_a_beacon_that_comes_back_elsewhere_has_its_old_name_again() -> None:
    gone, back = Disc(line(60, 60), dark_s=((0.4, 9),)), Disc(line(200, 120), dark_s=((0, 0.7),))
    core = new_core()
    reads: dict[int, dict[str, str | None]] = {
        300_000: {"b00t-0": "seed11/1"},
        800_000: {"b00t-0": "seed11/1", "b00t-1": "seed11/1"},
        900_000: {"b00t-0": "seed11/1"},
    }
    out = run(replace(STILL, discs=(gone, back)), core, reads, 1.2)
    assert [m.track for m in out if m.as_of_us == 800_000] == [["b00t-0", "b00t-1"]]
    assert out[-1].track == ["b00t-0"]
    assert place(out[-1]) == {"b00t-0": (200, 120)}
    assert out[-1].born_us == [0]
    assert core.counters["tracks_taken_over"] == 1


def test_statuses_that_stop_leave_tracks_valid_and_names_as_they_are() -> None:
    core = new_core()
    reads: dict[int, dict[str, str | None]] = {200_000: {"b00t-0": "seed11/1", "b00t-1": "seed11/2"}}
    out = run(STILL, core, reads, 2.0)
    assert out[-1].track == ["b00t-0", "b00t-1"]
    assert out[-1].status == ["valid", "valid"]
