"""How the packet receiver finds its bit clock: events are held until some window of them shows one.

Time is cut into blocks of 16 nominal bits on an absolute grid, and after each one the windows that end with it are
looked at (`heliograph.link.clock`): 4 blocks, and 16 where 4 do not suffice; scrambled bits have an edge in every other
bit, so a light as sharp as a packet needs is known after 32 to 64 bits. Three signs are looked at: changes
of polarity (`heliograph.link.polarity`), a lit LED's level while it moves (`heliograph.link.level`), and the events;
the first that shows a clock gives it. The window's events are handed on, so the lock costs nothing of a packet that
began within it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.events import Flags, Times
from heliograph.link import clock, level, packet_response, polarity

# Fewest bits since the light came: fewer are not worth a look.
WINDOW_LEAST_BITS: Final = 32
# Events held: 256 bits at 1 kbit/s hold 4 Mev/s in one region, a flicker of the whole image.
WINDOW_EVENTS: Final = 1_000_000
# Bits before the first edge of a window at which the grid begins: a packet may begin as the light before it ended, and
# its first edges may be lost. No run is as long.
LEAD_BITS: Final = 24
# What is looked at, in this order.
TURNS: Final = 0
LEVEL: Final = 1
EVENTS: Final = 2


@dataclass(slots=True)
class Clock:
    """A clock, and the events since its window began.

    Args:
        origin_us: beginning of the window; times are counted from it.
        found: (4,) of `heliograph.link.clock.grid`.
        folded: (2, SUB) of the same; None where the level or the polarities set the rates.
        t_us: (n,) int64.
        on: (n,) bool.
    """

    origin_us: int
    found: clock.Floats
    folded: clock.Floats | None
    t_us: Times
    on: Flags


class ClockSearch:
    """Looks for the clock of one track.

    Args:
        bit_us: nominal length of a bit.
        model: (8, 2, SUB) out: the rates, where the light shows its levels.
        seen: (8,) out: zero, then.
    """

    def __init__(self, bit_us: float, model: clock.Floats, seen: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        self._bit_us = bit_us
        self._block_us = clock.BLOCK_BITS * bit_us
        self._model, self._seen = model, seen
        self._since_us: int | None = None  # the first event, the end of a dark time, or where the last lock was lost
        self._block = 0  # number of the next block
        self._dark = 0  # blocks before it without events
        # Of the changes of polarity, of the edges of the level, and of the events themselves.
        self._sums = np.zeros((3, clock.LONG_BLOCKS, clock.SUMS))
        self._edge_t = np.zeros((2, clock.LONG_BLOCKS, 4 * clock.BLOCK_BITS))
        self._edge_on = np.zeros((2, clock.LONG_BLOCKS, 4 * clock.BLOCK_BITS), np.bool_)
        self._edge_n = np.zeros((2, clock.LONG_BLOCKS), np.int64)
        self._t: Times = np.empty(0, np.int64)
        self._on: Flags = np.empty(0, np.bool_)
        self.failed = 0  # short windows with events and no clock

    def restart(self, since_us: int) -> None:
        """Begin anew at a time: a lock was lost there."""
        self._since_us = since_us
        self._block = int(since_us // self._block_us)
        self._forget()
        self._drop(len(self._t))

    def feed(self, t_us: Times, on: Flags, until_us: int) -> Clock | None:
        """Take the events before until_us; return a clock, with all events from its window on, or None."""
        if len(t_us):
            if self._since_us is None:
                self._since_us = int(t_us[0])
            self._t = np.concatenate([self._t, t_us])
            self._on = np.concatenate([self._on, on])
        while len(self._t):
            # A long dark time is skipped, block by block no further than a window reaches back.
            if self._block - int(self._t[-1] // self._block_us) > clock.LONG_BLOCKS:
                self._drop(len(self._t))
                break
            first = int(self._t[0] // self._block_us)
            if first >= self._block + clock.LONG_BLOCKS or first < self._block - clock.LONG_BLOCKS:
                self._block = first
                self._forget()
                self._dark = clock.SHORT_BLOCKS
            if (self._block + 1) * self._block_us > until_us:
                break
            if (found := self._attempt()) is not None:
                return found
        return None

    def flush(self) -> Clock | None:
        """Look once more, the block that has begun counted as a whole one: the stream has ended."""
        return self._attempt() if len(self._t) else None

    def _forget(self) -> None:
        self._dark = 0
        self._sums[:] = 0.0
        self._edge_n[:] = 0

    def _drop(self, events: int) -> None:
        self._t, self._on = self._t[events:], self._on[events:]

    def _attempt(self) -> Clock | None:
        """Take in the next whole block and look for the clock in the windows that end with it."""
        end_us = (self._block + 1) * self._block_us
        stop = self._take_block(self._block * self._block_us, end_us)
        self._block += 1
        since_us = self._since_us or 0
        if self._dark == 0 and end_us - since_us >= WINDOW_LEAST_BITS * self._bit_us:
            windows = [(clock.SHORT_BLOCKS, clock.THRESHOLD_SHORT)]
            if self._block % clock.SHORT_BLOCKS == 0:
                windows.append((clock.LONG_BLOCKS, clock.THRESHOLD_LONG))
            for blocks, threshold in windows:
                found = self._lock(end_us, blocks, threshold)
                if found is not None:
                    self._t, self._on = self._t[:0], self._on[:0]
                    return found
            if self._block % clock.SHORT_BLOCKS == 0 and end_us - since_us >= clock.SHORT_BLOCKS * self._block_us:
                self.failed += 1
        keep_us = end_us - (clock.LONG_BLOCKS - 1) * self._block_us
        self._drop(max(int(np.searchsorted(self._t, keep_us)), stop - WINDOW_EVENTS))
        return None

    def _take_block(self, begin_us: float, end_us: float) -> int:
        """Sum the next block, its edges and its events; return how many held events it ends behind."""
        start, stop = (int(i) for i in np.searchsorted(self._t, (begin_us, end_us)))
        t: clock.Floats = np.asarray((self._t[start:stop] - begin_us) / self._bit_us, np.float64)
        on = self._on[start:stop]
        for kept in (self._sums, self._edge_t, self._edge_on, self._edge_n):
            kept[:, :-1] = kept[:, 1:]
        self._edge_n[LEVEL, -1] = level.edges(t, self._edge_t[LEVEL, -1], self._edge_on[LEVEL, -1])
        self._edge_n[TURNS, -1] = polarity.turns(t, on, self._edge_t[TURNS, -1], self._edge_on[TURNS, -1])
        for sign, n in enumerate(self._edge_n[:, -1]):
            clock.block(self._edge_t[sign, -1, :n], self._edge_on[sign, -1, :n], self._sums[sign, -1])
        clock.block(t, on, self._sums[EVENTS, -1])
        if stop == start:
            self._dark += 1
        else:
            if self._dark >= clock.SHORT_BLOCKS:
                # What comes out of the dark is young.
                self._since_us = int(self._t[start])
            self._dark = 0
        return stop

    def _lock(self, end_us: float, blocks: int, threshold: float) -> Clock | None:
        """Return the clock of the window of so many blocks, if it shows one."""
        peaks = [clock.peak(sums[-blocks:]) for sums in self._sums]
        if max(z for _, z in peaks) < threshold:
            return None
        begin_us = end_us - blocks * self._block_us
        origin_us = int(np.floor(begin_us))
        start, stop = (int(i) for i in np.searchsorted(self._t, (begin_us, end_us)))
        t: clock.Floats = np.asarray((self._t[start:stop] - origin_us) / self._bit_us, np.float64)
        on, until = self._on[start:stop], (end_us - origin_us) / self._bit_us
        found, folded = np.zeros(4), np.zeros((2, clock.SUB))
        for sign, (f, z) in enumerate(peaks):
            if z < threshold:
                continue
            if sign == EVENTS:
                clock.grid(t, on, f, until, found, folded)
                return self._clock(origin_us, found, folded, start)
            edge_t, edge_on = self._edges(sign, (begin_us - origin_us) / self._bit_us, blocks)
            clock.grid(edge_t, edge_on, f, until, found, folded)
            if sign == LEVEL:
                # The edges of a level are no clock unless the bits between them show it.
                pairs, seen = np.zeros((4, 2, clock.SUB)), np.zeros(4, np.int64)
                if not level.start(t, on, until, found, pairs, seen):
                    continue
                packet_response.from_pairs(pairs, self._model)
            else:
                polarity.start(t, on, until, found, edge_t, edge_on, self._model, self._seen)
            return self._clock(origin_us, found, None, start)
        return None

    def _clock(self, origin_us: int, found: clock.Floats, folded: clock.Floats | None, start: int) -> Clock:
        """Return a clock with the held events from `start` on; its grid begins before the first of them."""
        found[0] -= min(found[0] // found[1], LEAD_BITS) * found[1]
        return Clock(origin_us, found, folded, self._t[start:], self._on[start:])

    def _edges(self, sign: int, first: float, blocks: int) -> tuple[clock.Floats, Flags]:
        """Return the edges of a sign in the newest blocks, which begin `first` bits from the origin."""
        rows = range(clock.LONG_BLOCKS - blocks, clock.LONG_BLOCKS)
        n = self._edge_n[sign]
        t = [self._edge_t[sign, row, : n[row]] + first + i * clock.BLOCK_BITS for i, row in enumerate(rows)]
        return np.concatenate(t), np.concatenate([self._edge_on[sign, row, : n[row]] for row in rows])
