"""The receiver of `frequency` (`heliograph.link.modulations.frequency`): is this the light that blinks at f?

Time is cut into windows of W = max(64 half periods, 50 ms) on an absolute grid. With the window's events at t_i and
s_i = +1 (ON) or -1 (OFF), a beacon's rises and falls add up in the line of f::

    R(h, v) = sum_i s_i exp(-2 pi j h v t_i)        |v - f| <= tolerance f + 2 / W;   v^ = argmax |R(1, v)|

A window is a frame of the beacon if all of these hold:

1. the line stands out of noise:  z = |R(1, v^)|^2 / N >= 25       noise alone: exp(-z) a line
2. it is f:                       |v^ - f| <= tolerance f
3. it is no harmonic of a slower or image of a faster light:  |R(1, v^)| >= .7 |R(h, v^)|, h = 2 ... 7. The edges of a
   beacon have as much in their odd harmonics, at most; those of a light at 3 f cancel in R(1) (their small rest, from
   unlike rises and falls, would else pass 1 and 4: the middle one of three edges decides a slot)
4. every half period has its edge: laid about the line's phase, slot k holds more ON than OFF events if k is even, more
   OFF than ON if odd, in 95 % of the slots, of which there are 63 or more.

Chance. Signs of noise, and edges of random bits at just this clock, are right in half of the slots at most: at least 60
of 63 are with sum_{i<=3} binomial(63, i) / 2^63 = 4.5e-15. The phase and v^ are chosen from at most 4 x 8 x (tolerance
f W + 2) = 128 that differ at 8 kHz: 6e-13 a window, below 1e-10 a bit position; an identity takes two windows.
Codes at the bit rate 2 f fall to rule 4: no frame of ours has an edge in 95 % of its bits.

A lamp that is switched at f (pulse width modulation) is this beacon, by the nature of the protocol: the 2 % about the
mains' harmonics and the site's list are all that stands against it. Frequencies above 1 kHz meet dimmers of LEDs.
"""

from __future__ import annotations

from collections import Counter, deque
from math import ceil, log, log10, pi, sqrt
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link.acceptance import Acceptance, Place
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict
from heliograph.link.inlet import Inlet
from heliograph.link.modulations.frequency import window_us
from heliograph.link.pulse_words import probability
from heliograph.units import US_PER_S

NEEDED: Final = 2
LINE_LEAST: Final = 25.0
HARMONICS: Final = range(2, 8)
HARMONIC_SHARE: Final = 0.7
RIGHT_LEAST: Final = 0.95
SLOTS_LEAST: Final = 63
# A slot that is right is so with this chance where the beacon is there: what rule 4 lets pass, and a little better.
RIGHT_CHANCE: Final = 0.97
# Parts of a window that are summed at f; at the end of the search's span the phase within one is off by .06 turns.
PARTS: Final = 32
# Lines looked at, per 1 / W: a quarter of a line's width.
STEPS: Final = 4
# Events of a window that are looked at: 200 pixels at 10 kHz make 200,000 in 50 ms. More is a glare.
EVENTS_MOST: Final = 400_000

Floats = npt.NDArray[np.float64]


class BlinkReceiver:
    """Listens to one track for one frequency; obeys `heliograph.link.contract.Receiver`.

    Args:
        frequency_hz: the beacon's.
        tolerance: of its clock, as a share.
    """

    def __init__(self, frequency_hz: int, tolerance: float) -> None:
        self.refusals: Refusals = Counter()
        self._f_hz = frequency_hz
        self._tolerance = tolerance
        self._window_us = window_us(frequency_hz)
        self._acceptance = Acceptance(NEEDED, 1, US_PER_S / self._window_us)
        self._inlet = Inlet(self.refusals)
        self._window: int | None = None
        self._kept: list[tuple[Times, Flags]] = []
        self._n = 0
        self._recent: deque[tuple[int, bool]] = deque(maxlen=64)
        self._line: _Line | None = None  # of the newest frame

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take events and return what they decide; see the contract."""
        t_us, on = self._inlet.take(t_us, on, until_us)
        out: list[LinkFrame | Text] = []
        while len(t_us):
            window = int(t_us[0]) // self._window_us
            if self._window is not None and window != self._window:
                self._decide(out)
            self._window = window
            stop = int(np.searchsorted(t_us, (window + 1) * self._window_us))
            take = min(stop, EVENTS_MOST - self._n)
            if take > 0:
                self._kept.append((t_us[:take], on[:take]))
                self._n += take
            t_us, on = t_us[stop:], on[stop:]
        if self._window is not None and until_us >= (self._window + 1) * self._window_us:
            self._decide(out)
        return out

    def flush(self) -> list[LinkFrame | Text]:
        """Return nothing: what does not fill a window is no frame."""
        return []

    def identity(self) -> Identity | None:
        """Return the accepted identity, or None."""
        return self._acceptance.identity()

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        return self._acceptance.verdict(now_us)

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read; a frame is a window."""
        newest = [ok for end_us, ok in self._recent if now_us - US_PER_S < end_us <= now_us]
        mar = sum(newest) / len(newest) if newest else None
        line = self._line
        if line is None:
            return LinkQuality(2.0 * self._f_hz, None, None, None, None, mar)
        coherence = min(max(line.coherence, 1e-3), 1.0)
        return LinkQuality(
            bit_rate=2.0 * line.f_hz,
            snr_db=10.0 * log10(line.z),
            jitter_us=sqrt(-2.0 * log(coherence)) / (2.0 * pi * line.f_hz) * US_PER_S,
            clock_ppm=(line.f_hz / self._f_hz - 1.0) * 1e6,
            events_per_transition=line.events / (2.0 * line.f_hz * self._window_us / US_PER_S),
            mar_estimate=mar,
        )

    def _decide(self, out: list[LinkFrame | Text]) -> None:
        """Decide the window that is held, and let its events go."""
        window = self._window or 0
        t_us = np.concatenate([kept[0] for kept in self._kept])
        on = np.concatenate([kept[1] for kept in self._kept])
        self._window, self._kept, self._n = None, [], 0
        self._acceptance.heard(int(t_us[-1]))
        end_us = (window + 1) * self._window_us
        line = _Line(t_us - window * self._window_us, on, self._f_hz, self._tolerance, self._window_us)
        reason = line.refusal()
        self._recent.append((end_us, reason is None))
        if reason is not None:
            self.refusals[reason] += 1
            self._acceptance.refuse()
            return
        self._line = line
        margin = line.right * log(2.0 * RIGHT_CHANCE) + (line.slots - line.right) * log(2.0 * (1.0 - RIGHT_CHANCE))
        frame = LinkFrame(end_us, self._f_hz, probability(margin), margin)
        self._acceptance.frame(frame, Place(0, window))
        out.append(frame)


