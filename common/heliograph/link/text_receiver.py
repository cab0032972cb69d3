"""The receiver of one track of text: counts, cold start, following, and what is let out.

Every step waits for exactly the sub-bins that it reads, so how the input was cut changes nothing.
"""

from __future__ import annotations

from collections import deque
from math import log10, sqrt
from typing import Final

import numpy as np

from heliograph.errors import Refusals
from heliograph.events import Flags, Times
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict, edges_of
from heliograph.link.step_response import CHANGE_AT, SUB_BINS
from heliograph.link.sub_bins import SubBins
from heliograph.link.text_identity import TextIdentity
from heliograph.link.uart_follow import Decision, Follower
from heliograph.link.uart_layout import text_bits
from heliograph.link.uart_lock import CHARACTER_BINS, LOCK_BINS, LOCK_EVENTS, WORDS, characters_in, lock
from heliograph.link.uart_words import slots_of
from heliograph.units import US_PER_S, bit_us

# A failed cold start costs some ms: it is tried again after 4 characters, then after half as many again, up to 48.
RETRY_BINS: Final = 4 * CHARACTER_BINS
RETRY_MAX_BINS: Final = 48 * CHARACTER_BINS
# What is kept while there is no lock, so that what came before the first success is read after all; it covers the
# longest wait and the stretch that the cold start looks at.
KEPT_BINS: Final = RETRY_MAX_BINS + LOCK_BINS
NEVER_US: Final = 2**60


class TextReceiver:
    """Reads one track; obeys `heliograph.link.contract.Receiver`.

    Args:
        bit_rate: nominal bits a second.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, bit_rate: float) -> None:
        self.refusals: Refusals = Refusals()
        self._bit_rate = bit_rate
        self._bins = SubBins(bit_us(bit_rate) / SUB_BINS)
        self._identity = TextIdentity(self.refusals, bit_us(bit_rate))
        self._follower: Follower | None = None
        self._try_at = LOCK_BINS
        self._floor = 0  # what lies before this sub-bin has been read
        self._retry = RETRY_BINS
        self._recent: deque[tuple[int, Decision]] = deque(maxlen=int(2 * bit_rate / 11) + 2)

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take events and return what they decide; see the contract."""
        out: list[LinkFrame | Text] = []
        if len(t_us):
            self._identity.begin(int(t_us[0]))
        while True:
            done = self._bins.add(t_us, on)
            t_us, on = t_us[done:], on[done:]
            self._advance(self._bins.known(int(t_us[0]) if len(t_us) else until_us), out)
            if not len(t_us):
                break
            base = self._bins.base
            self._bins.drop(self._oldest())
            if self._bins.base == base:
                self._bins.grow()
        if self._follower is not None and self._follower.lit:
            self._identity.idle(until_us)
        return out

    def due_us(self) -> int:
        """Return when the sub-bins that the follower waits for are known; never while there is none."""
        if self._follower is None:
            return NEVER_US
        return self._bins.reaches_us(self._follower.need())

    def flush(self) -> list[LinkFrame | Text]:
        """Decide what is still held, as if silence followed."""
        out: list[LinkFrame | Text] = []
        self._advance(self._bins.known(1 << 62), out)
        return out

    def identity(self) -> Identity | None:
        """Return the accepted identity (its payload is None: text), or None."""
        return self._identity.identity()

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        return self._identity.verdict(now_us)

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read.

        snr_db is that of one change of level: events a transition over the overdispersion F (`step_response`).
        jitter_us is that of one change too: a character's timing is the mean of all of its changes.
        """
        decided = [d for end_us, d in self._recent if end_us > now_us - US_PER_S]
        follower = self._follower
        if follower is None or not decided:
            return LinkQuality(self._bit_rate, None, None, None, None, 0.0 if decided else None)
        rate = self._bit_rate * SUB_BINS / follower.bit_bins
        read = [d for d in decided if d.code is not None]
        chained = [d.offset for d in read if not d.after_idle]
        words = [int(WORDS[d.code]) for d in read if d.code is not None]
        # the fall of the start bit, and the changes of level within the character
        changes = sum(1 + (word ^ (word >> 1)).bit_count() for word in words)
        per_change = sum(d.events for d in read) / changes if changes else None
        return LinkQuality(
            bit_rate=rate,
            snr_db=10.0 * log10(per_change / follower.response.f) if per_change else None,
            jitter_us=float(np.std(chained)) * self._bins.width_us * sqrt(changes / len(read))
            if len(chained) > 1
            else None,
            clock_ppm=(rate / self._bit_rate - 1.0) * 1e6,
            events_per_transition=per_change,
            mar_estimate=sum(d.good for d in decided) / len(decided),
        )

    def _oldest(self) -> int:
        """Return the first sub-bin that is still needed."""
        if self._follower is not None:
            return round(self._follower.position) - 2 * SUB_BINS
        return max(self._try_at - KEPT_BINS, self._floor)

    def _advance(self, known: int, out: list[LinkFrame | Text]) -> None:
        while True:
            if self._follower is None:
                if known < self._try_at:
                    return
                self._cold_start()
            else:
                if known < self._follower.need():
                    break
                self._follow(self._follower, out)
        self._bins.drop(self._oldest())

    def _cold_start(self) -> None:
        bins, end = self._bins, self._try_at
        found = lock(bins.counts, end - LOCK_BINS - bins.base, LOCK_BINS)
        if found is None:
            quiet = int(bins.counts[end - LOCK_BINS - bins.base : end - bins.base].sum()) < LOCK_EVENTS
            self._try_at += self._retry
            self._retry = RETRY_BINS if quiet else self._longer()
            bins.drop(self._oldest())
            return
        start = max(self._floor, end - KEPT_BINS)
        # With what is known now, what was kept is read from its beginning.
        slots = slots_of(found.bit_bins)
        first = characters_in(bins.counts, start - bins.base, end - start, slots, found.response)
        self._follower = Follower(found, start + (first[0][0] if first else end - LOCK_BINS - start + found.start))

    def _follow(self, follower: Follower, out: list[LinkFrame | Text]) -> None:
        decision = follower.step(self._bins.counts, self._bins.base)
        if decision is None:
            return
        end_us = self._bins.time_us(decision.end + CHANGE_AT)
        self._recent.append((end_us, decision))
        out.extend(self._identity.take(decision, end_us))
        if self._identity.accepted:
            self._retry = RETRY_BINS
        if self._identity.bad():
            self._identity.drop()
            self._follower = None
            self._floor = round(follower.position)
            self._try_at = self._floor + LOCK_BINS + self._retry - RETRY_BINS
            self._retry = self._longer()

    def _longer(self) -> int:
        return min(self._retry * 3 // 2, RETRY_MAX_BINS)


def warm() -> None:
    """Compile, or load from the cache, all kernels of the receiver."""
    bit_rate = 1000.0
    bits = (*text_bits("the kernels are compiled, or loaded"), *(1,) * 100, *text_bits("once"), *(1,) * 100)
    at_us, levels = edges_of(bits, 0.0, bit_us(bit_rate), level=True)
    t_us = np.repeat(at_us, 8).astype(np.int64)
    receiver = TextReceiver(bit_rate)
    receiver.feed(t_us, np.repeat(levels, 8), int(t_us[-1]) + 1)
    receiver.flush()
