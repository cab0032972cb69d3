"""Where a frame begins among n bit positions, and what becomes of each frame.

Every slot closes a window of n bits; its evidence is E = ln(mean over words L(w) / mean over all 2^n bits L). At the
right position it is n ln 2 - ln W for each frame that is read (seed11: 3.5 nats, code20d4: 7.6), elsewhere it is
negative, whether the payload repeats or changes from frame to frame. Each position r = m mod n keeps a running sum::

    A_r <- 0.9 A_r + max(E, -3)

The track is *aligned* at r when A_r >= 6 and it leads all others by 3 nats; the frames since the lock are then decided
in their order, so a cold start costs none. Aligned, only the windows at r are decided; when A_r falls below -3 (a bit
slipped) the search starts anew over the last frames. An ambiguous word leads at two positions and never aligns; one
that a rotation turns into itself leads at several too, and any of them will do.

A frame is decided on its own n bits and published once.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link import one_phase, response
from heliograph.link.likelihood import BEST, EVIDENCE, MARGIN, SCORE, VERDICT_FIELDS, decide, plain_bits
from heliograph.link.state import (
    ALIGNED,
    AT,
    EDGE,
    EVENTS,
    GRID_WORD,
    HARD,
    LAST_END,
    NEXT_ONE,
    OCCLUSION,
    OFF_GRID,
    OUT,
    OUT_CODE,
    OUT_END,
    OUT_GRID,
    OUT_MARGIN,
    OUT_SCORE,
    OUT_SLOT,
    OUTSIDE,
    PERIOD,
    READ_OUT,
    RING,
    RUN,
    SEARCHED,
    SLOT,
    TRUST,
    WEAK,
    State,
)

# A frame of seed11 read without doubt twice (3.5 + 0.9 * 3.5 nats): by chance once in e^6 windows, and it must lead.
ALIGN: Final = 6.0
LEAD: Final = 3.0
DECAY: Final = 0.9
MISS: Final = -3.0
# Frames after which a search that found nothing gives the clock up.
SEARCH_FRAMES: Final = 8
# A score is the probability of being right: at one half and above, publishing is right more often than not.
ACCEPT: Final = 0.5
# Learning from a frame that is wrong spoils the next ones; nine in ten is the usual bar of decision direction.
LEARN: Final = 0.9
# Of a frame's events, more outside the transitions' place than inside, and this many: light on another grid.
OFF_GRID_EVENTS: Final = 8
# Every word has a rise and a fall.
EDGES_LEAST: Final = 1.5


@numba.njit(nogil=True)
def place(state: State) -> bool:
    """Take note of the slot that is closing (ints[SLOT]); return whether the model has learned from a frame."""
    ints, sums = state.ints, state.sums
    n = state.words.shape[1]
    m = ints[SLOT]
    if m < n:
        return False
    if ints[ALIGNED] >= 0:
        if m % n != ints[ALIGNED]:
            return False
        evidence, taught = _settle(m, state)
        state.floats[TRUST] = DECAY * state.floats[TRUST] + evidence
        if state.floats[TRUST] < MISS:
            ints[ALIGNED] = -1
            sums[:] = 0.0
            for earlier in range(max(n, m - 3 * n + 1), m + 1):
                _search(earlier, state)
        return taught
    ints[SEARCHED] += 1
    _search(m, state)
    r = m % n
    if sums[r] < ALIGN:
        return False
    word = -1
    for other in range(n):
        if other == r or sums[other] + LEAD <= sums[r]:
            continue
        if word < 0:
            verdict = np.empty(VERDICT_FIELDS)
            decide(state.ring, m - n, state.words, state.floats[NEXT_ONE], verdict)
            word = int(verdict[BEST])
        if not _is_turned_into_itself(state.words[word], other - r):
            return False
    return _align(m, state)


@numba.njit(nogil=True)
def _is_turned_into_itself(word: npt.NDArray[np.uint8], by: int) -> bool:
    n = len(word)
    differing = 0
    for i in range(n):
        differing += word[i] != word[(i + by) % n]
    return differing == 0


@numba.njit(nogil=True)
def _align(m: int, state: State) -> bool:
    """Take the position of slot m, and decide the frames at it that the search passed over."""
    n = state.words.shape[1]
    r = m % n
    state.ints[ALIGNED] = r
    state.ints[GRID_WORD] = -1
    state.floats[TRUST] = state.sums[r]
    taught = False
    # A frame that the old position has answered for is not counted again.
    oldest = max(n, m - RING + n + 1, m - state.ints[SEARCHED] - n + 1)
    for end in range(oldest + (r - oldest) % n, m + 1, n):
        _, now = _settle(end, state)
        taught = taught or now
    state.ints[SEARCHED] = 0
    return taught


@numba.njit(nogil=True)
def _search(m: int, state: State) -> None:
    n = state.words.shape[1]
    if _dark(m, state):
        return
    verdict = np.empty(VERDICT_FIELDS)
    decide(state.ring, m - n, state.words, state.floats[NEXT_ONE], verdict)
    state.sums[m % n] = DECAY * state.sums[m % n] + max(verdict[EVIDENCE], MISS)


@numba.njit(nogil=True)
def _dark(m: int, state: State) -> bool:
    """Return whether the frame that ends at slot m shows fewer transitions than any word has: the light is hidden."""
    edges = 0.0
    for slot in range(m - state.words.shape[1], m + 1):
        edges += state.facts[slot % RING, EDGE]
    return edges < EDGES_LEAST


@numba.njit(nogil=True)
def _record(m: int, code: float, score: float, margin: float, grid: float, state: State) -> None:
    record = state.out[state.ints[OUT]]
    record[OUT_END] = state.facts[m % RING, AT]
    record[OUT_CODE] = code
    record[OUT_SCORE] = score
    record[OUT_MARGIN] = margin
    record[OUT_SLOT] = m
    record[OUT_GRID] = grid
    state.ints[OUT] += 1


@numba.njit(nogil=True)
def _settle(m: int, state: State) -> tuple[float, bool]:
    """Publish or refuse the frame that ends at slot m; return its evidence (0 if it says nothing), and if it taught."""
    n = state.words.shape[1]
    # Each transmitted frame is published once: after a slip the next one may not overlap the last by half a bit.
    if state.facts[m % RING, AT] < state.floats[LAST_END] + (n - 0.5) * state.floats[PERIOD]:
        return 0.0, False
    verdict = np.empty(VERDICT_FIELDS)
    decide(state.ring, m - n, state.words, state.floats[NEXT_ONE], verdict)
    evidence = max(verdict[EVIDENCE], MISS)
    if verdict[SCORE] < ACCEPT:
        code = _reason(m, state)
        _record(m, code, verdict[SCORE], verdict[MARGIN], 0.0, state)
        return (0.0 if code == OCCLUSION else evidence), False
    grid = one_phase.note(m, int(verdict[BEST]), state)
    _record(m, verdict[BEST], verdict[SCORE], verdict[MARGIN], grid, state)
    state.floats[LAST_END] = state.facts[m % RING, AT]
    if verdict[SCORE] < LEARN:
        return evidence, False
    word = state.words[int(verdict[BEST])]
    for i in range(1, n):
        x, seen = 2 * word[i - 1] + word[i], state.counts[(m - n + i) % RING]
        response.learn(x, seen, state.floats[READ_OUT], state.model, state.seen)
    return evidence, True


@numba.njit(nogil=True)
def _reason(m: int, state: State) -> float:
    """Return why the frame that ends at slot m is refused."""
    n = state.words.shape[1]
    if _dark(m, state):
        return float(OCCLUSION)
    events, outside = 0.0, 0.0
    for slot in range(m - n, m + 1):
        events += state.facts[slot % RING, EVENTS]
        outside += state.facts[slot % RING, OUTSIDE]
    if outside > 0.5 * events and outside > 2.0 * state.figures[2] * (n + 1) + OFF_GRID_EVENTS:
        return float(OFF_GRID)
    word, share = plain_bits(state.ring, m - n, n)
    if share < 0.5:
        return float(WEAK)
    run, here = 1, 1
    for i in range(1, n):
        here = here + 1 if (word >> i) & 1 == (word >> (i - 1)) & 1 else 1
        run = max(run, here)
    if run > state.ints[RUN]:
        return float(OCCLUSION)
    return float(HARD - word)


@numba.njit(nogil=True)
def give_up(state: State) -> None:
    """Refuse the frames of a search that found no alignment, as its best position reads them."""
    if state.ints[ALIGNED] >= 0:
        return
    n = state.words.shape[1]
    m = state.ints[SLOT]
    r = int(np.argmax(state.sums))
    oldest = max(n, m - state.ints[SEARCHED], m - RING + n + 1)
    verdict = np.empty(VERDICT_FIELDS)
    for end in range(oldest + (r - oldest) % n, m, n):
        decide(state.ring, end - n, state.words, state.floats[NEXT_ONE], verdict)
        code = _reason(end, state)
        if verdict[SCORE] >= ACCEPT:
            word = 0
            for bit in state.words[int(verdict[BEST])]:
                word = 2 * word + int(bit)
            code = float(HARD - word)
        _record(end, code, 0.0, 0.0, 0.0, state)
