"""The event loop of the packet receiver: events in, packets out; one compiled call a feed.

Slots are closed as in `heliograph.link.demodulator`. The clock is steered by a transition's events n_p[k] in whatever
place the response has them (it is not moved to their middle: in dim light a burst goes on for bits, and its middle in a
slot means little). The shift that they ask for is, to first order, that of the likelihood::

    e = -sum (n - r) s / sum r s^2        r = rate[x, p, k] of the likeliest x, s = d ln r / dk

The loop is that of `heliograph.link.clock`.

Each closing slot may be the end of a packet: a position whose sync shows SYNC_LEAST nats is decided
(`heliograph.link.packet_soft`), and so is the one right behind a packet that was read, for there the next one is due. A
packet whose CRC and evidence hold is put out, and the response learns from all its bits.

Chance that random bits at the right clock make a packet, a bit position: exp(-SYNC_LEAST) 2^-32 = 4e-12, and where one
is due 2^-32 once in a packet, 8e-13 a position: each packet alone is an identification (below 1e-10).

Times are in nominal bits since the lock's origin, as float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, cast

import numba
import numpy as np

from heliograph.events import Flags
from heliograph.link import (
    clock,
    convolutional,
    demodulator,
    likelihood,
    packet_response,
    packet_soft,
    packet_state,
    response,
    viterbi,
)
from heliograph.link import state as shared
from heliograph.link.clock import CLOCK_LIMIT, GAIN_END, GAIN_SLOTS, GAIN_START, SUB, Floats
from heliograph.link.demodulator import AVERAGE, DONE, ERROR_LIMIT, FULL, LOST, SURE
from heliograph.link.packet_response import ROWS
from heliograph.link.packet_soft import EVIDENCE_LEAST, checks, decide, evidence, temper
from heliograph.link.packet_state import NEXT, OUT_END, OUT_EVIDENCE, OUT_GOOD, OUT_ROOM, PacketState
from heliograph.link.stamp import stamp
from heliograph.link.state import AT, BOUNDARY, EDGE, EDGES, EVENTS, JITTER2, OUT, PERIOD, SEARCHED, SILENT, SLOT

# A sync of 24 bits shows 16 nats, 3 less for each transition that it lacks. Of random bits fewer than one position in
# 55 passes (Markov), and costs a decision (0.1 ms); what passes with lost transitions is in bench/study_packet.py.
SYNC_LEAST: Final = 4.0
# So much is no chance within hours (2e-6 a position): a packet that is not read here was sent, and is counted.
SYNC_SURE: Final = 13.0
# Slots without a transition after which the clock is given up: known to 500 ppm it is then off by .05 bit, and
# finding it again costs no packet (scrambled bits hold no run of more than 15 or so).
SILENT_SLOTS: Final = 100
# Packets' lengths without one that was read, after which another clock is looked for.
SEARCH_PACKETS: Final = 8


@numba.njit(nogil=True)
def _close(state: PacketState) -> bool:
    """Close the open slot and open the next; return whether the clock is lost."""
    floats, ints = state.floats, state.ints
    size = state.ring.shape[0]
    at = ints[SLOT] % size
    here = state.counts[at]
    loglikelihood = np.empty(ROWS)
    packet_response.loglikelihoods(here, state.logs, state.total, state.figures, loglikelihood)
    temper(loglikelihood, state.ring[at])
    state.facts[at, AT] = floats[BOUNDARY]
    state.facts[at, EVENTS] = here.sum()
    error = _steer(state, at)
    ints[SEARCHED] += 1
    _look_at(ints[SLOT] - len(state.sent), state)
    floats[BOUNDARY] += floats[PERIOD] + error
    ints[SLOT] += 1
    state.counts[ints[SLOT] % size] = 0
    if ints[SILENT] > SILENT_SLOTS or ints[SEARCHED] > SEARCH_PACKETS * len(state.sent):
        return True
    return bool(abs(floats[PERIOD] - 1.0) > CLOCK_LIMIT)


@numba.njit(nogil=True)
def _steer(state: PacketState, at: int) -> float:
    """Steer the period by the slot's transition; return by how much the next boundary moves besides."""
    floats, ints, x = state.floats, state.ints, state.ring[at]
    rise, fall = x[1] + x[5], x[2] + x[6]
    whole = x.sum()
    state.facts[at, EDGE] = (rise + fall) / whole
    if max(rise, fall) < SURE * whole:
        ints[SILENT] += 1
        return 0.0
    ints[SILENT] = 0
    logs = state.logs[int(np.argmax(x))]
    score, information = 0.0, 0.5
    for p in range(2):
        for k in range(1, SUB - 1):
            rate = np.exp(logs[p, k])
            slope = 0.5 * (logs[p, k + 1] - logs[p, k - 1])
            score -= (state.counts[at, p, k] - rate) * slope
            information += rate * slope * slope
    error = min(max(score / information / SUB, -ERROR_LIMIT), ERROR_LIMIT)
    ints[EDGES] += 1
    floats[JITTER2] += max(AVERAGE, 1.0 / ints[EDGES]) * (error * error - floats[JITTER2])
    gain = GAIN_START if ints[EDGES] < GAIN_SLOTS else GAIN_END
    floats[PERIOD] += 0.25 * gain * gain * error
    return float(gain * error)


