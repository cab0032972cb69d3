"""What a slot of a packet looks like: event rates around a bit boundary, by the two bits before it and the one behind.

As `heliograph.link.response`, with one bit more of memory: in dim light a burst goes on for bits, so what is dark for
one bit still makes OFF events and what is dark for two makes none. x = 4 a + 2 b + c: the boundary between the bits b
and c, and a before b::

    n_p[k] ~ Poisson(rate[x, p, k])        p = 0 OFF, 1 ON;  k = 0 .. 15, the boundary at 8
    log L_x = 1/F (sum_p,k n_p[k] log rate[x, p, k] - sum_p,k rate[x, p, k])

F, at least 1, is the events of a transition over WITNESSES: all pixels see one edge and a scan bunches their events, so
no transition is believed more than so many independent ones (as `heliograph.link.step_response`).
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.clock import SUB, Floats
from heliograph.link.packet_layout import Ints
from heliograph.link.response import MEMORY_SLOTS, PRIOR_SLOTS, STRAY_EVENTS, STRAY_SHARE

ROWS: Final = 8
WITNESSES: Final = 10.0
# Places in `figures`.
BURST: Final = 0  # events of a transition
BACKGROUND: Final = 1  # events of a slot in which nothing changes
FIGURES: Final = 2


@numba.njit(nogil=True)
def tabulate(rate: Floats, logs: Floats, total: Floats, figures: Floats) -> None:
    """Set what the likelihood needs from the rates.

    Args:
        rate: (8, 2, SUB).
        logs: (8, 2, SUB) out: log of the rates, stray events included.
        total: (8,) out: events expected in a slot.
        figures: (FIGURES,) out.
    """
    burst, background = 0.0, 0.0
    for p in range(2):
        for k in range(SUB):
            quiet = 0.5 * (rate[0, p, k] + rate[ROWS - 1, p, k])
            background += quiet
            # Rises 001 and 101 make ON events, falls 010 and 110 OFF events.
            edge = 0.5 * (rate[1, 1, k] + rate[5, 1, k]) if p == 1 else 0.5 * (rate[2, 0, k] + rate[6, 0, k])
            burst += 0.5 * max(edge - quiet, 0.0)
    figures[BURST], figures[BACKGROUND] = burst, background
    stray = (STRAY_SHARE * burst + STRAY_EVENTS) / (2 * SUB)
    for x in range(ROWS):
        total[x] = 0.0
        for p in range(2):
            for k in range(SUB):
                full = rate[x, p, k] + stray
                logs[x, p, k] = np.log(full)
                total[x] += full


@numba.njit(nogil=True)
def loglikelihoods(counts: npt.NDArray[np.int32], logs: Floats, total: Floats, figures: Floats, out: Floats) -> None:
    """Set out (8,) to log L_x of one slot's counts (2, SUB), up to a constant."""
    for x in range(ROWS):
        out[x] = -total[x]
    for p in range(2):
        for k in range(SUB):
            n = counts[p, k]
            if n:
                for x in range(ROWS):
                    out[x] += n * logs[x, p, k]
    out /= max(1.0, figures[BURST] / WITNESSES)


@numba.njit(nogil=True)
def learn(x: int, counts: npt.NDArray[np.int32], rate: Floats, seen: Ints) -> None:
    """Move the rates of x towards the counts (2, SUB) of one slot."""
    share = max(1.0 / (PRIOR_SLOTS + seen[x]), 1.0 / MEMORY_SLOTS)
    seen[x] += 1
    for p in range(2):
        for k in range(SUB):
            rate[x, p, k] += share * (counts[p, k] - rate[x, p, k])


def from_pairs(pairs: Floats, rate: Floats) -> None:
    """Set rate (8, 2, SUB) to rates (4, 2, SUB) that know the bits b and c alone."""
    rate[:4] = pairs
    rate[4:] = pairs
