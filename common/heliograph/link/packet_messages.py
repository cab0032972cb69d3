"""Messages cut into packets, and put together again.

A message of n bytes goes in max(1, ceil(n / block)) packets under one number; the last says how many bytes it uses. The
next message has the next number, modulo 16. A sender without an answer repeats what matters, under the same number.

Put together:

- *Fragments* are kept by (address, kind, number) until all are there, of MESSAGES_LIMIT messages at a time, and as long
  as one of them comes again within `quiet_us`. A fragment that contradicts one that is held begins another message.
- A *repeat* is a packet of one of the last WINDOW messages of that address, equal to the one that came before. It is
  counted and said once. A message with an older number, or of a beacon that was silent for REPEAT_US, is new.
- A number that was skipped is a *lost* message: by serial-number arithmetic (RFC 1982), ahead by 1 to 7 is forward, by
  8 to 15 a sender that began anew. A message that is given up incomplete is lost too.

Memory is bounded: MESSAGES_LIMIT + DONE_LIMIT messages of at most 64 blocks of 30 bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from heliograph.errors import Refusal, Refusals
from heliograph.link.packet_layout import FRAGMENTS, NUMBERS, Packet
from heliograph.units import US_PER_S

# A sender has one message on the air, and perhaps repeats the one before; four leave room for a swap of tracks.
MESSAGES_LIMIT: Final = 4
# Half of all numbers: what is as near ahead as behind cannot be told.
WINDOW: Final = NUMBERS // 2
DONE_LIMIT: Final = 2 * WINDOW
REPEAT_US: Final = 60 * US_PER_S
# Packets' lengths (and 2 s) without any fragment of a message, after which it is given up.
QUIET_PACKETS: Final = 2 * FRAGMENTS
QUIET_US: Final = 2 * US_PER_S

Key = tuple[int, bool, int]


def packets_of(data: bytes | str, address: int, number: int, block: int) -> list[Packet]:
    """Return the packets of a message.

    Args:
        data: bytes, or text.
        address: of the sender.
        number: of the message; modulo 16.
        block: bytes of a packet's data.

    Raises:
        ValueError: it is too long for 64 fragments.
    """
    text = isinstance(data, str)
    whole = data.encode() if isinstance(data, str) else data
    if len(whole) > FRAGMENTS * block:
        raise ValueError(f"a message must have at most {FRAGMENTS * block} bytes, not {len(whole)}")
    parts = [whole[i : i + block] for i in range(0, len(whole), block)] or [b""]
    last = len(parts) - 1
    return [Packet(address, text, number % NUMBERS, i, i < last, part) for i, part in enumerate(parts)]


@dataclass(frozen=True, slots=True)
class Message:
    """A whole message."""

    address: int
    text: bool
    number: int
    data: bytes


@dataclass(slots=True)
class _Parts:
    """A message's fragments: number -> (more, data)."""

    t_us: int
    by_number: dict[int, tuple[bool, bytes]] = field(default_factory=dict)

    def fits(self, packet: Packet) -> bool:
        """Return whether a packet contradicts none of the fragments."""
        mine = self.by_number.get(packet.fragment)
        if mine is not None:
            return mine == (packet.more, packet.data)
        last = [i for i, (more, _) in self.by_number.items() if not more]
        if last and packet.fragment > last[0]:
            return False
        return packet.more or all(i < packet.fragment for i in self.by_number)

    def whole(self) -> bytes | None:
        """Return the message, or None as long as fragments are missing."""
        last = [i for i, (more, _) in self.by_number.items() if not more]
        if not last or len(self.by_number) <= last[0]:
            return None
        return b"".join(self.by_number[i][1] for i in range(last[0] + 1))


class Reassembler:
    """Puts one track's messages together.

    Args:
        refusals: where repeats and losses are counted.
        packet_us: length of a packet.
    """

    def __init__(self, refusals: Refusals, packet_us: float) -> None:
        self._refusals = refusals
        self._quiet_us = max(QUIET_US, QUIET_PACKETS * packet_us)
        self._parts: dict[Key, _Parts] = {}
        self._done: dict[Key, _Parts] = {}
        self._newest: dict[int, tuple[int, int]] = {}  # by address: number of the newest message, when heard

    def take(self, packet: Packet, t_us: int) -> Message | None:
        """Take a packet that ended at t_us (not falling); return the message that it completes."""
        self.expire(t_us)
        if packet.fragment == 0 and not packet.more and not packet.data:
            return None  # an empty message says who sends, and nothing else
        key = (packet.address, packet.text, packet.number)
        done = self._done.get(key)
        if done is not None:
            if done.fits(packet):
                done.t_us = t_us
                self._refusals[Refusal.REPEATED] += 1
                return None
            del self._done[key]
        self._advance(packet, t_us)
        parts = self._parts.get(key)
        if parts is not None and not parts.fits(packet):
            self._lose(key)
            parts = None
        if parts is None:
            if len(self._parts) >= MESSAGES_LIMIT:
                self._lose(min(self._parts, key=lambda each: self._parts[each].t_us))
            parts = self._parts[key] = _Parts(t_us)
        if packet.fragment in parts.by_number:
            self._refusals[Refusal.REPEATED] += 1
        parts.by_number[packet.fragment] = (packet.more, packet.data)
        parts.t_us = t_us
        data = parts.whole()
        if data is None:
            return None
        self._done[key] = self._parts.pop(key)
        if len(self._done) > DONE_LIMIT:
            del self._done[min(self._done, key=lambda each: self._done[each].t_us)]
        return Message(packet.address, packet.text, packet.number, data)

    def expire(self, now_us: int) -> None:
        """Give up what has waited too long."""
        for key in [key for key, parts in self._parts.items() if now_us - parts.t_us > self._quiet_us]:
            self._lose(key)
        for key in [key for key, parts in self._done.items() if now_us - parts.t_us > REPEAT_US]:
            del self._done[key]

    def close(self) -> None:
        """Count what is still incomplete: the stream has ended."""
        for key in list(self._parts):
            self._lose(key)

    def _lose(self, key: Key) -> None:
        del self._parts[key]
        self._refusals[Refusal.LOST] += 1

    def _advance(self, packet: Packet, t_us: int) -> None:
        """Note the number of a message that is no repeat: what was skipped is lost, what is long past forgotten."""
        newest = self._newest.get(packet.address)
        if newest is None or t_us - newest[1] > REPEAT_US:
            if newest is None and len(self._newest) >= MESSAGES_LIMIT:
                del self._newest[min(self._newest, key=lambda each: self._newest[each][1])]
            self._newest[packet.address] = (packet.number, t_us)
            return
        ahead = (packet.number - newest[0]) % NUMBERS
        if ahead < WINDOW:
            if ahead > 1:
                self._refusals[Refusal.LOST] += ahead - 1
            self._newest[packet.address] = (packet.number, t_us)
        elif (packet.address, packet.text, packet.number) not in self._parts:
            # Behind, and not known: the sender began anew.
            self._newest[packet.address] = (packet.number, t_us)
        now = self._newest[packet.address][0]
        for key in [key for key in self._done if key[0] == packet.address and (now - key[2]) % NUMBERS >= WINDOW]:
            del self._done[key]
