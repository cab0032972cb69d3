"""Cuts events into windows on an absolute grid, and names streams.

A stream's name is the CRC-32 of the sensor's size and of the first events: the same in every run over the same input,
the same for a simulated scene and for the file made of it, and independent of how the windows are cut.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Final

import numpy as np

from heliograph.events import EventBatch, concatenate

# The events that name a stream: those of the first 10 ms after the first event, at most as many as a small message.
NAMING_US: Final = 10_000
NAMING_EVENTS: Final = 4_096


def floor_to(t_us: int, step_us: int) -> int:
    """Return the last multiple of step_us that is not behind t_us."""
    return t_us // step_us * step_us


def stream_name(width: int, height: int, batch: EventBatch) -> str:
    """Return 8 hex digits that stand for a sensor and the first events of a stream.

    Args:
        width: of the sensor, pixels.
        height: of the sensor, pixels.
        batch: the stream's first events, at least those that `naming_is_complete` asks for, or all that there are.
    """
    crc = zlib.crc32(np.array([width, height], "<i8").tobytes())
    if len(batch):
        n = min(int(np.searchsorted(batch.t_us, batch.t_us[0] + NAMING_US)), NAMING_EVENTS)
        first = batch.part(0, n)
        for column, dtype in ((first.t_us, "<i8"), (first.x_px, "<u2"), (first.y_px, "<u2"), (first.on, "u1")):
            crc = zlib.crc32(column.astype(dtype).tobytes(), crc)
    return f"{crc:08x}"


def naming_is_complete(batch: EventBatch) -> bool:
    """Return whether more events would leave the stream's name as it is."""
    return len(batch) > 0 and (len(batch) >= NAMING_EVENTS or int(batch.t_us[-1] - batch.t_us[0]) >= NAMING_US)


class Cutter:
    """Takes events in order of time, gives windows of [t, t + window_us), t a multiple of window_us.

    Args:
        window_us: length of a window.
        first_us: a time in the first window.
    """

    def __init__(self, window_us: int, first_us: int) -> None:
        self._window_us = window_us
        self._t0_us = floor_to(first_us, window_us)
        self._held: list[EventBatch] = []

    @property
    def t0_us(self) -> int:
        """Beginning of the window that is being filled."""
        return self._t0_us

    def push(self, batch: EventBatch, until_us: int) -> Iterator[tuple[int, int, EventBatch]]:
        """Yield (t0_us, t1_us, events) of the windows that end by until_us.

        Args:
            batch: events not before the last until_us.
            until_us: there are no more events before this time.
        """
        done = 0
        while self._t0_us + self._window_us <= until_us:
            t1_us = self._t0_us + self._window_us
            stop = done + int(np.searchsorted(batch.t_us[done:], t1_us))
            yield self._t0_us, t1_us, concatenate([*self._held, batch.part(done, stop)])
            self._held.clear()
            self._t0_us, done = t1_us, stop
        if done < len(batch):
            self._held.append(batch.part(done, len(batch)))

    def rest(self) -> tuple[int, int, EventBatch]:
        """Return the window that is being filled, as it is."""
        held, self._held = concatenate(self._held), []
        t0_us = self._t0_us
        self._t0_us += self._window_us
        return t0_us, t0_us + self._window_us, held
