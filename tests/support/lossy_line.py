"""The controller's core and virtual beacons on lines that damage bytes and lose answers, in virtual time."""

from __future__ import annotations

import random
import secrets
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Protocol

from heliograph.beacons import BeaconCommand, BeaconReply, BeaconState
from heliograph.keys import key
from heliograph.site import Beacon
from heliograph.wire import header_for, pack
from heliograph_services.beacon_controller.config import BeaconControllerConfig
from heliograph_services.beacon_controller.core import ControllerCore

SITE = "yard"
UID = "00000000000000a1"
# How often the lights of beacons on quiet lines are looked at.
_STEP_S = 0.005
WALL_MS = 1_800_000_000_000
STARTED_MS = WALL_MS - 3_600_000


def crane(uid: str = UID, **changes: Any) -> Beacon:
    """Return the site's beacon."""
    fields: dict[str, Any] = {"name": "crane", "uid": uid, "protocol": "seed11", "payload": 42, "bit_rate": 1000.0}
    return Beacon(**fields | changes)


def packed(command: BeaconCommand) -> bytes:
    """Return a command in its envelope."""
    return pack(header_for(command, source="test/0", boot="00c0ffee", seq=0, mono_ns=0, wall_ns=0), command)


def command(op: str, name: str = "crane", at_s: float = 0.0, **fields: Any) -> BeaconCommand:
    """Return a command that lives for 20 s from a virtual time on."""
    issued_ms = WALL_MS + round(at_s * 1000)
    times = {"issued_ms": issued_ms, "expires_ms": issued_ms + 20_000}
    return BeaconCommand(name=name, op=op, nonce=secrets.token_hex(16), **times, **fields)  # type: ignore[arg-type]


class Talker(Protocol):
    """Who is at the other end of a line: a beacon, or something else."""

    def run_to(self, now_s: float) -> None:
        """Let time pass."""

    def receive(self, data: bytes) -> None:
        """Take bytes."""

    def take(self) -> bytes:
        """Return what it has written since."""
        ...


@dataclass
class Line:
    """A line between a port of the core and who is there; None where nobody is."""

    beacon: Talker | None
    is_open: bool = False
    way: deque[tuple[float, bool, bytes]] = field(default_factory=deque)  # (arrival, to the host, bytes)
    free_s: dict[bool, float] = field(default_factory=lambda: {True: 0.0, False: 0.0})  # to the host, to the beacon


class World:
    """A core, its lines, and the time.

    Args:
        config: of the core.
        bad: share of bytes that arrive as another byte.
        lost: share of the beacons' writes that do not arrive at all.
        seed: of the damage.
    """

    def __init__(
        self, config: BeaconControllerConfig, *, bad: float = 0.0, lost: float = 0.0, seed: int = 1, secret: bytes = b""
    ) -> None:
        self.core = ControllerCore(config, secret, seed, STARTED_MS)
        self.now_s = 0.0
        self.lines: dict[str, Line] = {}
        self.replies: dict[int, list[BeaconReply]] = {}
        self.states: dict[str, BeaconState] = {}
        self.written: dict[str, int] = {}
        self._byte_s = 10 / config.baud
        self._bad, self._lost = bad, lost
        self._random = random.Random(seed)

    def plug(self, port: str, beacon: Talker | None = None) -> None:
        """Open a port."""
        line = self.lines.setdefault(port, Line(beacon))
        line.beacon = beacon or line.beacon
        line.is_open = True
        self.core.opened(port, self.now_s)

    def unplug(self, port: str) -> None:
        """Take a port away; what is on the way is gone."""
        line = self.lines[port]
        line.is_open = False
        line.way.clear()
        self.core.closed(port, "unplugged")

    def ask(self, what: BeaconCommand) -> int:
        """Give a command on its key; return its ticket."""
        own = key(SITE, "beacon", what.name, "cmd")
        return self.core.asked(own, own, packed(what), WALL_MS + round(self.now_s * 1000), self.now_s)

    def run(self, until_s: float) -> None:
        """Let time pass."""
        while self.now_s < until_s:
            self._step(until_s)

    def end_of(self, ticket: int, within_s: float = 10.0) -> BeaconReply:
        """Let time pass until a command has ended; return how."""
        end_s = self.now_s + within_s
        while ticket not in self.replies:
            assert self.now_s < end_s, f"no reply within {within_s} s"
            self._step(end_s)
        return self.replies[ticket][0]

    def until(self, is_true: Any, within_s: float) -> float:
        """Let time pass until something is true; return how long it took."""
        begin_s = self.now_s
        while not is_true():
            assert self.now_s < begin_s + within_s, f"not within {within_s} s"
            self._step(begin_s + within_s)
        return self.now_s - begin_s

    def _step(self, until_s: float) -> None:
        work = self.core.step(self.now_s)
        for ticket, reply in work.replies:
            self.replies.setdefault(ticket, []).append(reply)
        for state in work.states:
            self.states[state.name] = state
        for port, data in work.writes:
            self.written[port] = self.written.get(port, 0) + len(data)
            self._send(self.lines[port], data, to_host=False)
        coming = [line.way[0][0] for line in self.lines.values() if line.way]
        due_s = min([until_s, self.now_s + _STEP_S, *coming, max(self.now_s + 1e-6, self.core.wake_s())])
        self.now_s = max(self.now_s, due_s)
        for port, line in self.lines.items():
            if line.beacon is not None:
                line.beacon.run_to(self.now_s)
                self._answer(line)
            while line.way and line.way[0][0] <= self.now_s:
                _, to_host, data = line.way.popleft()
                if to_host:
                    self.core.heard(port, data, self.now_s)
                elif line.beacon is not None:
                    line.beacon.receive(data)
                    self._answer(line)

    def _answer(self, line: Line) -> None:
        data = line.beacon.take() if line.beacon is not None else b""
        if data and self._random.random() >= self._lost:
            self._send(line, data, to_host=True)

    def _send(self, line: Line, data: bytes, *, to_host: bool) -> None:
        if not line.is_open:
            return
        chance = self._random
        damaged = bytes(chance.randrange(256) if chance.random() < self._bad else byte for byte in data)
        arrival_s = max(self.now_s, line.free_s[to_host]) + len(data) * self._byte_s
        line.free_s[to_host] = arrival_s
        line.way.append((arrival_s, to_host, damaged))
        line.way = deque(sorted(line.way, key=lambda item: item[0]))
