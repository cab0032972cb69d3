"""How the demodulator of scanned light begins: scans, turns and response of the window in which its clock was found.

The bits between the window's turns are known, if only nearly (a turn may have been missed, a burst's end be taken for
one). They give a first response (`heliograph.link.scan_response`), the response better bits (Viterbi over the window,
any bits equally likely), and these a better response, ROUNDS times. How likely the window's scans are with the last
tells clocks apart that are all read (`heliograph.link.beginning`): one that is a little off blurs the response.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, cast

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags
from heliograph.link import clock, scan_demodulator, scan_response, scan_state, scans
from heliograph.link import state as state_module
from heliograph.link.clock import SUB, Floats
from heliograph.link.scan_response import CONTEXTS
from heliograph.link.stamp import stamp

ROUNDS: Final = 4
# Slots of a window, at most: 256 bits and what a fast clock adds.
_SLOTS: Final = 300
Ints = npt.NDArray[np.int64]


@numba.njit(nogil=True)
def _levels(turn_t: Floats, turn_on: Flags, first: float, period: float, bits: Ints) -> None:
    """Set bits (slots + 1,) to the level between turns: that before slot 0, then that behind each slot."""
    at, n = 0, len(turn_t)
    for s in range(len(bits)):
        # The bit before slot s ends at its boundary; turns lie about boundaries.
        while at < n and turn_t[at] < first + (s - 0.5) * period:
            at += 1
        bits[s] = (0 if turn_on[0] else 1) if at == 0 else (1 if turn_on[at - 1] else 0)


@numba.njit(nogil=True)
def _viterbi(likely: Floats, bits: Ints) -> None:
    """Set bits (slots + 1,) to the likeliest, given (slots, 16) tempered likelihoods."""
    slots = likely.shape[0]
    best, after = np.zeros(8), np.empty(8)
    came = np.zeros((slots, 8), np.int64)
    for s in range(slots):
        after[:] = -1e300
        for x in range(CONTEXTS):
            value = best[x >> 1] + np.log(likely[s, x])
            if value > after[x & 7]:
                after[x & 7] = value
                came[s, x & 7] = x >> 1
        best[:] = after - after.max()
    at = int(np.argmax(best))
    for s in range(slots - 1, -1, -1):
        bits[s + 1] = at & 1
        at = came[s, at]
    bits[0] = at & 1


def _entry(sources: int) -> Callable[..., tuple[float, Floats]]:
    """Return `learn`, cached under these sources (`heliograph.link.stamp`)."""

    @numba.njit(cache=True, nogil=True)
    def kernel(
        rows: Floats, turn_t: Floats, turn_on: Flags, first: float, period: float, rate: Floats, weight: Floats
    ) -> tuple[float, Floats]:
        """See `begin`; rows (n, 3) are all scans of the window. Return a burst's events and each's log-likelihood."""
        slots = min(int((rows[-1, 0] - first) / period + 0.5) + 1, _SLOTS) if sources >= 0 else 0
        placed = np.empty((len(rows), 4))
        row_of = np.empty(len(rows), np.int64)
        n = 0
        per_slot = np.zeros(slots, np.int64)
        grouped = np.zeros((slots, scan_state.ROOM, 3))
        for j in range(len(rows)):
            place = (rows[j, 0] - first) / period + 0.5
            s = int(np.floor(place))
            if s < 0 or s >= slots:
                continue
            k = min(int((place - s) * SUB), SUB - 1)
            placed[n, 0], placed[n, 1], placed[n, 2], placed[n, 3] = s, k, rows[j, 1], rows[j, 2]
            row_of[n] = j
            n += 1
            if per_slot[s] < scan_state.ROOM:
                here = grouped[s, per_slot[s]]
                here[0], here[1], here[2] = k, rows[j, 1], rows[j, 2]
                per_slot[s] += 1
        bits = np.zeros(slots + 1, np.int64)
        _levels(turn_t, turn_on, first, period, bits)
        full, logs = np.empty(rate.shape), np.empty(rate.shape)
        likely, loglikelihood = np.empty((slots, CONTEXTS)), np.empty(CONTEXTS)
        for _ in range(ROUNDS):
            scan_response.guess(bits, 2, placed[:n], rate, weight)
            burst = scan_response.tabulate(rate, full, logs)
            for s in range(slots):
                scan_response.likelihoods(grouped[s], per_slot[s], full, logs, burst, loglikelihood)
                scan_demodulator.temper(loglikelihood, likely[s])
            _viterbi(likely, bits)
        scan_response.guess(bits, 2, placed[:n], rate, weight)
        burst = scan_response.tabulate(rate, full, logs)
        f = max(1.0, burst / scan_response.WITNESSES)
        fit = np.zeros(len(rows))
        for j in range(n):
            s, k = int(placed[j, 0]), int(placed[j, 1])
            if s >= 2:
                x = 8 * bits[s - 2] + 4 * bits[s - 1] + 2 * bits[s] + bits[s + 1]
                for p in range(2):
                    fit[row_of[j]] += (placed[j, 2 + p] * logs[x, p, k] - full[x, p, k]) / f
        return burst, fit

    return cast("Callable[..., tuple[float, Floats]]", kernel)


_KERNEL: Final = _entry(stamp(clock, scan_demodulator, scan_response, scan_state, scans, state_module))


def begin(
    scanned: scan_state.ScanState, t: Floats, on: Flags, until: float, found: Floats, turn_t: Floats, turn_on: Flags
) -> Floats | None:
    """Begin with a clock that turns have shown.

    Args:
        scanned: to be set.
        t: (n,) event times of the window in nominal bits from the lock's origin, rising.
        on: (n,) polarities.
        until: end of the window.
        found: (4,) of `heliograph.link.clock.grid`.
        turn_t: (m,) times of the turns in the window, m > 0.
        turn_on: (m,) True where the light turned up.

    Returns:
        How likely each of the window's scans is, in nats, up to a constant of its own: (m,), the same scans for every
        clock. None where the events are no scans; then nothing is set.
    """
    at, counts = np.empty(len(t)), np.empty((len(t), 2))
    n = scans.group(t, on, at, counts)
    at, counts = at[:n], counts[:n]
    q = scans.quantum(at)
    if q == 0.0 or len(turn_t) == 0:
        return None
    rows = scans.all_scans(at, counts, q, until)
    first, period = float(found[0]), float(found[1])
    burst, fit = _KERNEL(rows, turn_t, turn_on, first, period, scanned.rate, scanned.weight)
    scan_response.tabulate(scanned.rate, scanned.full, scanned.log_rate)
    scanned.floats[:] = 0.0
    scanned.floats[scan_state.QUANTUM] = q
    scanned.floats[scan_state.SCAN] = rows[0, 0] - q
    scanned.floats[scan_state.BURST] = burst
    scanned.floats[scan_state.END] = np.inf
    scanned.n[:] = 0
    scanned.turned[:] = 0.0
    scanned.before[:] = 0.125
    scanned.likely[:] = 1.0
    return fit
