"""With which clock and response a lock begins: of several guesses the one under which a window's frames fall in place.

A window may show several clocks: a word that repeats has lines beside its bit rate, and the grid of a sensor's scans
mirrors rates (`heliograph.link.clock`, `heliograph.link.cyclic_scans`). Which is the beacon's, its frames tell. So
where there is more than one, the window is demodulated under each. The trust in where the frames lie at its end (A of
`heliograph.link.alignment`) is 3.5 nats for each frame of seed11 that is read, of the newest; none counts as much as it
takes to find their place. Frames of a short window are read with a clock .2 % off too, those that follow are not: so of
scanned light it counts how likely the window's scans s are. Of the guesses that none surpasses by LEAD in trust the
likeliest begins; but the first, the nominal rate, unless the likeliest explains the scans better by more than SIGMAS of
the differences' own scatter (Vuong 1989)::

    sum_s d_s > SIGMAS sqrt(sum_s (d_s - mean d)^2)        d_s = log L_s of the likeliest - log L_s of the first

A single guess costs no such trial. A trial reads the whole window, also where an earlier lock has published its frames.

A likely clock, below the threshold, is believed only if the code repeats under it (`heliograph.link.trial`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from heliograph.events import Flags
from heliograph.link import clock, level, response, scan_state, state, trial
from heliograph.link.alignment import ALIGN, LEAD
from heliograph.link.clock import SUB, Floats
from heliograph.link.cyclic_blocks import ClockBlocks, Peaks
from heliograph.link.frames import CyclicCode

# One in 700 by chance; most clocks are within a hundredth of a per cent of the nominal.
SIGMAS: Final = 3.0
# End of the last published frame where there was none.
NEVER: Final = -1e9


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """What is held of a track from a lock's origin on; times in nominal bits from it.

    Args:
        t: (n,) event times, not falling.
        on: (n,) polarities.
        until: end of the window.
        blocks: of the window, the newest.
        begin_us: of the first of them, in microseconds from the origin, in [0, 1).
        last_end: end of the last published frame, NEVER where there is none.
        seen: blocks of it that show the light.
        read_out: length of the sensor's scans, 0 where its events come in none.
    """

    t: Floats
    on: Flags
    until: float
    blocks: int
    begin_us: float
    last_end: float
    seen: float
    read_out: float


class Guess(NamedTuple):
    """A bit grid, (4,) of `heliograph.link.clock.grid`, and the rates on it, (4, 2, SUB)."""

    found: Floats
    rate: Floats


class Beginner:
    """Begins the locks of one track.

    Args:
        code: its words.
        equal: frames that must repeat where a clock is only likely.
        at: set where a lock is begun.
        blocks: of the track.
    """

    def __init__(self, code: CyclicCode, equal: int, at: state.State, blocks: ClockBlocks) -> None:
        self._code = code
        self._equal = equal
        self._state = at
        self._blocks = blocks
        self._scans = blocks.scans
        self._found = np.zeros(4)
        self._folded = np.zeros((2, SUB))

    def begin(self, window: Window, peaks: Peaks, threshold: float, *, tried: bool) -> bool:
        """Begin with a clock found in a window, if what was found is one.

        The edges of a level are no clock unless the bits between them show it; what is tried, unless its code repeats.

        Args:
            window: that was looked at.
            peaks: what it shows.
            threshold: of z.
            tried: the clock is but likely.

        Returns:
            Whether a lock has begun.
        """
        events, levels, turns = peaks
        # A few bits behind scans give a clock that is .3 % off: it slides for a second, and reads what slides.
        if tried and not self._scans.may_try(window.blocks, window.seen, turns):
            return False
        if turns[0, 1] >= threshold and self._scanned(window, turns[:, 0].tolist(), tried=tried):
            return True
        guesses = self._guesses(window, events, levels, threshold, tried=tried)
        if not guesses:
            return False
        if not tried:
            self._start(guesses[self._surest(window, guesses)], window, window.last_end)
            return True
        for guess in guesses:
            if self._alike(window, guess.found):
                self._start(guess, window, NEVER)
                if trial.repeats(window.t, window.on, window.until, self._state, self._equal):
                    self._start(guess, window, window.last_end)
                    return True
        return False

    def _guesses(self, window: Window, events: Floats, levels: Floats, threshold: float, *, tried: bool) -> list[Guess]:
        """Return the guesses that the events, or the level of a light that moves, give."""
        at = self._state
        if levels[0, 1] >= threshold:
            edges_t, edges_on = self._blocks.level_edges(window.begin_us, window.blocks)
            clock.grid(edges_t, edges_on, levels[0, 0], window.until, self._found, self._folded)
            if level.start(window.t, window.on, window.until, self._found, at.model, at.seen):
                return [Guess(self._found.copy(), at.model.copy())]
        # Where scans are long, the turns go first, as soon as they have been seen for long enough.
        if not (tried or self._scans.enough(window.seen)):
            return []
        return [self._folded_guess(window, f) for f, z in events.tolist() if z >= threshold]

    def _folded_guess(self, window: Window, f: float) -> Guess:
        clock.grid(window.t, window.on, f, window.until, self._found, self._folded)
        rate, seen = np.zeros((4, 2, SUB)), np.zeros(4, np.int64)
        response.start(self._folded, float(self._found[3]), window.read_out, rate, seen)
        return Guess(self._found.copy(), rate)

    def _start(self, guess: Guess, window: Window, last_end: float) -> None:
        self._state.model[:] = guess.rate
        self._state.seen[:] = 0
        state.start(self._state, None, guess.found, last_end, window.read_out, self._code)

    def _alike(self, window: Window, found: Floats) -> bool:
        return trial.alike(window.t, window.on, window.until, found, self._code.bits, self._equal)

    def _surest(self, window: Window, guesses: list[Guess]) -> int:
        """Return the place of the guess whose frames are in their place most surely, the first where none are."""
        if len(guesses) == 1:
            return 0
        trusts = []
        for guess in guesses:
            self._start(guess, window, NEVER)
            trusts.append(trial.trust(window.t, window.on, window.until, self._state))
        return _likeliest(trusts, [np.zeros(1)] * len(trusts), [False] * len(trusts))

    def _scanned(self, window: Window, rates: list[float], *, tried: bool) -> bool:
        """Begin with a clock that the turns of scanned light show, as `begin` does."""
        if tried:
            return self._scanned_repeats(window, rates[: clock.PEAKS])
        if len(rates) == 1:
            return self._start_scanned(window, rates[0], window.last_end)
        trusts, fits = [], []
        on_grid = [self._scans.on_grid(f, window.blocks) for f in rates]
        for f in rates:
            if not self._start_scanned(window, f, NEVER):
                return False
            fits.append(self._scans.fit)
            trusts.append(trial.trust(window.t, window.on, window.until, self._state, self._scans.scanned))
        return self._start_scanned(window, rates[_likeliest(trusts, fits, on_grid)], window.last_end)

    def _scanned_repeats(self, window: Window, rates: list[float]) -> bool:
        # What repeats does so wherever its slots begin.
        clock.grid(window.t, window.on, rates[0], window.until, self._found, self._folded)
        if not self._alike(window, self._found):
            return False
        for f in rates:
            if not self._start_scanned(window, f, NEVER):
                return False
            if trial.repeats(window.t, window.on, window.until, self._state, self._equal, self._scans.scanned):
                return self._start_scanned(window, f, window.last_end)
        self._scans.scanned = None
        return False

    def _start_scanned(self, window: Window, f: float, last_end: float) -> bool:
        if not self._scans.begin(window.t, window.on, window.until, f, self._found):
            return False
        state.start(self._state, None, self._found, last_end, window.read_out, self._code)
        self._state.ints[state.SLOT] = -scan_state.LAG
        return True


def _likeliest(trusts: list[float], fits: list[Floats], on_grid: list[bool]) -> int:
    """Return the place of the guess that begins.

    Args:
        trusts: in each, the nominal rate first.
        fits: how likely each scan of the window is under each.
        on_grid: whether it is the rate of the scans' own grid.
    """
    trusts = [max(trust, ALIGN) for trust in trusts]
    trusted = [i for i, trust in enumerate(trusts) if trust >= max(trusts) - LEAD]
    if 0 in trusted:
        trusted = [i for i in trusted if i == 0 or not on_grid[i]]
    best = max(trusted, key=lambda i: (fits[i].sum(), -i))
    better = fits[best] - fits[0]
    if 0 in trusted and better.sum() <= SIGMAS * math.sqrt(len(better)) * float(better.std()):
        return 0
    return best
