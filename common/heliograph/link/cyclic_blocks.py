"""What the default receiver of cyclic codes keeps of the light while it waits for a clock, block by block.

Events are held as far back as a window reaches. Three signs of the clock are summed over blocks of 16 bits
(`heliograph.link.clock`): the events, the edges of the level of a lit LED that moves (`heliograph.link.level`), and the
turns of scanned light (`heliograph.link.cyclic_scans`).
"""

from __future__ import annotations

import numpy as np

from heliograph.events import Flags, Times
from heliograph.link import clock, level
from heliograph.link.cyclic_scans import ScanSearch, peaks

# (n, 2) the rates f that the events, the level and the turns may show and the z of each, the highest first.
Peaks = tuple[clock.Floats, clock.Floats, clock.Floats]
_NONE: clock.Floats = np.array([[1.0, 0.0]])


class ClockBlocks:
    """The newest LONG_BLOCKS blocks of one track.

    Args:
        bit_us: nominal length of a bit.
        frame_bits: of the code.
    """

    def __init__(self, bit_us: float, frame_bits: int) -> None:
        self.scans = ScanSearch(bit_us, frame_bits)
        self.held_t: Times = np.empty(0, np.int64)
        self.held_on: Flags = np.empty(0, np.bool_)
        self.since_us: int | None = None  # the first event; later, where the last lock was lost
        self.block = 0  # number of the next block on the absolute grid
        self.part = 0  # parts of it that have been looked at
        self.dark = 0  # blocks before it without events
        self._bit_us = bit_us
        self._events = np.zeros((clock.LONG_BLOCKS, clock.SUMS))
        self._level = np.zeros_like(self._events)
        self._level_t = np.zeros((clock.LONG_BLOCKS, 4 * clock.BLOCK_BITS))
        self._level_on = np.zeros((clock.LONG_BLOCKS, 4 * clock.BLOCK_BITS), np.bool_)
        self._level_n = [0] * clock.LONG_BLOCKS

    def hold(self, t_us: Times, on: Flags) -> None:
        """Keep events."""
        self.held_t = np.concatenate([self.held_t, t_us])
        self.held_on = np.concatenate([self.held_on, on])

    def drop(self, events: int) -> None:
        """Forget the oldest of the events."""
        self.held_t, self.held_on = self.held_t[events:], self.held_on[events:]

    def clear(self) -> None:
        """Forget the blocks that were summed."""
        self.dark = 0
        self.part = 0
        self._events[:] = 0.0
        self._level[:] = 0.0
        self._level_n = [0] * clock.LONG_BLOCKS
        self.scans.clear()

    def next(self) -> tuple[int, int, float]:
        """Sum the next whole block; return its first event held, the one behind its last, and its end."""
        block_us = clock.BLOCK_BITS * self._bit_us
        begin_us, end_us = self.block * block_us, (self.block + 1) * block_us
        start, stop = (int(i) for i in np.searchsorted(self.held_t, (begin_us, end_us)))
        self.block += 1
        self.part = 0
        t: clock.Floats = np.asarray((self.held_t[start:stop] - begin_us) / self._bit_us, np.float64)
        self.take(t, self.held_on[start:stop])
        if stop == start:
            self.dark += 1
        else:
            if self.dark >= clock.SHORT_BLOCKS:
                # What comes out of the dark is young.
                self.since_us = int(self.held_t[start])
            self.dark = 0
        young = end_us - (self.since_us or 0) <= clock.LONG_BLOCKS * block_us
        if young or self.block % clock.SHORT_BLOCKS == 0:
            self.look(self.held_t[:stop], self.held_on[:stop], self.block)
        return start, stop, end_us

    def take(self, t: clock.Floats, on: Flags) -> None:
        """Sum the next block, its events (times in bits from its beginning) and the edges of their level."""
        for kept in (self._events, self._level, self._level_t, self._level_on):
            kept[:-1] = kept[1:]
        clock.block(t, on, self._events[-1])
        n = level.edges(t, self._level_t[-1], self._level_on[-1])
        self._level_n = [*self._level_n[1:], n]
        clock.block(self._level_t[-1, :n], self._level_on[-1, :n], self._level[-1])
        self.scans.take(t, on)

    def look(self, held_t: Times, held_on: Flags, end_block: int, *, rare: bool = False) -> None:
        """See whether the events held are scans; if they are, sum the turns of the blocks before end_block.

        Args:
            held_t: of events.
            held_on: their polarities.
            end_block: behind the newest of them.
            rare: look at a long window, in which two scans in a row may be rare (`heliograph.link.scans`).
        """
        if self.scans.known:
            return
        block_us = clock.BLOCK_BITS * self._bit_us
        blocks = clock.LONG_BLOCKS if rare else clock.SHORT_BLOCKS
        newest = int(np.searchsorted(held_t, (end_block - blocks) * block_us))
        if not self.scans.look(held_t[newest:], rare=rare):
            return
        for block in range(end_block - clock.LONG_BLOCKS, end_block):
            begin_us = block * block_us
            start, stop = (int(i) for i in np.searchsorted(held_t, (begin_us, begin_us + block_us)))
            t: clock.Floats = np.asarray((held_t[start:stop] - begin_us) / self._bit_us, np.float64)
            self.scans.take(t, held_on[start:stop])

    def peaks(self, blocks: int, seen: float, threshold: float) -> Peaks:
        """Return what a window of the newest blocks shows, of which so many show the light."""
        scans, enough = self.scans, self.scans.enough(seen)
        turns = scans.peaks(blocks, threshold) if enough else scans.early(blocks, seen, threshold)
        events = peaks(self._events[-blocks:], threshold)
        return events, np.array([clock.peak(self._level[-blocks:])]), turns

    def tried(self, blocks: int, more: tuple[clock.Floats, Flags] | None, threshold: float) -> Peaks:
        """Return what a window shows that ends with the newest block or, where given, with events after it.

        What it shows will be believed only if the code repeats: so the level, which may be imagined, is left out.
        """
        events = self._events[-blocks:]
        if more is not None:
            newest = np.zeros_like(self._events[:1])
            clock.block(*more, newest[0])
            events = np.concatenate([self._events[clock.LONG_BLOCKS - blocks + 1 :], newest])
        return peaks(events, threshold), _NONE, self.scans.peaks(blocks, threshold)

    def level_edges(self, begin_us: float, blocks: int) -> tuple[clock.Floats, Flags]:
        """Return the level's edges in the newest blocks, which begin at begin_us from the origin; in bits from it."""
        first = begin_us / self._bit_us
        rows = range(clock.LONG_BLOCKS - blocks, clock.LONG_BLOCKS)
        t = [self._level_t[row, : self._level_n[row]] + first + i * clock.BLOCK_BITS for i, row in enumerate(rows)]
        return np.concatenate(t), np.concatenate([self._level_on[row, : self._level_n[row]] for row in rows])
