"""The event loop for scanned light whose bursts outlast a bit: events in, records of frames out.

It does for scans what `heliograph.link.demodulator` does for events. Scans (`heliograph.link.scans`) that lie in a slot
give the likelihoods l[a b c d] of the bits around it (`heliograph.link.scan_response`), tempered, since a scan may be
lost or belong to another light: l <- (1 - OUTLIER) l / max l + OUTLIER. What a slot shows depends on bits before it
and goes on behind it, so its two bits are judged on all slots before it and LAG behind it (forward-backward, any bits
equally likely: the code is not asked)::

    f_m+1[b c d] = 1/2 sum_a f_m[a b c] l_m[a b c d]         g_m-1[a b c] = 1/2 sum_d l_m[a b c d] g_m[b c d]
    P[c d] = sum_a,b f_m[a b c] l_m[a b c d] g_m[b c d]      ring_m[c d] = P[c d] / sqrt(P[c] P[d])

The product of ring over a frame's slots is then the likelihood of its bits (each inner bit's P[c] is divided out
once), as frames are decided on (`heliograph.link.alignment`).

Clock. A light that turned in the scan at t_j turned in (t_j - q, t_j]: any place in it is as likely. So the loop of
`heliograph.link.clock` is steered only by what lies outside::

    e = sign(o) max(0, |o| - DEAD q / 2)        o = t_j - b_m -+ half the polarities' delay

Otherwise it would follow the slow beat of bits and scans, and slip where it leaps (2.5 kbit/s behind 199 us).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, cast

import numba
import numpy as np

from heliograph.events import Flags
from heliograph.link import (
    alignment,
    clock,
    demodulator,
    likelihood,
    one_phase,
    response,
    scan_response,
    scan_state,
    scans,
)
from heliograph.link import state as state_module
from heliograph.link.alignment import LEARN, give_up, place
from heliograph.link.clock import CLOCK_LIMIT, GAIN_SLOTS, SUB, Floats
from heliograph.link.demodulator import AVERAGE, DONE, ERROR_LIMIT, FULL, LOST, SEARCH_FRAMES, SILENT_FRAMES, SURE
from heliograph.link.likelihood import FLOOR
from heliograph.link.scan_response import CONTEXTS
from heliograph.link.scan_state import (
    BURST,
    END,
    LAG,
    OFF_EVENTS,
    ON_EVENTS,
    OPEN,
    QUANTUM,
    ROOM,
    SCAN,
    ScanState,
)
from heliograph.link.scans import TOGETHER
from heliograph.link.stamp import stamp
from heliograph.link.state import (
    AT,
    BOUNDARY,
    EDGE,
    EDGES,
    EVENTS,
    HALF,
    JITTER2,
    OUT,
    OUT_CODE,
    OUT_FULL,
    OUT_SCORE,
    OUT_SLOT,
    OUTSIDE,
    PERIOD,
    RING,
    SEARCHED,
    SILENT,
    SLOT,
    State,
)

# One slot in a hundred is not what the table says: as MISSED in `heliograph.link.likelihood`.
OUTLIER: Final = 0.01
# Of a scan, where a turn says nothing of the clock: pixels differ by some of the rest.
DEAD: Final = 0.8
# What a sub-bin was learned to show holds for the grid of that time: one that moves by a whole sub-bin forgets it. Else
# a word that repeats is held against the rates of other sub-bins while the loop settles, and mistakes are learned.
MOVED: Final = 1.0
# Loop gains, below those of `heliograph.link.clock`: what is left outside of a scan is rare and one-sided, and the grid
# of the scans itself would capture a quicker loop where it lies half a per cent off.
SCAN_GAIN_START: Final = 0.05
SCAN_GAIN_END: Final = 0.02


@numba.njit(nogil=True)
def temper(loglikelihood: Floats, out: Floats) -> None:
    """Set out (16,) to a slot's tempered likelihoods."""
    top = loglikelihood.max()
    for x in range(CONTEXTS):
        out[x] = (1.0 - OUTLIER) * np.exp(loglikelihood[x] - top) + OUTLIER


