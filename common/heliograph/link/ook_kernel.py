"""Toggle on-off keying on an asynchronous sensor: a digital PLL, and levels by likelihood, slot by slot.

Time is in nominal bits from the lock. Slot k is the bit's length about the boundary b_k between bits k - 1 and k::

    x_k = ON events - OFF events in [b_k - T/2, b_k + T/2)          what is left of an edge there
    e   = mean offset of the slot's events of the stronger polarity, where |x_k| >= A / 2
    b  <- b + T + alpha e,  T <- T + alpha^2 / 4 e                  damping 1
    A  <- A + (|x_k| - A) / 64                                      where |x_k| >= A / 2

An edge's events reach into the slots around it where the jitter is a large share of a bit, and pixels that have just
fired are blind to it: what x_k is like depends on the bits before and on the next one. So x_k has a mean and a variance
for each context c = (b_{k-3}, b_{k-2}, b_{k-1}, b_k, b_{k+1}), 32 of them, learned from the decisions, and the bits are
those of the cheapest path (Viterbi, 16 states)::

    cost = sum_k (x_k - mean_c)^2 / (2 var_c) + ln(var_c) / 2

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

# floats: boundary of the slot that is being filled, period, amplitude, sums of the slot (offsets and counts of OFF and
# ON), x of the slot before.
B, T, A, OFF_SUM, ON_SUM, OFF_N, ON_N, X = range(8)
FLOATS: Final = 8
# ints: the slot's number, slots without an edge.
SLOT, SILENT = range(2)
INTS: Final = 2

DONE, SILENCE = 0, 1


@numba.njit(cache=True, nogil=True)
def guess(amplitude: float, mean: Floats, var: Floats, seen: Floats) -> None:
    """Set what contexts look like before anything is learned: an edge is one slot's."""
    for c in range(CONTEXTS):
        # Bits of c, newest last: k-3, k-2, k-1, k, k+1.
        mean[c] = amplitude * (((c >> 1) & 1) - ((c >> 2) & 1))
        var[c] = max(1.0, (amplitude / 3.0) ** 2)
        seen[c] = 0.0


@numba.njit(cache=True, nogil=True)
def _step(x: float, slot: int, mean: Floats, var: Floats, cost: Floats, back: Ints) -> None:
    """Extend all paths by the bit after the slot that holds x."""
    new = np.empty(STATES)
    for s in range(STATES):
        best, which = math.inf, 0
        for oldest in range(2):
            # The state before: its oldest bit falls out of the new one.
            before = (oldest << 3) | (s >> 1)
            c = (before << 1) | (s & 1)
            off = x - mean[c]
            through = cost[before] + off * off / (2.0 * var[c]) + 0.5 * math.log(var[c])
            if through < best:
                best, which = through, oldest
        new[s] = best
        back[slot % RING, s] = which
    least = new.min()
    for s in range(STATES):
        cost[s] = new[s] - least


@numba.njit(cache=True, nogil=True)
def _settled(slot: int, cost: Floats, back: Ints) -> int:
    """Return the context (5 bits, the newest decided DEPTH slots ago) on the cheapest path."""
    s = int(np.argmin(cost))
    for i in range(DEPTH):
        s = (back[(slot - i) % RING, s] << 3) | (s >> 1)
    return int((back[(slot - DEPTH) % RING, s] << 4) | s)


@numba.njit(cache=True, nogil=True)
def _learn(x: float, c: int, mean: Floats, var: Floats, seen: Floats) -> None:
    seen[c] = min(seen[c] + 1.0, CONTEXT_MEMORY)
    rate = 1.0 / (seen[c] + PRIOR)
    off = x - mean[c]
    mean[c] += rate * off
    # At least that of one event: a context that was the same a few times by chance must not outvote all others.
    var[c] = max(var[c] + rate * (off * off - var[c]), 1.0)


@numba.njit(cache=True, nogil=True)
def _close(floats: Floats, ints: Ints) -> float:
    """End the slot that is being filled; return its x."""
    x = float(floats[ON_N] - floats[OFF_N])
    if abs(x) >= 0.5 * floats[A]:
        error = floats[ON_SUM] / floats[ON_N] if x > 0.0 else floats[OFF_SUM] / floats[OFF_N]
        floats[B] += ALPHA * error
        floats[T] += 0.25 * ALPHA * ALPHA * error
        floats[A] += (abs(x) - floats[A]) / MEMORY
        ints[SILENT] = 0
    else:
        ints[SILENT] += 1
    floats[B] += floats[T]
    floats[OFF_SUM] = floats[ON_SUM] = floats[OFF_N] = floats[ON_N] = 0.0
    ints[SLOT] += 1
    return x


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
        paths: cost (STATES,), back (RING, STATES), x (RING,) and boundary (RING,) of the last slots.
        learned: mean, variance and how often seen, of each context.
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
            if on[taken]:
                floats[ON_SUM] += offset
                floats[ON_N] += 1.0
            else:
                floats[OFF_SUM] += offset
                floats[OFF_N] += 1.0
            taken += 1
        slot = ints[SLOT]
        boundaries[slot % RING] = floats[B]
        x = _close(floats, ints)
        xs[slot % RING] = x
        if slot > 0:
            # The next bit is known to matter for an edge's slot: it is looked at one slot later.
            _step(floats[X], slot, mean, var, cost, back)
        floats[X] = x
        if slot > DEPTH + 4:
            c = _settled(slot, cost, back)
            _learn(xs[(slot - DEPTH - 1) % RING], c, mean, var, seen)
            bits[decided] = c & 1
            ends[decided] = boundaries[(slot - DEPTH + 1) % RING]
            decided += 1
        if ints[SILENT] >= SILENT_MOST:
            return SILENCE, taken, decided
