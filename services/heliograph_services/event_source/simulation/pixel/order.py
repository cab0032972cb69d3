"""Events into order of time, then pixel; those of later intervals are held back.

Times are multiples of 2^-14 us, so within an interval they are small integers: sorted by digits (radix sort, the least
digit first), which costs the same however they crowd about an edge.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from heliograph.events import Flags
from heliograph_services.event_source.simulation.contract import Floats, Ints, Labels
from heliograph_services.event_source.simulation.pixel.leaf import leaf
from heliograph_services.event_source.simulation.pixel.response import CAUSES, PIXELS, TICKS

BITS: Final = 11


@numba.njit(nogil=True)
def _by_time(keys: Ints) -> Ints:
    """Return the indices that put the keys (0 to 2^31 - 1) into order, equal ones as they were."""
    n = len(keys)
    # A key and its index travel together, in one word.
    words, other = np.empty(n, np.int64), np.empty(n, np.int64)
    most = 0
    for k in range(n):
        words[k] = keys[k] << 32 | k
        most = max(most, keys[k])
    first = np.empty((1 << BITS) + 1, np.int64)
    shift = 32
    while most > 0:
        first[:] = 0
        for k in range(n):
            first[((words[k] >> shift) & ((1 << BITS) - 1)) + 1] += 1
        for d in range(1 << BITS):
            first[d + 1] += first[d]
        for k in range(n):
            digit = (words[k] >> shift) & ((1 << BITS) - 1)
            other[first[digit]] = words[k]
            first[digit] += 1
        words, other = other, words
        shift += BITS
        most >>= BITS
    for k in range(n):
        words[k] &= 0xFFFFFFFF
    return words


@leaf
def _break_ties(order: Ints, keys: Ints, pixel: Ints) -> None:
    for k in range(1, len(order)):
        at, j = order[k], k
        while j > 0 and keys[order[j - 1]] == keys[at] and pixel[order[j - 1]] > pixel[at]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = at


@numba.njit(nogil=True)
def ordered(out: Floats, n: int, t0_us: float, t1_us: float) -> tuple[int, Floats, Ints, Flags, Labels]:
    """Take the events before t1_us out of the first n.

    Args:
        out: events, none before t0_us; the later ones stay, moved to its beginning.
        n: so many.
        t0_us: beginning of the interval.
        t1_us: its end.

    Returns:
        How many stay; and of those taken, in order, the time, pixel, polarity and cause.
    """
    now = 0
    for k in range(n):
        if out[k, 0] < t1_us:
            now += 1
    keys, pixel = np.empty(now, np.int64), np.empty(now, np.int64)
    t_us, on, cause = np.empty(now), np.empty(now, np.bool_), np.empty(now, np.int16)
    held = 0
    at = 0
    for k in range(n):
        if out[k, 0] < t1_us:
            keys[at] = int((out[k, 0] - t0_us) * TICKS)
            label = np.floor(out[k, 1] / PIXELS)
            code = int(out[k, 1] - label * PIXELS)
            t_us[at], pixel[at], on[at], cause[at] = out[k, 0], code >> 1, (code & 1) == 1, int(label - CAUSES)
            at += 1
        else:
            out[held, 0], out[held, 1] = out[k, 0], out[k, 1]
            held += 1
    order = _by_time(keys)
    _break_ties(order, keys, pixel)
    return held, t_us[order], pixel[order], on[order], cause[order]
