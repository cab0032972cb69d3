"""The scan: how long it takes, what it reads, what it loses; and that a slow plain scan reads the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heliograph.events import EventBatch, concatenate
from heliograph_services.event_source.simulation.contract import Labels, PixelEvents
from heliograph_services.event_source.simulation.readout.numbers import Latch, ScanNumbers
from heliograph_services.event_source.simulation.readout.presets import load_preset, readout_of
from heliograph_services.event_source.simulation.readout.scan import ScanReadout
from reference.scan_plain import plain_scans

WIDTH, HEIGHT = 640, 480
LATCHES: tuple[Latch, ...] = ("first", "net", "step")


def mini(mode: str = "", **override: float | str) -> ScanNumbers:
    numbers = load_preset("dvxplorer_mini", mode, {f"readout.{key}": value for key, value in override.items()}).readout
    assert isinstance(numbers, ScanNumbers)
    return numbers


def events_of(*crossings: tuple[float, int, int, bool]) -> PixelEvents:
    """Make events of (t_us, x, y, on); their causes count from 0."""
    ordered = sorted(crossings, key=lambda c: (c[0], c[2] * WIDTH + c[1]))
    return PixelEvents(
        np.array([c[0] for c in ordered], np.float64),
        np.array([c[2] * WIDTH + c[1] for c in ordered], np.int64),
        np.array([c[3] for c in ordered], np.bool_),
        (np.arange(len(ordered)) % 1000).astype(np.int16),
    )


def spread(rate_hz: float, duration_us: float, seed: int) -> PixelEvents:
    """Make events at random times in random pixels."""
    random = np.random.default_rng(seed)
    n = int(rate_hz * duration_us / 1e6)
    return PixelEvents(
        np.sort(random.uniform(0, duration_us, n)),
        random.integers(0, WIDTH * HEIGHT, n),
        random.random(n) < 0.5,
        np.zeros(n, np.int16),
    )


def in_pieces(readout: ScanReadout, events: PixelEvents, ends_us: list[float]) -> tuple[EventBatch, Labels]:
    batches, labels, i = [], [], 0
    for end_us in ends_us:
        j = int(np.searchsorted(events.t_us, end_us, side="left"))
        part = PixelEvents(events.t_us[i:j], events.pixel[i:j], events.on[i:j], events.cause[i:j])
        batch, causes = readout.feed(part, end_us)
        assert len(batch) == 0 or batch.t_us[-1] <= readout.until_us
        batches.append(batch)
        labels.append(causes)
        i = j
    return concatenate(batches), np.concatenate(labels)


def scanned(numbers: ScanNumbers, events: PixelEvents, until_us: float) -> tuple[EventBatch, ScanReadout]:
    readout = ScanReadout(numbers, WIDTH, HEIGHT)
    return readout.feed(events, until_us)[0], readout


def scan_us(readout: ScanReadout) -> float:
    return readout.until_us / readout.counters["scans"]


def balance(readout: ScanReadout) -> int:
    c = readout.counters
    return c["events in"] - c["read"] - c["waiting"] - sum(n for name, n in c.items() if name.startswith("lost"))


QUIET = {
    "VARIABLE_2000": 499.0, "VARIABLE_5000": 199.0, "VARIABLE_10000": 99.6, "VARIABLE_15000": 65.0,
    "CONSTANT_100": 10_000.0, "CONSTANT_200": 5_000.0, "CONSTANT_500": 2_000.0, "CONSTANT_1000": 1_000.0,
    "CONSTANT_LOSSY_2000": 500.0, "CONSTANT_LOSSY_5000": 200.0, "CONSTANT_LOSSY_10000": 100.0,
}  # fmt: skip


@pytest.mark.parametrize(("mode", "length_us"), QUIET.items())
def test_a_quiet_scan_is_as_long_as_the_driver_says(mode: str, length_us: float) -> None:
    _, readout = scanned(mini(mode), events_of(), 1e6)
    assert scan_us(readout) == pytest.approx(length_us, abs=1.0 / readout.counters["scans"])
    assert readout.counters["scans"] == int(1e6 / length_us)


def test_a_full_scan_takes_0_83_to_0_85_ms() -> None:
    everything = PixelEvents(
        np.zeros(WIDTH * HEIGHT),
        np.arange(WIDTH * HEIGHT, dtype=np.int64),
        np.ones(WIDTH * HEIGHT, np.bool_),
        np.zeros(WIDTH * HEIGHT, np.int16),
    )
    batch, readout = scanned(mini(), everything, 900.0)
    assert readout.counters["scans"] == 1
    assert len(batch) == WIDTH * HEIGHT
    assert 830 <= readout.until_us <= 850
    assert readout.until_us == 7 + 640 * (5 + 60) * 20 // 1000


@pytest.mark.parametrize(("groups", "longer_ns"), [(0, 0), (1, 0), (10, 0), (11, 20), (60, 50 * 20)])
def test_a_column_stretches_only_above_10_active_groups(groups: int, longer_ns: int) -> None:
    # With "step" each pixel is read in a thousand scans; until_us is whole microseconds.
    crossings = [(0.0, 300, 8 * group, True) for group in range(groups)] * 1000
    _, readout = scanned(mini(latch="step"), events_of(*crossings), 1000 * (199.0 + longer_ns / 1000))
    assert readout.counters["scans"] == 1000
    assert readout.until_us == 199_000 + longer_ns


@pytest.mark.parametrize(
    ("rate_hz", "low_us", "high_us"), [(1e6, 199.0, 199.0), (10e6, 199.0, 199.05), (30e6, 205, 208)]
)
def test_scans_stretch_with_events_spread_evenly(rate_hz: float, low_us: float, high_us: float) -> None:
    _, readout = scanned(mini(), spread(rate_hz, 60_000, seed=1), 60_000)
    assert low_us - 0.01 <= scan_us(readout) <= high_us


def test_a_stretch_lengthens_each_scan() -> None:
    _, readout = scanned(mini(stretch_us=30.0), events_of(), 1e6)
    assert scan_us(readout) == pytest.approx(229.0, abs=0.001)


@pytest.mark.parametrize("latch", LATCHES)
@pytest.mark.parametrize("sample", ["hold", "column"])
@pytest.mark.parametrize("mode", ["VARIABLE_5000", "VARIABLE_15000", "CONSTANT_1000", "CONSTANT_LOSSY_10000"])
def test_a_pixel_has_one_event_a_scan_and_all_losses_are_counted(mode: str, sample: str, latch: Latch) -> None:
    # Few pixels, often: 400 of them at 20 Mev/s.
    dense = spread(20e6, 5_000, seed=2)
    rows = np.array([k % 20 * 8 for k in range(20)])[dense.pixel % 20]
    events = replace(dense, pixel=rows * WIDTH + dense.pixel // 20 % 20 * 30)
    batch, readout = scanned(mini(mode, latch=latch, sample=sample), events, 5_000)
    # All events of a scan share one time, so a pixel twice at one time would be twice in a scan.
    seen = np.stack([batch.t_us, batch.x_px.astype(np.int64), batch.y_px.astype(np.int64)])
    assert np.unique(seen, axis=1).shape[1] == len(batch) > 1000
    assert len(np.unique(batch.t_us)) <= readout.counters["scans"]
    assert balance(readout) == 0
    assert bool((np.diff(batch.t_us) >= 0).all())


def test_a_lossy_scan_loses_the_columns_that_it_does_not_reach_and_counts_them() -> None:
    # 64 us of empty columns, 36 us of time: each full column costs 65 cycles instead of 5, 1.2 us.
    crossings = [(0.0, x, y, True) for x in range(40) for y in range(HEIGHT)] + [(0.0, 639, 5, False)]
    batch, readout = scanned(mini("CONSTANT_LOSSY_10000"), events_of(*crossings), 300.0)
    assert readout.counters["scans"] == 3
    assert len(batch) == 40 * HEIGHT
    assert readout.counters["lost: no time"] == 1
    full, readout = scanned(mini("CONSTANT_LOSSY_10000"), spread(100e6, 20_000, seed=3), 20_000)
    assert readout.counters["lost: no time"] > 500_000
    assert scan_us(readout) == 100.0
    assert balance(readout) == 0
    assert np.count_nonzero(full.x_px > 300) < 0.01 * len(full)


def test_the_mini_stamps_a_scan_once_and_the_dvxplorer_column_by_column() -> None:
    crossings = [(1.0, 0, 3, True), (1.0, 639, 3, True)]
    batch, _ = scanned(mini(), events_of(*crossings), 199.0)
    assert batch.t_us.tolist() == [7, 7]
    batch, _ = scanned(mini(stamp="column"), events_of(*crossings), 199.0)
    assert batch.t_us.tolist() == [7, 7 + int(639 * 0.3)]
    batch, _ = scanned(mini(stamp="end"), events_of(*crossings), 199.0)
    assert batch.t_us.tolist() == [199, 199]
    for name, stamp in (("dvxplorer_mini", "start"), ("dvxplorer", "column")):
        numbers = load_preset(name).readout
        assert isinstance(numbers, ScanNumbers)
        assert numbers.stamp == stamp


def test_net_shows_the_sign_of_the_change_and_opposite_crossings_cancel() -> None:
    crossings = [(1.0, 5, 5, True), (2.0, 5, 5, False), (1.0, 6, 5, True), (2.0, 6, 5, True), (1.0, 7, 5, False)]
    batch, readout = scanned(mini(latch="net"), events_of(*crossings), 1_000.0)
    assert list(zip(batch.x_px, batch.on, strict=True)) == [(6, True), (7, False)]
    assert readout.counters["lost: cancelled"] == 2
    assert readout.counters["lost: merged"] == 1


def test_first_holds_the_first_crossing_whatever_follows() -> None:
    batch, readout = scanned(mini(latch="first"), events_of((1.0, 5, 5, True), (2.0, 5, 5, False)), 1_000.0)
    assert batch.on.tolist() == [True]
    assert readout.counters["lost: merged"] == 1


def test_step_reads_what_is_left_over_in_the_next_scans() -> None:
    batch, readout = scanned(mini(latch="step"), events_of(*[(1.0 + k, 5, 5, True) for k in range(3)]), 1_000.0)
    assert batch.t_us.tolist() == [7, 206, 405]
    assert balance(readout) == 0
    assert readout.counters["read"] == 3


def test_what_crosses_between_the_hold_and_the_reset_is_lost_only_by_a_pixel_that_is_reset() -> None:
    # Column 639 is read 7 + 639 x 0.3 us after the scan began; pixel (639, 9) has nothing at the hold.
    crossings = [(1.0, 639, 5, True), (100.0, 639, 5, True), (100.0, 639, 9, True), (198.9, 639, 5, False)]
    batch, readout = scanned(mini(), events_of(*crossings), 1_000.0)
    assert list(zip(batch.t_us, batch.y_px, batch.on, strict=True)) == [(7, 5, True), (206, 5, False), (206, 9, True)]
    assert readout.counters["lost: before reset"] == 1
    batch, _ = scanned(mini(sample="column"), events_of(*crossings), 1_000.0)
    assert list(zip(batch.t_us, batch.y_px, strict=True)) == [(7, 5), (7, 9), (206, 5)]


def test_the_seed_sets_the_phase_of_the_scan_and_nothing_else() -> None:
    sensor = load_preset("dvxplorer_mini")
    stamps = []
    for seed in range(20):
        batch, _ = readout_of(sensor, seed).feed(events_of((1_000.0, 5, 5, True)), 2_000.0)
        again, _ = readout_of(sensor, seed).feed(events_of((1_000.0, 5, 5, True)), 2_000.0)
        assert batch.t_us.tolist() == again.t_us.tolist()
        stamps.append(int(batch.t_us[0]))
    assert 1_000 <= min(stamps) < 1_040
    assert 1_160 < max(stamps) < 1_200


def test_scans_without_events_cost_nothing_however_long_they_last() -> None:
    readout = ScanReadout(mini(), WIDTH, HEIGHT)
    hour_us = 3.6e9
    readout.feed(events_of(), hour_us)
    batch, _ = readout.feed(events_of((hour_us + 100.0, 5, 5, True)), hour_us + 1_000.0)
    assert readout.counters["scans"] == int((hour_us + 1_000) // 199)
    assert hour_us + 100 <= int(batch.t_us[0]) < hour_us + 300


NUMBERS = ScanNumbers(
    mode="test", clock_ns=20, group_px=1, group_cycles=0, column_cycles=0, next_sel_cycles=9, detect_us=2.0,
    fixed_us=0.0, stretch_us=0.7, latch="first", sample="hold", stamp="start",
)  # fmt: skip
SMALL = {"w": 6, "h": 20}
numbers_of = st.builds(
    ScanNumbers,
    mode=st.just("test"),
    clock_ns=st.just(20),
    group_px=st.sampled_from([1, 4, 8]),
    group_cycles=st.integers(0, 8),
    column_cycles=st.integers(0, 8),
    next_sel_cycles=st.integers(1, 15),
    detect_us=st.sampled_from([0.0, 0.3, 2.0]),
    fixed_us=st.sampled_from([0.0, 0.0, 2.5, 3.0, 8.0]),
    stretch_us=st.sampled_from([0.0, 0.7]),
    latch=st.sampled_from(LATCHES),
    sample=st.sampled_from(["hold", "column"]),
    stamp=st.sampled_from(["start", "column", "end"]),
)
crossings_of = st.lists(
    st.tuples(st.integers(0, 4_000), st.integers(0, SMALL["w"] * SMALL["h"] - 1), st.booleans()), max_size=80
)


def small_events(crossings: list[tuple[int, int, bool]]) -> PixelEvents:
    """Make events at multiples of 10 ns, so that some fall on the edges of scans and columns."""
    ordered = sorted(crossings)
    return PixelEvents(
        np.array([c[0] / 100 for c in ordered], np.float64),
        np.array([c[1] for c in ordered], np.int64),
        np.array([c[2] for c in ordered], np.bool_),
        np.arange(len(ordered), dtype=np.int16),
    )


@settings(max_examples=400, deadline=None)
@example(  # a cut within the second scan: its events must not take the place of the first one's
    replace(NUMBERS, sample="column", stamp="end"), [(0, 0, False), (2090, 0, False)], [25]
)
@given(numbers_of, crossings_of, st.lists(st.integers(1, 59), max_size=12))
def test_any_cut_of_the_stream_reads_the_same_as_the_plain_scan(
    numbers: ScanNumbers, crossings: list[tuple[int, int, bool]], cuts: list[int]
) -> None:
    events = small_events(crossings)
    readout = ScanReadout(numbers, SMALL["w"], SMALL["h"])
    batch, labels = in_pieces(readout, events, [float(c) for c in sorted(set(cuts))] + [60.0])
    scans = plain_scans(numbers, SMALL["w"], SMALL["h"], events, 60.0)
    expected = [event for scan in scans for event in scan.events]
    fields = (batch.t_us.tolist(), batch.x_px.tolist(), batch.y_px.tolist(), batch.on.tolist(), labels.tolist())
    assert list(zip(*fields, strict=True)) == expected
    assert readout.counters["scans"] == len(scans)
    assert readout.until_us == (scans[-1].end_ns // 1000 if scans else 0)
    assert balance(readout) == 0
