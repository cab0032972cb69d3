"""What one scan of a scanned sensor shows, by where it lies in its bit and by four bits.

A scan that ends at t_j shows what the light has done since the scan before. An edge's burst goes on for several scans
(a pixel that falls is slow), often for more than a bit, and what a rise shows depends on how far the pixels had come
down. So the counts n_p of scan j, which lies at sub-bin k of the slot about the boundary between bits c and d, depend
on the two bits before these too, x = 8 a + 4 b + 2 c + d::

    n_p ~ Poisson(rate[x, p, k])                 of a scan at k, not of a sub-bin: a scan without events says something

Rates are learned: first from a window whose bits are guessed (`guess`), then from each slot of an accepted frame, which
moves its own row (`learn`). A word that repeats shows but some of the contexts, and where bits and scans drift slowly
but some of the sub-bins. What has been seen little must neither be ruled out nor fit by being vague: a rate is known as
well as it has been seen, Gamma with shape s by w scans, so that counts are negative binomial. A clock is off by a
sub-bin, and what a scan shows may change from nothing to all within one, so that neighbours count as well::

    s = w (mean + stray) / F + HALF
    log L[x, k] = sum_p lg(n_p / F + s) - lg s + s log(w / (w + 1)) - n_p / F log(w + 1)
    L_x = prod_j 1/2 L[x, k_j] + 1/4 L[x, k_j - 1] + 1/4 L[x, k_j + 1]

F, at least 1, is the events of a burst's scan over WITNESSES: all pixels see the same edge in the same scan, so that no
scan is believed more than so many independent events.

What stands in for a rate that has not been seen. A rise or fall at a boundary shows in the scans that end in the bit
behind it, from half a scan before the slot's middle on (a grid laid through turns lies half a scan behind the edges).
So scans are gathered by *cells*, bit-long, of bits a b c d: a slot's scans before that place belong to the cell before,
whatever d is. A cell's mean and w count its own scans at a place, those beside it (NEAR scans at most) and, as BACK_OFF
scans, the cells b c d, for which stand in the cells c d within half a bit. Every word has edges, but not every word has
00 or 11: for these stands in, FADE of it, what the edge shows that they go on from.
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.clock import SUB, Floats

CONTEXTS: Final = 16
WITNESSES: Final = 10.0
# Weight of what stands in for a context, in scans, against what was seen of it.
BACK_OFF: Final = 1.0
# Scans that those of the sub-bins beside one count for at most: an edge may begin to show between them.
NEAR: Final = 1.0
# Sub-bins from which others say nothing of one: of the same context, and of whatever has the same edge.
REACH: Final = 3
WIDE: Final = SUB // 2 + 1
# Of what an edge shows in its bit, what goes on a bit later where that has not been seen.
FADE: Final = 0.5
# Jeffreys' prior of a Poisson rate.
HALF: Final = 0.5
# Longest memory of a rate, in scans at its own sub-bin: the phase between bits and scans drifts, and comes back, but
# the grid of a loop that settles moves by a sub-bin or two.
MEMORY: Final = 24.0
# What comes from nowhere in a scan: of a burst's events, and events.
STRAY_SHARE: Final = 0.01
STRAY_EVENTS: Final = 0.02


@numba.njit(nogil=True)
def guess(bits: npt.NDArray[np.int64], first: int, scans: Floats, rate: Floats, weight: Floats) -> None:
    """Set the rates by the scans of a window whose bits are guessed.

    Args:
        bits: (slots + 1,) the bit before slot 0, then the one behind each slot.
        first: the first slot that counts; its three bits before are known.
        scans: (n, 4) slot, sub-bin, OFF events, ON events of each scan.
        rate: (16, 2, SUB) out: events a scan, of those seen; 0 where none were.
        weight: (16, SUB) out: scans seen, at most MEMORY.
    """
    rate[:] = 0.0
    weight[:] = 0.0
    for j in range(scans.shape[0]):
        slot, k = int(scans[j, 0]), int(scans[j, 1])
        if slot < max(first, 2) or slot + 1 >= bits.shape[0]:
            continue
        x = 8 * bits[slot - 2] + 4 * bits[slot - 1] + 2 * bits[slot] + bits[slot + 1]
        _move(x, k, scans[j, 2], scans[j, 3], rate, weight)


@numba.njit(nogil=True)
def _move(x: int, k: int, off: float, on: float, rate: Floats, weight: Floats) -> None:
    """Move the rates of x at k towards a scan."""
    weight[x, k] = min(weight[x, k] + 1.0, MEMORY)
    rate[x, 0, k] += (off - rate[x, 0, k]) / weight[x, k]
    rate[x, 1, k] += (on - rate[x, 1, k]) / weight[x, k]


@numba.njit(nogil=True)
def learn(x: int, scans: npt.NDArray[np.float64], n: int, rate: Floats, weight: Floats) -> None:
    """Move the rates of x towards the first n of a slot's scans (room, 3): sub-bin, OFF events, ON events."""
    for j in range(n):
        _move(x, int(scans[j, 0]), scans[j, 1], scans[j, 2], rate, weight)


