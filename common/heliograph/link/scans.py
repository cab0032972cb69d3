"""Events of a scanned sensor: its scans, and where the light turned.

Scans. A scanned sensor's events come in groups of (nearly) one time, whole multiples of one period q apart. q is the
smallest gap between groups but for accidents; where it is common and most gaps are multiples of it, the events are
scans.

Turns. With net_j = ON - OFF of scan j, and two sums that forget within a bit::

    up   <- max(0, up e^(-dt / T) + net_j)        down <- max(0, down e^(-dt / T) - net_j)

the light turns up in the scan in which up reaches h_on while it is falling, and down where down reaches h_off. h_p is
a share of what usually comes of a turn of that polarity. The turn is where its burst begins, however long that
goes on: a burst of falls may last longer than a bit.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags
from heliograph.link.clock import Floats

# Events nearer to the first of a group, in bits, are of its scan: what is left of a scan where columns are stamped as
# they are read.
TOGETHER: Final = 1.0 / 64.0
# Of shorter scans, in bits, the demodulator of events reads every edge; behind longer ones two edges share a scan.
LEAST: Final = 0.28
MOST: Final = 0.75
# Of the gaps, so few are shorter than a scan, by accident; so many are one scan long, where bursts go on for several,
# or where overexposed images show a single zero as half a bit (.25 to .3 of the gaps of random bits);
# and of those below FAR scans, so many are whole multiples of one, give or take NEAR.
FEW: Final = 0.02
IN_A_ROW: Final = 0.125
ON_GRID: Final = 0.9
NEAR: Final = 0.15
FAR: Final = 6.0
# Where all edges of clean light are in every second scan but for slips: two slips, and what a stray event or two spoil.
SLIPS: Final = 2
ON_GRID_RARE: Final = 0.97
# 48 bits of such images have two dozen edges: known later, they would be taken for events that are no scans.
GAPS_LEAST: Final = 16

# Places of the turns' state.
UP: Final = 0
DOWN: Final = 1
LEVEL: Final = 2  # 1 rising, -1 falling, 0 unknown
AT: Final = 3  # time of the newest scan
USUAL_OFF: Final = 4  # events of a burst
USUAL_ON: Final = 5
SWING: Final = 6  # of the burst that goes on
FIELDS: Final = 8
# h: a twelfth of the usual burst, but never a lone event or two.
SHARE: Final = 1.0 / 12.0
EVENTS_LEAST: Final = 3.0
# Memory of the usual burst, in turns.
MEMORY: Final = 32.0


@numba.njit(cache=True, nogil=True)
def turn(t: float, net: float, turns: Floats) -> int:
    """Take a scan of `net` events at time t (in bits); return 1 where the light turned up in it, -1 down, else 0."""
    fade = np.exp(-max(t - turns[AT], 0.0))
    turns[AT] = t
    turns[UP] = max(0.0, turns[UP] * fade + net)
    turns[DOWN] = max(0.0, turns[DOWN] * fade - net)
    found = 0
    if turns[LEVEL] != 1.0 and turns[UP] >= max(SHARE * turns[USUAL_ON], EVENTS_LEAST):
        found = 1
    elif turns[LEVEL] != -1.0 and turns[DOWN] >= max(SHARE * turns[USUAL_OFF], EVENTS_LEAST):
        found = -1
    if found != 0:
        if turns[LEVEL] != 0.0:
            usual = USUAL_ON if turns[LEVEL] > 0.0 else USUAL_OFF
            turns[usual] += (turns[SWING] - turns[usual]) / MEMORY
        turns[LEVEL] = float(found)
        turns[SWING] = 0.0
    turns[SWING] = max(turns[SWING], turns[UP] if turns[LEVEL] > 0.0 else turns[DOWN])
    return found


@numba.njit(cache=True, nogil=True)
def group(t: Floats, on: Flags, at: Floats, counts: Floats) -> int:
    """Gather events into scans.

    Args:
        t: (n,) in bits, not falling.
        on: (n,).
        at: (n,) out: time of the first event of each scan.
        counts: (n, 2) out: OFF and ON events.

    Returns:
        How many scans have events.
    """
    n = -1
    for i in range(len(t)):
        if n < 0 or t[i] - at[n] > TOGETHER:
            n += 1
            at[n] = t[i]
            counts[n] = 0.0
        counts[n, 1 if on[i] else 0] += 1.0
    return n + 1


@numba.njit(cache=True, nogil=True)
def turns(t: Floats, on: Flags, state: Floats, found_t: Floats, found_on: npt.NDArray[np.bool_]) -> int:
    """Find where the light turned.

    Args:
        t: (n,) event times in bits, not falling.
        on: (n,) polarities.
        state: (FIELDS,) what came before; changed.
        found_t: (m,) out: times of the scans.
        found_on: (m,) out: True where it turned up.

    Returns:
        How many turns there are, at most m.
    """
    found, i = 0, 0
    while i < len(t):
        first, net = t[i], 0.0
        while i < len(t) and t[i] - first <= TOGETHER:
            net += 1.0 if on[i] else -1.0
            i += 1
        way = turn(first, net, state)
        if way != 0 and found < len(found_t):
            found_t[found] = first
            found_on[found] = way > 0
            found += 1
    return found


@numba.njit(cache=True, nogil=True)
def starts(t: Floats) -> Floats:
    """Return the times of the first event of each scan, given (n,) event times in bits, not falling."""
    at = np.empty(len(t))
    n = 0
    for i in range(len(t)):
        if n == 0 or t[i] - at[n - 1] > TOGETHER:
            at[n] = t[i]
            n += 1
    return at[:n]


def quantum(at: Floats, *, rare: bool = False) -> float:
    """Return the length of a scan, in bits, given the times (n,) of those with events; 0 where they are no scans.

    Args:
        at: not falling.
        rare: see `spacing`.
    """
    return spacing(at, LEAST, MOST, rare=rare)


def spacing(at: Floats, least: float, most: float, *, rare: bool = False) -> float:
    """Return the length, in bits, of which times (n,) lie whole numbers apart; 0 where none of least to most is.

    Args:
        at: not falling.
        least: shortest.
        most: longest.
        rare: two in a row may be rare: one such gap is enough, or SLIPS of an odd number of them, if hardly any gap is
            not a multiple.
    """
    gaps = np.diff(at)
    if len(gaps) < GAPS_LEAST:
        return 0.0
    small = gaps.min() if rare else np.sort(gaps)[int(FEW * len(gaps))]
    near = gaps[np.abs(gaps - small) < NEAR * small]
    q = float(near.mean())
    if rare and least <= 0.5 * q and _slips(gaps / q):
        q *= 0.5
    if not least <= q <= most or (len(near) < IN_A_ROW * len(gaps) and not rare):
        return 0.0
    short = gaps[gaps < FAR * q] / q
    whole = np.round(short)
    if float(np.mean(np.abs(short - whole) < NEAR)) < ON_GRID:
        return 0.0
    # Of gaps that follow each other, what one has too much the next has too little: all together tell it far better.
    return q * float(short.sum() / whole.sum())


def _slips(gaps: Floats) -> bool:
    """Return whether gaps, (n,) in two scans, are whole numbers but for some that are halves."""
    odd = np.abs(gaps - np.floor(gaps) - 0.5) < 0.5 * NEAR
    whole = np.abs(gaps - np.round(gaps)) < 0.5 * NEAR
    return int(np.count_nonzero(odd)) >= SLIPS and float(np.mean(odd | whole)) >= ON_GRID_RARE


def all_scans(at: Floats, counts: Floats, q: float, until: float) -> npt.NDArray[np.float64]:
    """Return (m, 3) time, OFF and ON events of all scans before `until`, those without events included."""
    ends = np.append(at, until)
    silent = np.maximum(np.round(np.diff(ends) / q).astype(np.int64) - 1, 0)
    out = np.zeros((len(at) + int(silent.sum()), 3))
    where = np.arange(len(at)) + np.concatenate([[0], np.cumsum(silent)[:-1]])
    owner = np.repeat(np.arange(len(at)), silent + 1)
    out[:, 0] = at[owner] + (np.arange(len(out)) - where[owner]) * q
    out[where, 1:] = counts
    return out
