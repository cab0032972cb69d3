"""Keeps of a file's events what a camera can have sent: on the sensor, at a sane time, in order.

Where times fall, the fewest events are dropped that leave the rest of the chunk in order (the longest non-decreasing
subsequence behind the last event kept), and counted: so a time damaged upwards costs one event, not all that follow.
Cameras and converters put a few events out of order at the seams of packets; where more than one in a hundred is, the
file is not a recording in order of time, and is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numba
import numpy as np

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.events import EventBatch, Flags
from heliograph.messages import TIME_LIMIT_US
from heliograph_services.event_source.cameras.formats.contract import Chunk, Size

EARLY_SHARE: Final = 0.01
# Shares of fewer events than this are judged at the end of the file only: its first packet may be stale.
EARLY_JUDGED_FROM: Final = 10_000


class Sieve:
    """Sifts chunk after chunk of one pass over a file.

    Args:
        path: for the error's text.
        size: of the sensor.
    """

    def __init__(self, path: Path, size: Size) -> None:
        self._path = path
        self._size = size
        self._last_us = -TIME_LIMIT_US
        self._seen = 0
        self._early = 0
        self._first_early = ""

    def sift(self, chunk: Chunk) -> tuple[EventBatch, Refusals]:
        """Return the good events of a chunk, and what was refused of it.

        Raises:
            FileError: too many events of the file so far are early; the text names the first.
        """
        batch, refused = chunk.batch, Refusals(chunk.refused)
        self._seen += len(batch)
        batch = self._within(batch, refused)
        if len(batch):
            falls = batch.t_us[0] < self._last_us or bool((batch.t_us[1:] < batch.t_us[:-1]).any())
            if falls:
                batch = self._ordered(batch, refused)
            self._last_us = int(batch.t_us[-1]) if len(batch) else self._last_us
        if self._seen >= EARLY_JUDGED_FROM:
            self.judge()
        return batch, refused

    def judge(self) -> None:
        """Raise FileError where too many events so far were early."""
        if self._early > EARLY_SHARE * self._seen:
            raise FileError(
                f"{self._path}: time runs backwards at {self._early} of {self._seen} events, first {self._first_early}"
            )

    def _within(self, batch: EventBatch, refused: Refusals) -> EventBatch:
        if not len(batch):
            return batch
        if batch.x_px.max() >= self._size.width or batch.y_px.max() >= self._size.height:
            batch = self._only(
                batch, (batch.x_px < self._size.width) & (batch.y_px < self._size.height), Refusal.OFF_SENSOR, refused
            )
        if len(batch) and (batch.t_us.min() < -TIME_LIMIT_US or batch.t_us.max() > TIME_LIMIT_US):
            batch = self._only(
                batch, (batch.t_us >= -TIME_LIMIT_US) & (batch.t_us <= TIME_LIMIT_US), Refusal.TIME_JUMP, refused
            )
        return batch

    def _ordered(self, batch: EventBatch, refused: Refusals) -> EventBatch:
        before = np.concatenate([np.array([self._last_us], np.int64), batch.t_us])
        good = _in_order(batch.t_us, self._last_us)
        if not self._first_early:
            i = int(np.argmax(batch.t_us < before[:-1]))
            self._first_early = f"{batch.t_us[i]} us after {before[i]} us"
        self._early += len(good) - int(np.count_nonzero(good))
        return self._only(batch, good, Refusal.UNORDERED, refused)

    @staticmethod
    def _only(batch: EventBatch, good: Flags, reason: Refusal, refused: Refusals) -> EventBatch:
        refused[reason] += len(good) - int(np.count_nonzero(good))
        return EventBatch(batch.t_us[good], batch.x_px[good], batch.y_px[good], batch.on[good])


@numba.njit(cache=True, nogil=True)
def _in_order(t_us: Any, last_us: int) -> Any:
    """Return (n,) bool: the longest non-decreasing subsequence of the times that are not before last_us.

    ends[k] is the index at which the subsequence of k + 1 times with the smallest last time ends, before[i] the index
    before i in the best one that ends at i (patience sorting: n log n).
    """
    n = len(t_us)
    ends, before = np.empty(n, np.int64), np.empty(n, np.int64)
    length = 0
    for i in range(n):
        if t_us[i] < last_us:
            continue
        low, high = 0, length
        while low < high:
            middle = (low + high) // 2
            if t_us[ends[middle]] <= t_us[i]:
                low = middle + 1
            else:
                high = middle
        before[i] = ends[low - 1] if low else -1
        ends[low] = i
        length = max(length, low + 1)
    good = np.zeros(n, np.bool_)
    i = ends[length - 1] if length else -1
    while i >= 0:
        good[i] = True
        i = before[i]
    return good