@numba.njit(nogil=True)
def _judge(m: int, state: State, scanned: ScanState) -> None:
    """Set ring and facts of slot m, given those up to LAG behind it."""
    behind, nearer = np.ones(8), np.empty(8)
    for later in range(m + LAG, m, -1):
        slot = scanned.likely[later % RING]
        for abc in range(8):
            first = 2 * (abc & 3)
            nearer[abc] = slot[2 * abc] * behind[first] + slot[2 * abc + 1] * behind[first + 1]
        behind[:] = nearer / nearer.sum()
    at = m % RING
    slot, before = scanned.likely[at], scanned.before[at]
    pair = np.zeros(4)
    for x in range(CONTEXTS):
        pair[x & 3] += before[x >> 1] * slot[x] * behind[x & 7]
    pair /= pair.sum()
    row = state.ring[at]
    for cd in range(4):
        c, d = cd >> 1, cd & 1
        row[cd] = pair[cd] / np.sqrt((pair[2 * c] + pair[2 * c + 1]) * (pair[d] + pair[2 + d]) + 1e-12)
    top = row.max()
    for cd in range(4):
        row[cd] = max(row[cd] / top, FLOOR)
    state.facts[at, EDGE] = pair[response.RISE] + pair[response.FALL]
    state.facts[at, OUTSIDE] = 0.0
    _steer(m, pair, state, scanned)


@numba.njit(nogil=True)
def _steer(m: int, pair: Floats, state: State, scanned: ScanState) -> None:
    """Steer the clock by slot m, if the light turned there as its bits say."""
    floats, ints = state.floats, state.ints
    rise, fall = pair[response.RISE], pair[response.FALL]
    if max(rise, fall) < SURE:
        ints[SILENT] += 1
        return
    ints[SILENT] = 0
    way, behind = scanned.turned[m % RING]
    if way != (1.0 if rise > fall else -1.0):
        return
    off = min(max(behind - way * floats[HALF], -ERROR_LIMIT), ERROR_LIMIT)
    error = max(abs(off) - 0.5 * DEAD * scanned.floats[QUANTUM], 0.0) * (1.0 if off > 0.0 else -1.0)
    ints[EDGES] += 1
    floats[HALF] += AVERAGE * way * error
    floats[JITTER2] += max(AVERAGE, 1.0 / ints[EDGES]) * (off * off - floats[JITTER2])
    gain = SCAN_GAIN_START if ints[EDGES] < GAIN_SLOTS else SCAN_GAIN_END
    floats[PERIOD] += 0.25 * gain * gain * error
    floats[BOUNDARY] += gain * error
    if error != 0.0:
        scanned.weight[:] *= max(1.0 - MOVED * abs(gain * error) * SUB, 0.0)


@numba.njit(nogil=True)
def _close(state: State, scanned: ScanState) -> bool:
    """Close the open slot and open the next; judge the one that is LAG behind; return whether the clock is lost."""
    floats, ints = state.floats, state.ints
    m = ints[SLOT]
    at = (m + LAG) % RING
    loglikelihood = np.empty(CONTEXTS)
    scan_response.likelihoods(
        scanned.scans[at],
        scanned.n[at],
        scanned.shape,
        scanned.least,
        scanned.scale,
        scanned.floats[BURST],
        loglikelihood,
    )
    slot = scanned.likely[at]
    temper(loglikelihood, slot)
    after = scanned.before[(at + 1) % RING]
    after[:] = 0.0
    for x in range(CONTEXTS):
        after[x & 7] += scanned.before[at, x >> 1] * slot[x]
    after /= after.sum()
    state.facts[at, AT] = floats[BOUNDARY]
    state.facts[at, EVENTS] = scanned.scans[at, : scanned.n[at], 1:].sum()
    if m >= 0:
        _judge(m, state, scanned)
        told = ints[OUT]
        place(state)
        for record in range(told, ints[OUT]):
            _learn(state.out[record], state, scanned)
        if ints[OUT] > told:
            scanned.floats[BURST] = scan_response.tabulate(
                scanned.rate,
                scanned.weight,
                scanned.floats[QUANTUM],
                scanned.mean,
                scanned.shape,
                scanned.least,
                scanned.scale,
            )
    floats[BOUNDARY] += floats[PERIOD]
    ints[SLOT] += 1
    scanned.n[(at + 1) % RING] = 0
    scanned.turned[(at + 1) % RING] = 0.0
    one_phase.clear(state.facts[(at + 1) % RING])
    n = state.words.shape[1]
    if ints[SILENT] > SILENT_FRAMES * n or ints[SEARCHED] > SEARCH_FRAMES * n:
        return True
    return bool(abs(floats[PERIOD] - 1.0) > CLOCK_LIMIT)


