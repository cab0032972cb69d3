"""What the decoder's word does to a track, live and in lockstep."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as changed

from heliograph.messages import Status, StatusWord, Tracks
from heliograph.streams import Onsets
from support.onset_scenes import Disc, Scene, line
from support.tracker_runs import PERIOD, bodies, cut, feed, new_core, second, silence


def word(as_of_us: int, status: StatusWord, *names: str) -> Status:
    return Status(
        camera="cam0",
        as_of_us=as_of_us,
        track=list(names),
        status=[status] * len(names),
        accepted_us=[-1] * len(names),
        identity=[None] * len(names),
    )


@pytest.mark.parametrize(("status", "last_us"), [("new", 1_300_000), ("valid", 3_000_000)])
def test_silence_ends_a_track_after_the_patience_of_its_status(
    two: list[Onsets], status: StatusWord, last_us: int
) -> None:
    core = new_core()
    feed(core, two[:-1])
    core.feed(word(900_000, status, "b00t-0", "b00t-1"))
    out = feed(core, [changed(two[-1], end=False)])
    out += feed(core, [silence(1_000_000, 6_000_000)])
    alive = [m.as_of_us for m in out if m.track]
    assert max(alive) == last_us


def test_an_invalid_track_ends_and_its_place_is_closed_for_longer_each_time() -> None:
    lamp = Scene((Disc(line(100, 100), bit_rate=240.0, word=(1, 0)),))
    core = new_core()
    births: dict[str, int] = {}
    at_us = 0
    for m in lamp.onsets(12.0):
        for t in feed(core, [m]):
            for name, born_us in zip(t.track, t.born_us, strict=True):
                births.setdefault(name, born_us)
            core.feed(word(t.as_of_us, "invalid", *t.track))
            at_us = t.as_of_us
    assert at_us == 12_000_000
    # Born at 0, 1.4, 3.8, 8.2 s: pauses of 1, 2, 4 s, each after the time that an invalid track is given.
    gaps = np.diff(sorted(births.values())) / 1e6
    assert gaps == pytest.approx([1.4, 2.4, 4.4], abs=0.1)
    assert core.counters["tracks_ended_invalid"] == 4
    assert core.counters["births_quarantined"] > 0


def test_a_beacon_that_was_read_and_falls_silent_is_born_again_where_it_was() -> None:
    scene = Scene((Disc(line(100, 100), dark_s=((0.5, 1.5),)),))
    core = new_core()
    last: list[str] = []
    for m in scene.onsets(2.0):
        for t in feed(core, [m]):
            core.feed(word(t.as_of_us, "valid" if not 600_000 <= t.as_of_us < 1_500_000 else "invalid", *t.track))
            last = t.track
    assert core.counters["tracks_ended_invalid"] == 1
    assert core.counters["births_quarantined"] == 0
    assert last == ["b00t-1"]


def test_an_invalid_track_that_recovers_stays(two: list[Onsets]) -> None:
    core = new_core()
    out: list[Tracks] = []
    for i, m in enumerate(two):
        out += feed(core, [m])
        if m.t1_us % PERIOD == 0:
            core.feed(word(m.t1_us, "invalid" if (i // 20) % 2 else "valid", "b00t-0"))
    assert {tuple(m.track) for m in out} == {("b00t-0", "b00t-1")}
    assert {m.status[0] for m in out} == {"new", "valid", "invalid"}


def test_words_for_unknown_tracks_change_nothing(two: list[Onsets]) -> None:
    core, plain = new_core(), new_core()
    wanted = bodies(feed(plain, two))
    out: list[Tracks] = []
    for m in two:
        out += feed(core, [m])
        core.feed(word(m.t1_us, "invalid", "b00t-99", "b00t-", "other-0", "b00t-x", "b00t--1"))
    assert bodies(out) == wanted


# -- lockstep --


def test_lockstep_waits_for_the_status_two_periods_back(two: list[Onsets]) -> None:
    core = new_core(lockstep=True)
    assert core.ready(silence(0, 200_000))
    assert not core.ready(silence(0, 200_005))
    feed(core, [silence(0, 200_000)])
    nxt = silence(200_000, 205_000)
    assert not core.ready(nxt)
    core.feed(word(0, "new"))
    assert not core.ready(nxt)
    core.feed(word(100_000, "new"))
    assert core.ready(nxt)
    assert core.ready(silence(200_000, 300_000))
    assert not core.ready(silence(200_000, 305_000))
    assert new_core(lockstep=False).ready(silence(0, 9_000_000))


def test_lockstep_counts_from_the_period_in_which_the_stream_begins() -> None:
    core = new_core(lockstep=True)
    assert core.ready(silence(735_000, 900_000))
    assert not core.ready(silence(735_000, 905_000))
    # Words that came before the first onsets count; those of another time do not.
    core.feed(word(800_000, "new"))
    assert core.ready(silence(735_000, 905_000))
    core.feed(word(10**12, "new"))
    assert not core.ready(silence(735_000, 1_005_000))


def test_a_new_stream_forgets_the_statuses_of_the_old_one() -> None:
    core = new_core(lockstep=True)
    core.feed(word(5_000_000, "new"))
    assert core.ready(silence(5_000_000, 5_200_000))
    feed(core, [silence(5_000_000, 5_200_000)])
    assert not core.ready(silence(0, 250_000, stream="next"))
    feed(core, [silence(0, 200_000, stream="next")])
    assert not core.ready(silence(200_000, 250_000, stream="next"))


@settings(max_examples=20)
@given(st.lists(st.integers(0, 100_000), min_size=1, max_size=6), st.lists(st.integers(1, 20), min_size=1, max_size=5))
def test_in_lockstep_neither_the_moment_a_status_comes_nor_the_cut_changes_anything(
    delays_us: list[int], sizes: list[int]
) -> None:
    """A status may come any time between its instant and the moment at which `ready` insists on it."""
    onsets = second()

    def run(messages: list[Onsets], delays: list[int]) -> list[bytes]:
        core = new_core(lockstep=True)
        out: list[Tracks] = []
        pending: list[tuple[int, Status]] = []
        for m in messages:
            due = [s for at, s in pending if at <= m.t0_us]
            pending = [(at, s) for at, s in pending if at > m.t0_us]
            for s in due:
                core.feed(s)
            while not core.ready(m):
                core.feed(pending.pop(0)[1])
            for t in feed(core, [m]):
                out.append(t)
                status: StatusWord = "invalid" if t.as_of_us in {300_000, 400_000, 500_000, 600_000} else "valid"
                delay = delays[len(out) % len(delays)]
                pending.append((t.as_of_us + delay, word(t.as_of_us, status, *t.track[:1])))
        return bodies(out)

    wanted = run(onsets, [0])
    assert len(set(wanted)) == len(wanted) == 10
    assert run(cut(onsets, sizes), delays_us) == wanted


def test_a_status_is_used_from_one_period_after_its_instant_on(two: list[Onsets]) -> None:
    core = new_core(lockstep=True)
    out: list[Tracks] = []
    for m in two:
        out += feed(core, [m])
        if m.t1_us == 300_000:
            core.feed(word(300_000, "valid", "scene-0"))
    assert [m.status[0] for m in out[:6]] == ["new", "new", "new", "new", "valid", "valid"]


# -- silence --
