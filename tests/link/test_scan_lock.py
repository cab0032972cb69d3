"""How scanned light begins: what is computed once a kind, and until nothing changes, is what all of it gives."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from heliograph.link import scan_demodulator, scan_lock, scan_response
from heliograph.link.clock import SUB

Floats = npt.NDArray[np.float64]
Q = 0.4
SLOTS = 120


def window(seed: int, frame: int) -> tuple[Floats, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the scans (n, 4) of a light that repeats a word of random bits, these bits, and others nearly the same."""
    rng = np.random.default_rng(seed)
    bits = np.tile(rng.integers(0, 2, frame), SLOTS // frame + 2)[: SLOTS + 1].astype(np.int64)
    placed = []
    for t in np.arange(0.0, SLOTS - 0.5, Q):
        slot, part = int(t), t - int(t)
        rise, fall = bits[slot + 1] > bits[slot], bits[slot + 1] < bits[slot]
        shown = 0.5 <= part < 0.5 + Q
        placed.append([slot, int(part * SUB), rng.poisson(9.0 * fall * shown), rng.poisson(12.0 * rise * shown)])
    guessed = bits.copy()
    wrong = rng.integers(0, SLOTS, 6)
    guessed[wrong] = 1 - guessed[wrong]
    return np.array(placed, np.float64), bits, guessed


def settled_slowly(placed: Floats, frame: int, bits: npt.NDArray[np.int64]) -> tuple[Floats, Floats, float, float]:
    """Return rate, weight, burst and how likely all of it is: every round, every scan by itself."""
    rate, weight = np.zeros((16, 2, SUB)), np.zeros((16, SUB))
    mean, shape, least = np.zeros_like(rate), np.zeros_like(rate), np.zeros_like(rate)
    scale, likely, of_slot = np.zeros_like(weight), np.zeros((SLOTS, 16)), np.zeros(16)
    if frame:
        scan_lock._fold_bits(bits, frame)
    for _ in range(scan_lock.ROUNDS):
        scan_response.guess(bits, 2, placed, rate, weight)
        burst = scan_response.tabulate(rate, weight, Q, mean, shape, least, scale)
        for s in range(SLOTS):
            own = np.ascontiguousarray(placed[placed[:, 0] == s, 1:])
            scan_response.likelihoods(own, len(own), shape, least, scale, burst, of_slot)
            scan_demodulator.temper(of_slot, likely[s])
        likely[:] = np.log(likely)
        if frame:
            scan_lock._fold(likely, frame)
        scan_lock._viterbi(likely, bits)
    scan_response.guess(bits, 2, placed, rate, weight)
    burst = scan_response.tabulate(rate, weight, Q, mean, shape, least, scale)
    f = max(1.0, burst / scan_response.WITNESSES)
    told = -(frame or SLOTS) * math.log(2.0)
    for slot, k, off, on in placed:
        s = int(slot)
        if s >= 2:
            x = int(8 * bits[s - 2] + 4 * bits[s - 1] + 2 * bits[s] + bits[s + 1])
            told += scan_response.likelihood(off / f, on / f, x, int(k), shape, least, scale)
            told -= math.lgamma(off / f + 1.0) + math.lgamma(on / f + 1.0)
    return rate, weight, burst, told


@pytest.mark.parametrize("frame", [0, 11, 22])
@pytest.mark.parametrize("seed", range(4))
def test_a_window_is_learned_as_by_every_round_and_scan_by_itself(seed: int, frame: int) -> None:
    placed, sent, guessed = window(seed, frame or 17)
    per_slot = np.bincount(placed[:, 0].astype(np.int64), minlength=SLOTS)
    grouped = np.zeros((SLOTS, 16), np.int64)
    for s in range(SLOTS):
        grouped[s, : per_slot[s]] = np.flatnonzero(placed[:, 0] == s)
    bits, other = guessed.copy(), guessed.copy()
    rate, weight, fit = np.zeros((16, 2, SUB)), np.zeros((16, SUB)), np.zeros(len(placed))
    scans = (grouped, per_slot, placed, np.arange(len(placed)))
    burst, told = scan_lock._settle(scans, frame, Q, bits, (rate, weight), fit)
    slow_rate, slow_weight, slow_burst, slow_told = settled_slowly(placed, frame, other)
    assert np.array_equal(bits, other)
    assert np.array_equal(rate, slow_rate)
    assert np.array_equal(weight, slow_weight)
    assert burst == slow_burst
    assert told == pytest.approx(slow_told, rel=1e-12)
    assert np.mean(bits == sent) > 0.97


def test_scans_are_of_a_kind_where_all_but_their_slot_is_equal() -> None:
    placed = np.array([[0, 3, 0, 5], [1, 3, 0, 5], [2, 3, 5, 0], [3, 4, 0, 5], [9, 3, 5, 0]], np.float64)
    kind = np.zeros(5, np.int64)
    example = scan_lock._kinds(placed, kind)
    assert len(example) == 3
    assert kind[0] == kind[1] != kind[2] == kind[4]
    assert [placed[example[k], 1:].tolist() for k in kind] == placed[:, 1:].tolist()
