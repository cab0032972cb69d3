"""The samples of one scale that still answer, in the order of their ticks, in one piece of memory.

A sample of tick t answers from t on for the scale's hold, moved on with its own motion: x(t') = x + v (t' - t).
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.units import US_PER_S

Floats = npt.NDArray[np.float64]
# x and y of the places, vx and vy, weight: (n,) float64 each, n > 0.
Columns = tuple[Floats, Floats, Floats, Floats, Floats]

CAPACITY_AT_FIRST: Final = 4096


class Holding:
    """Keeps samples by tick.

    Args:
        hold_us: how long a sample answers.
    """

    def __init__(self, hold_us: int) -> None:
        self._hold_us = hold_us
        self._columns = np.empty((5, CAPACITY_AT_FIRST))
        self._ticks: deque[tuple[int, int]] = deque()  # t_us and the number of samples, of each tick that is held
        self._begin = 0  # column of the first sample that is held
        self._end = 0
        self._moved: tuple[int, Columns | None] | None = None  # the last answer of `at`

    def add(self, t_us: int, columns: Columns) -> None:
        """Take the samples of a tick, later than the one before; `at` may be asked again."""
        n = len(columns[0])
        if self._end + n > self._columns.shape[1]:
            held = self._columns[:, self._begin : self._end]
            # At least as much room again as is used: copying stays rare.
            self._columns = np.empty((5, max(CAPACITY_AT_FIRST, 2 * (held.shape[1] + n))))
            self._columns[:, : held.shape[1]] = held
            self._begin, self._end = 0, held.shape[1]
        for row, column in zip(self._columns, columns, strict=True):
            row[self._end : self._end + n] = column
        self._end += n
        self._ticks.append((t_us, n))
        self._moved = None

    def forget(self, t0_us: int) -> None:
        """Drop the samples that answer nothing from t0 on."""
        self._moved = None
        while self._ticks and t0_us - self._ticks[0][0] > self._hold_us:
            self._begin += self._ticks.popleft()[1]

    def at(self, at_us: int) -> Columns | None:
        """Return all samples that answer at a time, moved on to it; None without any."""
        # Many places are asked at one time.
        if self._moved is None or self._moved[0] != at_us:
            self._moved = at_us, self._at(at_us, None)
        return self._moved[1]

    def some(self, at_us: int, limit: int) -> Columns | None:
        """Return about as many as a limit of them, evenly chosen."""
        return self._at(at_us, limit)

    def _at(self, at_us: int, limit: int | None) -> Columns | None:
        first, ages_s, counts = self._begin, [], []
        for t_us, n in self._ticks:
            if at_us - t_us > self._hold_us:
                first += n
            elif t_us <= at_us:
                ages_s.append((at_us - t_us) / US_PER_S)
                counts.append(n)
        if not counts:
            return None
        n = sum(counts)
        every = slice(None, None, 1 if limit is None else -(-n // limit))
        age_s = np.repeat(ages_s, counts)[every]
        x, y, vx, vy, weight = (column[every] for column in self._columns[:, first : first + n])
        return x + vx * age_s, y + vy * age_s, vx, vy, weight