class _Line:
    """What a window shows at the frequency: see the module.

    Args:
        t_us: (n,) int64 from the window's beginning, n > 0.
        on: (n,) bool.
        f_hz: the nominal frequency.
        tolerance: of it.
        length_us: of the window.
    """

    def __init__(self, t_us: Times, on: Flags, f_hz: float, tolerance: float, length_us: int) -> None:
        self.events = len(t_us)
        self._nominal_hz, self._tolerance = f_hz, tolerance
        self._t_s: Floats = np.asarray(t_us * (1.0 / US_PER_S), np.float64)
        self._sign: Floats = np.where(on, 1.0, -1.0)
        self._length_s = length_us / US_PER_S
        self.f_hz, line = self._strongest()
        self._line = line
        self.z = abs(line) ** 2 / self.events
        self.coherence = abs(line) / self.events
        self.right, self.slots = 0, 0

    def refusal(self) -> Refusal | None:
        """Return why the window is no frame of the beacon, or None; the cheap rules come first."""
        if self.z < LINE_LEAST or abs(self.f_hz - self._nominal_hz) > self._tolerance * self._nominal_hz:
            return Refusal.NO_CLOCK
        self.right, self.slots = self._slots()
        if self.slots < SLOTS_LEAST or self.right < RIGHT_LEAST * self.slots:
            return Refusal.WEAK
        harmonics = (abs(self._at(h * self.f_hz)) for h in HARMONICS)
        return Refusal.PERIODIC if abs(self._line) < HARMONIC_SHARE * max(harmonics) else None

    def _at(self, f_hz: float) -> complex:
        return complex((self._sign * np.exp(-2j * pi * f_hz * self._t_s)).sum())

    def _strongest(self) -> tuple[float, complex]:
        """Return the frequency of the strongest line near the nominal one, and R there."""
        centres = (np.arange(PARTS) + 0.5) * (self._length_s / PARTS)
        part = np.minimum((self._t_s * (PARTS / self._length_s)).astype(np.int64), PARTS - 1)
        turned = self._sign * np.exp(-2j * pi * self._nominal_hz * (self._t_s - centres[part]))
        sums = np.bincount(part, turned.real, PARTS) + 1j * np.bincount(part, turned.imag, PARTS)
        span_hz = self._tolerance * self._nominal_hz + 2.0 / self._length_s
        steps = ceil(span_hz * self._length_s * STEPS)
        tried: Floats = self._nominal_hz + span_hz * np.arange(-steps, steps + 1) / steps
        power = np.asarray(np.abs(np.exp(-2j * pi * tried[:, None] * centres) @ sums), np.float64)
        best = int(np.argmax(power))
        f_hz = float(tried[best])
        if 0 < best < len(tried) - 1:
            bend = float(power[best - 1] - 2.0 * power[best] + power[best + 1])
            if bend < 0.0:
                f_hz += 0.5 * float(power[best - 1] - power[best + 1]) / bend * span_hz / steps
        return f_hz, self._at(f_hz)

    def _slots(self) -> tuple[int, int]:
        """Return how many half periods have their edge, and how many lie in the window whole."""
        phase = -np.angle(self._line) / (2.0 * pi)  # of the rises, in periods
        at: Floats = 2.0 * (self._t_s * self.f_hz - phase)
        first, last = ceil(-2.0 * phase + 0.5), int(2.0 * (self._length_s * self.f_hz - phase) - 0.5)
        slot = np.floor(at + 0.5).astype(np.int64)
        inside = (slot >= first) & (slot <= last)
        n = last - first + 1
        if n <= 0:
            return 0, 0
        balance = np.bincount(slot[inside] - first, self._sign[inside], n)
        expected = np.where((np.arange(first, last + 1) & 1) == 0, 1.0, -1.0)
        return int((balance * expected > 0.0).sum()), n