@numba.njit(nogil=True)
def _cells(rate: Floats, weight: Floats, start: int, cells: Floats, seen: Floats) -> None:
    """Gather the scans of each cell, by place behind its start and by its bit and the three before.

    Args:
        rate: (16, 2, SUB).
        weight: (16, SUB).
        start: sub-bin of a slot at which its second bit begins to show.
        cells: (16, 2, SUB) out: mean rates.
        seen: (16, SUB) out: scans.
    """
    for y in range(CONTEXTS):
        for u in range(SUB):
            k = u + start
            if k < SUB:
                seen[y, u] = weight[y, k]
                cells[y, :, u] = rate[y, :, k]
                continue
            # The cell's bits are the first three of the next slot; what comes next does not show yet.
            first, k = 2 * (y & 7), k - SUB
            seen[y, u] = weight[first, k] + weight[first + 1, k]
            for p in range(2):
                both = weight[first, k] * rate[first, p, k] + weight[first + 1, k] * rate[first + 1, p, k]
                cells[y, p, u] = both / max(seen[y, u], 1e-9)


@numba.njit(nogil=True)
def _pool(cells: Floats, seen: Floats, size: int, row: Floats, rows_seen: Floats) -> None:
    """Set row (size, 2, SUB), rows_seen (size, SUB) to mean rates and scans of the cells alike in their newest bits."""
    row[:] = 0.0
    rows_seen[:] = 0.0
    for y in range(CONTEXTS):
        at = y & (size - 1)
        for u in range(SUB):
            rows_seen[at, u] += seen[y, u]
            for p in range(2):
                row[at, p, u] += seen[y, u] * cells[y, p, u]
    for at in range(size):
        for u in range(SUB):
            for p in range(2):
                row[at, p, u] /= max(rows_seen[at, u], 1e-9)


@numba.njit(nogil=True)
def _beside(row: Floats, seen: Floats, u: int, size: int, half_width: int, out: Floats) -> float:
    """Set out (2,) to the mean rates beside a place, by triangle; return the scans they count for.

    Args:
        row: (size, 2, SUB) of cells that share their newest bits.
        seen: (size, SUB) their scans.
        u: index of the cell times SUB, and the place in it.
        size: 4, 8 or 16; from 8 on a cell goes over into the next.
        half_width: of the triangle.
        out: (2,) out.
    """
    y, u = u // SUB, u % SUB
    total = 0.0
    out[:] = 0.0
    for near in range(u - half_width + 1, u + half_width):
        share = 1.0 - abs(near - u) / half_width
        first, step = y, 0
        if near < 0:
            first, step = y >> 1, size >> 1
        elif near >= SUB:
            first, step = (2 * y) & (size - 1), 1
        if near == u or (step > 0 and size < 8):
            continue
        for other in range(2 if step > 0 else 1):
            at = first + other * step
            part = share * seen[at, near % SUB]
            total += part
            for p in range(2):
                out[p] += part * row[at, p, near % SUB]
    out /= max(total, 1e-9)
    return total


@numba.njit(nogil=True)
def _pairs(cells: Floats, seen: Floats, pairs: Floats) -> None:
    """Set pairs (4, 2, SUB) to what a cell shows by its bit and the one before."""
    row, row_seen, beside = np.empty((4, 2, SUB)), np.empty((4, SUB)), np.empty(2)
    _pool(cells, seen, 4, row, row_seen)
    known = np.zeros((4, SUB))
    for cd in range(4):
        for u in range(SUB):
            share = min(_beside(row, row_seen, cd * SUB + u, 4, WIDE, beside), BACK_OFF)
            known[cd, u] = row_seen[cd, u] + share
            for p in range(2):
                own = row_seen[cd, u] * row[cd, p, u] + share * beside[p]
                pairs[cd, p, u] = own / max(known[cd, u], 1e-9)
    for level in (0, 3):
        # 00 goes on as 10 did, 11 as 01.
        edge = level ^ 2
        for u in range(SUB):
            n = known[level, u]
            for p in range(2):
                pairs[level, p, u] = (n * pairs[level, p, u] + BACK_OFF * FADE * pairs[edge, p, u]) / (n + BACK_OFF)


