"""A clock that is likely, not certain, is believed if the code repeats under it.

A word with two edges of a polarity shows z = 5.5 in the 44 bits that four frames of it take where one polarity
trails over the bits (`heliograph.link.clock`), and the threshold of the edges alone only after 70. But the frames
speak too: a trial demodulates what is held on the likely grid, and the clock is believed if the last frames read one
payload, one frame apart, one frame less than an identity takes. In random bits that happens, at a bit position, with W
words in 2^n::

    W / 2^n * 2^-n (k - 2)            seed11, k 4: 48/2048 * 2048^-2 = 5.6e-9; code20d4, k 3: 2e-7 (one error corrected)

so that a trial which fails costs its time alone, and one that succeeds has found what the receiver was made for.
A beacon that changes its payload with every frame waits for the threshold.

Most young tracks are clutter, and demodulating it over and over would cost more than all else. What repeats, though, is
seen before it is read. Of the last k - 1 frames' slots m, with c_p[m] events of polarity p, the likeness is::

    r = sum_m,p d_p[m] d_p[m + n] / sqrt(sum d_p[m]^2 sum d_p[m + n]^2)        d = c - mean c of the polarity
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np

from heliograph.events import Flags
from heliograph.link import demodulator, scan_demodulator, scan_state, state
from heliograph.link.clock import Floats

# Of the weakest words at 44 bits; noise passes once in seven windows, and then costs a trial.
THRESHOLD: Final = 4.5
# Fewest equal frames: two may be chance.
REPEATS_LEAST: Final = 2
# A word that repeats shows nearly 1 (bursts differ), a beam that comes and goes less; random bits 0 +- 1 / sqrt(2 n).
LIKENESS: Final = 0.5
NOT_ALIGNED: Final = -1e9


@numba.njit(cache=True, nogil=True)
def likeness(t: Floats, on: Flags, begin: float, period: float, slots: int, n: int) -> float:
    """Return r of the slots from begin on, n apart.

    Args:
        t: (events,) times in nominal bits, not falling.
        on: (events,) polarities.
        begin: of the first slot.
        period: of a slot.
        slots: how many, more than n.
        n: bits of a frame.
    """
    counts = np.zeros((2, slots))
    for i in range(np.searchsorted(t, begin), len(t)):
        slot = int((t[i] - begin) / period)
        if 0 <= slot < slots:
            counts[1 if on[i] else 0, slot] += 1.0
    both, first, second = 0.0, 0.0, 0.0
    for p in range(2):
        mean = counts[p].mean()
        for slot in range(slots - n):
            a, b = counts[p, slot] - mean, counts[p, slot + n] - mean
            both += a * b
            first += a * a
            second += b * b
    return both / math.sqrt(first * second) if first * second > 0.0 else 0.0


def alike(t: Floats, on: Flags, until: float, found: Floats, n: int, wanted: int) -> bool:
    """Return whether the last frames of a window look like one another on a grid.

    Args:
        t: (events,) event times in nominal bits, not falling.
        on: (events,) polarities.
        until: end of the window.
        found: (4,) of `heliograph.link.clock.grid`.
        n: bits of a frame.
        wanted: how many frames.
    """
    period = float(found[1])
    # A slot reaches from the middle of a bit to that of the next; the last whole one ends before `until`.
    last = found[0] + (math.floor((until - found[0]) / period - 0.5) + 0.5) * period
    slots = max(wanted, REPEATS_LEAST) * n
    return bool(likeness(t, on, last - slots * period, period, slots, n) >= LIKENESS)


def repeats(
    t: Floats, on: Flags, until: float, at: state.State, wanted: int, scanned: scan_state.ScanState | None = None
) -> bool:
    """Return whether the frames of a window, demodulated from a lock at its beginning, end with equal ones.

    Args:
        t: (n,) event times in nominal bits from the lock's origin, not falling.
        on: (n,) polarities.
        until: end of the window.
        at: begun with the lock (`state.start`); changed.
        wanted: how many equal frames.
        scanned: begun with the lock, where the light is scanned; changed.
    """
    if trust(t, on, until, at, scanned) == NOT_ALIGNED:
        return False
    newest = at.out[: at.ints[state.OUT]][-max(wanted, REPEATS_LEAST) :]
    if len(newest) < max(wanted, REPEATS_LEAST):
        return False
    code, slot, bits = newest[:, state.OUT_CODE], newest[:, state.OUT_SLOT], at.words.shape[1]
    return bool(code[0] >= 0 and (code == code[0]).all() and (slot[1:] - slot[:-1] == bits).all())


def trust(t: Floats, on: Flags, until: float, at: state.State, scanned: scan_state.ScanState | None = None) -> float:
    """Return how surely the frames of a window are in their place at its end: A of `heliograph.link.alignment`, nats.

    Args:
        t: (n,) as of `repeats`.
        on: likewise.
        until: likewise.
        at: likewise.
        scanned: likewise.

    Returns:
        NOT_ALIGNED where they have no place.
    """
    while True:
        if scanned is None:
            outcome, taken = demodulator.advance(t, on, until, at)
        else:
            outcome, taken = scan_demodulator.advance(t, on, until, at, scanned)
        if outcome != demodulator.FULL:
            break
        t, on = t[taken:], on[taken:]
        at.ints[state.OUT] = 0
    placed = outcome == demodulator.DONE and at.ints[state.ALIGNED] >= 0
    return float(at.floats[state.TRUST]) if placed else NOT_ALIGNED


def warm() -> None:
    """Compile, or load from the cache, the kernel of this module."""
    likeness(np.zeros(1), np.zeros(1, np.bool_), 0.0, 1.0, 2, 1)
