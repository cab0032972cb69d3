"""What a transition looks like: event rates around a bit boundary, learned from the receiver's own decisions.

A *slot* is the bit-long interval centred on a boundary b_m, cut into 16 sub-bins k. Its events are Poisson with rates
that depend on the LED's levels before and after the boundary, x = 2 before + after (0 dark, 1 rise, 2 fall, 3 lit)::

    n_p[k] ~ Poisson(rate[x, p, k])        p = 0 OFF, 1 ON
    log L_x = sum_p,k n_p[k] log rate[x, p, k] - sum_p,k rate[x, p, k]

So one table holds the step response of each polarity with its delay and tail, the background, and what a lit LED does
when it moves while a dark one is silent. At lock the table comes from the folded window (`heliograph.link.clock`); then
each slot of an accepted frame moves its row by 1 / (16 + n), at least 1/256, towards what was seen.

A sensor that reads its pixels in scans of q bits shows an edge at the end of a scan, up to q late, and the same edges
at other sub-bins when bits and scans have drifted against each other. A bin that is empty until then would be learned
as part of whatever the first mistaken frame took it for, and a word that repeats never contradicts it. So what is seen
is spread by what two readings of one edge differ by, the triangle of half-width q::

    spread[k, j] ~ max(1 - |k - j| / (SUB q), 0)        sum over k = 1
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.clock import SUB, Floats

DARK: Final = 0
RISE: Final = 1
FALL: Final = 2
LIT: Final = 3
# A code's word of n bits rises in about a quarter of its slots; only the start of learning depends on it.
RISES_A_SLOT: Final = 0.25
# Standard deviations over the background that make a bin of the lock's window part of the response; without it, half of
# a noisy region's bins would add up to a phantom transition.
SIGNIFICANT: Final = 2.0
# Half-width in sub-bins of the least spread at lock: .25, .5, .25, for a window's clock is known to a sub-bin.
SMOOTH: Final = 2.0
# Weight of the table at lock, in slots, and the longest memory: 256 slots are 15 to 25 frames.
PRIOR_SLOTS: Final = 16
MEMORY_SLOTS: Final = 256
# No bin is ever held to be free of stray events: two hundredths of a transition's events are spread over each slot,
# and one event in 50 slots comes from nowhere. Less, and a single stray event outweighs a missing transition.
STRAY_SHARE: Final = 0.02
STRAY_EVENTS: Final = 0.02
# A bin belongs to the response where the rate is this many times the background.
CORE_RATIO: Final = 3.0
# Sub-bins that the clock may be off within a frame: an eighth of a bit.
REACH: Final = 2
FIGURES: Final = 9


@numba.njit(nogil=True)
def _spread(j: int, half_width: float, weights: Floats) -> tuple[int, int]:
    """Set weights[k] for the sub-bins that an event of sub-bin j may have been in; return the first and the end."""
    reach = int(np.ceil(half_width)) - 1
    first, end = max(j - reach, 0), min(j + reach + 1, SUB)
    whole = 0.0
    for k in range(first, end):
        weights[k] = 1.0 - abs(k - j) / half_width
        whole += weights[k]
    for k in range(first, end):
        weights[k] /= whole
    return first, end


@numba.njit(cache=True, nogil=True)
def start(folded: Floats, slots: float, q: float, rate: Floats, seen: npt.NDArray[np.int64]) -> None:
    """Set the rates at lock.

    Args:
        folded: (2, SUB) events a slot in the lock's window, by polarity (OFF, ON) and sub-bin.
        slots: slots in the window.
        q: length of a scan in bits, 0 where events come in none.
        rate: (4, 2, SUB) out.
        seen: (4,) out: zero.
    """
    seen[:] = 0
    weights = np.zeros(SUB)
    half_width = max(q * SUB, SMOOTH)
    for p in range(2):
        # The median is the background as long as transitions fill less than half of a slot.
        background = np.median(folded[p])
        least = SIGNIFICANT * np.sqrt(background / slots)
        for x in range(4):
            rate[x, p] = background
        for j in range(SUB):
            over = folded[p, j] - background
            if over > least:
                first, end = _spread(j, half_width, weights)
                for k in range(first, end):
                    rate[RISE if p == 1 else FALL, p, k] += over * weights[k] / RISES_A_SLOT


@numba.njit(nogil=True)
def learn(x: int, counts: npt.NDArray[np.int32], q: float, rate: Floats, seen: npt.NDArray[np.int64]) -> None:
    """Move the rates of x towards the counts (2, SUB) of one slot, seen in scans of q bits."""
    share = max(1.0 / (PRIOR_SLOTS + seen[x]), 1.0 / MEMORY_SLOTS)
    seen[x] += 1
    # Dark and lit begin with the same guess. Until a level has been seen often, it follows the other: a level seen less
    # would else keep the guess longer, and that difference would be taken for a sign of the level.
    other = DARK + LIT - x
    along = share * PRIOR_SLOTS / (PRIOR_SLOTS + seen[other]) if x in (DARK, LIT) else 0.0
    half_width = max(q * SUB, 1.0)
    weights = np.empty(SUB)
    rate[x] *= 1.0 - share
    rate[other] *= 1.0 - along
    for p in range(2):
        for j in range(SUB):
            if counts[p, j]:
                first, end = _spread(j, half_width, weights)
                for k in range(first, end):
                    rate[x, p, k] += share * counts[p, j] * weights[k]
                    rate[other, p, k] += along * counts[p, j] * weights[k]


@numba.njit(nogil=True)
def _beside(rate: Floats, p: int, k: int) -> float:
    """Return the rate beside a transition of polarity p: before a rise and after a fall that of the dark, else the lit.

    A light that moves goes on making events once it is lit: taken for late ones of its rise, they would draw the clock.
    """
    lit = (k < SUB // 2) == (p == 0)
    return float(rate[LIT if lit else DARK, p, k])


@numba.njit(cache=True, nogil=True)
def tabulate(
    rate: Floats, logs: Floats, total: Floats, core: npt.NDArray[np.bool_], share: Floats, figures: Floats
) -> None:
    """Set what the likelihood needs from the rates.

    Args:
        rate: (4, 2, SUB).
        logs: (4, 2, SUB) out: log of the rates, stray events included.
        total: (4,) out: events expected in a slot.
        core: (2, SUB) out: where a transition's events are expected.
        share: (2, SUB) out: the probability that an event is a transition's, given that there is one near here.
        figures: (FIGURES,) out: events a transition, background events a slot, events expected outside `core` a slot;
            then for OFF and ON the background's part of sum share and of sum share x, and a transition's of sum share.
    """
    background = 0.0
    burst = 0.0
    for p in range(2):
        edge = RISE if p == 1 else FALL
        for k in range(SUB):
            quiet = 0.5 * (rate[DARK, p, k] + rate[LIT, p, k])
            background += quiet
            burst += 0.5 * max(rate[edge, p, k] - quiet, 0.0)
    stray = (STRAY_SHARE * burst + STRAY_EVENTS) / (2 * SUB)
    outside = 0.0
    for x in range(4):
        total[x] = 0.0
        for p in range(2):
            for k in range(SUB):
                full = rate[x, p, k] + stray
                logs[x, p, k] = np.log(full)
                total[x] += full
    for p in range(2):
        edge = RISE if p == 1 else FALL
        for k in range(SUB):
            quiet = 0.5 * (rate[DARK, p, k] + rate[LIT, p, k]) + stray
            core[p, k] = rate[edge, p, k] + stray > CORE_RATIO * quiet
            if not core[p, k]:
                outside += max(quiet, 0.25 * rate[edge, p, k])
        for k in range(SUB):
            # As wide as the clock may be off: a shifted response must still be seen to be steered back.
            quiet, whole = 0.0, 0.0
            for near in range(max(k - REACH, 0), min(k + REACH, SUB - 1) + 1):
                beside = _beside(rate, p, near)
                quiet += beside + stray
                whole += max(rate[edge, p, near], beside) + stray
            share[p, k] = 1.0 - quiet / whole
        figures[3 + p], figures[5 + p], figures[7 + p] = 0.0, 0.0, 0.0
        for k in range(SUB):
            quiet = _beside(rate, p, k)
            figures[3 + p] += quiet * share[p, k]
            figures[5 + p] += quiet * share[p, k] * ((k + 0.5) / SUB - 0.5)
            figures[7 + p] += max(rate[edge, p, k] - quiet, 0.0) * share[p, k]
    figures[0] = burst
    figures[1] = background
    figures[2] = outside


@numba.njit(nogil=True)
def loglikelihoods(counts: npt.NDArray[np.int32], logs: Floats, total: Floats, out: Floats) -> None:
    """Set out (4,) to log L_x of one slot's counts (2, SUB), up to a constant."""
    for x in range(4):
        out[x] = -total[x]
    for p in range(2):
        for k in range(SUB):
            n = counts[p, k]
            if n:
                for x in range(4):
                    out[x] += n * logs[x, p, k]
