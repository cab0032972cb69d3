"""One request at a time, repeated byte for byte until its answer comes or its deadline is over.

A try waits for ``WAIT_S + 3 (request + reply)`` on the wire, and for its copies. The beacon carries a request out once,
however often it comes (`firmware/PROTOCOL.md`), so on a line that damages frames a try may hold copies: after k tries
without an answer there are k + 1, COPIES_MOST at most. With 5 % of the bytes bad, a program of 27 bytes and its reply
of 14 come through in one of eight tries of one copy (30 ms each), but in two of five of four copies: that is what
brings a rebooted beacon back within a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from heliograph_services.beacon_controller.frames import REPLY, Frame, pack, wire_bytes
from heliograph_services.beacon_controller.records import Kind

# A USB adapter holds bytes back for up to 16 ms (FTDI's latency timer).
WAIT_S: Final = 0.02
# Beyond, a try is longer than the wait for its answer would have been.
COPIES_MOST: Final = 8
# A late answer is at most so many requests old: each of them waits for longer than the line holds bytes back.
_ECHOES: Final = 8
# On a UART: a start and a stop bit around each byte.
_BITS_A_BYTE: Final = 10
# Payloads of replies, where they are more than a result and a number; the port's name and a text may be shorter.
_REPLIES: Final = {Kind.HELLO: 49, Kind.GET: 82, Kind.STATUS: 43}
_REPLY: Final = 4


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of a beacon.

    Args:
        kind: what.
        payload: its bytes.
        deadline_s: when it is given up.
    """

    kind: Kind
    payload: bytes = b""
    deadline_s: float = float("inf")


class Exchange:
    """The request that is under way on a line.

    Args:
        baud: of the line.
        seq: a number drawn at random, from which requests are counted.
    """

    def __init__(self, baud: int, seq: int) -> None:
        self.request: Request | None = None
        self.tries = 0
        self.repeats = 0  # since the start: tries beyond the first of each request
        self._byte_s = _BITS_A_BYTE / baud
        self._seq = seq & 0xFFFF
        self._boot = 0
        self._wire = b""
        self._due_s = 0.0

    def begin(self, request: Request, boot: int, now_s: float) -> None:
        """Take up a request for a beacon's present boot; one that is under way is forgotten."""
        self._seq = (self._seq + 1) & 0xFFFF
        self._boot = boot
        self.request = request
        self.tries = 0
        self._wire = pack(Frame(request.kind, self._seq, boot, request.payload))
        self._due_s = now_s

    def end(self) -> None:
        """Forget the request."""
        self.request = None

    def due(self, now_s: float) -> bytes:
        """Return what is to be written now; empty where it is not yet time."""
        if self.request is None or now_s < self._due_s:
            return b""
        copies = min(self.tries + 1, COPIES_MOST)
        self.repeats += self.tries > 0
        self.tries += 1
        reply = wire_bytes(_REPLIES.get(self.request.kind, _REPLY))
        self._due_s = now_s + WAIT_S + self._byte_s * ((copies + 2) * len(self._wire) + 3 * reply)
        return self._wire * copies

    def is_over(self, now_s: float) -> bool:
        """Return whether the deadline has passed."""
        return self.request is not None and now_s >= self.request.deadline_s

    def wake_s(self) -> float:
        """Return when something is due again."""
        return float("inf") if self.request is None else min(self._due_s, self.request.deadline_s)

    def is_answer(self, frame: Frame) -> bool:
        """Return whether a frame answers the request that is under way."""
        return self.request is not None and frame.kind == self.request.kind | REPLY and frame.seq == self._seq

    def is_echo(self, frame: Frame) -> bool:
        """Return whether a frame answers a request of just before once more: a copy's answer, or one that was late."""
        return frame.kind > REPLY and (self._seq - frame.seq) & 0xFFFF <= _ECHOES
