"""The event loop of the default receiver: events in, records of frames out; one compiled call a feed.

Events are taken one by one. Before an event is counted, every slot that ends before it is closed: its likelihoods are
computed (`response`, `likelihood`), the clock is steered by its transition (`clock`), and the frames that it ends are
decided (`alignment`). A slot's end depends on earlier slots alone, so nothing depends on how the input is cut.

Times are in nominal bits since the lock's origin, as float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, cast

import numba
import numpy as np

from heliograph.events import Flags
from heliograph.link import alignment, clock, likelihood, one_phase, response
from heliograph.link import state as state_module
from heliograph.link.alignment import give_up, place
from heliograph.link.clock import CLOCK_LIMIT, GAIN_END, GAIN_SLOTS, GAIN_START, SUB, Floats
from heliograph.link.likelihood import slot
from heliograph.link.stamp import stamp
from heliograph.link.state import (
    AT,
    BOUNDARY,
    EDGE,
    EDGES,
    EVENTS,
    HALF,
    JITTER2,
    MOMENT,
    NUMBER,
    OUT,
    OUT_FULL,
    OUTSIDE,
    PERIOD,
    RING,
    SEARCHED,
    SILENT,
    SLOT,
    SQUARE,
    State,
)

# A slot's transition steers the clock when it is more likely than all else; in noise few are surer than that.
SURE: Final = 0.5
# Frames without any transition after which the clock is given up: a clock known to 500 ppm is then off by 0.05 bit, and
# finding it again costs no frame.
SILENT_FRAMES: Final = 6
# Frames after which a search for the alignment that found nothing gives the clock up.
SEARCH_FRAMES: Final = 8
# Long-run averages of jitter and of the polarities' delay, in transitions.
AVERAGE: Final = 1.0 / 64.0

# A transition's timing error is believed up to here, in bits: what is further off belongs to the next boundary.
ERROR_LIMIT: Final = 0.3

DONE: Final = 0
FULL: Final = 1
LOST: Final = 2


@numba.njit(nogil=True)
def _close(state: State) -> bool:
    """Close the open slot and open the next; return whether the clock is lost."""
    floats, ints = state.floats, state.ints
    at = ints[SLOT] % RING
    here = state.counts[at]
    loglikelihood = np.empty(4)
    response.loglikelihoods(here, state.logs, state.total, loglikelihood)
    slot(loglikelihood, state.ring[at])
    fact = state.facts[at]
    fact[AT] = floats[BOUNDARY]
    fact[EVENTS] = 0.0
    fact[OUTSIDE] = 0.0
    for p in range(2):
        fact[NUMBER + p] = here[p].sum()
        for k in range(SUB):
            fact[EVENTS] += here[p, k]
            if not state.core[p, k]:
                fact[OUTSIDE] += here[p, k]
    error = _steer(state, at)
    if place(state):
        response.tabulate(state.model, state.logs, state.total, state.core, state.share, state.figures)
    floats[BOUNDARY] += floats[PERIOD] + error
    ints[SLOT] += 1
    state.counts[ints[SLOT] % RING] = 0
    state.facts[ints[SLOT] % RING, MOMENT : SQUARE + 2] = 0.0
    n = state.words.shape[1]
    if ints[SILENT] > SILENT_FRAMES * n or ints[SEARCHED] > SEARCH_FRAMES * n:
        return True
    return bool(abs(floats[PERIOD] - 1.0) > CLOCK_LIMIT)


@numba.njit(nogil=True)
def _steer(state: State, at: int) -> float:
    """Steer the period by the slot's transition; return by how much the next boundary moves besides."""
    floats, ints, x = state.floats, state.ints, state.ring[at]
    whole = x[0] + x[1] + x[2] + x[3]
    rise, fall = x[response.RISE] / whole, x[response.FALL] / whole
    state.facts[at, EDGE] = rise + fall
    if max(rise, fall) < SURE:
        ints[SILENT] += 1
        return 0.0
    ints[SILENT] = 0
    p = 1 if rise > fall else 0
    # What the background adds to both sums is known.
    weight, moment = -state.figures[3 + p], -state.figures[5 + p]
    for k in range(SUB):
        events = state.counts[at, p, k] * state.share[p, k]
        weight += events
        moment += events * ((k + 0.5) / SUB - 0.5)
    least = max(0.5 * state.figures[7 + p], 0.5)
    error = float(moment / max(weight, least)) - (floats[HALF] if p == 1 else -floats[HALF])
    error = min(max(error, -ERROR_LIMIT), ERROR_LIMIT)
    ints[EDGES] += 1
    floats[HALF] += AVERAGE * (error if p == 1 else -error)
    floats[JITTER2] += max(AVERAGE, 1.0 / ints[EDGES]) * (error * error - floats[JITTER2])
    gain = GAIN_START if ints[EDGES] < GAIN_SLOTS else GAIN_END
    floats[PERIOD] += 0.25 * gain * gain * error
    return float(gain * error)


def _entry(sources: int) -> Callable[[Floats, Flags, float, State], tuple[int, int]]:
    """Return `advance`, cached under these sources (`heliograph.link.stamp`)."""

    @numba.njit(cache=True, nogil=True)
    def kernel(t: Floats, on: Flags, until: float, state: State) -> tuple[int, int]:
        floats, ints = state.floats, state.ints
        i = 0
        n = len(t) if sources >= 0 else 0
        while True:
            close = floats[BOUNDARY] + 0.5 * floats[PERIOD]
            while i < n and t[i] < close:
                p = 1 if on[i] else 0
                offset = t[i] - floats[BOUNDARY]
                k = min(max(int((offset / floats[PERIOD] + 0.5) * SUB), 0), SUB - 1)
                state.counts[ints[SLOT] % RING, p, k] += 1
                state.facts[ints[SLOT] % RING, MOMENT + p] += offset
                state.facts[ints[SLOT] % RING, SQUARE + p] += offset * offset
                i += 1
            if i == n and until < close:
                return DONE, i
            if _close(state):
                give_up(state)
                return LOST, i
            if ints[OUT] >= OUT_FULL:
                return FULL, i

    return cast("Callable[[Floats, Flags, float, State], tuple[int, int]]", kernel)


_KERNEL: Final = _entry(stamp(alignment, clock, likelihood, one_phase, response, state_module))


def advance(t: Floats, on: Flags, until: float, state: State) -> tuple[int, int]:
    """Take events, and the word that none is left before `until`.

    Args:
        t: (n,) times, not falling.
        on: (n,) polarities.
        until: there are no more events before this time.
        state: of the track.

    Returns:
        DONE, FULL (empty `state.out`, call again) or LOST (the clock), and how many events were taken.
    """
    return _KERNEL(t, on, until, state)
