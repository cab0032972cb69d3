"""Edges of a light whose bursts are longer than a bit: its changes of polarity.

In dim light a pixel follows the LED slowly: a burst goes on for bits, and its events, spread evenly, show no clock
(`heliograph.link.clock`) where bits are random. But the light turns at once: while it rises there are ON events, and
from its fall on OFF events alone. So, with D(k) = ON - OFF and A(k) = ON + OFF in the half bit before (-) and after (+)
the beginning of sub-bin k::

    e(k) = D+ - D-        g(k) = e^2 / (A+ + A-)        twice the log-likelihood ratio of a change, to second order

Where |e| is the largest within half a bit either way, g is above CHANGE, and what follows is mostly of e's sign (a
burst that ends changes D too), the light turned. Such edges are given to the clock like events. Between them its level
is known, if only nearly; so the response (`heliograph.link.packet_response`) starts with the mean counts of each three
bits.
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
# Of the events behind an edge so many are of its sign: the tail of the burst before may still be among them.
MOSTLY: Final = 0.7
# Slots that the guess (the mean of all slots of the same pair of bits) weighs against those seen of the three.
GUESS_SLOTS: Final = 2.0


@numba.njit(cache=True, nogil=True)
def turns(t: Floats, on: npt.NDArray[np.bool_], found_t: Floats, found_on: npt.NDArray[np.bool_]) -> int:
    """Find the edges of the light within a block.

    Args:
        t: (n,) event times in nominal bits from the block's beginning, in [0, BLOCK_BITS).
        on: (n,) polarities.
        found_t: (BLOCK_BITS * 4,) out: times of the edges, rising.
        found_on: (BLOCK_BITS * 4,) out: True for a rise.

    Returns:
        How many there are.
    """
    cells = BLOCK_BITS * SUB
    signed, both = np.zeros(cells + 1), np.zeros(cells + 1)
    for i in range(len(t)):
        cell = max(0, min(int(t[i] * SUB), cells - 1)) + 1
        signed[cell] += 1.0 if on[i] else -1.0
        both[cell] += 1.0
    for cell in range(cells):
        signed[cell + 1] += signed[cell]
        both[cell + 1] += both[cell]
    change = np.zeros(cells)
    for k in range(HALF_BIT, cells - HALF_BIT + 1):
        after = signed[k + HALF_BIT] - signed[k]
        e = after - (signed[k] - signed[k - HALF_BIT])
        follows = e * after > 0.0 and abs(after) >= (2.0 * MOSTLY - 1.0) * (both[k + HALF_BIT] - both[k])
        if follows and e * e > CHANGE * (both[k + HALF_BIT] - both[k - HALF_BIT]):
            change[k] = e
    n = 0
    for k in range(HALF_BIT, cells - HALF_BIT + 1):
        if change[k] == 0.0:
            continue
        largest = True
        for j in range(max(k - HALF_BIT, 0), min(k + HALF_BIT + 1, cells)):
            # Of equal ones, before and at a single burst, the last one is at the burst.
            if abs(change[j]) > abs(change[k]) or (abs(change[j]) == abs(change[k]) and j > k):
                largest = False
                break
        if largest and n < len(found_t):
            found_t[n] = k / SUB
            found_on[n] = change[k] > 0.0
            n += 1
    return n


@numba.njit(cache=True, nogil=True)
def start(
    t: Floats, on: npt.NDArray[np.bool_], until: float, found: Floats, edge_t: Floats, edge_on: npt.NDArray[np.bool_],
    rate: Floats, seen: npt.NDArray[np.int64],
) -> None:  # fmt: skip
    """Set the rates at lock by the levels between the edges of the window.

    Args:
        t: (n,) event times in nominal bits, rising.
        on: (n,) polarities.
        until: end of the window.
        found: (4,) of `heliograph.link.clock.grid`: the first boundary, the period.
        edge_t: (m,) times of the edges, rising, m > 0.
        edge_on: (m,) True for a rise.
        rate: (8, 2, SUB) out (`heliograph.link.packet_response`).
        seen: (8,) out: zero.
    """
    seen[:] = 0
    # Slot s reaches from half a bit before boundary s to half a bit behind it.
    slots = max(int((until - found[0]) / found[1] - 0.5), 1)
    level = np.zeros(slots + 1, np.int64)  # of the bit before slot s
    first = 1 if not edge_on[0] else 0
    at = 0
    for s in range(slots + 1):
        middle = found[0] + (s - 0.5) * found[1]
        while at < len(edge_t) and edge_t[at] < middle:
            at += 1
        level[s] = first if at == 0 else (1 if edge_on[at - 1] else 0)
    total = np.zeros((8, 2, SUB))
    n = np.zeros(8)
    for s in range(1, slots):
        n[4 * level[s - 1] + 2 * level[s] + level[s + 1]] += 1.0
    for i in range(len(t)):
        place = (t[i] - found[0]) / found[1] + 0.5
        s = int(np.floor(place))
        if 1 <= s < slots:
            x = 4 * level[s - 1] + 2 * level[s] + level[s + 1]
            total[x, 1 if on[i] else 0, min(int((place - s) * SUB), SUB - 1)] += 1.0
    for x in range(8):
        other = (x + 4) % 8  # the pair of bits is the same
        for p in range(2):
            for k in range(SUB):
                before, behind = max(k - 1, 0), min(k + 1, SUB - 1)
                mine = 0.25 * total[x, p, before] + 0.5 * total[x, p, k] + 0.25 * total[x, p, behind]
                theirs = 0.25 * total[other, p, before] + 0.5 * total[other, p, k] + 0.25 * total[other, p, behind]
                guess = (mine + theirs) / max(n[x] + n[other], 1.0)
                rate[x, p, k] = (mine + GUESS_SLOTS * guess) / (n[x] + GUESS_SLOTS)
