"""The onset kernel says what the definition says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.events import EventBatch
from heliograph.onsets import TICK_ENTRIES_LIMIT, Gate, OnsetColumns, OnsetCounter, OnsetSettings
from reference.onsets_plain import Entry, Event, onsets

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
    counter = OnsetCounter(OnsetSettings(WIDTH, HEIGHT, tick_us, pool_px, gate, min_events))
    found = counter.count(batch_of(events), 0, 400)
    wanted = onsets(events, 0, tick_us, pool_px, gate, min_events)
    assert entries(found) == wanted
    open_gate = onsets(events, 0, tick_us, pool_px, "open", 1)
    assert found.gated == len(open_gate) - len(wanted)
    # The scratch is clean again: a second look sees the same.
    assert entries(counter.count(batch_of(events), 0, 400)) == wanted


@given(EVENTS)
def test_ticks_counted_one_by_one_are_those_counted_together(events: list[Event]) -> None:
    counter = OnsetCounter(OnsetSettings(WIDTH, HEIGHT, 100))
    together = entries(counter.count(batch_of(events), 0, 400))
    apart: list[Entry] = []
    for tick in range(4):
        inside = [event for event in events if event[0] // 100 == tick]
        found = entries(counter.count(batch_of(inside), tick * 100, tick * 100 + 100))
        apart += [(tick, *entry[1:]) for entry in found]
    assert apart == together


def test_counts_stop_at_255() -> None:
    events = [(0, 0, 0, True)] * 300 + [(0, 0, 0, False)] * 260
    counter = OnsetCounter(OnsetSettings(1, 1, 10))
    assert entries(counter.count(batch_of(events), 0, 10)) == [(0, 0, 0, 255, 255)]


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


@pytest.mark.parametrize(("t0_us", "t1_us"), [(0, 15), (0, 10 * 65_536), (10, 0), (10, 20)])
def test_windows_must_be_whole_ticks_around_their_events(t0_us: int, t1_us: int) -> None:
    with pytest.raises(ValueError, match="must"):
        OnsetCounter(OnsetSettings(WIDTH, HEIGHT, 10)).count(batch_of([(5, 0, 0, True)]), t0_us, t1_us)
