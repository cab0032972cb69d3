"""Edges from outside, so that real firmware can drive a simulated light.

Text, a line an edge, after an optional header line::

    t_ns,level        header (any line whose first character is a letter, before the first edge)
    # until 1000000   all changes before 1 ms are told; any other line that begins with # says nothing
    1500000,1         at 1.5 ms after the scene's begin the LED goes on
    2500000,0         at 2.5 ms it goes off; a line that repeats the level says only that the time has come so far

A file is read at once and must be sound: whoever wrote it can mend it. A FIFO or a terminal (a pty) is read as it
comes, by `poll`; what the line damages is refused and counted. Its drive knows the light up to `known_until_us`; who
asks beyond is told that nothing changes, and an edge that comes later for that time is refused. So a shell, which has
a clock, waits until the light is known as far as it needs, or until its patience ends.

Time in a stream only moves on. A line more than JUMP_NS ahead, or behind, is set aside: if the next one goes on from
there, the sender was silent for long (ahead: both count) or has begun anew (behind: its new time goes on from the last
edge); else it was damaged.
"""

from __future__ import annotations

import os
import re
import stat
from bisect import bisect_left
from pathlib import Path
from typing import Final

import numpy as np

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.units import NS_PER_US, US_PER_S
from heliograph_services.event_source.simulation.contract import Floats, SentFrame

# The slowest beacon, at 1 bit/s, changes within its longest run: seconds.
JUMP_NS: Final = 60 * 1_000_000_000
# 2**53 ns are 104 days; beyond, a float64 no longer holds every nanosecond.
TIME_LIMIT_NS: Final = 2**53
# What has been asked for may be asked again by the truth, which lags by less than this.
KEPT_US: Final = 2.0 * US_PER_S
# A sender that runs ahead is left waiting in its pipe once so much of the future is known: this bounds what is kept.
AHEAD_US: Final = 10.0 * US_PER_S
_POLL_BYTES: Final = 1 << 16
_LINE_BYTES: Final = 64
_LINE: Final = re.compile(rb"\s*(\d{1,19})\s*[,;\t ]\s*([01])\s*\Z")
_HEADER: Final = re.compile(rb"\s*[A-Za-z]")
_NOTE: Final = re.compile(rb"\s*#")
_UNTIL: Final = re.compile(rb"\s*#\s*until\s+(\d{1,19})\s*\Z")


