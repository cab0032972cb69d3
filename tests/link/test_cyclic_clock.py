"""The bit clock's periodogram: one polarity does not drown the other, and 5 % off is not too far."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.link import clock
from heliograph.link.modulations import modulation
from support.async_lights import read

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


@pytest.mark.parametrize("percent", [-5.0, -2.0, 0.0, 2.0, 5.0])
@pytest.mark.parametrize("protocol", ["seed11", "code"])
def test_beacons_of_rc_clocks_are_identified_at_the_nominal_rate(protocol: str, percent: float) -> None:
    # Words of 20 bits repeat every 5 % of the bit rate: their lines lie where another clock would.
    kind = modulation(protocol)
    bits = np.array(kind.encode(42)).tolist()
    bit = 500.0 / (1.0 + 0.01 * percent)
    levels = np.array([0, *(bits * (600 // len(bits)))])
    edges = np.flatnonzero(np.diff(levels))
    rng = np.random.default_rng(7)
    t = np.repeat(1000.0 + edges * bit, 6) + rng.exponential(0.05 * bit, 6 * len(edges))
    on = np.repeat(np.diff(levels)[edges] > 0, 6)
    order = np.argsort(t, kind="stable")
    done = read(kind.receiver(2000.0), t[order].astype(np.int64), on[order], window_us=5000)
    assert done.identity is not None
    assert done.identity.payload == 42
    # Half a second before the clock is found and the frames are in their place.
    assert done.payloads.count(42) >= len(done.payloads) - 1 >= 600 // len(bits) - 6


def test_a_line_beside_the_bit_rate_is_told_too_and_a_rarer_clock_comes_after_a_common_one() -> None:
    # One rise in every 20 bits: all lines of the word are as high.
    t = np.arange(3.3, 256.0, 20.0)
    sums = np.zeros((16, clock.SUMS))
    for b in range(16):
        own = t[(t >= 16.0 * b) & (t < 16.0 * (b + 1))] - 16.0 * b
        clock.block(np.repeat(own, 3), np.ones(3 * len(own), np.bool_), sums[b])
    found = np.empty((clock.PEAKS, 2))
    assert clock.peaks(sums, 10.0, found) == 3
    assert found[0, 0] == pytest.approx(1.0, abs=1e-3)
    assert sorted(found[1:, 0]) == pytest.approx([0.95, 1.05], abs=1e-3)
    assert clock.peaks(sums, 1e3, found) == 1
    assert clock.peak(sums)[0] == pytest.approx(1.0, abs=1e-3)
