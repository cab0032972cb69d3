"""The level of an LED that moves: lit it makes events all the time, dark it makes none.

At 50 bit/s an image that moves by some pixels a bit makes ten times as many events within a lit bit as at its edges,
so the edges drown (NRZ bits have a spectral null at the bit rate only on average). Activity has edges itself. ::

    A-(k), A+(k)   events of both polarities in the half bit before and after the beginning of sub-bin k
    g(k) = (A+ - A-)^2 / (A+ + A-)         twice the log-likelihood ratio of a change, to second order

Where g is the largest within half a bit either way, above `CHANGE`, and one side has `RATIO` times as many
events as the other, there is an edge of the level. These edges are given to the clock (`heliograph.link.clock`) like
events: a rise as ON, a fall as OFF.

A light that stands still shows such edges too, around each burst. It is told apart once the grid is known: the middle
of its bits is silent; and where its bursts are so slow that they fill a bit, every other one begins with OFF events,
while a level only ever rises with ON events and falls with OFF events. So its rises have a greater share of ON events
than a lit LED has while it moves, and its falls a smaller one. If a window shows a level, its bits are read by
their middle, and the response (`heliograph.link.response`) starts with the mean counts of each pair of bits.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.clock import BLOCK_BITS, SUB, Floats

HALF_BIT: Final = SUB // 2
# g is about the square of a normal variable where nothing changes: one sub-bin in two thousand.
CHANGE: Final = 12.0
RATIO: Final = 3.0
# Fewer events in a lit half of a bit are edges' tails or noise.
LIT_EVENTS: Final = 3.0
# A word has at least one lit and one dark bit in eleven to thirty-two.
LIT_SHARE_LEAST: Final = 0.05
# Slots that the composed guess of a pair of bits weighs against those seen in the window.
COMPOSED_SLOTS: Final = 4.0
BITS_LEAST: Final = 24
# The middle of a bit, in sub-bins from both its ends: bursts are over, and the grid may be off by a sub-bin or two.
MIDDLE: Final = 3
# Where a change shows its burst: sub-bins before the boundary (the grid may be late) and after it.
BEFORE: Final = 1
AFTER: Final = 4
# Of a level's rises so many show their polarity, and there are so many; slow bursts have a half. A fall's burst lies on
# the edge of a lit bit, whose own events hide it now and then.
RISES_ON: Final = 0.75
FALLS_OFF: Final = 0.5
CHANGES_LEAST: Final = 4
# Shares of a few dozen events err by less: falls with so much more of ON than lit bits have are no falls.
SHARE_SLACK: Final = 0.2


@numba.njit(cache=True, nogil=True)
def edges(t: Floats, found_t: Floats, found_on: npt.NDArray[np.bool_]) -> int:
    """Find the edges of the level within a block.

    Args:
        t: (n,) event times in nominal bits from the block's beginning, in [0, BLOCK_BITS).
        found_t: (BLOCK_BITS * 4,) out: times of the edges, rising.
        found_on: (BLOCK_BITS * 4,) out: True for a rise.

    Returns:
        How many there are.
    """
    cells = BLOCK_BITS * SUB
    upto = np.zeros(cells + 1)
    for i in range(len(t)):
        upto[max(0, min(int(t[i] * SUB), cells - 1)) + 1] += 1.0
    for cell in range(cells):
        upto[cell + 1] += upto[cell]
    change = np.zeros(cells)
    for k in range(HALF_BIT, cells - HALF_BIT + 1):
        before = upto[k] - upto[k - HALF_BIT]
        after = upto[k + HALF_BIT] - upto[k]
        if max(before, after) >= LIT_EVENTS and max(before, after) > RATIO * min(before, after):
            change[k] = (after - before) ** 2 / (after + before)
    n = 0
    for k in range(HALF_BIT, cells - HALF_BIT + 1):
        if change[k] < CHANGE:
            continue
        rise = upto[k + HALF_BIT] - upto[k] > upto[k] - upto[k - HALF_BIT]
        largest = True
        for j in range(max(k - HALF_BIT, 0), min(k + HALF_BIT + 1, cells)):
            # Of equal ones, before and after a single burst, the one at the burst counts.
            if change[j] > change[k] or (change[j] == change[k] and ((j > k) if rise else (j < k)) and j != k):
                largest = False
                break
        if largest and n < len(found_t):
            found_t[n] = k / SUB
            found_on[n] = rise
            n += 1
    return n


@numba.njit(cache=True, nogil=True)
def start(
    t: Floats, on: npt.NDArray[np.bool_], until: float, found: Floats, rate: Floats, seen: npt.NDArray[np.int64]
) -> bool:
    """Set the rates at lock by the levels of the window's bits, if it shows any.

    Args:
        t: (n,) event times in nominal bits, rising.
        on: (n,) polarities.
        until: end of the window.
        found: (4,) of `heliograph.link.clock.grid`: the first boundary, the period.
        rate: (4, 2, SUB) out, only where it shows levels: the mean counts of dark, rise, fall, lit.
        seen: (4,) out: zero.

    Returns:
        Whether the middles of its bits are lit or dark, and it rises and falls as a level does; otherwise the rates
        mean nothing.
    """
    bits = int((until - found[0]) / found[1])
    if bits < BITS_LEAST:
        return False
    counts = np.zeros((bits, 2, SUB))
    for i in range(len(t)):
        at = (t[i] - found[0]) / found[1]
        bit = int(np.floor(at))
        if 0 <= bit < bits:
            counts[bit, 1 if on[i] else 0, min(int((at - bit) * SUB), SUB - 1)] += 1.0
    middle = np.zeros(bits)
    for bit in range(bits):
        for p in range(2):
            middle[bit] += counts[bit, p, MIDDLE:-MIDDLE].sum()
    lit = middle > 0.5 * middle.mean()
    share = lit.mean()
    if share < LIT_SHARE_LEAST or share > 1.0 - LIT_SHARE_LEAST:
        return False
    bright, dim = middle[lit].mean(), middle[~lit].mean()
    if bright < LIT_EVENTS or bright < RATIO * dim or not _changes_by_polarity(counts, lit):
        return False
    _average(counts, lit, rate)
    seen[:] = 0
    steady = _share_on(rate[3])
    return _share_on(rate[1]) > steady - SHARE_SLACK and _share_on(rate[2]) < steady + SHARE_SLACK


@numba.njit(cache=True, nogil=True)
def _share_on(rate: Floats) -> float:
    """Return the share of ON events in a row of the rates."""
    return float(rate[1].sum() / max(rate.sum(), 1e-9))


@numba.njit(cache=True, nogil=True)
def _changes_by_polarity(counts: Floats, lit: npt.NDArray[np.bool_]) -> bool:
    """Return whether the level's rises show more ON events than OFF, and its falls more OFF than the lit bit before."""
    rises, rises_on, falls, falls_off = 0, 0, 0, 0
    for bit in range(1, len(lit)):
        if lit[bit] == lit[bit - 1]:
            continue
        excess = counts[bit - 1, 1, -BEFORE:].sum() + counts[bit, 1, :AFTER].sum()
        excess -= counts[bit - 1, 0, -BEFORE:].sum() + counts[bit, 0, :AFTER].sum()
        if lit[bit]:
            rises += 1
            rises_on += 1 if excess > 0.0 else 0
        else:
            steady = counts[bit - 1, 1, MIDDLE:-MIDDLE].sum() - counts[bit - 1, 0, MIDDLE:-MIDDLE].sum()
            falls += 1
            falls_off += 1 if excess < steady * BEFORE / (SUB - 2 * MIDDLE) else 0
    return min(rises, falls) >= CHANGES_LEAST and rises_on >= RISES_ON * rises and falls_off > FALLS_OFF * falls


