"""The beacon's serial protocol as a test speaks it: from firmware/PROTOCOL.md, sharing no code with any side."""

from __future__ import annotations

import binascii
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Self

VERSION: Final = 1
HELLO, GET, SET, ARM, DISARM, QUEUE, CLEAR, STATUS, SAVE = range(1, 10)
REPLY: Final = 0x80
BOOT, DARK, ON_AIR, MESSAGE = range(0x41, 0x45)
(OK, UNKNOWN, LENGTH, RANGE, AMBIGUOUS, UNSUPPORTED, FULL, NOT_NOW, STORAGE, WRONG_BOOT, WRONG_VERSION, NO_PROGRAM) = (
    range(12)
)
SEED11, CODE, UART, PACKET = range(1, 5)


def cobs(body: bytes) -> bytes:
    """Return a body's COBS, without the 00 at its end."""
    return b"".join(bytes([len(block) + 1]) + block for block in body.split(b"\0"))


def uncobs(frame: bytes) -> bytes:
    """Return a frame's body.

    Raises:
        ValueError: it is none.
    """
    body = b""
    while frame:
        code, block = frame[0], frame[1 : frame[0]]
        if len(block) != code - 1:
            raise ValueError("a block is cut off")
        frame = frame[code:]
        body += block + (b"\0" if frame and code < 255 else b"")
    return body


@dataclass(frozen=True)
class Body:
    """What a frame says."""

    type: int
    seq: int
    boot: int
    payload: bytes
    version: int = VERSION

    def wire(self) -> bytes:
        """Return it as it goes on the line."""
        body = struct.pack(">BBHH", self.version, self.type, self.seq, self.boot) + self.payload
        return b"\0" + cobs(body + struct.pack(">H", binascii.crc_hqx(body, 0xFFFF) ^ 0xFFFF)) + b"\0"


def parse(stream: bytes) -> list[Body]:
    """Return what a stream of whole frames says; every frame must be sound.

    Raises:
        ValueError: one is not.
    """
    bodies = []
    for frame in stream.split(b"\0"):
        if not frame:
            continue
        body = uncobs(frame)
        checked, (crc,) = body[:-2], struct.unpack(">H", body[-2:])
        if binascii.crc_hqx(checked, 0xFFFF) ^ 0xFFFF != crc:
            raise ValueError("a frame fails its CRC")
        version, kind, seq, boot = struct.unpack(">BBHH", checked[:6])
        bodies.append(Body(kind, seq, boot, checked[6:], version))
    return bodies


def record(
    protocol: int,
    payload: int = 0,
    *,
    bit_rate: float = 1000.0,
    option: int | None = None,
    size: int | None = None,
    gap: int = 0,
    power: int = 1000,
    kind: int = 0,
    text: bytes = b"",
) -> bytes:
    """Return a program as SET says it; packets are of 16 bytes at rate 2/3, unless said otherwise."""
    block = 16 if protocol == PACKET else 0
    usual = 1 if protocol == PACKET else 0
    head = (
        protocol,
        usual if option is None else option,
        block if size is None else size,
        gap,
        round(1000 * bit_rate),
        power,
        payload,
        kind,
    )
    return struct.pack(">BBBBIHIB", *head) + text


@dataclass
class Status:
    """What STATUS says."""

    flags: int
    lease_ms: int
    uptime_ms: int
    program: int
    on_air: int
    free: int
    accepted: int
    ended: int
    sent: int
    dropped: int
    bad: int
    refused: int
    replays: int
    late: int

    @property
    def armed(self) -> bool:
        """Return whether it is lit."""
        return bool(self.flags & 1)

    @property
    def saved(self) -> bool:
        """Return whether the program is the saved one."""
        return bool(self.flags & 2)


def status_of(reply: Body) -> Status:
    """Return what a reply to STATUS says."""
    return Status(*struct.unpack(">BIIHHBHHIIIIII", reply.payload[1:]))


@dataclass
class Host:
    """A host on a clean line: sends one request, returns its reply, keeps the events.

    Args:
        exchange: sends bytes and returns what came back, whole frames, at least one reply among them.
    """

    exchange: Callable[[bytes], bytes]
    boot: int = 0
    seq: int = 100
    events: list[Body] = field(default_factory=list)

    def ask(self, kind: int, payload: bytes = b"", *, boot: int | None = None) -> Body:
        """Return the reply to a request."""
        self.seq += 1
        return self.again(Body(kind, self.seq, self.boot if boot is None else boot, payload).wire(), self.seq)

    def again(self, wire: bytes, seq: int) -> Body:
        """Return the reply to these bytes."""
        replies: list[Body] = []
        for body in parse(self.exchange(wire)):
            (replies if body.type & REPLY else self.events).append(body)
        (reply,) = replies
        assert reply.seq == seq
        return reply

    def hello(self) -> Body:
        """Make it known which boot it is."""
        reply = self.ask(HELLO, b"\1\2\3\4", boot=0)
        self.boot = reply.boot
        return reply

    def done(self, kind: int, payload: bytes = b"") -> bytes:
        """Carry out a request that must succeed; return what follows OK."""
        reply = self.ask(kind, payload)
        assert reply.payload[0] == OK, f"request {kind} was refused: {reply.payload.hex()}"
        return reply.payload[1:]

    def status(self) -> Status:
        """Return its state."""
        return status_of(self.ask(STATUS))


class TcpLine:
    """A line to a port on the loopback."""

    def __init__(self, port: int, timeout_s: float = 20.0) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout_s)
        self._rest = b""

    @classmethod
    def of(cls, connection: socket.socket, timeout_s: float) -> Self:
        """Return the line of a connection that the other side made."""
        line = cls.__new__(cls)
        line.socket = connection
        line.socket.settimeout(timeout_s)
        line._rest = b""
        return line

    def __call__(self, wire: bytes) -> bytes:
        """Send bytes; return the frames up to the reply."""
        self.socket.sendall(wire)
        frames = b""
        while True:
            frame = self._frame()
            frames += b"\0" + frame + b"\0"
            if uncobs(frame)[1] & REPLY:
                return frames

    def until(self, kind: int) -> Body:
        """Wait for an event."""
        while True:
            (body,) = parse(b"\0" + self._frame() + b"\0")
            if body.type == kind:
                return body

    def _frame(self) -> bytes:
        while True:
            frame, found, rest = self._rest.partition(b"\0")
            if found:
                self._rest = rest
                if frame:
                    return frame
                continue
            data = self.socket.recv(4096)
            if not data:
                raise ConnectionError("the beacon closed the line")
            self._rest += data
