"""One track's events, counted in sub-bins of a bit on a grid that does not depend on how the input was cut.

Sub-bin k of a stretch that began at t_s with sub-bin k_s holds the events with floor((t - t_s) / w) = k - k_s, where
w = T / 16 and T is the nominal length of a bit. The first event of all begins the first stretch. Where no event comes
for more than `QUIET_BINS` sub-bins, the rest of the silence is cut out: a new stretch begins with the next event,
`QUIET_BINS` sub-bins after the last one. So silence costs neither time nor memory, however long it is, and the
receiver sees enough of it to know that the LED idles.
"""

from __future__ import annotations

from bisect import bisect_right
from math import ceil
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times
from heliograph.link.step_response import SUB_BINS, Counts

# Four characters: longer than any run of equal levels (9 bits), the receiver's look-ahead (26 bits) and their sum.
QUIET_BINS: Final = 44 * SUB_BINS
# Silence assumed before the first event of all: an LED that begins to speak shows its first start bit there, and the
# bit needs room to be found early.
LEAD_BINS: Final = 2 * SUB_BINS
# Characters that the window holds before it is asked to move on or to grow.
_START_BINS: Final = 8 * QUIET_BINS


@numba.njit(cache=True, nogil=True)
def _count(
    t_us: Times, on: Flags, state: npt.NDArray[np.int64], width_us: float, quiet: int, base: int, counts: Counts,
    marks: npt.NDArray[np.int64],
) -> tuple[int, int]:  # fmt: skip
    """Count events until the array is full; return how many were taken, and how many new stretches (marks) began.

    Room for the silence that may follow the last event is kept, since the receiver reads that far.

    state holds t_s, k_s, the last event's sub-bin, and 1 once there was an event.
    """
    fresh = 0
    for i in range(len(t_us)):
        if state[3] == 0:
            k = state[1]
            new = True
        else:
            since = (t_us[i] - state[0]) / width_us  # compared as a float: time may jump further than an int holds
            new = since > state[2] - state[1] + quiet
            k = state[2] + quiet if new else state[1] + np.int64(since)
        if k - base + quiet >= counts.shape[0] or (new and fresh == marks.shape[0]):
            return i, fresh
        if new:
            state[0], state[1], state[3] = t_us[i], k, 1
            marks[fresh, 0], marks[fresh, 1] = k, t_us[i]
            fresh += 1
        state[2] = k
        counts[k - base, 0 if on[i] else 1] += 1
    return len(t_us), fresh


class SubBins:
    """Counts of one track, a window that moves on.

    Args:
        width_us: w, length of a sub-bin.
    """

    def __init__(self, width_us: float) -> None:
        self.width_us = width_us
        self.base = 0  # number of the first sub-bin in `counts`
        self.counts: Counts = np.zeros((_START_BINS, 2), np.int32)
        self._state = np.array([0, LEAD_BINS, 0, 0], np.int64)
        self._marks: list[tuple[int, int]] = []  # (first sub-bin, its time) of the stretches still held
        self._new = np.empty((64, 2), np.int64)

    def add(self, t_us: Times, on: Flags) -> int:
        """Count events, none older than those counted before, while there is room; return how many were taken."""
        # A kernel is compiled anew for arrays that may not be written, such as those that came over a wire.
        t_us, on = np.require(t_us, requirements=("C", "W")), np.require(on, requirements=("C", "W"))
        done = 0
        while done < len(t_us):
            taken, fresh = _count(
                t_us[done:], on[done:], self._state, self.width_us, QUIET_BINS, self.base, self.counts, self._new
            )
            self._marks.extend((int(k), int(t)) for k, t in self._new[:fresh])
            done += taken
            if fresh < len(self._new):
                break
        return done

    def grow(self) -> None:
        """Make room for as many sub-bins again."""
        grown = np.zeros((2 * len(self.counts), 2), np.int32)
        grown[: len(self.counts)] = self.counts
        self.counts = grown

    def known(self, until_us: int) -> int:
        """Return the first sub-bin that may still change, when there are no more events before until_us."""
        if not self._state[3]:
            return self.base
        begun_us, first, last = int(self._state[0]), int(self._state[1]), int(self._state[2])
        return int(min(first + (until_us - begun_us) / self.width_us, last + QUIET_BINS))

    def reaches_us(self, sub_bin: int) -> int:
        """Return the least until_us at which `known` is this sub-bin; 2**60 where that takes another event."""
        begun_us, first, last = int(self._state[0]), int(self._state[1]), int(self._state[2])
        if sub_bin > last + QUIET_BINS:
            return 2**60
        return begun_us + ceil((sub_bin - first) * self.width_us)

    def time_us(self, sub_bin: float) -> int:
        """Return the time at which a sub-bin (or a part of it) begins."""
        at = max(bisect_right(self._marks, (sub_bin, 1 << 62)) - 1, 0)
        if not self._marks:
            return 0
        first, begun_us = self._marks[at]
        return begun_us + round((sub_bin - first) * self.width_us)

    def drop(self, before: int) -> None:
        """Forget the sub-bins before this one; does nothing while little can be gained."""
        gain = before - self.base
        if gain < len(self.counts) // 2:
            return
        kept = max(len(self.counts) - gain, 0)
        self.counts[:kept] = self.counts[gain : gain + kept].copy()
        self.counts[kept:] = 0
        self.base = before
        while len(self._marks) > 1 and self._marks[1][0] <= before:
            del self._marks[0]