@numba.njit(cache=True, nogil=True)
def _average(counts: Floats, lit: npt.NDArray[np.bool_], rate: Floats) -> None:
    """Set the rates to the mean counts about the boundaries between bits, by what lies before and behind."""
    quiet = np.zeros((2, 2, SUB))
    for level in range(2):
        n = 0
        for bit in range(len(lit)):
            if lit[bit] == (level == 1):
                quiet[level] += counts[bit]
                n += 1
        quiet[level] /= max(n, 1)
    total = np.zeros((4, 2, SUB))
    slots = np.zeros(4)
    for bit in range(1, len(lit)):
        x = 2 * int(lit[bit - 1]) + int(lit[bit])
        slots[x] += 1.0
        for p in range(2):
            total[x, p, :HALF_BIT] += counts[bit - 1, p, HALF_BIT:]
            total[x, p, HALF_BIT:] += counts[bit, p, :HALF_BIT]
    for x in range(4):
        for p in range(2):
            for k in range(SUB):
                composed = quiet[x // 2, p, k + HALF_BIT] if k < HALF_BIT else quiet[x % 2, p, k - HALF_BIT]
                rate[x, p, k] = (total[x, p, k] + COMPOSED_SLOTS * composed) / (slots[x] + COMPOSED_SLOTS)
