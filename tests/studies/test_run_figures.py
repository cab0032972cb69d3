"""Figures of a few runs: values of all runs as one, intervals that reach from run to run."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from heliograph_services.cli.studies import run_figures
from heliograph_services.cli.studies.run_figures import acquisition, between, histogram, latency, of_runs, quotient


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=10))
def test_the_interval_of_a_mean_is_students(values: list[float]) -> None:
    low, high = between(values)
    half = stats.t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values))
    assert high - low == pytest.approx(2 * half, rel=1e-3, abs=1e-9)
    assert (low + high) / 2 == pytest.approx(statistics.fmean(values), abs=1e-6)


def test_an_interval_holds_the_truth_nineteen_times_in_twenty() -> None:
    rng = np.random.default_rng(7)
    held = 0
    for _ in range(1000):
        # Times of 100 ms, e^.3 apart from run to run and e^.05 within one.
        runs = [np.exp(rng.normal(4.605 + rng.normal(0, 0.3), 0.05, 21)).tolist() for _ in range(3)]
        found = acquisition(runs, 0.5)
        assert found.low is not None
        assert found.high is not None
        held += found.low <= 100.0 <= found.high
    assert 935 <= held <= 980


@given(st.lists(st.floats(0.2, 5_000.0), min_size=5, max_size=200), st.sampled_from([0.5, 0.95]))
def test_a_quantile_of_binned_latencies_is_that_of_the_latencies_within_a_bin(values_ms: list[float], q: float) -> None:
    binned = histogram([(ms / 1e3, 1_000_000 * (i % 3)) for i, ms in enumerate(values_ms)])
    found = latency([binned], q)
    exact = float(np.quantile(values_ms, q, method="inverted_cdf"))
    assert found.n == len(values_ms)
    assert found.value == pytest.approx(exact, rel=0.055)  # a bin, and three digits


def test_a_quantile_of_latencies_moves_within_its_bin() -> None:
    ms = np.geomspace(100.0, 400.0, 2001)
    binned = histogram([(one / 1e3, 0) for one in ms])
    found = latency([binned], 0.5)
    assert found.value == pytest.approx(200.0, rel=0.01)
    lower = latency([binned | {"1": {"0": 40}}], 0.5)
    assert lower.value is not None
    assert found.value is not None
    assert 0.98 < lower.value / found.value < 0.995


def test_the_interval_of_one_runs_acquisition_time_is_that_of_order_statistics() -> None:
    # Of twenty, the median lies between the 6th and the 15th with 95.9 % (tables of the sign test).
    found = acquisition([[float(i) for i in range(1, 21)]], 0.5)
    assert (found.value, found.low, found.high) == (10.0, 6.0, 15.0)
    late = acquisition([[5.0, None, None]], 0.5)
    assert (late.value, late.n) == (None, 3)
    few = acquisition([[1.0, 2.0, 3.0]], 0.95)
    assert (few.value, few.high) == (3.0, None)
    assert acquisition([[], []], 0.5).value is None


def test_a_run_that_never_identified_half_leaves_no_bound_above() -> None:
    runs: list[list[float | None]] = [[float(ms) for ms in range(50, 90)], [*map(float, range(50, 70)), *[None] * 30]]
    found = acquisition(runs, 0.5)
    assert found.value is not None
    assert found.low is not None
    assert (found.low <= 69.0, found.high) == (True, None)


def test_intervals_of_latencies_and_shares_reach_from_run_to_run() -> None:
    slow = [{"0": {str(i): 50}, "1": {str(i): 50}} for i in (60, 70, 80)]
    late = latency(slow, 0.5)
    assert late.low is not None
    assert late.high is not None
    # Bins of ten steps apart: log 1.05 * 10 * 4.303 / sqrt(3) on each side.
    assert late.high / late.low == pytest.approx(run_figures.STEP ** (2 * 10 * 4.303 / math.sqrt(3)), rel=0.02)
    bad = of_runs([np.array([[100, right]] * 30) for right in (100, 100, 70)])
    assert bad.value == 0.9
    assert bad.low == pytest.approx(0.9 - 4.303 * statistics.stdev([1.0, 1.0, 0.7]) / math.sqrt(3), abs=1e-4)
    assert bad.high == 1.0
    assert of_runs([]).value is None


def test_runs_that_agree_have_the_interval_of_their_blocks() -> None:
    found = of_runs([np.array([[100, 100], [100, 90]]) for _ in range(3)])
    # Six blocks, drawn anew: none good 1 time in 64, at most one 7 times in 64.
    assert (found.low, found.high) == pytest.approx((0.9 + 0.1 / 6, 1.0 - 0.1 / 6), abs=1e-4)
    all_right = of_runs([np.array([[100, 100]] * 10)] * 3)
    assert all_right.low == pytest.approx(0.05 ** (1 / 30), abs=1e-4)


def test_a_quotient_is_of_all_runs_and_its_interval_of_theirs() -> None:
    found = quotient([0.6, 0.8], [2, 2], 3, "core")
    assert (found.value, found.n, found.unit) == (0.35, 2, "core")
    assert (found.low, found.high) == (0.0, 0.985)  # .35 -+ 12.706 * .0707 / sqrt(2), and nothing below 0
    assert quotient([3.0], [1.0], 1).low is None
    assert quotient([], [], 1).value is None
