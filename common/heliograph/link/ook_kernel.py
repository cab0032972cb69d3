"""Toggle on-off keying on an asynchronous sensor: a digital PLL, and levels by likelihood, slot by slot.

Time is in nominal bits from the lock. Slot k is the bit's length about the boundary b_k between bits k - 1 and k::

    x_k,p = events of polarity p in [b_k - T/2, b_k + T/2)          p: OFF, ON
    e     = mean offset of the slot's events of a polarity with x_k,p >= A_p / 2
    b    <- b + T + alpha e,  T <- T + alpha^2 / 4 e                damping 1
    A_p  <- A_p + (x_k,p - A_p) / 64                                where x_k,p >= A_p / 2

Where edges are smeared over more than their slot (s bits, a guess that the window has confirmed) that e would pull
the clock towards the middle between boundaries. There the decisions of five slots later tell whose the events are: an
event u from b_k belongs to the edges of its polarity at b_{k+j} with the weights w_j ~ exp(-((u - j) / s)^2 / 2), and
``e = sum_events sum_j w_j (u - j) / A_p`` (expectation and maximisation of the edges' common shift).

An edge's events reach into the slots around it where the jitter is a large share of a bit; and where it is dark around
the light its OFF events trail for many bits. So x_k,p has a mean and a variance for each context c = (b_{k-3}, b_{k-2},
b_{k-1}, b_k, b_{k+1}), 32 of them, learned from the decisions.

A pixel that has just fired is blind for its refractory time, and which pixels those are is not a matter of the bits: it
has been seen. Of the P pixels of the light the share that an edge at b_k finds ready is::

    r_k = 1 - sum_j w_j (x_{k-j,ON} + x_{k-j,OFF}) / P        j = 1 .. 8; w_j: share still blind j bits after firing

and of the slot's edges of polarity p that nearest to it (at b_k, b_{k-1} or b_{k+1}) has its share, rho. The bits are
those of the cheapest path (Viterbi, 16 states)::

    cost = sum_k sum_p (x_k,p - rho mean_c,p)^2 / (2 var_c,p) + ln(var_c,p) / 2

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
# Jitter in bits from which on decisions steer the clock; how many slots later; and parts of a slot.
SMEARED: Final = 0.3
STEER_DEPTH: Final = 5
FINE: Final = 4
# Slots over which pixels may be blind: 130 us at 60 kbit/s.
BLIND: Final = 8
CONTEXT_MEMORY: Final = 256.0
# Without an edge for so long the clock is no clock any more: 100 ppm make .2 bit.
SILENT_MOST: Final = 2_000

# floats: boundary of the slot that is being filled, period; then by polarity (OFF, ON): amplitude A, sum of the slot's
# offsets, its events; then what the cheapest path has cost, the light's pixels P, the share of an edge's events that
# fall into its own slot, and the jitter in bits.
B, T, A, SUM, N, COST, PIXELS, OWN, SIGMA = 0, 1, 2, 4, 6, 8, 9, 10, 11
FLOATS: Final = 12
# ints: the slot's number, slots without an edge, whether OFF events steer the clock.
SLOT, SILENT, OFF_STEERS = range(3)
INTS: Final = 3

DONE, SILENCE = 0, 1


@numba.njit(cache=True, nogil=True)
def guess(
    off: float, lit: float, sigma: float, trails: bool, dead: float, learned: tuple[Floats, Floats, Floats, Floats]
) -> None:
    """Set what contexts look like before anything is learned.

    Args:
        off: OFF events of a fall.
        lit: ON events of a rise.
        sigma: jitter of the events, in bits; their times are normal about the edge's.
        trails: OFF events come all along dark bits, not at falls alone.
        dead: refractory time in bits, whole and half ones.
        learned: out: mean (CONTEXTS, 2), variance (CONTEXTS, 2), how often seen (CONTEXTS,), w (BLIND,).
    """
    mean, var, seen, blind = learned
    for c in range(CONTEXTS):
        seen[c] = 0.0
        for p in range(2):
            full = lit if p == 1 else off
            mean[c, p] = 0.0
            for j in range(-2, 2):
                if _edge(c, j) == 2 * p - 1:
                    mean[c, p] += full * _within(j - 0.5, j + 0.5, sigma)
            var[c, p] = max(1.0, (full / 3.0) ** 2)
        if trails and (c >> 1) & 1 == 0:
            mean[c, 0] = max(mean[c, 0], off)
    for j in range(BLIND):
        blind[j] = min(max(dead - j - 0.5, 0.0), 1.0)


@numba.njit(cache=True, nogil=True)
def _within(low: float, high: float, sigma: float) -> float:
    """Return the share of a normal distribution in [low, high)."""
    scale = 1.0 / (sigma * math.sqrt(2.0))
    return 0.5 * (math.erf(high * scale) - math.erf(low * scale))


@numba.njit(cache=True, nogil=True)
def _edge(c: int, j: int) -> int:
    """Return the edge at b_{k+j}, j from -2 to 1, in a context: 1 a rise, -1 a fall, 0 none."""
    # Bits of c, newest last: k-3, k-2, k-1, k, k+1.
    return ((c >> (1 - j)) & 1) - ((c >> (2 - j)) & 1)


@numba.njit(cache=True, nogil=True)
def ready(slot: int, xs: Floats, blind: Floats, pixels: float) -> float:
    """Return the share of the pixels that an edge at this slot finds ready."""
    waiting = 0.0
    for j in range(BLIND):
        if blind[j] > 0.0:
            k = (slot - 1 - j) % RING
            waiting += blind[j] * (xs[k, 0] + xs[k, 1])
    return min(max(1.0 - waiting / max(pixels, 1.0), 0.0), 1.0)


@numba.njit(cache=True, nogil=True)
def _share(c: int, p: int, now: float, before: float) -> float:
    """Return rho of a polarity's events in a slot of context c, r of the slot and of the one before given."""
    sign = 2 * p - 1
    if _edge(c, 0) == sign:
        return now
    if _edge(c, -1) == sign:
        return before
    return now if _edge(c, 1) == sign else 1.0