class RecordedDrive:
    """The edges of a file (`contract.Drive`); known for all time.

    Args:
        path: for the messages.
        text: the file's bytes.

    Raises:
        FileError: a line is no edge, time falls, or there is no edge at all; the message names the line and its value.
    """

    known_until_us: float = float("inf")

    def __init__(self, path: str, text: bytes) -> None:
        times_ns: list[int] = []
        levels: list[int] = []
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip() or _NOTE.match(line) or (not times_ns and _HEADER.match(line)):
                continue
            found = _LINE.match(line)
            if found is None:
                raise FileError(f"{path}: line {number} must be t_ns,level with level 0 or 1, not {_shown(line)}")
            t_ns = int(found[1])
            if t_ns > TIME_LIMIT_NS:
                raise FileError(f"{path}: line {number}: t_ns must be in [0, {TIME_LIMIT_NS}], not {t_ns}")
            if times_ns and t_ns <= times_ns[-1]:
                raise FileError(f"{path}: line {number}: t_ns must rise, not {t_ns} after {times_ns[-1]}")
            times_ns.append(t_ns)
            levels.append(int(found[2]))
        if not times_ns:
            raise FileError(f"{path}: there must be at least 1 edge in it, not 0")
        level = np.array(levels, np.float64)
        self._level0 = 1.0 - float(level[0])
        changed = np.concatenate([[True], level[1:] != level[:-1]])
        self._t_us: Floats = np.array(times_ns, np.float64)[changed] / NS_PER_US
        self._level: Floats = level[changed]

    def changes(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and new levels of the changes in [t0_us, t1_us)."""
        i, j = (int(k) for k in np.searchsorted(self._t_us, (t0_us, t1_us)))
        return self._t_us[i:j], self._level[i:j]

    def level(self, t_us: float) -> float:
        """Return the level just before t_us."""
        i = int(np.searchsorted(self._t_us, t_us))
        return float(self._level[i - 1]) if i else self._level0

    def frames_ended(self, t0_us: float, t1_us: float) -> list[SentFrame]:  # noqa: ARG002 - of the protocol
        """Return no frames: what the edges mean is not known here."""
        return []


class StreamedDrive:
    """The edges of a FIFO or a terminal as they come (`contract.Drive`); see the module.

    Args:
        path: the FIFO or the terminal; opened without waiting for a sender.

    Raises:
        FileError: it cannot be opened.
    """

    def __init__(self, path: str) -> None:
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | getattr(os, "O_NOCTTY", 0))
        except OSError as error:
            raise FileError(f"{path}: {error.strerror}") from None
        self.refusals = Refusals()
        self.ended = False
        self._edges = _Edges(self.refusals)
        self._rest = b""

    @property
    def known_until_us(self) -> float:
        """The light is known before this time; without end once the sender has closed its end."""
        return float("inf") if self.ended else self._edges.known_until_us

    def poll(self) -> bool:
        """Read what has come, without waiting; return whether anything had.

        A sender that has closed its end has `ended`, and may open it again.
        """
        if self._edges.known_until_us > self._edges.asked_us + AHEAD_US:
            return False
        try:
            data = os.read(self._file, _POLL_BYTES)
        except BlockingIOError:
            return False
        except OSError:  # a terminal whose other side has gone
            data = b""
        if not data:
            # A FIFO without a sender reads the same before the first has come.
            self.ended = self._edges.known_until_us > float("-inf")
            return False
        self.ended = False
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._edges.take(line)
        if len(self._rest) > _LINE_BYTES:
            self.refusals[Refusal.DAMAGED] += 1
            self._rest = b""
        return True

    def changes(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and new levels of the known changes in [t0_us, t1_us)."""
        return self._edges.between(t0_us, t1_us)

    def level(self, t_us: float) -> float:
        """Return the level just before t_us."""
        return self._edges.level(t_us)

    def frames_ended(self, t0_us: float, t1_us: float) -> list[SentFrame]:  # noqa: ARG002 - of the protocol
        """Return no frames: what the edges mean is not known here."""
        return []

    def close(self) -> None:
        """Let go of the file; may be called twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


class _Edges:
    """The edges of a stream, line by line."""

    def __init__(self, refusals: Refusals) -> None:
        self.known_until_us = float("-inf")
        self.asked_us = 0.0
        self._refusals = refusals
        self._t_us: list[float] = []
        self._level: list[float] = []
        self._before = 0.0  # the level before the first edge that is kept
        self._last: tuple[int, float] | None = None  # of the last good line: its own time, and its level
        self._shift_ns = 0  # of a sender that has begun anew
        self._aside: tuple[int, float] | None = None

    def take(self, line: bytes) -> None:
        """Take a line."""
        if not line.strip() or (self._last is None and _HEADER.match(line)):
            return
        until = _UNTIL.match(line) if len(line) <= _LINE_BYTES else None
        if until is not None and int(until[1]) <= TIME_LIMIT_NS:
            self._told_until(int(until[1]))
            return
        if _NOTE.match(line):
            return
        found = _LINE.match(line) if len(line) <= _LINE_BYTES else None
        if found is None or int(found[1]) > TIME_LIMIT_NS:
            self._refusals[Refusal.DAMAGED] += 1
            return
        edge = int(found[1]), float(found[2])
        if self._last is None and self._aside is None and edge[0] <= JUMP_NS:
            self._before = 1.0 - edge[1]
            self._accept(edge)
        elif self._last is not None and 0 < edge[0] - self._last[0] <= JUMP_NS:
            self._refuse_aside()
            self._accept(edge)
        elif self._aside is not None and 0 < edge[0] - self._aside[0] <= JUMP_NS:
            self._begin_anew(self._aside)
            self._accept(edge)
        else:
            self._refuse_aside()
            self._aside = edge

    def _told_until(self, t_ns: int) -> None:
        """Take a note that the time has come so far: the light is as it was, dark before the first edge."""
        # An edge at t_ns itself may still come.
        if self._last is None:
            self._last = t_ns - 1, 0.0
        elif not 0 < t_ns - 1 - self._last[0] <= JUMP_NS:
            return
        else:
            self._last = t_ns - 1, self._last[1]
        self.known_until_us = max(self.known_until_us, (t_ns + self._shift_ns) / NS_PER_US)

    def between(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and levels in [t0_us, t1_us)."""
        self.asked_us = max(self.asked_us, t1_us)
        self._forget(self.asked_us - KEPT_US)
        i, j = bisect_left(self._t_us, t0_us), bisect_left(self._t_us, t1_us)
        return np.array(self._t_us[i:j], np.float64), np.array(self._level[i:j], np.float64)

    def level(self, t_us: float) -> float:
        """Return the level just before t_us."""
        i = bisect_left(self._t_us, t_us)
        return self._level[i - 1] if i else self._before

    def _accept(self, edge: tuple[int, float]) -> None:
        self._last = edge
        t_us = (edge[0] + self._shift_ns) / NS_PER_US
        if t_us < self.asked_us:
            # The light has been told already: what was told stays, and the new level begins now.
            self._refusals[Refusal.TIME_BACKWARDS] += 1
            t_us = max(self.asked_us, self.known_until_us)
        self.known_until_us = max(self.known_until_us, t_us)
        if edge[1] != (self._level[-1] if self._level else self._before):
            self._t_us.append(t_us)
            self._level.append(edge[1])

    def _begin_anew(self, edge: tuple[int, float]) -> None:
        """Accept the line that was set aside: after a long silence, or as the first of a sender that begins anew."""
        if self._last is None:
            self._before = 1.0 - edge[1]
        elif edge[0] <= self._last[0]:
            self._refusals[Refusal.TIME_BACKWARDS] += 1
            self._shift_ns += self._last[0] - edge[0]
        else:
            self._refusals[Refusal.TIME_JUMP] += 1
        self._aside = None
        self._accept(edge)

    def _refuse_aside(self) -> None:
        if self._aside is not None:
            self._refusals[Refusal.TIME_JUMP] += 1
            self._aside = None

    def _forget(self, before_us: float) -> None:
        n = bisect_left(self._t_us, before_us)
        if n:
            self._before = self._level[n - 1]
            del self._t_us[:n], self._level[:n]


def open_edges(path: str) -> RecordedDrive | StreamedDrive:
    """Return the drive of a file, a FIFO or a terminal.

    Raises:
        FileError: it does not exist, is something else, or is no file of edges.
    """
    try:
        mode = Path(path).stat().st_mode
        if stat.S_ISREG(mode):
            return RecordedDrive(path, Path(path).read_bytes())
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}") from None
    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
        return StreamedDrive(path)
    raise FileError(f"{path}: edges must come from a file, a FIFO or a terminal")


def _shown(line: bytes) -> str:
    return repr(line[:40].decode("utf-8", "replace"))
