"""The bus of asynchronous sensors: its limit holds, nothing else is lost or changed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.events import concatenate
from heliograph_services.event_source.simulation.contract import PixelEvents
from heliograph_services.event_source.simulation.readout.aer import AerReadout
from heliograph_services.event_source.simulation.readout.numbers import AerNumbers
from heliograph_services.event_source.simulation.readout.presets import load_preset, readout_of


def random_events(n: int, duration_us: float, pixels: int, seed: int) -> PixelEvents:
    random = np.random.default_rng(seed)
    return PixelEvents(
        np.sort(random.uniform(0, duration_us, n)),
        random.integers(0, pixels, n),
        random.random(n) < 0.5,
        random.integers(-4, 20, n).astype(np.int16),
    )


def part(events: PixelEvents, start: int, stop: int) -> PixelEvents:
    cut = slice(start, stop)
    return PixelEvents(events.t_us[cut], events.pixel[cut], events.on[cut], events.cause[cut])


@pytest.mark.parametrize(("name", "limit_hz"), [("davis346", 12e6), ("imx636", 1066e6)])
def test_the_bus_passes_what_it_can_and_no_more(name: str, limit_hz: float) -> None:
    sensor = load_preset(name)
    duration_us = 20_000.0 if name == "davis346" else 1_000.0
    events = random_events(int(3 * limit_hz * duration_us / 1e6), duration_us, sensor.width * sensor.height, 1)
    readout = readout_of(sensor, 0)
    batch, _ = readout.feed(events, duration_us)
    windows_us = 100
    passed = np.bincount(batch.t_us // windows_us)
    assert passed.max() <= limit_hz * windows_us / 1e6 + 1
    assert passed[1:-1].min() >= limit_hz * windows_us / 1e6 - 1
    c = readout.counters
    assert c["events in"] == c["read"] + c["waiting"] + c["lost: bus full"] == len(events)
    assert bool((np.diff(batch.t_us) >= 0).all())


@pytest.mark.parametrize("name", ["davis346", "imx636", "genx320", "ideal"])
def test_below_the_limit_every_event_passes_unchanged(name: str) -> None:
    sensor = load_preset(name)
    events = random_events(20_000, 20_000.0, sensor.width * sensor.height, 2)
    batch, labels = readout_of(sensor, 0).feed(events, 20_001.0)
    assert len(batch) == len(events)
    assert batch.x_px.tolist() == (events.pixel % sensor.width).tolist()
    assert batch.y_px.tolist() == (events.pixel // sensor.width).tolist()
    assert batch.on.tolist() == events.on.tolist()
    assert labels.tolist() == events.cause.tolist()
    # A few wait for one another on the slowest bus.
    assert int((batch.t_us - events.t_us.astype(np.int64)).max()) <= 1
    assert int((batch.t_us - events.t_us.astype(np.int64)).min()) >= 0


def test_a_burst_waits_and_what_the_queue_cannot_hold_is_lost_and_counted() -> None:
    # 1 event a microsecond, 10 may wait: of 30 at once one passes and 10 wait.
    readout = AerReadout(AerNumbers(bus_hz=1e6, queue_events=10, resolution_us=1), 100, 100)
    events = PixelEvents(np.full(30, 5.0), np.arange(30, dtype=np.int64), np.ones(30, np.bool_), np.zeros(30, np.int16))
    batch, _ = readout.feed(events, 100.0)
    assert batch.t_us.tolist() == list(range(5, 16))
    assert batch.x_px.tolist() == list(range(11))
    assert readout.counters == {"events in": 30, "read": 11, "lost: bus full": 19, "waiting": 0}


def test_time_stamps_are_rounded_down_to_the_resolution() -> None:
    readout = AerReadout(AerNumbers(bus_hz=1e9, queue_events=10, resolution_us=4), 100, 100)
    events = PixelEvents(
        np.array([3.9, 4.0, 11.2]), np.arange(3, dtype=np.int64), np.ones(3, np.bool_), np.zeros(3, np.int16)
    )
    batch, _ = readout.feed(events, 13.0)
    assert batch.t_us.tolist() == [0, 4, 8]
    assert readout.until_us == 12


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.integers(0, 5_000), max_size=120),
    st.lists(st.integers(1, 99), max_size=10),
    st.sampled_from([2e5, 1e6, 1e9]),
    st.integers(1, 20),
)
def test_any_cut_of_the_stream_passes_the_same_as_a_plain_queue(
    times: list[int], cuts: list[int], bus_hz: float, depth: int
) -> None:
    t_us = np.array(sorted(times), np.float64) / 50
    n = len(t_us)
    pixel = np.arange(n, dtype=np.int64)
    events = PixelEvents(t_us, pixel, pixel % 2 == 0, pixel.astype(np.int16))
    readout = AerReadout(AerNumbers(bus_hz=bus_hz, queue_events=depth, resolution_us=1), 640, 480)
    batches, i = [], 0
    for end_us in [*sorted(set(cuts)), 100, 10_000]:
        j = int(np.searchsorted(t_us, end_us, side="left"))
        batches.append(readout.feed(part(events, i, j), float(end_us))[0])
        i = j
    batch = concatenate(batches)
    expected: list[tuple[int, int]] = []
    waiting: list[float] = []
    free_us = -np.inf
    for k in range(n):
        waiting = [d for d in waiting if d > t_us[k]]
        if len(waiting) < depth:
            passes_us = max(float(t_us[k]), free_us)
            free_us = passes_us + 1e6 / bus_hz
            waiting.append(passes_us)
            expected.append((int(passes_us), k))
    assert list(zip(batch.t_us.tolist(), batch.x_px.tolist(), strict=True)) == expected
    assert readout.counters["waiting"] == 0
    assert readout.counters["lost: bus full"] == n - len(expected)
