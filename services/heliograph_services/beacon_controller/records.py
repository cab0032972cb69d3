"""What the frames of `firmware/PROTOCOL.md` carry: requests to a beacon, and what it answers; integers, big-endian.

Bytes from a beacon are checked: what breaks its table is None, never an exception. What an operator asks for and no
beacon can do is a ValueError that names the value and the range.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from heliograph.beacons import Settings


class Kind(IntEnum):
    """Requests and events."""

    HELLO = 0x01
    GET = 0x02
    SET = 0x03
    ARM = 0x04
    DISARM = 0x05
    QUEUE = 0x06
    CLEAR = 0x07
    STATUS = 0x08
    SAVE = 0x09
    BOOT = 0x41
    DARK = 0x42
    ON_AIR = 0x43
    MESSAGE = 0x44


class Result(IntEnum):
    """The first byte of a reply."""

    OK = 0
    UNKNOWN = 1
    LENGTH = 2
    RANGE = 3
    AMBIGUOUS = 4
    UNSUPPORTED = 5
    FULL = 6
    NOT_NOW = 7
    STORAGE = 8
    WRONG_BOOT = 9
    WRONG_VERSION = 10
    NO_PROGRAM = 11


# In words for the operator who asked.
WORDS: Final[dict[int, str]] = {
    Result.UNKNOWN: "it does not know this request",
    Result.LENGTH: "too long for it",
    Result.RANGE: "a value is out of its range",
    Result.AMBIGUOUS: "this payload reads like another one when rotated",
    Result.UNSUPPORTED: "its hardware cannot",
    Result.FULL: "its queue is full",
    Result.NOT_NOW: "its protocol carries no messages",
    Result.STORAGE: "its memory failed",
    Result.WRONG_VERSION: "it speaks another version",
    Result.NO_PROGRAM: "nothing was set",
}
LEASE_LIMIT_MS: Final = 3_600_000
UID_BYTES: Final = 8
MESSAGE_LIMIT: Final = 240
TEXT_LIMIT: Final = 64
_POWER_FULL: Final = 1000
_MILLI: Final = 1000
_PROTOCOLS: Final = ("seed11", "code", "uart", "packet")
_PARITIES: Final = ("even", "paper_text")
_BOOKS: Final = ("", "code18d4", "code20d4")
_CODE_RATES: Final = ("1/2", "2/3", "3/4", "5/6")
# The receivers' own defaults (heliograph.link.modulations).
_BOOK: Final = "code20d4"
_CODE_RATE: Final = "2/3"
_BLOCK: Final = 16
_PROGRAM: Final = struct.Struct(">BBBBIHIB")
_HELLO: Final = struct.Struct(">IB3s8sIIIIHBB")
_STATUS: Final = struct.Struct(">BIIHHBHHIIIIII")
# A reader finds the first start bit of a text behind a rest of more than three characters.
_UART_GAP: Final = 40


@dataclass(frozen=True, slots=True)
class Hello:
    """Who a beacon is, and what it can."""

    nonce: int
    version: int
    firmware: str
    uid: str
    capabilities: int
    rate_min: int
    rate_max: int
    message_max: int
    text_max: int
    queue: int
    port: str

    def speaks(self, protocol: int) -> bool:
        """Return whether a program may have this protocol's number."""
        return bool(self.capabilities >> (protocol - 1) & 1)

    @property
    def has_power(self) -> bool:
        """Whether the light's power can be set."""
        return bool(self.capabilities >> 8 & 1)


@dataclass(frozen=True, slots=True)
class Program:
    """What a beacon sends: the record of SET; rates and power in thousandths."""

    protocol: int
    option: int
    size: int
    gap: int
    bit_rate: int
    power: int
    payload: int
    kind: int
    text: bytes

    def to_bytes(self) -> bytes:
        """Return the record."""
        fields = (self.protocol, self.option, self.size, self.gap, self.bit_rate, self.power, self.payload, self.kind)
        return _PROGRAM.pack(*fields) + self.text

    def to_settings(self) -> Settings:
        """Return the program in the words of the bus; `armed` and `lease_s` are not its own."""
        protocol = _PROTOCOLS[self.protocol - 1]
        options: dict[str, str | int] = {}
        if protocol == "seed11":
            options = {"parity": _PARITIES[self.option]}
        elif protocol == "code":
            options = {"codebook": _BOOKS[self.option]} if self.option else {"bits": self.size}
        elif protocol == "packet":
            options = {"rate": _CODE_RATES[self.option], "block": self.size}
        return Settings(
            protocol=protocol,
            options=options,
            payload=None if protocol == "uart" else self.payload,
            bit_rate=self.bit_rate / _MILLI,
            power=self.power / _POWER_FULL,
            text=self.text.decode("utf-8", "replace") if self.text else None,
            gap_bits=self.gap,
        )


@dataclass(frozen=True, slots=True)
class Status:
    """How a beacon is; times in ms."""

    flags: int
    lease_ms: int
    uptime_ms: int
    program_set: int
    program_on_air: int
    free: int
    accepted: int
    ended: int
    sent: int
    dropped: int
    damaged: int
    refused: int
    repeated: int
    late: int

    @property
    def armed(self) -> bool:
        """Whether it may shine."""
        return bool(self.flags & 1)


