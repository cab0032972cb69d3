"""The receiver of `pulse_interval` (`heliograph.link.modulations.pulse_interval`): rises in, words out.

A gap d between two rises (`heliograph.link.rises`) means n = 2, 3 or 4 units p if |d - n p| <= tolerance n p. A word is
a start and exactly its data bits: it counts once the gap after it is a start too, or longer words would be read for
their first bits. What breaks it is counted, and the next start begins anew.

Margin. The deviations e = d / p - n of the gaps have a standard deviation s, learned (at least .02). A gap read as its
nearest neighbour n +- 1 would be off by 1 - |e|::

    margin = min over the word's gaps of ((1 - |e|)^2 - e^2) / (2 s^2) = (1 - 2 |e|) / (2 s^2), at most ln(1e6)

The spread knows nothing of rises that are missed or made up: no word is surer than one in a million.

Identity: three equal words, no other between, within five word lengths. Chance that random bits of period p give one:
a rise begins a gap of n units with a chance of (n - 1) / 2^n, so of 2, 3 and 4 with 1/4, 1/4 and 3/16. Three words of b
bits, the last two equal to the first, at any of six pairs of places::

    3/16 (1/4 + 1/4)^b * (3/16 (1/4)^b)^2 * 6 = 3.6e-14 with b = 8, a rise; less with more bits, and with the last start
"""

from __future__ import annotations

from collections import Counter, deque
from math import exp, log, log10
from typing import Final

import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link.acceptance import Acceptance, Place
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict
from heliograph.link.inlet import Inlet
from heliograph.link.modulations.pulse_interval import GAP_0, GAP_1, GAP_START
from heliograph.link.rises import Rises
from heliograph.units import US_PER_S, bit_us

NEEDED: Final = 3
# Of p. The least gap is 2 p: by then a burst has decayed to 1 %, and noise is summed over little more than p / 3.
TAU: Final = 0.35
# Units of p without a rise after which the threshold is halved: eight of the longest gaps.
SILENCE: Final = 32
SPREAD_LEAST: Final = 0.02
MARGIN_MOST: Final = log(1e6)
# Gaps averaged for the spread and the clock: four words of 8 bits.
MEMORY: Final = 32


def probability(margin: float) -> float:
    """Return the chance that a decision with this margin (nats to the runner-up) is right."""
    return 1.0 / (1.0 + exp(-min(max(margin, 0.0), 700.0)))


class PulseReceiver:
    """Reads one track; obeys `heliograph.link.contract.Receiver`.

    Args:
        bit_rate: 1 / p, in bit/s.
        bits: data bits of a word.
        tolerance: of a gap, as a share of it.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, bit_rate: float, bits: int, tolerance: float) -> None:
        self.refusals: Refusals = Counter()
        self._p_us = bit_us(bit_rate)
        self._bits = bits
        self._tolerance = tolerance
        longest_us = (GAP_START + GAP_1 * bits) * self._p_us
        self._acceptance = Acceptance(NEEDED, 1, US_PER_S / longest_us)
        self._inlet = Inlet(self.refusals)
        self._rises = Rises(TAU * self._p_us, SILENCE * self._p_us)
        self._last_us: int | None = None
        self._word: list[int] | None = None  # the data bits since a start
        self._errors: list[float] = []  # of the word's gaps
        self._recent: deque[tuple[int, bool]] = deque(maxlen=8192)
        self._gaps = 0
        self._spread2 = 0.05**2  # before anything is learned: half of what the published tolerance lets pass
        self._clock = 1.0  # units of the beacon's clock a nominal one

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take events and return what they decide; see the contract."""
        t_us, on = self._inlet.take(t_us, on, until_us)
        out: list[LinkFrame | Text] = []
        for rise_us in self._rises.find(t_us, on):
            self._acceptance.heard(rise_us)
            if self._last_us is not None:
                self._gap(rise_us, (rise_us - self._last_us) / self._p_us, out)
            self._last_us = rise_us
        return out

    def flush(self) -> list[LinkFrame | Text]:
        """Return nothing: a word counts once the start after it has been seen."""
        return []

    def identity(self) -> Identity | None:
        """Return the accepted identity, or None."""
        return self._acceptance.identity()

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        return self._acceptance.verdict(now_us)

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read; snr_db is that of a rise: its events over one of noise."""
        newest = [ok for end_us, ok in self._recent if now_us - US_PER_S < end_us <= now_us]
        mar = sum(newest) / len(newest) if newest else None
        events = self._rises.events
        if not self._gaps or events is None:
            return LinkQuality(US_PER_S / self._p_us, None, None, None, None, mar)
        return LinkQuality(
            bit_rate=US_PER_S / (self._p_us * self._clock),
            snr_db=10.0 * log10(max(events, 1e-3)),
            # A gap has two edges.
            jitter_us=float(np.sqrt(self._spread2 / 2.0)) * self._p_us,
            clock_ppm=(1.0 / self._clock - 1.0) * 1e6,
            events_per_transition=events,
            mar_estimate=mar,
        )

    def _gap(self, end_us: int, units: float, out: list[LinkFrame | Text]) -> None:
        """Take the gap that ends at end_us."""
        n = max(round(units), 1)
        if not GAP_0 <= n <= GAP_START or abs(units - n) > self._tolerance * n:
            self._break(Refusal.OCCLUSION if n > GAP_START else Refusal.OFF_GRID, end_us)
            return
        if n == GAP_START:
            if self._word is not None and len(self._word) == self._bits:
                self._decide(self._last_us or 0, out)
            else:
                self._break(Refusal.UNKNOWN_WORD, end_us)
            self._word, self._errors = [], [units - n]
            return
        if self._word is None:
            return
        if len(self._word) == self._bits:
            self._break(Refusal.NO_START_CODE, end_us)
            return
        self._word.append(n - GAP_0)
        self._errors.append(units - n)

    def _break(self, reason: Refusal, end_us: int) -> None:
        """Give up the word that was being read, if there was one."""
        if self._word is not None:
            self.refusals[reason] += 1
            self._acceptance.refuse()
            self._recent.append((end_us, False))
        self._word = None

    def _decide(self, end_us: int, out: list[LinkFrame | Text]) -> None:
        """Decide the word that ended at end_us."""
        word = self._word or []
        payload = sum(bit << i for i, bit in enumerate(word))
        units = GAP_START + sum(bit + GAP_0 for bit in word)
        stretch = sum(self._errors) / units
        for error in self._errors:
            self._gaps = min(self._gaps + 1, MEMORY)
            self._spread2 += (error**2 - self._spread2) / (self._gaps + 1)
        self._clock += (1.0 + stretch - self._clock) / max(self._gaps // len(self._errors), 1)
        spread2 = max(self._spread2, SPREAD_LEAST**2)
        margin = min((1.0 - 2.0 * abs(error)) / (2.0 * spread2) for error in self._errors)
        margin = min(max(margin, 0.0), MARGIN_MOST)
        frame = LinkFrame(end_us, payload, probability(margin), margin)
        self._recent.append((end_us, True))
        place = Place(0, round(end_us / (units * self._p_us)))
        if self._acceptance.frame(frame, place):
            self.refusals[Refusal.PAYLOAD_CHANGED] += 1
        out.append(frame)