@numba.njit(cache=True, nogil=True)
def step(
    slot: int, xs: Floats, pixels: float, learned: tuple[Floats, Floats, Floats, Floats], cost: Floats, back: Ints
) -> float:
    """Extend all paths by the bit `slot`, which the slot before it tells too; return what the cheapest has paid."""
    mean, var, _, blind = learned
    k = slot - 1
    now, before = ready(k, xs, blind, pixels), ready(k - 1, xs, blind, pixels)
    branch = np.empty(CONTEXTS)
    for c in range(CONTEXTS):
        a = xs[k % RING, 0] - mean[c, 0] * _share(c, 0, now, before)
        b = xs[k % RING, 1] - mean[c, 1] * _share(c, 1, now, before)
        branch[c] = 0.5 * (a * a / var[c, 0] + b * b / var[c, 1] + math.log(var[c, 0] * var[c, 1]))
    new = np.empty(STATES)
    for s in range(STATES):
        best, which = math.inf, 0
        for oldest in range(2):
            # The state before: its oldest bit falls out of the new one.
            state = (oldest << 3) | (s >> 1)
            through = cost[state] + branch[(state << 1) | (s & 1)]
            if through < best:
                best, which = through, oldest
        new[s] = best
        back[slot % RING, s] = which
    least = float(new.min())
    for s in range(STATES):
        cost[s] = new[s] - least
    return least


@numba.njit(cache=True, nogil=True)
def settled(slot: int, depth: int, cost: Floats, back: Ints) -> int:
    """Return the context (5 bits, the newest of depth slots ago) on the cheapest path."""
    s = int(np.argmin(cost))
    for i in range(depth):
        s = (back[(slot - i) % RING, s] << 3) | (s >> 1)
    return int((back[(slot - depth) % RING, s] << 4) | s)


