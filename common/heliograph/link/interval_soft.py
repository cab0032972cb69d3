"""Which character five gaps say, and how sure that is: likelihood over all characters, and over none of them.

With x_j the gaps in units of the beacon's clock less the guard, S_cj the symbols of character c (S_c0 the start's, 8),
s the spread of the gaps, a share w of gaps that are spread three times as far (the first events of a rise tell it, and
noise may be among them), and a share e that say nothing (a rise lost or made up)::

    p(y) = (1 - w - e) N(y; s) + w N(y; 3 s) + e / 8
    L(c) = sum_j ln p(x_j - S_cj - d(S_cj) + d(S_c,j-1))        "it is c"
    L(0) = ln 128 + ln(mean of exp L over all 8^5 words) + ln(q / (1 - q))     "it is none", of any symbols
    margin = L(best) - ln(exp L(0) + sum_{c != best} exp L(c))

d(n) is how much later a rise is told after a gap of G + n units: a pixel that was dark for a short time has not come to
rest. d, s and q are learned from the track's own words, d by a mean's step of 1/32 at each end of a gap, q as the mean
of exp(L(0)) / (exp L(0) + sum exp L(c)) over the last 64 words, with half a word more that was none.

An exact word is 256 times likelier where somebody sends characters; where q says that nobody does, that is not enough.
`SURE` = ln 1000 is needed: what is told is wrong once in a thousand at the most, by this model. A gap that lies nearest
to another symbol by a hair is corrected where gaps are spread so far; one that lies in another's place is not.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import exp, log, pi, sqrt
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.link.checked_characters import CHARACTERS
from heliograph.link.modulations.event_interval import SYMBOLS, WORD_SYMBOLS, symbols_of

# Of a unit, where a gap has to be a symbol's own; half of one would take every gap for one of the alphabet.
TOLERANCE: Final = 0.45
SURE: Final = log(1000.0)
# Of gaps, and how much wider they are spread: with none a gap 5 s off, still the nearest, would cost its word.
WIDE: Final = 0.05
WIDER: Final = 3.0
# Of gaps: a light of which more rises are lost or made up has no words to be read.
STRAY: Final = 1e-3
# What jitter, a scan grid and the clock leave at best; and before anything is known: a fifth of what TOLERANCE lets in.
SPREAD_LEAST: Final = 0.03
SPREAD_START: Final = 0.1
SPREAD_MEMORY: Final = 64  # gaps
# Of a deviation to each of the two delays behind it; a gap of each length comes once in a word or two.
DELAY_GAIN: Final = 1.0 / 32.0
WORDS: Final = 64

Floats = npt.NDArray[np.float64]

# (128, 6): the start, and the symbols.
_SYMBOLS_OF: Final = np.array([(SYMBOLS, *symbols_of(code)) for code in range(CHARACTERS)], np.int64)
_NOW: Final = _SYMBOLS_OF[:, 1:]
_BEFORE: Final = _SYMBOLS_OF[:, :-1]
_PLACES: Final = np.arange(WORD_SYMBOLS)
_GRID: Final = np.arange(SYMBOLS, dtype=np.float64)


def _mean(each: Floats) -> float:
    """Return the mean of the products over all words, of the (5, 9, 8) likelihoods of gaps after and as symbols."""
    some: Floats = each[0, SYMBOLS]
    for gap in each[1:]:
        some = some @ gap[:SYMBOLS]
    return float(some.sum()) / float(SYMBOLS) ** WORD_SYMBOLS


@dataclass(frozen=True, slots=True)
class Choice:
    """What a word most likely is.

    Args:
        code: the character.
        margin: nats to all else, see the module.
        none: "none of them" is likelier than the character.
        exact: every gap lies within `TOLERANCE` of the character's own symbol.
    """

    code: int
    margin: float
    none: bool
    exact: bool


class IntervalLikelihood:
    """Decides the words of one track; learns their spread, their delays, and how many are none."""

    def __init__(self) -> None:
        self._gaps = 1
        self._spread2 = SPREAD_START**2
        self._late = np.zeros(SYMBOLS + 1)
        self._none: deque[float] = deque(maxlen=WORDS)

    @property
    def spread(self) -> float:
        """Standard deviation of a gap, in units."""
        return sqrt(max(self._spread2, SPREAD_LEAST**2))

    def take(self, gaps: list[float]) -> Choice:
        """Return what five gaps say, and learn from them.

        Args:
            gaps: in units of the clock, less the guard.
        """
        s = self.spread
        # (5, 9, 8): each gap, after each symbol, as each symbol.
        off = (np.array(gaps)[:, None] - _GRID - self._late[:SYMBOLS])[:, None, :] + self._late[:, None]
        z2 = -0.5 * (off / s) ** 2
        core = (1.0 - WIDE - STRAY) * np.exp(z2) + WIDE / WIDER * np.exp(z2 / WIDER**2)
        each: Floats = np.log(core / (s * sqrt(2.0 * pi)) + STRAY / SYMBOLS)
        total: Floats = each[_PLACES, _BEFORE, _NOW].sum(axis=1)
        best = int(np.argmax(total))
        q = (sum(self._none) + 0.5) / (len(self._none) + 1.0)
        none = log(CHARACTERS) + log(_mean(np.exp(each))) + log(q / (1.0 - q))
        top = max(float(total[best]), none)
        some, nothing = float(np.exp(total - top).sum()), exp(none - top)
        others = some - exp(float(total[best]) - top) + nothing
        margin = float(total[best]) - top - log(max(others, 1e-300))
        mine = off[_PLACES, _BEFORE[best], _NOW[best]]
        self._none.append(nothing / (some + nothing))
        # Likelier this character than none, sure or not: the sure ones alone would flatter.
        if none <= total[best]:
            self._learn(best, mine)
        return Choice(best, margin, bool(none > total[best]), bool((np.abs(mine) <= TOLERANCE).all()))

    def _learn(self, code: int, off: Floats) -> None:
        for before, now, more in zip(_BEFORE[code].tolist(), _NOW[code].tolist(), off.tolist(), strict=True):
            self._gaps = min(self._gaps + 1, SPREAD_MEMORY)
            # A stray gap is no measure.
            error = min(max(more, -1.0), 1.0)
            self._spread2 += (error * error - self._spread2) / self._gaps
            self._late[now] += DELAY_GAIN * error
            self._late[before] -= DELAY_GAIN * error