@numba.njit(nogil=True)
def _learn(record: Floats, state: State, scanned: ScanState) -> None:
    """Learn from a frame that was accepted, where all four bits are its own."""
    if record[OUT_CODE] < 0.0 or record[OUT_SCORE] < LEARN:
        return
    word = state.words[int(record[OUT_CODE])]
    n = len(word)
    first = int(record[OUT_SLOT]) - n
    for i in range(3, n):
        at = (first + i) % RING
        x = 8 * word[i - 3] + 4 * word[i - 2] + 2 * word[i - 1] + word[i]
        scan_response.learn(x, scanned.scans[at], scanned.n[at], scanned.rate, scanned.weight)


@numba.njit(nogil=True)
def _take(t: float, off: float, on: float, state: State, scanned: ScanState) -> None:
    """Count a scan in the open slot."""
    boundary, period = state.floats[BOUNDARY], state.floats[PERIOD]
    at = (state.ints[SLOT] + LAG) % RING
    n = scanned.n[at]
    if n < ROOM:
        k = min(max(int(((t - boundary) / period + 0.5) * SUB), 0), SUB - 1)
        scanned.scans[at, n, 0], scanned.scans[at, n, 1], scanned.scans[at, n, 2] = k, off, on
        scanned.n[at] += 1
    if off + on > 0.0:
        one_phase.take(t - boundary, off, on, state.facts[at])
        way = scans.turn(t, on - off, scanned.turn)
        if way != 0:
            scanned.turned[at, 0], scanned.turned[at, 1] = way, t - boundary
    scanned.floats[SCAN] = t


@numba.njit(nogil=True)
def _silent(until: float, state: State, scanned: ScanState) -> None:
    """Count the scans without events before `until`; the newest scan grows no more."""
    own = scanned.floats
    if own[OPEN] != 0.0:
        own[OPEN] = 0.0
        _take(own[SCAN], own[OFF_EVENTS], own[ON_EVENTS], state, scanned)
    until = min(until, own[END])
    while own[SCAN] + own[QUANTUM] <= until:
        _take(own[SCAN] + own[QUANTUM], 0.0, 0.0, state, scanned)


def _entry(sources: int) -> Callable[[Floats, Flags, float, State, ScanState], tuple[int, int]]:
    """Return `advance`, cached under these sources (`heliograph.link.stamp`)."""

    @numba.njit(cache=True, nogil=True)
    def kernel(t: Floats, on: Flags, until: float, state: State, scanned: ScanState) -> tuple[int, int]:
        floats, own = state.floats, scanned.floats
        n = len(t) if sources >= 0 else 0
        i = 0
        while True:
            limit = t[i] if i < n else until
            close = floats[BOUNDARY] + 0.5 * floats[PERIOD]
            if close + TOGETHER <= limit:
                if own[OPEN] == 0.0 or own[SCAN] < close:
                    # A scan expected just before the slot's end may come just behind it.
                    _silent(close - 0.25 * own[QUANTUM], state, scanned)
                if _close(state, scanned):
                    give_up(state)
                    return LOST, i
                if state.ints[OUT] >= OUT_FULL:
                    return FULL, i
                continue
            if i == n:
                return DONE, i
            if own[OPEN] == 0.0 or t[i] - own[SCAN] > TOGETHER:
                _silent(t[i] - 0.5 * own[QUANTUM], state, scanned)
                own[SCAN], own[OPEN], own[OFF_EVENTS], own[ON_EVENTS] = t[i], 1.0, 0.0, 0.0
            own[ON_EVENTS if on[i] else OFF_EVENTS] += 1.0
            i += 1

    return cast("Callable[[Floats, Flags, float, State, ScanState], tuple[int, int]]", kernel)


_KERNEL: Final = _entry(
    stamp(
        alignment, clock, demodulator, likelihood, one_phase, response, scan_response, scan_state, scans, state_module,
    )
)  # fmt: skip


def advance(t: Floats, on: Flags, until: float, state: State, scanned: ScanState) -> tuple[int, int]:
    """Take events, and the word that none is left before `until`.

    Args:
        t: (n,) times, not falling.
        on: (n,) polarities.
        until: there are no more events before this time.
        state: of the track.
        scanned: of the same.

    Returns:
        DONE, FULL (empty `state.out`, call again) or LOST (the clock), and how many events were taken.
    """
    outcome, taken = _KERNEL(t, on, until, state, scanned)
    return int(outcome), int(taken)