def is_uart_text(text: str) -> bool:
    """Return whether a text beacon can send it."""
    return all(ord(character) < 0x7F for character in text)


def hello_of(data: bytes) -> Hello | None:
    """Return the HELLO in a reply's payload behind its result."""
    if not _HELLO.size < len(data) <= _HELLO.size + 12:
        return None
    nonce, version, firmware, uid, capabilities, low, high, _, message, text, queue = _HELLO.unpack_from(data)
    name = data[_HELLO.size :]
    if not name.isascii() or not name.decode("ascii").isprintable() or not 0 < low <= high:
        return None
    number = ".".join(str(part) for part in firmware)
    return Hello(nonce, version, number, uid.hex(), capabilities, low, high, message, text, queue, name.decode("ascii"))


def refuser_of(payload: bytes) -> str:
    """Return the uid in a reply's payload that refuses a request for another boot; empty where it is another reply."""
    return payload[1:].hex() if payload[:1] == bytes((Result.WRONG_BOOT,)) and len(payload) == 1 + UID_BYTES else ""


def program_of(data: bytes) -> Program | None:
    """Return the program in a GET's reply behind its number."""
    if not _PROGRAM.size <= len(data) <= _PROGRAM.size + TEXT_LIMIT:
        return None
    protocol, option, size, gap, bit_rate, power, payload, kind = _PROGRAM.unpack_from(data)
    program = Program(protocol, option, size, gap, bit_rate, power, payload, kind, data[_PROGRAM.size :])
    options = {1: len(_PARITIES), 2: len(_BOOKS), 3: 1, 4: len(_CODE_RATES)}.get(program.protocol, 0)
    sound = program.option < options and program.bit_rate >= _MILLI and 1 <= program.power <= _POWER_FULL
    return program if sound else None


def status_of(data: bytes) -> Status | None:
    """Return the status in a reply's payload behind its result."""
    return Status(*_STATUS.unpack(data)) if len(data) == _STATUS.size else None


def program_for(settings: Settings) -> Program | None:
    """Return the program of settings; None where they do not say enough to send anything.

    Raises:
        ValueError: a value that no beacon can send; names it and its range.
    """
    if settings.protocol is None or settings.bit_rate is None:
        return None
    if settings.protocol not in _PROTOCOLS:
        raise ValueError(f"protocol must be one of {', '.join(_PROTOCOLS)}, not {settings.protocol!r}")
    protocol = _PROTOCOLS.index(settings.protocol) + 1
    option, size = _option_of(settings.protocol, settings.options)
    if settings.payload is None and protocol != _PROTOCOLS.index("uart") + 1:
        return None
    text = (settings.text or "").encode("utf-8")
    if len(text) > TEXT_LIMIT:
        raise ValueError(f"text must have at most {TEXT_LIMIT} bytes, not {len(text)}")
    if settings.protocol == "uart" and not is_uart_text(settings.text or ""):
        raise ValueError(f"text of uart must be 7-bit ASCII without DEL, not {settings.text!r}")
    payload = settings.payload or 0
    limit = {"seed11": 63, "packet": 255, "uart": 0}.get(settings.protocol, 2**32 - 1)
    if payload > limit:
        raise ValueError(f"payload of {settings.protocol} must be in [0, {limit}], not {payload}")
    return Program(
        protocol=protocol,
        option=option,
        size=size,
        gap=_gap_of(settings),
        bit_rate=round(settings.bit_rate * _MILLI),
        power=max(1, round((1.0 if settings.power is None else settings.power) * _POWER_FULL)),
        payload=payload,
        kind=1 if settings.protocol == "packet" and text else 0,
        text=text if settings.protocol in {"uart", "packet"} else b"",
    )


def _gap_of(settings: Settings) -> int:
    if settings.protocol not in {"uart", "packet"}:
        return 0
    if settings.gap_bits is not None:
        return settings.gap_bits
    return _UART_GAP if settings.protocol == "uart" else 0


def _option_of(protocol: str, options: dict[str, str | int]) -> tuple[int, int]:
    """Return OPTION and SIZE."""
    if protocol == "seed11":
        return _row("parity", options.get("parity", _PARITIES[0]), _PARITIES), 0
    if protocol == "code":
        if "bits" in options:
            return 0, _size("bits", options["bits"], 4, 32)
        return _row("codebook", options.get("codebook", _BOOK), _BOOKS), 0
    if protocol == "packet":
        rate = _row("rate", options.get("rate", _CODE_RATE), _CODE_RATES)
        return rate, _size("block", options.get("block", _BLOCK), 4, 30)
    return 0, 0


def _row(name: str, value: str | int, rows: tuple[str, ...]) -> int:
    if value not in rows or not value:
        raise ValueError(f"{name} must be one of {', '.join(filter(None, rows))}, not {value!r}")
    return rows.index(str(value))


def _size(name: str, value: str | int, low: int, high: int) -> int:
    if not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name} must be in [{low}, {high}], not {value!r}")
    return value