@numba.njit(cache=True, nogil=True)
def learn(slot: int, xs: Floats, c: int, pixels: float, learned: tuple[Floats, Floats, Floats, Floats]) -> None:
    """Learn from a slot whose context is decided."""
    mean, var, seen, blind = learned
    now, before = ready(slot, xs, blind, pixels), ready(slot - 1, xs, blind, pixels)
    seen[c] = min(seen[c] + 1.0, CONTEXT_MEMORY)
    rate = 1.0 / (seen[c] + PRIOR)
    for p in range(2):
        share = _share(c, p, now, before)
        away = xs[slot % RING, p] - share * mean[c, p]
        mean[c, p] += rate * share * away
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
    if weight > 0.0 and floats[SIGMA] < SMEARED:
        _steer(error / weight, floats)
    ints[SILENT] = 0 if strong else ints[SILENT] + 1
    floats[B] += floats[T]
    for p in range(2):
        floats[SUM + p] = floats[N + p] = 0.0
    ints[SLOT] += 1


@numba.njit(cache=True, nogil=True)
def _steer(error: float, floats: Floats) -> None:
    floats[B] += ALPHA * error
    floats[T] += 0.25 * ALPHA * ALPHA * error


@numba.njit(cache=True, nogil=True)
def _shift(fine: Floats, c: int, sigma: float) -> float:
    """Return sum over a slot's events of how far they lie behind their edges, in bits.

    Args:
        fine: (2, FINE) events by polarity and quarter of the slot.
        c: context.
        sigma: jitter in bits.
    """
    total = 0.0
    for p in range(2):
        for q in range(FINE):
            if fine[p, q] == 0.0:
                continue
            u = (q + 0.5) / FINE - 0.5
            error, weight = 0.0, 0.0
            for j in range(-2, 2):
                away = (u - j) / sigma
                # Beyond three sigmas it is nobody's.
                if _edge(c, j) == 2 * p - 1 and abs(away) < 3.0:
                    w = math.exp(-0.5 * away * away)
                    error += w * (u - j)
                    weight += w
            if weight > 0.0:
                total += fine[p, q] * error / weight
    return total


@numba.njit(cache=True, nogil=True)
def advance(
    t: Floats,
    on: Flags,
    until: float,
    floats: Floats,
    ints: Ints,
    paths: tuple[Floats, Ints, Floats, Floats, Floats],
    learned: tuple[Floats, Floats, Floats, Floats],
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
        paths: cost (STATES,), back (RING, STATES); of the last slots x (RING, 2), boundary (RING,) and events by
            quarters (RING, 2, FINE).
        learned: mean (CONTEXTS, 2), variance (CONTEXTS, 2), how often seen (CONTEXTS,), and w (BLIND,).
        bits: out: the decided bits, room for every slot that ends before until.
        ends: out: when each of them ended.

    Returns:
        DONE or SILENCE (no edge for SILENT_MOST slots), how many events were taken, how many bits decided.
    """
    cost, back, xs, boundaries, fine = paths
    mean = learned[0]
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
            quarter = int((offset / floats[T] + 0.5) * FINE)
            fine[ints[SLOT] % RING, p, min(max(quarter, 0), FINE - 1)] += 1.0
            taken += 1
        slot = ints[SLOT]
        boundaries[slot % RING] = floats[B]
        for p in range(2):
            xs[slot % RING, p] = floats[N + p]
        if slot > 0:
            # The next bit matters for an edge's slot too: it is looked at one slot later.
            floats[COST] += step(slot, xs, floats[PIXELS], learned, cost, back)
        _close(floats, ints)
        fine[ints[SLOT] % RING] = 0.0
        if slot > STEER_DEPTH + 4 and floats[SIGMA] >= SMEARED:
            c = settled(slot, STEER_DEPTH, cost, back)
            own = fine[(slot - STEER_DEPTH - 1) % RING]
            _steer(_shift(own, c, floats[SIGMA]) / max(floats[PIXELS], 1.0), floats)
        if slot > DEPTH + 4:
            c = settled(slot, DEPTH, cost, back)
            learn(slot - DEPTH - 1, xs, c, floats[PIXELS], learned)
            floats[PIXELS] = mean.max() / floats[OWN]
            bits[decided] = c & 1
            ends[decided] = boundaries[(slot - DEPTH + 1) % RING]
            decided += 1
        if ints[SILENT] >= SILENT_MOST:
            return SILENCE, taken, decided
