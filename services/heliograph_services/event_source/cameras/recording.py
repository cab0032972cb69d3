"""The recording camera: a file played as if it were a camera; formats in `formats/`.

Times are the file's own. What was refused travels with the window that follows. A silence of more than a minute is no
silence but a jump of the clock: it is counted, and a new stream begins behind it, so that nobody steps through years.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from heliograph.camera import Intrinsics
from heliograph.core import Context
from heliograph.errors import ConfigError, FileError, Refusal, Refusals, by_name
from heliograph.events import EventBatch, concatenate
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.cameras.formats import open_reader
from heliograph_services.event_source.cameras.formats.contract import Reader, Size
from heliograph_services.event_source.cameras.sieve import Sieve
from heliograph_services.event_source.cameras.windows import Cutter, floor_to, naming_is_complete, stream_name
from heliograph_services.event_source.config import EventSourceConfig

# Longer than any camera is silent (its noise alone sends events); a minute of windows of 2 ms is still quick to play.
JUMP_US: Final = 60 * US_PER_S
# No recording that begins later than this, or is longer, has its clock in microseconds; it is a bound for the sums of
# a loop, far within the wire's.
_LOOP_LIMIT_US: Final = 2**50

Piece = tuple[EventBatch, Refusals]


class RecordingCamera:
    """A camera made of a file.

    Args:
        config: file, format, width and height, loop, duration_s, window_us.
        context: not used: a recording is the same in every process.

    Raises:
        ConfigError: no file is given.
        FileError: it cannot be read, or holds no event.
    """

    def __init__(self, config: EventSourceConfig, context: Context) -> None:  # noqa: ARG002 - see the class
        if not config.file:
            raise ConfigError(f"file must name a recording where backend is {config.backend}")
        self._config = config
        self._path = Path(config.file)
        self._reader = self._opened()
        self.width, self.height = self._reader.size.width, self._reader.size.height
        self.intrinsics: Intrinsics | None = None
        first = self._first_events()
        self.stream = stream_name(self.width, self.height, first)
        self._start_us = floor_to(int(first.t_us[0]), config.window_us)

    def _opened(self) -> Reader:
        """Return the reader of the file; other kinds of files have others."""
        return open_reader(self._path, self._config.format, Size(self._config.width, self._config.height))

    def close(self) -> None:
        """Do nothing: a file is open only while windows are drawn."""

    def windows(self) -> Iterator[Window]:
        """Yield the windows of the file (`contract.Camera`)."""
        held: Window | None = None
        for window in self._windows():
            if held is not None:
                yield held
            held = window
        if held is not None:
            yield replace(held, end=True)

    def _first_events(self) -> EventBatch:
        """Return the events that name the stream."""
        found: list[EventBatch] = []
        why = Refusals()
        for batch, refused in self._pieces():
            found.append(batch)
            why.update(refused)
            first = concatenate(found)
            if naming_is_complete(first):
                return first
        if not any(len(batch) for batch in found):
            reasons = ", ".join(f"{name} ({n})" for name, n in by_name(why).items())
            raise FileError(f"{self._path}: no events in it{': ' if reasons else ''}{reasons}")
        return concatenate(found)

    def _pieces(self) -> Iterator[Piece]:
        """Yield the good events of one pass over the file; a piece has no jump within or before it but at its start."""
        sieve = Sieve(self._path, self._reader.size)
        for chunk in self._reader.chunks():
            batch, refused = sieve.sift(chunk)
            start = 0
            for jump in np.flatnonzero(np.diff(batch.t_us) > JUMP_US):
                stop = int(jump) + 1
                yield batch.part(start, stop), refused
                start, refused = stop, Refusals()
            yield batch.part(start, len(batch)), refused
        sieve.judge()

    def _passes(self) -> Iterator[Piece]:
        """Yield the pieces of the file, again and again where it loops, times going on from pass to pass."""
        shift_us = 0
        while True:
            end_us = self._start_us
            for batch, refused in self._pieces():
                if len(batch):
                    end_us = int(batch.t_us[-1]) + 1
                    if shift_us:
                        batch = replace(batch, t_us=batch.t_us + shift_us)  # noqa: PLW2901 - the same events, later
                yield batch, refused
            length_us = floor_to(end_us - self._start_us - 1, self._config.window_us) + self._config.window_us
            shift_us += length_us
            if not self._config.loop or shift_us + abs(self._start_us) > _LOOP_LIMIT_US:
                return

    def _windows(self) -> Iterator[Window]:
        window_us = self._config.window_us
        limit_us = self._start_us + round(self._config.duration_s * US_PER_S) if self._config.duration_s else None
        cutter = Cutter(window_us, self._start_us)
        stream, refused, last_us = self.stream, Refusals(), self._start_us
        for piece, more in self._passes():
            refused.update(more)
            batch = piece if limit_us is None else piece.part(0, int(np.searchsorted(piece.t_us, limit_us)))
            if len(batch) and batch.t_us[0] - last_us > JUMP_US:
                yield self._window(cutter.rest(), stream, refused)
                refused = Refusals({Refusal.TIME_JUMP: 1})
                cutter = Cutter(window_us, int(batch.t_us[0]))
                stream = stream_name(self.width, self.height, batch)
            if len(batch):
                last_us = int(batch.t_us[-1])
                for cut in cutter.push(batch, last_us):
                    yield self._window(cut, stream, refused)
                    refused = Refusals()
            if limit_us is not None and len(batch) < len(piece):
                break
        yield self._window(cutter.rest(), stream, refused)

    @staticmethod
    def _window(cut: tuple[int, int, EventBatch], stream: str, refused: Refusals) -> Window:
        return Window(cut[0], cut[1], cut[2], stream, refused=refused)
