"""The onset kernel says what the definition says."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import poisson

from heliograph.events import EventBatch
from heliograph.onsets import TICK_ENTRIES_LIMIT, Gate, OnsetColumns, OnsetCounter, OnsetSettings
from reference.onsets_plain import Entry, Event, lights, onsets

WIDTH, HEIGHT = 9, 7
EVENTS = st.lists(
    st.tuples(st.integers(0, 399), st.integers(0, WIDTH - 1), st.integers(0, HEIGHT - 1), st.booleans()), max_size=120
).map(lambda events: sorted(events, key=lambda event: event[0]))


def batch_of(events: list[Event]) -> EventBatch:
    t, x, y, on = ([event[i] for event in events] for i in range(4))
    return EventBatch(np.array(t, np.int64), np.array(x, np.uint16), np.array(y, np.uint16), np.array(on, np.bool_))


def entries(columns: OnsetColumns) -> list[Entry]:
    parts = (columns.tick, columns.y_px, columns.x_px, columns.on_count, columns.off_count)
    return list(zip(*(part.tolist() for part in parts), strict=True))


@given(EVENTS, st.sampled_from(["open", "active"]), st.integers(1, 5), st.integers(1, 4), st.sampled_from([50, 100]))
def test_the_kernel_agrees_with_the_definition(
    events: list[Event], gate: Gate, min_events: int, pool_px: int, tick_us: int
) -> None:
    counter = OnsetCounter(OnsetSettings(WIDTH, HEIGHT, tick_us, pool_px, gate, min_events, noise_hz=0, memory_us=150))
    found = counter.count(batch_of(events), 0, 400)
    wanted = onsets(events, 0, tick_us, pool_px, gate, min_events)
    assert entries(found) == wanted
    open_gate = onsets(events, 0, tick_us, pool_px, "open", 1)
    assert found.gated == len(open_gate) - len(wanted)
    assert found.light.tolist() == (lights(wanted, 150 // tick_us) if gate == "active" else [False] * len(wanted))
    # A new stream remembers nothing of the last.
    counter.reset()
    assert entries(counter.count(batch_of(events), 0, 400)) == wanted


@given(EVENTS, st.sets(st.integers(1, 7)), st.sampled_from([0.0, 20_000.0, 200_000.0]))
def test_ticks_counted_in_any_pieces_are_those_counted_together(
    events: list[Event], cuts: set[int], noise_hz: float
) -> None:
    def found(edges: list[int]) -> list[tuple[Entry, bool]]:
        counter, out = OnsetCounter(OnsetSettings(WIDTH, HEIGHT, 50, noise_hz=noise_hz)), []
        for start, stop in pairwise(edges):
            inside = [event for event in events if start <= event[0] // 50 < stop]
            columns = counter.count(batch_of(inside), start * 50, stop * 50)
            rows: list[Entry] = [(tick + start, y, x, a, b) for tick, y, x, a, b in entries(columns)]
            out += list(zip(rows, columns.light.tolist(), strict=True))
        return out

    assert found([0, *sorted(cuts), 8]) == found([0, 8])


def noise(rate_hz: float, seconds: float, side: int, seed: int = 0) -> EventBatch:
    rng = np.random.default_rng(seed)
    n = rng.poisson(rate_hz * seconds)
    t = np.sort(rng.integers(0, int(seconds * 1e6), n))
    x, y = rng.integers(0, side, (2, n)).astype(np.uint16)
    return EventBatch(t, x, y, rng.random(n) < 0.5)


@pytest.mark.parametrize("rate_hz", [2_000.0, 20_000.0, 100_000.0])
def test_no_more_noise_passes_than_was_asked_for(rate_hz: float) -> None:
    side, tick_us = 128, 5_000
    counter = OnsetCounter(OnsetSettings(side, side, tick_us, noise_hz=500.0))
    found = counter.count(noise(rate_hz, 2.0, side), 0, 2_000_000)
    later = int(np.count_nonzero(found.tick >= 100))  # after half a second
    assert later / 1.5 <= 500 * 1.1
    assert counter.noise_hz == pytest.approx(rate_hz, rel=0.25)
    # The threshold is the least that does, by somebody else's Poisson law.
    mean = counter.noise_hz * tick_us / 1e6 / side**2
    rate = [side**2 * 200 * poisson.sf(0, mean) * poisson.sf(m - 2, 17 * mean) for m in range(2, 9)]
    assert counter.threshold == 2 + next(i for i, r in enumerate(rate) if r <= 500 or i == 6)


def test_a_pixel_that_blinks_is_told_from_one_that_an_edge_crosses() -> None:
    side, tick_us = 64, 5_000
    events: list[Event] = []
    yy, xx = np.mgrid[0:side, 0:side]
    disc = np.argwhere((xx - 16) ** 2 + (yy - 16) ** 2 <= 4)
    for t_us in range(0, 400_000, 20_000):  # 50 bit/s, a change each bit
        events += [(t_us + 7 * i, int(x), int(y), t_us // 20_000 % 2 == 0) for i, (y, x) in enumerate(disc)]
    for t_us in range(0, 400_000, 10_000):  # a bar of 8 px at 100 px/s: its front brighter, its end darker
        front = 20 + t_us // 10_000
        for x, on in ((front, True), (front - 8, False)):
            events += [(t_us + y, x, y, on) for y in range(32, 60) if x < side]
    counter = OnsetCounter(OnsetSettings(side, side, tick_us))
    found = counter.count(batch_of(sorted(events, key=lambda event: event[0])), 0, 400_000)
    blinks = found.y_px < 30
    # The first two changes do not tell yet; from the third on each one does.
    assert found.light[blinks & (found.tick >= 8)].all()
    assert np.count_nonzero(found.light & blinks) == 18 * len(disc)
    assert not found.light[~blinks].any()


def test_counts_stop_at_15() -> None:
    events = [(0, 0, 0, True)] * 300 + [(0, 0, 0, False)] * 260
    counter = OnsetCounter(OnsetSettings(1, 1, 10))
    assert entries(counter.count(batch_of(events), 0, 10)) == [(0, 0, 0, 15, 15)]


def test_pixels_in_the_corners_have_neighbours_only_on_the_sensor() -> None:
    # The last pixel of a row and the first of the next are neighbours in memory, not on the sensor.
    events = [(0, WIDTH - 1, 0, True), (0, 0, 1, True), (0, 0, HEIGHT - 1, True), (0, WIDTH - 1, HEIGHT - 1, True)]
    found = OnsetCounter(OnsetSettings(WIDTH, HEIGHT, 10)).count(batch_of(events), 0, 10)
    assert (entries(found), found.gated) == ([], 4)


def test_a_flash_over_the_whole_sensor_empties_its_tick_alone() -> None:
    side = 300
    assert side * side > TICK_ENTRIES_LIMIT
    y, x = (d.ravel().astype(np.uint16) for d in np.mgrid[0:side, 0:side])
    n = len(x)
    t = np.concatenate([np.zeros(n, np.int64), np.array([10, 10], np.int64)])
    pair = np.array([5, 5], np.uint16)
    batch = EventBatch(t, np.concatenate([x, pair]), np.concatenate([y, pair]), np.ones(n + 2, np.bool_))
    found = OnsetCounter(OnsetSettings(side, side, 10)).count(batch, 0, 20)
    assert (found.flooded, entries(found)) == (1, [(1, 5, 5, 2, 0)])


def test_events_off_the_sensor_are_counted_and_harm_nothing() -> None:
    events = [(0, WIDTH, 0, True), (0, 0, HEIGHT, True), (0, 65535, 65535, False), (1, 2, 3, True), (2, 2, 3, True)]
    found = OnsetCounter(OnsetSettings(WIDTH, HEIGHT, 10)).count(batch_of(events), 0, 10)
    assert (found.off_sensor, entries(found)) == (3, [(0, 3, 2, 2, 0)])


@pytest.mark.parametrize(("t0_us", "t1_us"), [(0, 15), (0, 10 * 65_536), (10, 0), (10, 20), (5, 15)])
def test_windows_must_be_whole_ticks_around_their_events(t0_us: int, t1_us: int) -> None:
    with pytest.raises(ValueError, match="must"):
        OnsetCounter(OnsetSettings(WIDTH, HEIGHT, 10)).count(batch_of([(5, 0, 0, True)]), t0_us, t1_us)
