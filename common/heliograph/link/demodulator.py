"""The event loop of the default receiver: events in, records of frames out; one compiled call a feed.

Events are taken one by one. Before an event is counted, every slot that ends before it is closed: its likelihoods are
computed (`response`, `likelihood`), the clock is steered by its transition (`clock`), and the frames that it ends are
decided (`alignment`). A slot's end depends on earlier slots alone, so nothing depends on how the input is cut.

Times are in nominal bits since the lock's origin, as float64.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link import response
from heliograph.link.alignment import give_up, place
from heliograph.link.clock import CLOCK_LIMIT, GAIN_END, GAIN_SLOTS, GAIN_START, SUB, Floats
from heliograph.link.likelihood import slot
from heliograph.link.state import (
    AT,
    BOUNDARY,
    EDGE,
    EDGES,
    EVENTS,
    HALF,
    JITTER2,
    OUT,
    OUT_FULL,
    OUTSIDE,
    PERIOD,
    RING,
    SEARCHED,
    SILENT,
    SLOT,
    State,
)

# A slot holds a transition when nine tenths of its likelihood say so (the four kinds being equally likely before).
SURE: Final = 0.9
# Frames without any transition after which the clock is given up: a clock known to 300 ppm is then off by 0.05 bit.
SILENT_FRAMES: Final = 16
# Frames after which a search for the alignment that found nothing gives the clock up.
SEARCH_FRAMES: Final = 8
# Long-run averages of jitter and of the polarities' delay, in transitions.
AVERAGE: Final = 1.0 / 64.0

DONE: Final = 0
FULL: Final = 1
LOST: Final = 2


@numba.njit(cache=True, nogil=True)
def advance(t: Floats, on: npt.NDArray[np.bool_], until: float, state: State) -> tuple[int, int]:
    """Take events, and the word that none is left before `until`.

    Args:
        t: (n,) times, not falling.
        on: (n,) polarities.
        until: there are no more events before this time.
        state: of the track.

    Returns:
        DONE, FULL (empty `state.out`, call again) or LOST (the clock), and how many events were taken.
    """
    floats, ints = state.floats, state.ints
    i = 0
    n = len(t)
    while True:
        close = floats[BOUNDARY] + 0.5 * floats[PERIOD]
        while i < n and t[i] < close:
            p = 1 if on[i] else 0
            offset = t[i] - floats[BOUNDARY]
            k = min(max(int((offset / floats[PERIOD] + 0.5) * SUB), 0), SUB - 1)
            state.counts[ints[SLOT] % RING, p, k] += 1
            state.moments[p, 0] += 1.0
            state.moments[p, 1] += offset
            i += 1
        if i == n and until < close:
            return DONE, i
        if _close(state):
            give_up(state)
            return LOST, i
        if ints[OUT] >= OUT_FULL:
            return FULL, i


@numba.njit(cache=True, nogil=True)
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
    fact[EVENTS] = state.moments[0, 0] + state.moments[1, 0]
    fact[OUTSIDE] = 0.0
    for p in range(2):
        for k in range(SUB):
            if not state.core[p, k]:
                fact[OUTSIDE] += here[p, k]
    error = _steer(state, state.ring[at], fact)
    state.moments[:] = 0.0
    if place(state):
        response.tabulate(state.model, state.logs, state.total, state.core, state.figures)
    floats[BOUNDARY] += floats[PERIOD] + error
    ints[SLOT] += 1
    state.counts[ints[SLOT] % RING] = 0
    n = state.words.shape[1]
    if ints[SILENT] > SILENT_FRAMES * n or ints[SEARCHED] > SEARCH_FRAMES * n:
        return True
    return bool(abs(floats[PERIOD] - 1.0) > CLOCK_LIMIT)


@numba.njit(cache=True, nogil=True)
def _steer(state: State, likelihood: Floats, fact: Floats) -> float:
    """Steer the period by the slot's transition; return by how much the next boundary moves besides."""
    floats, ints = state.floats, state.ints
    whole = likelihood[0] + likelihood[1] + likelihood[2] + likelihood[3]
    p = -1
    if likelihood[response.RISE] > SURE * whole:
        p = 1
    elif likelihood[response.FALL] > SURE * whole:
        p = 0
    fact[EDGE] = 0.0
    if p < 0 or state.moments[p, 0] == 0.0:
        ints[SILENT] += 1
        return 0.0
    fact[EDGE] = 1.0
    ints[SILENT] = 0
    mean = float(state.moments[p, 1] / state.moments[p, 0])
    error = mean - (floats[HALF] if p == 1 else -floats[HALF])
    ints[EDGES] += 1
    floats[HALF] += AVERAGE * (error if p == 1 else -error)
    floats[JITTER2] += max(AVERAGE, 1.0 / ints[EDGES]) * (error * error - floats[JITTER2])
    gain = GAIN_START if ints[EDGES] < GAIN_SLOTS else GAIN_END
    floats[PERIOD] += 0.25 * gain * gain * error
    return float(gain * error)
