"""Keeps of a file's events what a camera can have sent: on the sensor, at a sane time, in order.

An event earlier than one before it is dropped and counted. Cameras and converters do that to a few events at the seams
of packets; where more than one in a hundred is early, the file is not a recording in order of time, and is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

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
        newest = np.maximum.accumulate(np.concatenate([np.array([self._last_us], np.int64), batch.t_us]))[:-1]
        good = batch.t_us >= newest
        if not self._first_early:
            i = int(np.argmin(good))
            self._first_early = f"{batch.t_us[i]} us after {newest[i]} us"
        self._early += len(good) - int(np.count_nonzero(good))
        return self._only(batch, good, Refusal.UNORDERED, refused)

    @staticmethod
    def _only(batch: EventBatch, good: Flags, reason: Refusal, refused: Refusals) -> EventBatch:
        refused[reason] += len(good) - int(np.count_nonzero(good))
        return EventBatch(batch.t_us[good], batch.x_px[good], batch.y_px[good], batch.on[good])
