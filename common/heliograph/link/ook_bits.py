"""From one track's events to a stream of bits: the clock is found, followed (`heliograph.link.ook_kernel`), lost.

The clock is looked for in windows of 256 nominal bits on an absolute grid, by the periodogram of all codes
(`heliograph.link.clock`: +-2.5 %); the window in which it is found is read from its beginning, first three times to
learn what the slots look like. Events of the two polarities are shifted towards each other by half the delay that the
window shows between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link import clock, ook_kernel
from heliograph.units import US_PER_S, bit_us

Floats = npt.NDArray[np.float64]

WINDOW_BLOCKS: Final = clock.LONG_BLOCKS
WINDOW_BITS: Final = WINDOW_BLOCKS * clock.BLOCK_BITS
# Fewer events are no light to be read: a quarter of the bits have an edge, of two events each.
EVENTS_LEAST: Final = WINDOW_BITS // 2
EVENTS_MOST: Final = 1_000_000  # of a window; more is a glare
REHEARSALS: Final = 3
# The clock of both polarities is used unless that of the rises alone stands out twice as much.
STEERS_LEAST: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Decided bits.

    Args:
        bits: (n,) uint8.
        end_us: (n,) float64, when each ended, camera time.
        fresh: the first of them does not follow the last one of the piece before: the clock was found anew.
    """

    bits: npt.NDArray[np.uint8]
    end_us: Floats
    fresh: bool


