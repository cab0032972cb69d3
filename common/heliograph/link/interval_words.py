"""The receiver of `event_interval` (`heliograph.link.modulations.event_interval`): rises in, characters out.

A gap d between two rises (`heliograph.link.rises`) is nearest to n units of the beacon's clock v. One with
|d / v - (G + 8)| <= `TOLERANCE` is a start; the clock is followed by the starts, the longest and of known length::

    v <- v + beta (d / (G + 8) - v)        beta 1/8; |v / u - 1| <= .02

A start begins a character, whatever came before; a gap that is none of the alphabet, or a start too early, breaks it,
which is counted. So a rise that is lost, or one too many, costs one character. What the five gaps after a start say is
decided by likelihood (`heliograph.link.interval_soft`); what is not sure is refused as `WEAK`, what is likelier no
character as `UNKNOWN_WORD`. Until the track is a text beacon (`heliograph.link.text_run`) characters count if, and only
if, each of their gaps is within `TOLERANCE` of its symbol, the check without an error: random gaps make one in 256.
"""

from __future__ import annotations

from collections import Counter
from math import log10, sqrt
from typing import Final

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict
from heliograph.link.inlet import Inlet
from heliograph.link.interval_soft import SURE, TOLERANCE, IntervalLikelihood
from heliograph.link.modulations.event_interval import SYMBOLS, WORD_BITS, WORD_SYMBOLS
from heliograph.link.rises import Rises
from heliograph.link.text_run import TextRun
from heliograph.units import US_PER_S, bit_us

CLOCK_GAIN: Final = 0.125
CLOCK_MOST: Final = 0.02
# Of the shortest gap, as in `heliograph.link.pulse_words` (.35 p, 2 p).
TAU: Final = 0.175
# Starts without a rise after which the threshold is halved: 7 ms at the fastest; a pause between texts is no glare.
SILENCE_STARTS: Final = 64


class IntervalReceiver:
    """Reads one track; obeys `heliograph.link.contract.Receiver`.

    Args:
        bit_rate: 1 / u, in bit/s.
        guard: G.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, bit_rate: float, guard: int) -> None:
        self.refusals: Refusals = Counter()
        self._u_us = bit_us(bit_rate)
        self._guard = guard
        self._start = guard + SYMBOLS
        self._unit_us = self._u_us
        self._inlet = Inlet(self.refusals)
        self._rises = Rises(TAU * guard * self._u_us, SILENCE_STARTS * self._start * self._u_us)
        longest_us = (WORD_SYMBOLS + 1) * self._start * self._u_us
        self._run = TextRun(self.refusals, longest_us, WORD_BITS)
        self._likelihood = IntervalLikelihood()
        self._last_us: int | None = None
        self._word: list[float] | None = None  # the character's gaps since its start, less the guard; None: no start
        self._starts = 0

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take events and return what they decide; see the contract."""
        t_us, on = self._inlet.take(t_us, on, until_us)
        out: list[LinkFrame | Text] = []
        for rise_us in self._rises.find(t_us, on):
            self._run.begin(rise_us)
            if self._last_us is not None:
                self._gap(rise_us - self._last_us, rise_us, out)
            self._last_us = rise_us
        return out

    def flush(self) -> list[LinkFrame | Text]:
        """Return nothing: a character ends with the rise after it."""
        return []

    def identity(self) -> Identity | None:
        """Return the accepted identity (its payload is None: text), or None."""
        return self._run.identity()

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        return self._run.verdict(now_us)

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read; snr_db is that of a rise: its events over one of noise."""
        mar = self._run.share_read(now_us)
        events = self._rises.events
        if not self._starts or events is None:
            return LinkQuality(US_PER_S / self._u_us, None, None, None, None, mar)
        return LinkQuality(
            bit_rate=US_PER_S / self._unit_us,
            snr_db=10.0 * log10(max(events, 1e-3)),
            # A gap has two edges.
            jitter_us=self._likelihood.spread / sqrt(2.0) * self._unit_us,
            clock_ppm=(self._u_us / self._unit_us - 1.0) * 1e6,
            events_per_transition=events,
            mar_estimate=mar,
        )

    def _gap(self, gap_us: int, end_us: int, out: list[LinkFrame | Text]) -> None:
        units = gap_us / self._unit_us
        n = round(units)
        if not self._guard <= n <= self._start or (n == self._start and abs(units - n) > TOLERANCE):
            self._break(Refusal.OCCLUSION if n >= self._start else Refusal.OFF_GRID, end_us)
            return
        if n == self._start:
            if self._word is not None and len(self._word) < WORD_SYMBOLS:
                self._break(Refusal.NO_START_CODE, end_us)
            self._starts += 1
            self._follow(gap_us)
            self._word = []
        elif self._word is not None and len(self._word) < WORD_SYMBOLS:
            self._word.append(units - self._guard)
            if len(self._word) == WORD_SYMBOLS:
                out += self._decide(self._word, end_us)
        else:
            self._break(Refusal.NO_START_CODE, end_us)

    def _decide(self, gaps: list[float], end_us: int) -> list[LinkFrame | Text]:
        """Decide the character of these gaps, which ended at end_us."""
        choice = self._likelihood.take(gaps)
        if choice.margin >= SURE if self._run.accepted else choice.exact:
            return self._run.character(choice.code, choice.margin, end_us)
        self._run.refuse(Refusal.UNKNOWN_WORD if choice.none else Refusal.WEAK, end_us)
        return []

    def _break(self, reason: Refusal, end_us: int) -> None:
        """Give up the character that was being read; silence after a whole one is none."""
        if self._word is not None and (len(self._word) < WORD_SYMBOLS or reason is not Refusal.OCCLUSION):
            self._run.refuse(reason, end_us)
        self._word = None

    def _follow(self, gap_us: int) -> None:
        """Let the clock follow a start."""
        unit_us = self._unit_us + CLOCK_GAIN * (gap_us / self._start - self._unit_us)
        self._unit_us = min(max(unit_us, self._u_us * (1.0 - CLOCK_MOST)), self._u_us * (1.0 + CLOCK_MOST))
