"""The receiver of one track of packets: clock, demodulator, identity, messages.

Each packet is a `LinkFrame` whose payload is the sender's address; it carries its own proof (a CRC of 32 bits and its
evidence, `heliograph.link.packet_demodulator`), so the first is an identity, and a message is said with its last
fragment. Confidence: of the packets whose sync was surely seen, how many were read lately tells the link's quality, not
whether those that were read are right: that is 1 - 2^-32 or so, told as CONFIDENCE_TOP.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link import demodulator, level, packet_demodulator, packet_state
from heliograph.link import state as shared
from heliograph.link.acceptance import CONFIDENCE_TOP
from heliograph.link.clock import SUB
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict, edges_of
from heliograph.link.packet_clock import ClockSearch
from heliograph.link.packet_layout import Layout, Packet, layout_of
from heliograph.link.packet_messages import Message, Reassembler, packets_of
from heliograph.link.packet_response import BACKGROUND, BURST
from heliograph.units import US_PER_S, bit_us

# A valid track may be silent, or unreadable, for 2 s or five packets; a new one must have said something within six
# packets: the first may be cut, and some are lost.
SILENCE_US: Final = 2 * US_PER_S
SILENCE_PACKETS: Final = 5
NEW_US: Final = 300_000
NEW_PACKETS: Final = 6


class PacketReceiver:
    """Reads one track; obeys `heliograph.link.contract.Receiver`.

    Args:
        layout: of its packets.
        bit_rate: nominal bits a second; the beacon's own may differ by 2 %.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, layout: Layout, bit_rate: float) -> None:
        self.refusals: Refusals = Refusals()
        self._layout = layout
        self._bit_us = bit_us(bit_rate)
        self._packet_us = layout.bits * self._bit_us
        self._state = packet_state.new_state(layout)
        self._search = ClockSearch(self._bit_us, self._state.model, self._state.seen)
        self._messages = Reassembler(self.refusals, self._packet_us)
        self._origin_us: int | None = None  # of the lock; None while there is no clock
        self._until_us: int | None = None
        self._begun_us: int | None = None
        self._end_us: int | None = None  # of the newest packet
        self._identity: Identity | None = None
        self._recent: deque[tuple[int, bool]] = deque(maxlen=1024)  # (end, read) of the last second's packets

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take the events before until_us (see the contract)."""
        if self._until_us is not None and until_us < self._until_us:
            self.refusals[Refusal.TIME_BACKWARDS] += 1
            return []
        if len(t_us) and self._until_us is not None and t_us[0] < self._until_us:
            self.refusals[Refusal.TIME_BACKWARDS] += 1
            start = int(np.searchsorted(t_us, self._until_us))
            t_us, on = t_us[start:], on[start:]
        if self._begun_us is None and len(t_us):
            self._begun_us = int(t_us[0])
        self._until_us = until_us
        out: list[LinkFrame | Text] = []
        while True:
            if self._origin_us is None:
                t_us, on = self._wait(t_us, on, until_us)
                if self._origin_us is None:
                    return out
            t_us, on = self._follow(t_us, on, until_us, out)
            if self._origin_us is not None:
                return out

    def flush(self) -> list[LinkFrame | Text]:
        """Decide the packet that ends within the last bit; the stream has ended."""
        out: list[LinkFrame | Text] = []
        if self._until_us is not None:
            t_us, on = np.empty(0, np.int64), np.empty(0, np.bool_)
            if self._origin_us is None and (found := self._search.flush()) is not None:
                self._origin_us = found.origin_us
                packet_state.start(self._state, found.folded, found.found)
                t_us, on = found.t_us, found.on
            if self._origin_us is not None:
                self._follow(t_us, on, self._until_us + int(self._bit_us) + 1, out)
        self._messages.close()
        return out

    def identity(self) -> Identity | None:
        """Return the sender that was read last, or None."""
        return self._identity

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        if self._end_us is not None:
            silent = now_us - self._end_us > max(SILENCE_US, SILENCE_PACKETS * self._packet_us)
            return "invalid" if silent else "valid"
        late = self._begun_us is not None and now_us - self._begun_us > max(NEW_US, NEW_PACKETS * self._packet_us)
        return "invalid" if late else "new"

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read; mar_estimate is of the packets whose sync was surely seen."""
        newest = [read for end_us, read in self._recent if now_us - US_PER_S < end_us <= now_us]
        mar = sum(newest) / len(newest) if newest else None
        if self._origin_us is None or self._end_us is None:
            return LinkQuality(US_PER_S / self._bit_us, None, None, None, None, mar)
        period = float(self._state.floats[shared.PERIOD])
        jitter_us = float(np.sqrt(self._state.floats[shared.JITTER2])) * self._bit_us
        burst, background = float(self._state.figures[BURST]), float(self._state.figures[BACKGROUND])
        # Energy of a transition over the background in a slot, half an event of which is never excluded.
        snr_db = 10.0 * float(np.log10(max(burst, 1e-3) / max(background, 0.5)))
        return LinkQuality(
            US_PER_S / (self._bit_us * period), snr_db, jitter_us, (1.0 / period - 1.0) * 1e6, burst, mar
        )

    def _wait(self, t_us: Times, on: Flags, until_us: int) -> tuple[Times, Flags]:
        """Look for the clock; return the events from the lock's origin on, or none."""
        found = self._search.feed(t_us, on, until_us)
        if self._search.failed:
            self.refusals[Refusal.NO_CLOCK] += self._search.failed
            self._search.failed = 0
        if found is None:
            return t_us[:0], on[:0]
        self._origin_us = found.origin_us
        packet_state.start(self._state, found.folded, found.found)
        return found.t_us, found.on

    def _follow(self, t_us: Times, on: Flags, until_us: int, out: list[LinkFrame | Text]) -> tuple[Times, Flags]:
        """Demodulate; return the events that are left when the clock is lost."""
        origin_us = self._origin_us
        if origin_us is None:
            return t_us, on
        t = np.asarray((t_us - origin_us) / self._bit_us, np.float64)
        until = (until_us - origin_us) / self._bit_us
        done = 0
        while True:
            outcome, taken = packet_demodulator.advance(t[done:], on[done:], until, self._state)
            done += taken
            self._settle(origin_us, out)
            if outcome == demodulator.DONE:
                break
            if outcome == demodulator.LOST:
                # From here on the search begins anew, with what the lost lock has not taken.
                if self._state.ints[shared.SEARCHED] > packet_demodulator.SEARCH_PACKETS * self._layout.bits:
                    self.refusals[Refusal.NO_START_CODE] += 1
                floats = self._state.floats
                lost = floats[shared.BOUNDARY] - 0.5 * floats[shared.PERIOD]
                self._search.restart(origin_us + int(np.ceil(lost * self._bit_us)))
                self._origin_us = None
                break
        return t_us[done:], on[done:]

    def _settle(self, origin_us: int, out: list[LinkFrame | Text]) -> None:
        """Turn the demodulator's records into packets and refusals."""
        state = self._state
        for i in range(int(state.ints[shared.OUT])):
            end, good, evidence = state.out[i].tolist()
            end_us = origin_us + round(end * self._bit_us)
            packet = self._layout.parse(state.read[i].tobytes()) if good else None
            self._recent.append((end_us, packet is not None))
            if packet is None:
                self.refusals[Refusal.CHECKSUM] += 1
            else:
                self._packet(packet, end_us, evidence, out)
        state.ints[shared.OUT] = 0

    def _packet(self, packet: Packet, end_us: int, evidence: float, out: list[LinkFrame | Text]) -> None:
        known = self._identity
        if known is None or known.payload != packet.address:
            self._identity = Identity(packet.address, end_us, end_us, 1, evidence, CONFIDENCE_TOP)
        else:
            used, margin = known.frames_used + 1, known.margin + evidence
            self._identity = Identity(packet.address, known.since_us, end_us, used, margin, CONFIDENCE_TOP)
        self._end_us = end_us
        out.append(LinkFrame(end_us, packet.address, CONFIDENCE_TOP, evidence))
        message = self._messages.take(packet, end_us)
        if message is not None:
            out.append(said(message, end_us))


def said(message: Message, t_us: int) -> Text:
    """Return a message as the link tells it; what calls itself text and is no UTF-8 goes as bytes."""
    if message.text:
        try:
            return Text(t_us, message.data.decode(), None, whole=True)
        except UnicodeDecodeError:
            pass
    return Text(t_us, None, message.data, whole=True)


def warm() -> None:
    """Compile, or load from the cache, all kernels of the receiver: packets of a bright light and of a faint one."""
    layout = layout_of()
    bits = [
        bit for packet in packets_of("the kernels are compiled", 1, 0, layout.block) for bit in layout.encode(packet)
    ]
    at_us, levels = edges_of([*bits, *(0,) * 300], 0.0, 1000.0)
    for events in (20, 6):
        receiver = PacketReceiver(layout, 1000.0)
        receiver.feed(np.repeat(at_us, events).astype(np.int64), np.repeat(levels, events), len(bits) * 1000 + 300_000)
        receiver.flush()
    # What only a light that moves would ask for.
    nothing = np.zeros(1), np.zeros(1, np.bool_)
    level.start(*nothing, 0.0, np.ones(4), np.zeros((4, 2, SUB)), np.zeros(4, np.int64))
