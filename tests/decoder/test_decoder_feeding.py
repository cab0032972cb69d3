"""Receivers are fed when they may decide something: no frame is lost, changed, or later for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.core import Context
from heliograph.link.contract import LinkFrame, Punctual, Receiver, Text
from heliograph.link.cyclic import CyclicReceiver
from heliograph.link.frames import seed11_code
from heliograph.link.modulations import modulation
from heliograph.link.text_receiver import TextReceiver
from heliograph.link.uart_layout import text_bits
from heliograph.messages import Frames, Identification, Status
from heliograph.site import Beacon
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from heliograph_services.decoder.feeding import AWAKE_US, BEAT_US, NEVER_DUE_US, WAIT_US, Feeding, beat_us
from heliograph_services.decoder.regions import Routed
from support.blinkers import Disc, coded, merged, messages, still, tracks
from support.lights import Light, Seen, seen

WINDOW_US = 1_000


def routed(t_us: list[int], label: list[int], n: int) -> Routed:
    """Return a window's events by track; labels in order."""
    order = np.argsort(label, kind="stable")
    times = np.array(t_us, np.int64)[order]
    starts = np.searchsorted(np.array(label)[order], np.arange(n + 1)).astype(np.int64)
    return Routed(starts, times, times % 2 == 0, np.zeros(len(times), np.uint8), 0)


def begun(n: int, due_us: int = NEVER_DUE_US) -> Feeding:
    feeding = Feeding(8)
    feeding.append(0, [False] * n, [due_us] * n)
    return feeding


@given(
    st.lists(st.tuples(st.lists(st.integers(0, 2), max_size=5), st.sets(st.integers(0, 2)), st.booleans()), max_size=40)
)
def test_every_event_reaches_its_track_once_and_in_order(windows: list[tuple[list[int], set[int], bool]]) -> None:
    feeding = begun(3)
    wanted: dict[int, list[int]] = {i: [] for i in range(3)}
    got: dict[int, list[int]] = {i: [] for i in range(3)}
    for k, (label, taking, grows) in enumerate(windows):
        times = [k * WINDOW_US + j for j in range(len(label))]
        feeding.note(routed(times, label, feeding.n), (k + 1) * WINDOW_US)
        for t_us, i in zip(times, label, strict=True):
            wanted[i].append(t_us)
        for i in taking:
            got[i] += feeding.take([i], [0])[0][0].tolist()
            feeding.fed(i, (k + 1) * WINDOW_US, NEVER_DUE_US)
        if grows and feeding.n < 8:
            feeding.append((k + 1) * WINDOW_US, [False], [NEVER_DUE_US])
    for i in range(3):
        got[i] += feeding.take([i], [0])[0][0].tolist()
    assert got == wanted


def test_what_waits_moves_along_when_tracks_end() -> None:
    feeding = begun(3)
    feeding.note(routed([1, 2, 3], [0, 1, 2], 3), WINDOW_US)
    feeding.keep([2])
    assert feeding.take([0], [0])[0][0].tolist() == [3]


def test_a_track_that_has_heard_nothing_is_never_fed() -> None:
    feeding = begun(2)
    feeding.note(routed([1], [1], 2), WINDOW_US)
    assert feeding.whom(WINDOW_US, beat=True, every=True) == [1]


def test_a_track_is_fed_in_the_window_in_which_it_is_due_and_at_beats_only_while_it_does_not_know() -> None:
    feeding = begun(2)
    feeding.note(routed([1, 2], [0, 1], 2), WINDOW_US)
    feeding.fed(0, WINDOW_US, 7_500)
    feeding.fed(1, WINDOW_US, NEVER_DUE_US)
    assert feeding.whom(5_000, beat=True, every=False) == [1]
    assert feeding.whom(7_000, beat=False, every=False) == []
    assert feeding.whom(8_000, beat=False, every=False) == [0]


def test_what_waits_is_fed_at_the_latest_after_so_long_and_what_sleeps_is_not() -> None:
    feeding = begun(1)
    feeding.note(routed([1], [0], 1), WINDOW_US)
    feeding.fed(0, WINDOW_US, 10**9)
    assert feeding.whom(WAIT_US, beat=True, every=False) == []
    assert feeding.whom(WAIT_US + WINDOW_US, beat=True, every=False) == [0]
    assert feeding.whom(AWAKE_US + 2 * WINDOW_US, beat=True, every=False) == []


