"""Frames of the beacon's serial protocol, version 1.

`firmware/PROTOCOL.md` is the contract::

    00  COBS( VERSION TYPE SEQ BOOT PAYLOAD CRC )  00
        1       1    2   2    0..246  2            big-endian

CRC-16/GENIBUS of all before it: x^16 + x^12 + x^5 + 1, begun with FFFF, complemented. Without the complement a 00 more
at the end would not be seen, and just that is what a closing 00 reads as that is damaged into 01.

COBS: the body with a 00 behind it is cut behind each 00; each piece is sent as its length and its bytes without the 00.
Nothing here raises on bad bytes: what is no frame is dropped and counted by its reason.
"""

from __future__ import annotations

import binascii
from collections import Counter
from dataclasses import dataclass
from typing import Final

from heliograph.errors import Refusal, Refusals

VERSION: Final = 1
REPLY: Final = 0x80
PAYLOAD_LIMIT: Final = 246
_HEAD: Final = 6
_CRC_BYTES: Final = 2
_BODY_LIMIT: Final = _HEAD + PAYLOAD_LIMIT + _CRC_BYTES
# Such a body takes one byte more as COBS.
_WIRE_LIMIT: Final = _BODY_LIMIT + 1


@dataclass(frozen=True, slots=True)
class Frame:
    """What one side says to the other; ranges as in the module's table."""

    kind: int
    seq: int
    boot: int
    payload: bytes = b""
    version: int = VERSION


def pack(frame: Frame) -> bytes:
    """Return a frame as it goes over the line, a 00 on both sides."""
    body = bytes((frame.version, frame.kind)) + frame.seq.to_bytes(2, "big") + frame.boot.to_bytes(2, "big")
    body += frame.payload
    body += _crc(body).to_bytes(_CRC_BYTES, "big")
    if len(body) > _BODY_LIMIT:
        raise ValueError(f"payload must have at most {PAYLOAD_LIMIT} bytes, not {len(frame.payload)}")
    return b"\0" + b"".join(bytes((len(piece) + 1,)) + piece for piece in body.split(b"\0")) + b"\0"


def wire_bytes(payload: int) -> int:
    """Return how many bytes a frame with a payload of so many takes on the line."""
    return _HEAD + payload + _CRC_BYTES + 3


class Deframer:
    """Cuts what comes from a line into frames."""

    def __init__(self) -> None:
        self.refusals: Refusals = Counter()
        self._rest = bytearray()
        self._is_overlong = False

    def feed(self, data: bytes) -> list[Frame]:
        """Return the sound frames that are whole with these bytes, in order."""
        found = []
        for byte in data:
            if byte:
                if len(self._rest) < _WIRE_LIMIT:
                    self._rest.append(byte)
                else:
                    self._is_overlong = True
                continue
            if self._rest:
                frame = self._frame_of(bytes(self._rest))
                if frame is not None:
                    found.append(frame)
            self._rest.clear()
            self._is_overlong = False
        return found

    def reset(self) -> None:
        """Forget what has begun: the line has been cut."""
        self._rest.clear()
        self._is_overlong = False

    def _frame_of(self, wire: bytes) -> Frame | None:
        body = None if self._is_overlong else _unstuffed(wire)
        if body is None or not _HEAD + _CRC_BYTES <= len(body) <= _BODY_LIMIT:
            self.refusals[Refusal.DAMAGED] += 1
            return None
        if _crc(body[:-_CRC_BYTES]) != int.from_bytes(body[-_CRC_BYTES:], "big"):
            self.refusals[Refusal.CHECKSUM] += 1
            return None
        seq, boot = int.from_bytes(body[2:4], "big"), int.from_bytes(body[4:6], "big")
        return Frame(body[1], seq, boot, body[_HEAD:-_CRC_BYTES], body[0])


def _crc(data: bytes) -> int:
    return binascii.crc_hqx(data, 0xFFFF) ^ 0xFFFF


def _unstuffed(wire: bytes) -> bytes | None:
    """Return what COBS has packed, or None where a length leads beyond the end."""
    body = bytearray()
    at = 0
    while at < len(wire):
        end = at + wire[at]
        if end > len(wire):
            return None
        body += wire[at + 1 : end]
        body.append(0)
        at = end
    return bytes(body[:-1])
