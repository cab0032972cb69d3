"""Cut a stream of onsets into clustering windows on an absolute grid.

Window k holds the ticks that begin in [k W, (k + 1) W), W a whole number of ticks; the first and the last window of a
stream may hold fewer ticks. Nothing depends on how the stream was cut into messages. Windows without entries are not
made.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.streams import Onsets


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The n entries of one window [start_us, end_us), in the order of the stream; a pixel may occur once a tick.

    Args:
        start_us: begin, a multiple of the window's length.
        end_us: end.
        x_px: (n,) uint16, onset pixels.
        y_px: (n,) uint16.
        on: (n,) uint8, events.
        off: (n,) uint8.
        tick: (n,) int64, the entries' ticks, counted from the window's begin.
        tick_us: length of a tick.
        flooded: there were more entries than the limit; the arrays are empty.
    """

    start_us: int
    end_us: int
    x_px: npt.NDArray[Any]
    y_px: npt.NDArray[Any]
    on: npt.NDArray[Any]
    off: npt.NDArray[Any]
    tick: npt.NDArray[Any]
    tick_us: int
    flooded: bool = False


_NOTHING: Final = (
    np.empty(0, np.uint16),
    np.empty(0, np.uint16),
    np.empty(0, np.uint8),
    np.empty(0, np.uint8),
    np.empty(0, np.int64),
)


class Cutter:
    """Collects entries until their window is complete.

    Args:
        tick_us: the stream's tick.
        ticks: ticks in a window.
        entries_limit: a window of more entries is flooded; it bounds what is held.
    """

    def __init__(self, tick_us: int, ticks: int, entries_limit: int) -> None:
        self._tick_us = tick_us
        self._ticks = ticks
        self._limit = entries_limit
        self._held: list[tuple[npt.NDArray[Any], ...]] = []
        self._held_n = 0
        self._held_index = 0

    @property
    def window_us(self) -> int:
        """The length of a window."""
        return self._tick_us * self._ticks

    def cut(self, onsets: Onsets) -> Iterator[Window]:
        """Yield the windows that this message completes, in order; take them all before the next message."""
        tick = onsets.t0_us // self._tick_us + onsets.tick.astype(np.int64)
        index = tick // self._ticks
        edges = np.flatnonzero(np.diff(index)) + 1
        starts = [0, *edges.tolist()] if len(index) else []
        stops = [*edges.tolist(), len(index)]
        for start, stop in zip(starts, stops, strict=False):
            if self._held_n and index[start] != self._held_index:
                yield self._release()
            self._hold(onsets, tick, int(index[start]), slice(start, stop))
        if self._held_n and (self._held_index + 1) * self.window_us <= onsets.t1_us:
            yield self._release()

    def drop(self) -> None:
        """Forget the window that has begun."""
        self._held, self._held_n = [], 0

    def _hold(self, onsets: Onsets, tick: npt.NDArray[np.int64], index: int, part: slice) -> None:
        self._held_index = index
        self._held_n += part.stop - part.start
        if self._held_n > self._limit:
            self._held = []
            return
        columns = (onsets.x_px, onsets.y_px, onsets.on_count, onsets.off_count, tick - index * self._ticks)
        self._held.append(tuple(column[part] for column in columns))

    def _release(self) -> Window:
        start_us = self._held_index * self.window_us
        flooded = self._held_n > self._limit
        held = [_NOTHING] if flooded else self._held
        x_px, y_px, on, off, tick = (np.concatenate(column) for column in zip(*held, strict=True))
        self.drop()
        end_us = start_us + self.window_us
        return Window(start_us, end_us, x_px, y_px, on, off, tick, self._tick_us, flooded)