@pytest.mark.parametrize(
    ("window_us", "grids_us", "wanted"),
    [(1_000, (100_000, 100_000), BEAT_US), (2_000, (100_000, 50_000), 2_000), (1_000, (100_000, 2_000), 2_000),
     (10_000, (100_000, 100_000), 10_000), (100, (100_000, 100_000), BEAT_US)],
)  # fmt: skip
def test_a_beat_is_whole_windows_and_all_grids_are_whole_beats(
    window_us: int, grids_us: tuple[int, ...], wanted: int
) -> None:
    assert beat_us(window_us, *grids_us) == wanted


# ---- receivers that say when they are due ----------------------------------------------------------------------------

Told = list[tuple[int, LinkFrame | Text]]


def fed_always(receiver: Receiver, what: Seen) -> Told:
    """Return what is decided, with the window's end: fed every window."""
    out: Told = []
    for t1_us in range(WINDOW_US, what.until_us + WINDOW_US, WINDOW_US):
        first, behind = np.searchsorted(what.t_us, (t1_us - WINDOW_US, t1_us))
        out += [(t1_us, one) for one in receiver.feed(what.t_us[first:behind], what.on[first:behind], t1_us)]
    return out


def fed_when_due(receiver: Receiver, what: Seen) -> tuple[Told, int]:
    """Return the same and how many feeds it took: fed as the decoder does it."""
    assert isinstance(receiver, Punctual)
    out: Told = []
    fed_us = feeds = 0
    for t1_us in range(WINDOW_US, what.until_us + WINDOW_US, WINDOW_US):
        due_us = receiver.due_us()
        late = due_us >= NEVER_DUE_US or t1_us - fed_us >= WAIT_US
        if due_us > t1_us and not (t1_us % BEAT_US == 0 and late):
            continue
        first, behind = np.searchsorted(what.t_us, (fed_us, t1_us))
        out += [(t1_us, one) for one in receiver.feed(what.t_us[first:behind], what.on[first:behind], t1_us)]
        fed_us, feeds = t1_us, feeds + 1
    return out, feeds


LIGHTS = [Light(), Light(edge_jitter=0.08, event_jitter=0.1, noise_hz=2_000.0), Light(clock_ppm=300.0, dropped=0.05)]


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("bit_rate", [500.0, 2_000.0])
def test_frames_of_a_code_are_the_same_and_hardly_one_is_later_if_it_is_fed_when_due(
    light: Light, bit_rate: float
) -> None:
    kind = modulation("seed11")
    rng = np.random.default_rng(3)
    payloads = rng.choice([5, 9, 21, 42], 150)
    what = seen(light, [bit for p in payloads for bit in kind.encode(int(p))], bit_rate, 4)
    always = fed_always(CyclicReceiver(seed11_code(), bit_rate), what)
    due, feeds = fed_when_due(CyclicReceiver(seed11_code(), bit_rate), what)
    assert [one for _, one in due] == [one for _, one in always]
    # Those of the cold start come at the next beat.
    later = [a - b for (a, one), (b, _) in zip(due, always, strict=True) if one.t_us > 400 / bit_rate * 1e6]
    assert len(later) > 60
    assert sum(us > 0 for us in later) <= 0.02 * len(later)
    assert max(later) <= WINDOW_US
    assert feeds < 0.6 * what.until_us / WINDOW_US


def test_a_frame_is_decided_in_the_window_in_which_half_a_bit_behind_it_is_over() -> None:
    bit_rate = 2_000.0
    what = seen(Light(), list(modulation("seed11").encode(42)) * 100, bit_rate, 1)
    told, _ = fed_when_due(CyclicReceiver(seed11_code(), bit_rate), what)
    for t1_us, frame in told[40:]:
        assert frame.t_us + 250 - 50 <= t1_us < frame.t_us + 250 + WINDOW_US + 50


