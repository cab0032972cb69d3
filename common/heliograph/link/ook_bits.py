"""From one track's events to a stream of bits: the clock is found, followed (`heliograph.link.ook_kernel`), lost.

The clock is looked for in windows of 256 nominal bits on an absolute grid, and where four of them in a row show none,
in all four together (`heliograph.link.ook_clock`: +-2.5 %); what the clock was found in is read from its beginning,
first three times to learn what the slots look like. Events of the two polarities are shifted towards each other by half
the delay that a window of sharp edges shows between them.

How far the events are smeared, whether falls trail, and how long pixels are blind is not seen from outside: of some
guesses that is kept under which the window is likeliest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import erf, sqrt
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link import clock, ook_clock, ook_kernel
from heliograph.units import US_PER_S, bit_us

Floats = npt.NDArray[np.float64]

WINDOW_BLOCKS: Final = clock.LONG_BLOCKS
WINDOW_BITS: Final = WINDOW_BLOCKS * clock.BLOCK_BITS
# Fewer events are no light to be read: a quarter of the bits have an edge, of two events each.
EVENTS_LEAST: Final = WINDOW_BITS // 2
EVENTS_MOST: Final = 1_000_000  # of a window; more is a glare
# Windows that are searched together, on a grid of their own.
TOGETHER: Final = 4
REHEARSALS: Final = 3
ROUNDS: Final = 2  # of guesses: what the events look like, how long pixels are blind
# The clock of both polarities is used unless that of the rises alone stands out twice as much.
STEERS_LEAST: Final = 0.5
# Guesses of an event's jitter, in bits, where the clock is seen in the events themselves, and where it is not (beyond
# .8 it is seen nowhere); and of a pixel's refractory time: less than a bit blinds nobody, and 8 bits are remembered.
SHARP: Final = (0.15, 0.4)
SMEARED: Final = (0.4, 0.6, 0.8)
DEADS: Final = (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.5, 6.0, 7.5)


@dataclass(frozen=True, slots=True)
class _Clock:
    """A clock that was found.

    Args:
        boundary: between two bits, in nominal bits.
        period: length of a bit in nominal ones.
        steers: OFF events steer it too.
        half: of ON's delay over OFF's, in bits.
        sharp: seen in the events themselves.
    """

    boundary: float
    period: float
    steers: bool
    half: float
    sharp: bool


@dataclass(frozen=True, slots=True)
class _Guess:
    """What the light may be like; see `ook_kernel.guess`."""

    sigma: float = SHARP[0]
    trails: bool = False
    dead: float = 0.0


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
            np.zeros((ook_kernel.RING, 2, ook_kernel.FINE)),
        )
        contexts = ook_kernel.CONTEXTS
        self._learned = (
            np.zeros((contexts, 2)),
            np.ones((contexts, 2)),
            np.zeros(contexts),
            np.zeros(ook_kernel.BLIND),
        )
        self._failed = 0  # windows without a clock whose events are still held

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
        _, var, seen, _ = self._learned
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
        self._failed = 0
        self._window = int(end_us // (WINDOW_BITS * self._bit_us)) + 1

    def _drop(self, n: int) -> None:
        self._t, self._on = self._t[n:], self._on[n:]

    def _search(self, until_us: int) -> bool:
        """Look for the clock in whole windows; return whether it was found."""
        window_us = WINDOW_BITS * self._bit_us
        while len(self._t):
            if not self._failed:
                self._window = max(self._window, int(self._t[0] // window_us))
                self._drop(int(np.searchsorted(self._t, self._window * window_us)))
                if not len(self._t):
                    return False
            begin_us = self._window * window_us
            if begin_us + window_us > until_us:
                if len(self._t) > EVENTS_MOST:
                    self._drop(len(self._t))
                    self._refusals[Refusal.NO_CLOCK] += 1
                    self._window += 1
                    self._failed = 0
                return False
            if self._lock(begin_us):
                return True
            self._window += 1
            self._failed += 1
            if self._window % TOGETHER == 0:
                if self._failed >= TOGETHER and self._lock_together(begin_us - (TOGETHER - 1) * window_us):
                    return True
                self._drop(int(np.searchsorted(self._t, begin_us + window_us)))
                self._failed = 0
        return False

    def _between(self, begin_us: float, bits: int) -> tuple[Floats, Flags]:
        """Return times, in nominal bits from begin_us, and polarities of the held events of so many bits."""
        own = slice(*np.searchsorted(self._t, [begin_us, begin_us + bits * self._bit_us]).tolist())
        return np.asarray((self._t[own] - begin_us) / self._bit_us, np.float64), self._on[own]

    def _lock(self, begin_us: float) -> bool:
        """Begin with the clock of the window that begins at begin_us, if it has one; its events stay."""
        t, on = self._between(begin_us, WINDOW_BITS)
        if not EVENTS_LEAST <= len(t) <= EVENTS_MOST:
            return False
        f, z = ook_clock.sharp(t, on, WINDOW_BLOCKS)
        f_lit, z_lit = ook_clock.sharp(t[on], on[on], WINDOW_BLOCKS) if on.any() else (1.0, 0.0)
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
        self._begin(
            begin_us, WINDOW_BITS, _Clock(float(found[0]), float(found[1]), steers, float(found[2]), sharp=True)
        )
        return True

    def _lock_together(self, begin_us: float) -> bool:
        """Begin with the clock of all the windows from begin_us on, if they have one; their events stay."""
        bits = TOGETHER * WINDOW_BITS
        t, on = self._between(begin_us, bits)
        if not TOGETHER * EVENTS_LEAST <= len(t) <= EVENTS_MOST:
            return False
        f, z, boundary = ook_clock.smeared(t, on, bits)
        if z < ook_clock.THRESHOLD:
            return False
        self._begin(begin_us, bits, _Clock(boundary, 1.0 / f, steers=True, half=0.0, sharp=False))
        return True

    def _begin(self, begin_us: float, bits: int, found: _Clock) -> None:
        """Set out from a clock, with the guess of the light that suits so many bits from begin_us on best."""
        self._drop(int(np.searchsorted(self._t, begin_us)))
        self._origin_us, self._half, self._failed = begin_us, found.half, 0
        stop = int(np.searchsorted(self._t, begin_us + bits * self._bit_us))
        t, on, _ = self._shifted(stop)
        # Of the larger slots, as most have no edge or but a rest of one.
        slot = np.maximum(np.floor((t - found.boundary) / found.period + 0.5).astype(np.int64), 0)
        light = _larger(np.bincount(slot[~on])), _larger(np.bincount(slot[on]))
        until = bits - 1.0
        costs: dict[_Guess, float] = {}

        def cost(guess: _Guess) -> float:
            if guess not in costs:
                costs[guess] = self._rehearse(t, on, until, found, light, guess)
            return costs[guess]

        sigmas = SHARP if found.sharp else SMEARED
        shapes = [*((sigma, False) for sigma in sigmas), (sigmas[0], True)]
        best = _Guess()
        for _ in range(ROUNDS):
            best = min((_Guess(sigma, trails, best.dead) for sigma, trails in shapes), key=cost)
            best = min((replace(best, dead=dead) for dead in DEADS), key=cost)
        self._rehearse(t, on, until, found, light, best)
        self._start(found, light, best)
        self._fresh = True

    def _rehearse(
        self, t: Floats, on: Flags, until: float, found: _Clock, light: tuple[float, float], guess: _Guess
    ) -> float:
        """Learn the contexts from a window; return what its cheapest path costs in the end."""
        own = _own(guess.sigma)
        ook_kernel.guess(light[0] / own, light[1] / own, guess.sigma, guess.trails, guess.dead, self._learned)
        for _ in range(REHEARSALS):
            self._start(found, light, guess)
            self._advance(t, on, until)
        return float(self._floats[ook_kernel.COST])

    def _start(self, found: _Clock, light: tuple[float, float], guess: _Guess) -> None:
        """Set the state to the beginning of a window; what has been learned stays."""
        self._floats[:] = 0.0
        self._floats[ook_kernel.B] = found.boundary
        self._floats[ook_kernel.T] = found.period
        self._floats[ook_kernel.A : ook_kernel.A + 2] = light
        self._floats[ook_kernel.SIGMA] = guess.sigma
        self._floats[ook_kernel.OWN] = _own(guess.sigma)
        self._floats[ook_kernel.PIXELS] = max(light) / _own(guess.sigma)
        self._ints[:] = 0
        self._ints[ook_kernel.OFF_STEERS] = found.steers
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


def _own(sigma: float) -> float:
    """Return the share of an edge's events that fall within half a bit of it."""
    return erf(0.5 / (sigma * sqrt(2.0)))


def _larger(counts: npt.NDArray[np.int64]) -> float:
    """Return the mean of the counts, each weighted by itself; at least 1."""
    total = float(counts.sum())
    return max(float((counts.astype(np.float64) ** 2).sum()) / total, 1.0) if total else 1.0
