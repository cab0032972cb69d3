"""One port: who is at its other end, and the talk with it. It opens nothing; bytes and time come in.

::

    closed ---opened---> greeting ---HELLO, or BOOT's uid---> bound <---> (silent for SILENT_S: the link says so)
                             |                                  |
                             |  nothing sensible for nonsense_s |  NONSENSE_MOST answers in a row break the protocol
                             +----------> left alone <----------+
                 another uid or version, or one already found: left alone too ("foreign")

Who is left alone is written nothing more until it is plugged in anew, or announces another boot by itself. A port that
comes back with the beacon that was there (same boot) goes on with the very request that was under way, so that it is
not carried out twice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final, Literal

from heliograph.beacons import LinkWord
from heliograph.errors import Refusal, Refusals
from heliograph_services.beacon_controller.config import BeaconControllerConfig
from heliograph_services.beacon_controller.exchange import Exchange, Request
from heliograph_services.beacon_controller.frames import REPLY, VERSION, Deframer, Frame
from heliograph_services.beacon_controller.keeper import Keeper
from heliograph_services.beacon_controller.records import Hello, Kind, Result, hello_of, refuser_of

# Polls come five times a second: five in vain.
SILENT_S: Final = 1.0
# Damage gets past a CRC-16 once in 65,536 times: so many in a row come from a program that is wrong.
NONSENSE_MOST: Final = 8
# A beacon that was there before is asked for its program for so long, before it is asked who it is. If it has rebooted
# its refusal tells who and which boot it is, in a third of the bytes of a HELLO's reply: on a line with 5 % bad bytes
# that arrives seven times as often, and all but never takes so long.
_RETURN_S: Final = 1.0

Phase = Literal["closed", "greeting", "bound", "left alone"]
# Finds the keeper of a uid for a port; None where the site lists none, a text where it may not be taken.
Claim = Callable[[str, str], Keeper | str | None]


class Line:
    """A port and what is at its other end.

    Args:
        port: its name.
        config: time-outs.
        claim: see `Claim`.
        number: drawn at random; requests and nonces are counted from it.
    """

    def __init__(self, port: str, config: BeaconControllerConfig, claim: Claim, number: int) -> None:
        self.port = port
        self.phase: Phase = "closed"
        self.link: LinkWord = "absent"
        self.keeper: Keeper | None = None
        self.uid = ""  # of a beacon that is left alone because it is foreign
        self.trouble = ""
        self.refusals: Refusals = Counter()
        self._config = config
        self._claim = claim
        self._deframer = Deframer()
        self._exchange = Exchange(config.baud, number)
        self._nonce = (number * 0x9E3779B1 + 1) & 0xFFFFFFFF
        self._boot = self._left_boot = 0
        self._sense_s = 0.0  # when something sensible came last
        self._senseless_s: float | None = None  # since when only nonsense comes
        self._asked_s = 0.0  # when the request under way was begun
        self._in_row = 0

    # The port

    def opened(self, now_s: float) -> None:
        """The port is open: find out who is there."""
        self._deframer.reset()
        self.phase, self.link = "greeting", "silent"
        self._sense_s = now_s
        self._senseless_s = None
        self._in_row = 0
        self.trouble = ""
        if self.keeper is None:
            self._exchange.end()
        elif self._exchange.request is None or self._exchange.request.kind == Kind.HELLO:
            self._asked_s = now_s
            self._exchange.begin(Request(Kind.GET, b"", now_s + _RETURN_S), self._boot, now_s)

    def closed(self, why: str) -> None:
        """The port has gone; the request under way may be answered when it comes back."""
        self.phase, self.link = "closed", "absent"
        self.trouble = why
        self.uid = ""

    # Bytes in, bytes out

    def heard(self, data: bytes, now_s: float) -> None:
        """Take what has come."""
        if self._senseless_s is None:
            self._senseless_s = now_s
        for frame in self._deframer.feed(data):
            self._take(frame, now_s)
        self.refusals += self._deframer.refusals
        self._deframer.refusals.clear()

    def due(self, now_s: float) -> bytes:
        """Return what is to be written now."""
        self._watch(now_s)
        if self.phase in {"closed", "left alone"}:
            return b""
        self._give_up(now_s)
        if self._exchange.request is None:
            request = self._next(now_s)
            if request is None:
                return b""
            self._asked_s = now_s
            self._exchange.begin(request, self._boot if request.kind != Kind.HELLO else 0, now_s)
        data = self._exchange.due(now_s)
        if data and self.keeper is not None:
            self.keeper.tried(self._exchange.tries)
            if self._exchange.tries > 1:
                self.keeper.counters["tries again"] += 1
        return data

    def wake_s(self) -> float:
        """Return when something is due."""
        if self.phase in {"closed", "left alone"}:
            return float("inf")
        if self._exchange.request is not None or self.keeper is None:
            return self._exchange.wake_s()
        return self.keeper.poll_s

    # Who is there, and does it make sense

    def _next(self, now_s: float) -> Request | None:
        if self.phase == "bound" and self.keeper is not None:
            return self.keeper.next_request(now_s)
        self._nonce = (self._nonce + 1) & 0xFFFFFFFF
        return Request(Kind.HELLO, self._nonce.to_bytes(4, "big"), now_s + self._config.deadline_s)

    def _give_up(self, now_s: float) -> None:
        exchange = self._exchange
        request = exchange.request
        if request is None or not exchange.is_over(now_s):
            return
        exchange.end()
        if self.keeper is not None and request.kind != Kind.HELLO and self.phase == "bound":
            self.keeper.unanswered(request, now_s)
        elif self.keeper is not None:
            self.keeper.interrupted(now_s, "no answer", "its port came back, but it did not answer")

    def _watch(self, now_s: float) -> None:
        waited_s = now_s - max(self._sense_s, self._asked_s)
        if self.phase == "bound" and self._exchange.request is not None and waited_s > SILENT_S:
            self.link = "silent"
        senseless_s = 0.0 if self._senseless_s is None else now_s - self._senseless_s
        if self.phase in {"greeting", "bound"} and senseless_s > self._config.nonsense_s:
            self._leave("nonsense", f"nothing sensible came for {self._config.nonsense_s:g} s", now_s)

    def _leave(self, link: LinkWord, why: str, now_s: float) -> None:
        self.phase, self.link, self.trouble = "left alone", link, why
        self._left_boot = self._boot
        self._exchange.end()
        if self.keeper is not None:
            self.keeper.trouble = why
            self.keeper.interrupted(now_s, link, why)

    def _take(self, frame: Frame, now_s: float) -> None:
        if frame.boot == 0 or (frame.version != VERSION and frame.kind != Kind.HELLO | REPLY):
            self._nonsense(now_s)
            return
        if self.phase == "greeting":  # a sound frame is no nonsense, whatever it says
            self._senseless_s = None
        if frame.kind == Kind.BOOT:
            self._announced(frame, now_s)
        elif self.phase == "left alone":
            return
        elif self.keeper is not None and self._boot and frame.boot == self._boot:
            self._of_known(frame, now_s)
        elif self.keeper is not None and self._exchange.is_echo(frame) and refuser_of(frame.payload):
            self._refused(refuser_of(frame.payload), frame.boot, now_s)
        elif self.phase == "greeting":
            self._greeted(frame, now_s)
        elif self.keeper is not None:
            self._rebooted(frame.boot, now_s)

    def _announced(self, frame: Frame, now_s: float) -> None:
        """Take a BOOT event: it tells who it is, so nobody needs to ask."""
        if len(frame.payload) != 9:
            self._nonsense(now_s)
            return
        uid = frame.payload[1:].hex()
        if self.phase == "bound" and self.keeper is not None:
            if uid != self.keeper.uid:
                self._other(now_s)
            elif frame.boot != self._boot:
                self._rebooted(frame.boot, now_s)
            else:
                self._sensible(now_s)
            return
        if self.phase == "left alone" and frame.boot == self._left_boot:
            return
        found = self._claim(uid, self.port)
        if isinstance(found, Keeper) and found.hello is not None:
            self._bind(found, None, frame.boot, now_s)
        elif self.phase == "left alone":
            self.keeper, self._boot, self._left_boot = None, 0, frame.boot
            self.opened(now_s)

    def _refused(self, uid: str, boot: int, now_s: float) -> None:
        """Take a refusal of a request for another boot: it tells who is there, and which boot it is."""
        keeper = self.keeper
        if keeper is None or uid != keeper.uid:
            self._other(now_s)
        elif self.phase == "bound":
            self._rebooted(boot, now_s)
        else:
            self._bind(keeper, None, boot, now_s)

    def _greeted(self, frame: Frame, now_s: float) -> None:
        """Take what comes while nobody knows who speaks: the answer to HELLO counts."""
        if not self._exchange.is_answer(frame) or frame.kind != Kind.HELLO | REPLY:
            if self.keeper is not None and self._boot and frame.kind > REPLY:
                # It is not the boot that was here: whoever it is, the request under way is none of its business.
                self._exchange.end()
            return
        hello = hello_of(frame.payload[1:]) if frame.payload[:1] == bytes((Result.OK,)) else None
        if hello is None or hello.nonce != self._nonce:
            self._exchange.end()
            self._nonsense(now_s)
            return
        self._exchange.end()
        self._boot = frame.boot
        if hello.version != VERSION:
            self.uid = hello.uid
            self._leave("foreign", f"it speaks version {hello.version} of the protocol, not {VERSION}", now_s)
            return
        found = self._claim(hello.uid, self.port)
        if isinstance(found, Keeper):
            self._bind(found, hello, frame.boot, now_s)
            return
        self.uid = hello.uid
        self.keeper = None
        self._leave("foreign", found or f"uid {hello.uid} is none that the site lists", now_s)

    def _bind(self, keeper: Keeper, hello: Hello | None, boot: int, now_s: float) -> None:
        self._exchange.end()
        if self.keeper is not None and self.keeper is not keeper:
            self.keeper.interrupted(now_s, "absent", "another beacon is on its port")
        if keeper.boot == boot:
            # What was under way on this port or another cannot be told from what came before HELLO.
            keeper.interrupted(now_s, "no answer", "its port came back, but it did not confirm")
        self.keeper, self._boot, self.phase = keeper, boot, "bound"
        self.uid = ""
        self._sensible(now_s)
        keeper.bound(self.port, hello, boot, now_s)

    def _rebooted(self, boot: int, now_s: float) -> None:
        self._exchange.end()
        self._boot = boot
        self._sensible(now_s)
        if self.keeper is not None:
            self.keeper.rebooted(boot, now_s)

    def _of_known(self, frame: Frame, now_s: float) -> None:
        """Take a frame of the beacon and boot that are known here."""
        keeper, exchange = self.keeper, self._exchange
        if keeper is None:
            return
        if self.phase == "greeting":
            self.phase = "bound"
            keeper.bound(self.port, None, frame.boot, now_s)
        request = exchange.request
        if frame.kind < REPLY:
            self._judged(keeper.event(frame.kind, frame.payload), now_s)
        elif request is not None and exchange.is_answer(frame):
            exchange.end()
            if request.kind == Kind.HELLO:  # it came back by itself while it was asked who it is
                self._judged(hello_of(frame.payload[1:]) is not None, now_s)
                return
            result = frame.payload[0] if frame.payload else -1
            is_sound = keeper.answered(request, result, frame.payload[1:], now_s)
            if not is_sound:
                keeper.interrupted(now_s, "nonsense", "its answer breaks the protocol")
            self._judged(is_sound, now_s)
        elif exchange.is_echo(frame):
            self._sensible(now_s)
        else:
            self.refusals[Refusal.NOT_ASKED] += 1

    def _judged(self, is_sound: bool, now_s: float) -> None:
        if is_sound:
            self._in_row = 0
            self._sensible(now_s)
        else:
            self._nonsense(now_s)

    def _sensible(self, now_s: float) -> None:
        self._sense_s = now_s
        self._senseless_s = None
        if self.phase == "bound":
            self.link = "ready"

    def _nonsense(self, now_s: float) -> None:
        self.refusals[Refusal.NONSENSE] += 1
        self._in_row += 1
        if self._in_row >= NONSENSE_MOST and self.phase != "left alone":
            self._leave("nonsense", f"{self._in_row} answers in a row break the protocol", now_s)

    def _other(self, now_s: float) -> None:
        """Another beacon speaks on the line: begin anew."""
        self.refusals[Refusal.OTHER_BEACON] += 1
        if self.keeper is not None:
            self.keeper.interrupted(now_s, "absent", "another beacon is on its port")
        self.keeper, self._boot = None, 0
        self.opened(now_s)
