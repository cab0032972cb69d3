"""Intervals and bounds: against theory, scipy, and cases worked by hand."""

from __future__ import annotations

from math import log

import numpy as np
import pytest
from scipy import stats

from heliograph import accuracy
from heliograph.shares import RESAMPLES, merged, most_events, quotient, share, upper_bound


def test_the_interval_is_wider_for_bursts_than_for_single_errors() -> None:
    """100 blocks of 10 frames with 100 errors: one in each block, or ten blocks lost whole."""
    sent = np.full(100, 10, np.int64)
    single = share(sent - 1, sent)
    burst = share(np.where(np.arange(100) < 10, 0, 10), sent)
    assert single.value == burst.value == pytest.approx(0.9)
    assert single.low == pytest.approx(0.9)
    # Theory for 100 independent blocks of which a tenth is lost: 0.9 +- 1.96 * sqrt(0.9 * 0.1 / 100) = 0.059.
    assert burst.low == pytest.approx(0.9 - 0.059, abs=0.015)
    assert burst.high == pytest.approx(0.9 + 0.059, abs=0.015)


def test_no_error_in_k_blocks_leaves_the_bound_that_k_blocks_give() -> None:
    sent = np.full(60, 10, np.int64)
    found = share(sent, sent)
    assert (found.value, found.high) == (1.0, 1.0)
    assert found.low == pytest.approx(0.05 ** (1 / 60))
    assert share(np.zeros(60), sent).high == pytest.approx(1 - 0.05 ** (1 / 60))


def test_many_blocks_are_merged_without_losing_one() -> None:
    blocks = np.stack([np.full(10_007, 2), np.full(10_007, 3)])
    few = merged(blocks, 1024)
    assert few.shape[1] <= 1024
    assert few.sum(axis=1).tolist() == [20_014, 30_021]
    assert merged(blocks, 20_000) is blocks


def test_few_and_many_blocks_are_drawn_alike() -> None:
    """Both ways of drawing are one bootstrap: their intervals agree with theory, 1.96 sqrt(p q / n)."""
    for k in (1000, 1100):
        draw = np.random.default_rng(k)
        found = share(draw.random(k) < 0.8, np.ones(k))
        assert found.high - found.low == pytest.approx(2 * 1.96 * (0.8 * 0.2 / k) ** 0.5, rel=0.1)


def test_nothing_sent_has_no_share() -> None:
    found = quotient([0, 0], [0, 0])
    assert (found.n, str(found), found.row()) == (0, "-", {"n": 0})
    assert RESAMPLES >= 1000


@pytest.mark.parametrize(("k", "n"), [(0, 10), (1, 10), (3, 200), (5, 1_000_000), (10, 10)])
def test_the_upper_bound_of_failures_is_scipys(k: int, n: int) -> None:
    assert upper_bound(k, n) == pytest.approx(stats.binomtest(k, n).proportion_ci(0.9, "exact").high, rel=1e-6)
    assert upper_bound(0, 0) == 1.0


def test_the_bound_of_a_count_is_poissons() -> None:
    assert most_events(0) == pytest.approx(-log(0.05))
    for k in (1, 3, 40, 1000):
        assert most_events(k) == pytest.approx(stats.chi2.ppf(0.95, 2 * (k + 1)) / 2, rel=1e-6)


def test_the_ratios_are_those_of_the_definitions() -> None:
    """Two blocks of 10 frames of 11 bits, 11 ms: 8 right, 1 wrong, 1 missing, 1 inserted; then all right."""
    right, wrong, inserted, sent = np.array([[8, 10], [1, 0], [1, 0], [10, 10]])
    assert accuracy.mar_sent(right, sent).value == 18 / 20
    assert accuracy.mar_received(right, wrong, inserted).value == 18 / 20
    assert accuracy.frame_errors(right, sent).value == 2 / 20
    assert accuracy.character_errors(right, inserted, sent).value == 3 / 20
    bits, matched = np.array([97, 110]), np.array([99, 110])
    assert accuracy.bits_right(bits, 11 * sent).value == 207 / 220
    assert accuracy.bit_errors(bits, matched).value == pytest.approx(2 / 209)
    assert accuracy.goodput_bit_s(6 * right, 11_000 * sent).value == pytest.approx(6 * 18 / (20 * 0.011))


def test_insertions_may_lift_the_character_error_rate_above_one() -> None:
    found = accuracy.character_errors(np.array([0, 0]), np.array([8, 9]), np.array([5, 5]))
    assert (found.value, found.n) == (2.7, 10)
    assert found.low <= 2.7 <= found.high