@numba.njit(nogil=True)
def _look_at(first: int, state: PacketState) -> None:
    """Decide the packet whose first slot this is, if it seems to be one."""
    ints = state.ints
    n = len(state.sent)
    # Within a packet that was read there is no other; a slip may bring the next one a bit early.
    if first < 0 or first < ints[NEXT] - 1:
        return
    seen = evidence(state.ring, first, state.sync)
    if seen < SYNC_LEAST and first != ints[NEXT]:
        return
    found = decide(state.ring, first, state.sync, state.mother, state.flip, state.signs, state.data, state.sent)
    good = checks(state.data, len(state.whole), state.whole) and found >= EVIDENCE_LEAST
    if not good and seen < SYNC_SURE:
        return
    record = state.out[ints[OUT]]
    record[OUT_END] = state.facts[(first + n) % state.ring.shape[0], AT]
    record[OUT_GOOD] = 1.0 if good else 0.0
    record[OUT_EVIDENCE] = found
    state.read[ints[OUT]] = state.whole
    ints[OUT] += 1
    if good:
        ints[NEXT] = first + n
        ints[SEARCHED] = 0
        _learn(state, first)


@numba.njit(nogil=True)
def _learn(state: PacketState, first: int) -> None:
    """Learn the response from all slots of the packet that was read."""
    size = state.ring.shape[0]
    sent = state.sent
    for i in range(2, len(sent)):
        x = 4 * sent[i - 2] + 2 * sent[i - 1] + sent[i]
        packet_response.learn(x, state.counts[(first + i) % size], state.model, state.seen)
    packet_response.tabulate(state.model, state.logs, state.total, state.figures)


def _entry(sources: int) -> Callable[[Floats, Flags, float, PacketState], tuple[int, int]]:
    """Return `advance`, cached under these sources (`heliograph.link.stamp`)."""

    @numba.njit(cache=True, nogil=True)
    def kernel(t: Floats, on: Flags, until: float, state: PacketState) -> tuple[int, int]:
        floats, ints = state.floats, state.ints
        size = state.ring.shape[0]
        i = 0
        n = len(t) if sources >= 0 else 0
        while True:
            close = floats[BOUNDARY] + 0.5 * floats[PERIOD]
            while i < n and t[i] < close:
                p = 1 if on[i] else 0
                offset = t[i] - floats[BOUNDARY]
                k = min(max(int((offset / floats[PERIOD] + 0.5) * SUB), 0), SUB - 1)
                state.counts[ints[SLOT] % size, p, k] += 1
                i += 1
            if i == n and until < close:
                return DONE, i
            if _close(state):
                return LOST, i
            if ints[OUT] >= OUT_ROOM:
                return FULL, i

    return cast("Callable[[Floats, Flags, float, PacketState], tuple[int, int]]", kernel)


_KERNEL: Final = _entry(
    stamp(
        clock,
        convolutional,
        demodulator,
        likelihood,
        packet_response,
        packet_soft,
        packet_state,
        response,
        shared,
        viterbi,
    )
)


def advance(t: Floats, on: Flags, until: float, state: PacketState) -> tuple[int, int]:
    """Take events, and the word that none is left before `until`.

    Args:
        t: (n,) times, not falling.
        on: (n,) polarities.
        until: there are no more events before this time.
        state: of the track.

    Returns:
        DONE, FULL (empty `state.out`, call again) or LOST (the clock), and how many events were taken.
    """
    outcome, taken = _KERNEL(t, on, until, state)
    return int(outcome), int(taken)
