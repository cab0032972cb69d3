"""Toggle on-off keying on an asynchronous sensor: a digital PLL, and levels by likelihood, slot by slot.

Time is in nominal bits from the lock. Slot k is the bit's length about the boundary b_k between bits k - 1 and k::

    x_k,p = events of polarity p in [b_k - T/2, b_k + T/2)          p: OFF, ON
    e     = mean offset of the slot's events of a polarity with x_k,p >= A_p / 2
    b    <- b + T + alpha e,  T <- T + alpha^2 / 4 e                damping 1
    A_p  <- A_p + (x_k,p - A_p) / 64                                where x_k,p >= A_p / 2

An edge's events reach into the slots around it where the jitter is a large share of a bit; pixels that have just fired
are blind to it; and where it is dark around the light its OFF events trail for many bits. What x_k is like depends on
the bits before and on the next one. So x_k,p has a mean and a variance for each context c = (b_{k-3}, b_{k-2}, b_{k-1},
b_k, b_{k+1}), 32 of them, learned from the decisions, and the bits are those of the cheapest path (Viterbi, 16
states)::

    cost = sum_k sum_p (x_k,p - mean_c,p)^2 / (2 var_c,p) + ln(var_c,p) / 2

A bit is decided DEPTH bits later. The levels are absolute: an ON event means light.
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

STATES: Final = 16
CONTEXTS: Final = 32
# Five to seven times the memory of the code is where a survivor's past is settled; seven.
DEPTH: Final = 28
RING: Final = 64
# Averages 1 / alpha = 20 transitions; 100 ppm of drift leave .01 bit.
ALPHA: Final = 0.05
# Transitions averaged: a millisecond or two at 60 kbit/s.
MEMORY: Final = 64
# Weight of the first guess of a context's mean, in slots; and the most that are averaged.
PRIOR: Final = 8.0
CONTEXT_MEMORY: Final = 256.0
# Without an edge for so long the clock is no clock any more: 100 ppm make .2 bit.
SILENT_MOST: Final = 2_000

# floats: boundary of the slot that is being filled, period; then by polarity (OFF, ON): amplitude A, sum of the slot's
# offsets, its events, those of the slot before; last what the cheapest path has cost.
B, T, A, SUM, N, X, COST = 0, 1, 2, 4, 6, 8, 10
FLOATS: Final = 11
# ints: the slot's number, slots without an edge, whether OFF events steer the clock.
SLOT, SILENT, OFF_STEERS = range(3)
INTS: Final = 3

DONE, SILENCE = 0, 1


@numba.njit(cache=True, nogil=True)
def guess(off: float, lit: float, trails: bool, mean: Floats, var: Floats, seen: Floats) -> None:
    """Set what contexts look like before anything is learned: an edge is one slot's.

    Args:
        off: OFF events of a fall.
        lit: ON events of a rise.
        trails: OFF events come all along dark bits, not at falls alone.
        mean: (CONTEXTS, 2) out.
        var: (CONTEXTS, 2) out.
        seen: (CONTEXTS,) out.
    """
    for c in range(CONTEXTS):
        # Bits of c, newest last: k-3, k-2, k-1, k, k+1.
        edge = ((c >> 1) & 1) - ((c >> 2) & 1)
        fallen = ((c >> 1) & 1) == 0 if trails else edge < 0
        mean[c, 0] = off if fallen else 0.0
        mean[c, 1] = lit if edge > 0 else 0.0
        var[c, 0] = max(1.0, (off / 3.0) ** 2)
        var[c, 1] = max(1.0, (lit / 3.0) ** 2)
        seen[c] = 0.0


@numba.njit(cache=True, nogil=True)
def _step(off: float, lit: float, slot: int, mean: Floats, var: Floats, cost: Floats, back: Ints) -> float:
    """Extend all paths by the bit after a slot of so many OFF and ON events; return what the cheapest has paid."""
    branch = np.empty(CONTEXTS)
    for c in range(CONTEXTS):
        a, b = off - mean[c, 0], lit - mean[c, 1]
        branch[c] = 0.5 * (a * a / var[c, 0] + b * b / var[c, 1] + math.log(var[c, 0] * var[c, 1]))
    new = np.empty(STATES)
    for s in range(STATES):
        best, which = math.inf, 0
        for oldest in range(2):
            # The state before: its oldest bit falls out of the new one.
            before = (oldest << 3) | (s >> 1)
            through = cost[before] + branch[(before << 1) | (s & 1)]
            if through < best:
                best, which = through, oldest
        new[s] = best
        back[slot % RING, s] = which
    least = float(new.min())
    for s in range(STATES):
        cost[s] = new[s] - least
    return least


@numba.njit(cache=True, nogil=True)
def _settled(slot: int, cost: Floats, back: Ints) -> int:
    """Return the context (5 bits, the newest decided DEPTH slots ago) on the cheapest path."""
    s = int(np.argmin(cost))
    for i in range(DEPTH):
        s = (back[(slot - i) % RING, s] << 3) | (s >> 1)
    return int((back[(slot - DEPTH) % RING, s] << 4) | s)


@numba.njit(cache=True, nogil=True)
def _learn(off: float, lit: float, c: int, mean: Floats, var: Floats, seen: Floats) -> None:
    seen[c] = min(seen[c] + 1.0, CONTEXT_MEMORY)
    rate = 1.0 / (seen[c] + PRIOR)
    for p in range(2):
        away = (lit if p == 1 else off) - mean[c, p]
        mean[c, p] += rate * away
        # At least that of one event: a context that was the same a few times by chance must not outvote all others.
        var[c, p] = max(var[c, p] + rate * (away * away - var[c, p]), 1.0)


@numba.njit(cache=True, nogil=True)
def _close(floats: Floats, ints: Ints) -> None:
    """End the slot that is being filled."""
    strong = False
    error, weight = 0.0, 0.0
    for p in range(2):
        n = floats[N + p]
        if n > 0.0 and n >= 0.5 * floats[A + p]:
            strong = True
            floats[A + p] += (n - floats[A + p]) / MEMORY
            if p == 1 or ints[OFF_STEERS] != 0:
                error += floats[SUM + p]
                weight += n
    if weight > 0.0:
        floats[B] += ALPHA * error / weight
        floats[T] += 0.25 * ALPHA * ALPHA * error / weight
    ints[SILENT] = 0 if strong else ints[SILENT] + 1
    floats[B] += floats[T]
    for p in range(2):
        floats[SUM + p] = floats[N + p] = 0.0
    ints[SLOT] += 1


@numba.njit(cache=True, nogil=True)
def advance(
    t: Floats,
    on: Flags,
    until: float,
    floats: Floats,
    ints: Ints,
    paths: tuple[Floats, Ints, Floats, Floats],
    learned: tuple[Floats, Floats, Floats],
    bits: npt.NDArray[np.uint8],
    ends: Floats,
) -> tuple[int, int, int]:
    """Follow the clock and decide bits.

    Args:
        t: (n,) times, not falling.
        on: (n,) polarities.
        until: there are no more events before this time.
        floats: (FLOATS,) state.
        ints: (INTS,) state.
        paths: cost (STATES,), back (RING, STATES), x (RING, 2) and boundary (RING,) of the last slots.
        learned: mean (CONTEXTS, 2), variance (CONTEXTS, 2) and how often seen (CONTEXTS,).
        bits: out: the decided bits, room for every slot that ends before until.
        ends: out: when each of them ended.

    Returns:
        DONE or SILENCE (no edge for SILENT_MOST slots), how many events were taken, how many bits decided.
    """
    cost, back, xs, boundaries = paths
    mean, var, seen = learned
    taken, decided = 0, 0
    while True:
        end = floats[B] + 0.5 * floats[T]
        if end > until or decided >= len(bits):
            return DONE, taken, decided
        while taken < len(t) and t[taken] < end:
            offset = t[taken] - floats[B]
            p = 1 if on[taken] else 0
            floats[SUM + p] += offset
            floats[N + p] += 1.0
            taken += 1
        slot = ints[SLOT]
        boundaries[slot % RING] = floats[B]
        if slot > 0:
            # The next bit matters for an edge's slot too: it is looked at one slot later.
            floats[COST] += _step(floats[X], floats[X + 1], slot, mean, var, cost, back)
        for p in range(2):
            floats[X + p] = xs[slot % RING, p] = floats[N + p]
        _close(floats, ints)
        if slot > DEPTH + 4:
            c = _settled(slot, cost, back)
            k = (slot - DEPTH - 1) % RING
            _learn(xs[k, 0], xs[k, 1], c, mean, var, seen)
            bits[decided] = c & 1
            ends[decided] = boundaries[(slot - DEPTH + 1) % RING]
            decided += 1
        if ints[SILENT] >= SILENT_MOST:
            return SILENCE, taken, decided
