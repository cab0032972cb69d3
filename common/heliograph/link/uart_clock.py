"""Text of beacons whose clock is off: the bit rate is measured before framing is looked for.

The cold start (`heliograph.link.uart_lock`) explains sixteen characters with bits of a given length, and half a per
cent too long is .06 bit at a character's end. So the light's own bit rate is looked for in each window of WINDOW_BLOCKS
blocks of 16 bits since it came (`heliograph.link.clock`, +-5 %) in which nothing is read; the first ends just before
the first cold start. Where it shows, and lies more than OFF from the rate that is tried, a receiver of text of the
measured rate takes over, with the window's events. The nominal one does all that a beacon of a good clock needs: for it
nothing changes. Behind scans of rate s, times are as coherent at s - f as at f: where s is nearly 2, the rate that is
nearer to the nominal one is tried first, its image in a later window.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from heliograph.events import Flags, Times
from heliograph.link import clock, scans
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict
from heliograph.link.text_receiver import NEVER_US, TextReceiver
from heliograph.units import bit_us

# 160 bits: the cold start takes 176.
WINDOW_BLOCKS: Final = 10
# Of the bit rate: what the cold start and its clock make up for; crystals keep a fiftieth of it.
OFF: Final = 0.005
# Of the characters of the newest second, so many are good where text is read.
READ_LEAST: Final = 0.5
# Events of a window at most, as in `heliograph.link.cyclic`.
WINDOW_EVENTS: Final = 1_000_000


class ClockedTextReceiver:
    """Reads one track; obeys `heliograph.link.contract.Receiver`.

    Args:
        bit_rate: nominal bits a second; the beacon's own may differ by 5 %.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, bit_rate: float) -> None:
        self._bit_rate = bit_rate
        self._bit_us = bit_us(bit_rate)
        self._f = 1.0  # bits a nominal bit of the receiver that reads
        self._text = TextReceiver(bit_rate)
        self.refusals = self._text.refusals
        self._window_us = int(WINDOW_BLOCKS * clock.BLOCK_BITS * self._bit_us)
        self._imaged = False  # whether the rate nearer to the nominal one was looked at, and its image is next
        self._begin_us: int | None = None  # of the window; None until there is light to look at
        self._lit = False  # whether the window has an event
        self._reading = False  # whether text was being read when it began
        self._t_us: Times = np.empty(0, np.int64)
        self._on: Flags = np.empty(0, np.bool_)

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take events and return what they decide; see the contract."""
        out: list[LinkFrame | Text] = []
        while True:
            if (begin_us := self._begin_us) is None:
                if not len(t_us):
                    break
                # What is known at this event, however the input is cut.
                begin_us = int(t_us[0])
                out += self._text.feed(t_us[:0], on[:0], begin_us)
                self._open(begin_us)
            end_us = begin_us + self._window_us
            stop = int(np.searchsorted(t_us, min(end_us, until_us)))
            self._hold(t_us[:stop], on[:stop])
            if until_us < end_us:
                break
            out += self._text.feed(t_us[:stop], on[:stop], end_us)
            t_us, on = t_us[stop:], on[stop:]
            if not self._reading and not self._reads(end_us):
                out += self._look(begin_us, end_us)
            self._open(end_us if self._lit else None)
        return out + self._text.feed(t_us, on, until_us)

    def due_us(self) -> int:
        """Return when something may be decided; see the contract."""
        return self._text.due_us()

    def flush(self) -> list[LinkFrame | Text]:
        """Decide what is still held, as if silence followed."""
        return self._text.flush()

    def identity(self) -> Identity | None:
        """Return the accepted identity (its payload is None: text), or None."""
        return self._text.identity()

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        return self._text.verdict(now_us)

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read."""
        quality = self._text.quality(now_us)
        if quality.clock_ppm is None:
            return quality
        return replace(quality, clock_ppm=(quality.bit_rate / self._bit_rate - 1.0) * 1e6)

    def _reads(self, now_us: int) -> bool:
        """Return whether text is followed, and not mostly what is none, as at the image of a rate."""
        if self._text.due_us() == NEVER_US:
            return False
        good = self._text.quality(now_us).mar_estimate
        return good is None or good >= READ_LEAST

    def _open(self, begin_us: int | None) -> None:
        """Begin the next window; behind one without an event, with the next event (None)."""
        self._begin_us = begin_us
        self._reading = begin_us is not None and self._reads(begin_us)
        self._lit = False
        self._t_us, self._on = self._t_us[:0], self._on[:0]

    def _hold(self, t_us: Times, on: Flags) -> None:
        """Keep the window's events, unless text is being read."""
        self._lit = self._lit or len(t_us) > 0
        if not self._reading:
            self._t_us = np.concatenate([self._t_us, t_us])[:WINDOW_EVENTS]
            self._on = np.concatenate([self._on, on])[:WINDOW_EVENTS]

    def _choice(self, f: float, scan_bits: float) -> float:
        """Return which rate is tried where f, bits a nominal bit, shows; scan_bits: 0 where the events are no scans."""
        image = 1.0 / scan_bits - f if scan_bits > 0.0 else f
        if abs(image - 1.0) <= clock.SPAN:
            near, far = sorted((f, image), key=lambda rate: abs(rate - 1.0))
            f = far if self._imaged else near
            self._imaged = not self._imaged
        return f if abs(f - 1.0) > OFF else 1.0

    def _look(self, begin_us: int, end_us: int) -> list[LinkFrame | Text]:
        """Look at a whole window; where it shows another rate than is tried, try that one from its beginning on."""
        t: clock.Floats = np.asarray((self._t_us - begin_us) / self._bit_us, np.float64)
        sums = np.zeros((WINDOW_BLOCKS, clock.SUMS))
        cuts = np.searchsorted(t, np.arange(WINDOW_BLOCKS + 1) * float(clock.BLOCK_BITS))
        for b in range(WINDOW_BLOCKS):
            own = slice(cuts[b], cuts[b + 1])
            clock.block(t[own] - b * clock.BLOCK_BITS, self._on[own], sums[b])
        f, z = clock.peak(sums)
        rate = self._choice(f, scans.quantum(scans.starts(t)))
        if z < clock.THRESHOLD_LONG or abs(rate - self._f) <= OFF:
            return []
        self._f = rate
        self._text = TextReceiver(self._bit_rate * rate)
        self._text.refusals.update(self.refusals)
        self.refusals = self._text.refusals
        return self._text.feed(self._t_us, self._on, end_us)
