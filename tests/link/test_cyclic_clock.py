"""The bit clock's periodogram: what one polarity does not drown the other."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.link import clock

BLOCKS = 4


def window(falls_trail_bits: float, seed: int) -> clock.Floats:
    """Return the sums of 64 random bits: sharp rises of 20 events, falls of 80 spread evenly over so much time."""
    rng = np.random.Generator(np.random.Philox(seed))
    bits = rng.integers(0, 2, clock.BLOCK_BITS * BLOCKS)
    edges = np.flatnonzero(np.diff(bits)) + 1.0
    rises = bits[edges.astype(int)] == 1
    n = np.where(rises, 20, 80)
    spread = np.where(rises, 0.1, falls_trail_bits)
    t = np.repeat(edges, n) + rng.random(n.sum()) * np.repeat(spread, n)
    on = np.repeat(rises, n)
    sums = np.zeros((BLOCKS, clock.SUMS))
    for b in range(BLOCKS):
        own = (t >= b * clock.BLOCK_BITS) & (t < (b + 1) * clock.BLOCK_BITS)
        clock.block(t[own] - b * clock.BLOCK_BITS, on[own], sums[b])
    return sums


@pytest.mark.parametrize("trail_bits", [0.1, 0.5, 1.2])
def test_sharp_rises_are_a_clock_whatever_the_falls_do(trail_bits: float) -> None:
    for seed in range(5):
        f, z = clock.peak(window(trail_bits, seed))
        assert z >= clock.THRESHOLD_SHORT
        assert abs(f - 1.0) < 0.004


def test_noise_is_as_coherent_as_theory_says() -> None:
    """exp(-z) (1 + z) at a frequency; four independent ones in a window of 64 bits, and four between them."""
    rng = np.random.Generator(np.random.Philox(1))
    n, above = 1000, 0
    for _ in range(n):
        sums = np.zeros((BLOCKS, clock.SUMS))
        for b in range(BLOCKS):
            t = np.sort(rng.random(60) * clock.BLOCK_BITS)
            clock.block(t, rng.random(60) < 0.5, sums[b])
        above += clock.peak(sums)[1] >= 5.0
    expected = 8.0 * np.exp(-5.0) * 6.0 * n
    assert 0.6 * expected < above < 1.2 * expected


def test_one_polarity_alone_is_a_clock() -> None:
    sums = window(0.1, 0)
    sums[:, clock.POWER] = 0.0
    for o in range(clock.BLOCK_OFFSETS):
        sums[:, 4 * o : 4 * o + 2] = 0.0
    assert clock.peak(sums)[1] >= clock.THRESHOLD_SHORT
    assert clock.peak(np.zeros((BLOCKS, clock.SUMS))) == (1.0, 0.0)