@pytest.mark.parametrize("seed", [0, 1])
def test_characters_are_the_same_and_as_early_if_text_is_fed_when_due(seed: int) -> None:
    bits = (*text_bits("what is fed when it is due says the same"), *(1,) * 60, *text_bits("behind a silence too"))
    what = seen(Light(), (*bits, *(1,) * 400), 1_000.0, seed)
    always = fed_always(TextReceiver(1_000.0), what)
    due, _ = fed_when_due(TextReceiver(1_000.0), what)
    assert [one for _, one in due] == [one for _, one in always]
    later = [(a - b, one.t_us) for (a, one), (b, _) in zip(due, always, strict=True)]
    assert max(us for us, _ in later) <= BEAT_US
    # What was held back, and what comes with it, is the cold start's.
    assert [us for us, t_us in later if t_us > 200_000] == [0] * sum(t_us > 200_000 for _, t_us in later)


# ---- the whole decoder -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("batch_us", [500, 1_000])
def test_a_frame_leaves_with_the_batch_that_holds_the_half_bit_behind_it(batch_us: int) -> None:
    place = still(80.5, 60.5)
    batch = merged([coded(place, 4.0, list(modulation("seed11").encode(42)), 500.0, 500_000, 160, 120, seed=0)])
    beacon = Beacon(name="crane", protocol="seed11", payload=42, bit_rate=2_000)
    core = DecoderCore(DecoderConfig(beacons=(beacon,)), Context(instance="d", boot="b", lockstep=False))
    waits_us: list[int] = []
    for message in messages(batch, 0, 500_000, range(0, 500_000, batch_us), end=False):
        if message.time_us % 100_000 == batch_us:
            core.feed(tracks(message.time_us - batch_us, [("a-0", Disc(0, place), 0)]))
        for one in core.feed(message):
            if isinstance(one, Frames) and one.t1_us > 250_000:
                waits_us += [message.time_us - t_us for t_us in one.t_us]
    assert len(waits_us) > 40  # of 45 sent
    assert max(waits_us) <= 250 + WINDOW_US + 50
    assert min(waits_us) >= 250 - 50


def test_tracks_that_hear_nothing_are_told_and_read_nothing_and_the_beacon_among_them_is_read() -> None:
    place = still(80.5, 60.5)
    batch = merged([coded(place, 4.0, list(modulation("seed11").encode(42)), 1_000.0, 600_000, 160, 120, seed=0)])
    beacon = Beacon(name="crane", protocol="seed11", payload=42, bit_rate=1_000)
    core = DecoderCore(DecoderConfig(beacons=(beacon,)), Context(instance="d", boot="b", lockstep=False))
    rows = [("a-0", Disc(0, place), 0), *((f"b-{k}", Disc(1, still(10.0 + 5 * k, 110.0)), 0) for k in range(25))]
    out = []
    for message in messages(batch, 0, 600_000, range(0, 600_000, 10_000), end=False):
        if message.time_us % 100_000 == 10_000:
            core.feed(tracks(message.time_us - 10_000, rows))
        out += core.feed(message)
    statuses = [one for one in out if isinstance(one, Status)]
    assert len(statuses[-1].track) == 26
    assert [us > 0 for us in statuses[-1].accepted_us] == [True] + 25 * [False]
    assert {one.beacon for one in out if isinstance(one, Identification)} == {"crane"}


@pytest.mark.parametrize("windows", [1, 40])
def test_what_is_too_shallow_for_a_track_is_left_out_and_not_given_later(windows: int) -> None:
    feeding = begun(2)
    for k in range(windows):
        t_us = np.repeat(np.arange(3, dtype=np.int64) + 1_000 * k, 2)
        depth = np.tile(np.arange(3, dtype=np.uint8), 2)
        order = np.argsort(np.tile([0, 1], 3), kind="stable")
        starts = np.array([0, 3, 6], np.int64)
        feeding.note(Routed(starts, t_us[order], np.ones(6, np.bool_), depth, 0), 1_000 * (k + 1))
    (mine_t, _, mine), (other_t, _, others) = feeding.take([1, 0], [2, 1])
    assert mine_t.tolist() == [1_000 * k + 2 for k in range(windows)]
    assert other_t.tolist() == [1_000 * k + at for k in range(windows) for at in (1, 2)]
    assert set(mine.tolist()) == {2}
    assert set(others.tolist()) == {1, 2}
    assert [len(piece[0]) for piece in feeding.take([0, 1], [0, 0])] == [0, 0]