class OokBits:
    """Bits of one track's light.

    Args:
        bit_rate: nominal bits a second.
        refusals: where windows without a clock are counted.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, bit_rate: float, refusals: Refusals) -> None:
        self._bit_us = bit_us(bit_rate)
        self._refusals = refusals
        self._t: Times = np.empty(0, np.int64)
        self._on: Flags = np.empty(0, np.bool_)
        self._window = -(1 << 62)
        self._origin_us: float | None = None
        self._half = 0.0  # bits, half of ON's delay over OFF's
        self._fresh = True
        self._floats = np.zeros(ook_kernel.FLOATS)
        self._ints = np.zeros(ook_kernel.INTS, np.int64)
        self._paths = (
            np.zeros(ook_kernel.STATES),
            np.zeros((ook_kernel.RING, ook_kernel.STATES), np.int64),
            np.zeros((ook_kernel.RING, 2)),
            np.zeros(ook_kernel.RING),
        )
        contexts = ook_kernel.CONTEXTS
        self._learned = (np.zeros((contexts, 2)), np.ones((contexts, 2)), np.zeros(contexts))

    @property
    def locked(self) -> bool:
        """Whether there is a clock."""
        return self._origin_us is not None

    @property
    def period(self) -> float:
        """Length of a bit in nominal ones."""
        return float(self._floats[ook_kernel.T])

    @property
    def amplitude(self) -> float:
        """ON events of a rise."""
        return float(self._floats[ook_kernel.A + 1])

    @property
    def spread(self) -> float:
        """Mean variance of a slot's ON events, over the contexts that have been seen."""
        _, var, seen = self._learned
        return float((var[:, 1] * seen).sum() / max(float(seen.sum()), 1.0))

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[Piece]:
        """Take the events before until_us; return the bits that they decide."""
        if len(t_us):
            self._t = np.concatenate([self._t, t_us])
            self._on = np.concatenate([self._on, on])
        out: list[Piece] = []
        while True:
            if self._origin_us is None and not self._search(until_us):
                return out
            if not self._follow(until_us, out):
                return out

    def lose(self, end_us: float) -> None:
        """Give up the clock: what is held from end_us on is searched anew."""
        self._origin_us = None
        self._window = int(end_us // (WINDOW_BITS * self._bit_us)) + 1

    def _drop(self, n: int) -> None:
        self._t, self._on = self._t[n:], self._on[n:]

    def _search(self, until_us: int) -> bool:
        """Look for the clock in whole windows; return whether it was found."""
        window_us = WINDOW_BITS * self._bit_us
        while len(self._t):
            self._window = max(self._window, int(self._t[0] // window_us))
            begin_us = self._window * window_us
            self._drop(int(np.searchsorted(self._t, begin_us)))
            if not len(self._t):
                return False
            if begin_us + window_us > until_us:
                if len(self._t) > EVENTS_MOST:
                    self._drop(len(self._t))
                    self._refusals[Refusal.NO_CLOCK] += 1
                    self._window += 1
                return False
            stop = int(np.searchsorted(self._t, begin_us + window_us))
            if self._lock(begin_us, stop):
                return True
            self._window += 1
            self._drop(stop)
        return False

    def _lock(self, begin_us: float, stop: int) -> bool:
        """Begin with the clock of the window that begins at begin_us, if it has one; the held events stay."""
        if not EVENTS_LEAST <= stop <= EVENTS_MOST:
            return False
        t: Floats = np.asarray((self._t[:stop] - begin_us) / self._bit_us, np.float64)
        on = self._on[:stop]
        f, z = _clock(t, on)
        f_lit, z_lit = _clock(t[on], on[on]) if on.any() else (1.0, 0.0)
        # Falls that trail for many bits hide the clock of the rises.
        steers = z >= STEERS_LEAST * z_lit
        if max(z, z_lit) < clock.THRESHOLD_LONG:
            self._refusals[Refusal.NO_CLOCK] += 1
            return False
        found, folded = np.zeros(4), np.zeros((2, clock.SUB))
        if steers:
            clock.grid(t, on, f, float(WINDOW_BITS), found, folded)
        else:
            clock.grid(t[on], on[on], f_lit, float(WINDOW_BITS), found, folded)
        self._origin_us, self._half = begin_us, float(found[2])
        # Of the larger slots, as most have no edge or but a rest of one.
        slot = np.maximum(np.floor((t - found[0]) / found[1] + 0.5).astype(np.int64), 0)
        off, lit = (_larger(np.bincount(slot[on == level])) for level in (False, True))
        eff, by, _ = self._shifted(stop)
        start = float(found[0]), float(found[1]), off, lit
        # Whether falls trail is not seen from outside: the guess under which the window is likelier is kept.
        costs = [self._rehearse(eff, by, start, steers=steers, trails=trails) for trails in (False, True)]
        if costs[0] <= costs[1]:
            self._rehearse(eff, by, start, steers=steers, trails=False)
        self._start(*start, steers=steers)
        self._fresh = True
        return True

    def _rehearse(
        self, t: Floats, on: Flags, start: tuple[float, float, float, float], *, steers: bool, trails: bool
    ) -> float:
        """Learn the contexts from a window; return what its cheapest path costs in the end."""
        ook_kernel.guess(start[2], start[3], trails, *self._learned)
        for _ in range(REHEARSALS):
            self._start(*start, steers=steers)
            self._advance(t, on, WINDOW_BITS - 1.0)
        return float(self._floats[ook_kernel.COST])

    def _start(self, boundary: float, period: float, off: float, lit: float, *, steers: bool) -> None:
        """Set the state to the beginning of a window; what has been learned stays."""
        self._floats[:] = 0.0
        self._floats[ook_kernel.B] = boundary
        self._floats[ook_kernel.T] = period
        self._floats[ook_kernel.A] = off
        self._floats[ook_kernel.A + 1] = lit
        self._ints[:] = 0
        self._ints[ook_kernel.OFF_STEERS] = steers
        for table in self._paths:
            table[:] = 0

    def _shifted(self, stop: int) -> tuple[Floats, Flags, npt.NDArray[np.int64]]:
        """Return the first held events in nominal bits from the origin, their polarities, and their order as held."""
        origin_us = self._origin_us or 0.0
        on = self._on[:stop]
        t = (self._t[:stop] - origin_us) / self._bit_us - np.where(on, self._half, -self._half)
        order = np.argsort(t, kind="stable")
        return np.asarray(t[order], np.float64), on[order], order

    def _advance(self, t: Floats, on: Flags, until: float) -> tuple[int, int, Piece]:
        room = max(int((until - self._floats[ook_kernel.B]) / min(self._floats[ook_kernel.T], 1.0) * 1.1) + 8, 8)
        bits, ends = np.empty(room, np.uint8), np.empty(room)
        outcome, taken, n = ook_kernel.advance(
            t, on, until, self._floats, self._ints, self._paths, self._learned, bits, ends
        )
        end_us = (self._origin_us or 0.0) + ends[:n] * self._bit_us
        return outcome, taken, Piece(bits[:n], end_us, self._fresh)

    def _follow(self, until_us: int, out: list[Piece]) -> bool:
        """Decide bits; return whether the clock was lost and what is left is to be searched."""
        until = (until_us - (self._origin_us or 0.0)) / self._bit_us - abs(self._half)
        if until < self._floats[ook_kernel.B] + 0.5 * self._floats[ook_kernel.T]:
            return False
        t, on, order = self._shifted(len(self._t))
        outcome, taken, piece = self._advance(t, on, until)
        if len(piece.bits):
            out.append(piece)
            self._fresh = False
        kept = np.sort(order[taken:])
        self._t, self._on = self._t[kept], self._on[kept]
        if outcome == ook_kernel.DONE:
            return False
        self.lose((self._origin_us or 0.0) + float(self._floats[ook_kernel.B]) * self._bit_us)
        return True

    def quality(self) -> tuple[float, float]:
        """Return the measured bit rate and the clock's offset in ppm."""
        return US_PER_S / (self._bit_us * self.period), (1.0 / self.period - 1.0) * 1e6


def _clock(t: Floats, on: Flags) -> tuple[float, float]:
    """Return bits a nominal bit and z of the periodogram over a window."""
    sums = np.zeros((WINDOW_BLOCKS, clock.SUMS))
    cuts = np.searchsorted(t, np.arange(WINDOW_BLOCKS + 1) * float(clock.BLOCK_BITS))
    for b in range(WINDOW_BLOCKS):
        own = slice(cuts[b], cuts[b + 1])
        clock.block(t[own] - b * clock.BLOCK_BITS, on[own], sums[b])
    f, z = clock.peak(sums)
    return float(f), float(z)


def _larger(counts: npt.NDArray[np.int64]) -> float:
    """Return the mean of the counts, each weighted by itself; at least 1."""
    total = float(counts.sum())
    return max(float((counts.astype(np.float64) ** 2).sum()) / total, 1.0) if total else 1.0