@numba.njit(nogil=True)
def _fill(rate: Floats, weight: Floats, start: int, mean: Floats, known: Floats) -> None:
    """Set the mean (16, 2, SUB) of each context and the scans that it is known by (16, SUB), see above."""
    cells, seen, beside = np.empty((CONTEXTS, 2, SUB)), np.empty((CONTEXTS, SUB)), np.empty(2)
    _cells(rate, weight, start, cells, seen)
    shorter, longer = np.empty((CONTEXTS, 2, SUB)), np.empty((CONTEXTS, 2, SUB))
    row, row_seen, scans = np.empty((CONTEXTS, 2, SUB)), np.empty((CONTEXTS, SUB)), np.empty((CONTEXTS, SUB))
    _pairs(cells, seen, shorter)
    for size in (8, 16):
        _pool(cells, seen, size, row, row_seen)
        for y in range(size):
            for u in range(SUB):
                around = min(_beside(row, row_seen, y * SUB + u, size, REACH, beside), NEAR)
                scans[y, u] = row_seen[y, u] + around + BACK_OFF
                for p in range(2):
                    own = row_seen[y, u] * row[y, p, u] + around * beside[p]
                    longer[y, p, u] = (own + BACK_OFF * shorter[y & (size // 2 - 1), p, u]) / scans[y, u]
        shorter[:] = longer
    for x in range(CONTEXTS):
        for k in range(SUB):
            if k >= start:
                known[x, k] = scans[x, k - start]
                mean[x, :, k] = longer[x, :, k - start]
                continue
            u = k - start + SUB
            n = min(scans[x >> 1, u], NEAR + BACK_OFF)
            known[x, k] = weight[x, k] + n
            for p in range(2):
                mean[x, p, k] = (weight[x, k] * rate[x, p, k] + n * longer[x >> 1, p, u]) / known[x, k]


@numba.njit(nogil=True)
def tabulate(
    rate: Floats, weight: Floats, q: float, mean: Floats, shape: Floats, least: Floats, scale: Floats
) -> float:
    """Set what the likelihoods need from the rates; return the events of a burst's scan.

    Args:
        rate: (16, 2, SUB) of what was seen.
        weight: (16, SUB) scans that it was seen in.
        q: length of a scan in bits.
        mean: (16, 2, SUB) out: rates, what stands in for others included.
        shape: (16, 2, SUB) out: s.
        least: (16, 2, SUB) out: log-likelihood of a scan without events.
        scale: (16, SUB) out: log(w + 1).
    """
    known = np.empty((CONTEXTS, SUB))
    _fill(rate, weight, max(int(0.5 * SUB * (1.0 - q) + 0.5), 0), mean, known)
    burst = 0.0
    for p in range(2):
        # Rises make ON events, falls OFF events.
        for k in range(SUB):
            top = 0.0
            for a in range(4):
                top += 0.25 * mean[4 * a + (1 if p == 1 else 2), p, k]
            burst += 0.5 * top / SUB
    stray = STRAY_SHARE * burst + STRAY_EVENTS
    f = max(1.0, burst / WITNESSES)
    for x in range(CONTEXTS):
        for k in range(SUB):
            w = known[x, k]
            scale[x, k] = np.log(w + 1.0)
            for p in range(2):
                s = w * (mean[x, p, k] + stray) / f + HALF
                shape[x, p, k] = s
                least[x, p, k] = s * np.log(w / (w + 1.0)) - math.lgamma(s)
    return burst


@numba.njit(nogil=True)
def likelihood(off: float, on: float, x: int, k: int, shape: Floats, least: Floats, scale: Floats) -> float:
    """Return the log-likelihood of a scan at k with so many OFF and ON events / F, up to a constant of its own."""
    total, best = 0.0, -1e300
    values = np.empty(3)
    for i in range(3):
        near = min(max(k + i - 1, 0), SUB - 1)
        values[i] = least[x, 0, near] + least[x, 1, near] - (off + on) * scale[x, near]
        values[i] += math.lgamma(off + shape[x, 0, near]) + math.lgamma(on + shape[x, 1, near])
        best = max(best, values[i])
    for i in range(3):
        total += (0.5 if i == 1 else 0.25) * np.exp(values[i] - best)
    return float(best + np.log(total))


@numba.njit(nogil=True)
def likelihoods(scans: Floats, n: int, shape: Floats, least: Floats, scale: Floats, burst: float, out: Floats) -> None:
    """Set out (16,) to log L_x of the first n of a slot's scans (room, 3): sub-bin, OFF events, ON events."""
    f = max(1.0, burst / WITNESSES)
    out[:] = 0.0
    for j in range(n):
        for x in range(CONTEXTS):
            out[x] += likelihood(scans[j, 1] / f, scans[j, 2] / f, x, int(scans[j, 0]), shape, least, scale)
