"""The beacon controller without ports and bus: bytes, commands, time come in; bytes, replies, states go out.

A uid is kept by one `Keeper`, a port by one `Line`; which line a keeper is on shows when the beacon has said who it is.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import msgspec

from heliograph.beacons import BeaconReply, BeaconState, LinkWord, Settings
from heliograph.errors import ConfigError, Refusals
from heliograph.messages import Message
from heliograph_services.beacon_controller.adapt import Adapter
from heliograph_services.beacon_controller.authority import Authority, Denied
from heliograph_services.beacon_controller.config import BeaconControllerConfig
from heliograph_services.beacon_controller.keeper import Keeper
from heliograph_services.beacon_controller.line import Line

# A state whose counters alone have moved is told so often: who watches sees that it lives.
_COUNTERS_S: Final = 1.0
# What a person can follow; a beacon that flaps must not fill the bus.
_STATE_S: Final = 0.05


@dataclass(slots=True)
class Work:
    """What is to be done now."""

    writes: list[tuple[str, bytes]] = field(default_factory=list)
    replies: list[tuple[int, BeaconReply]] = field(default_factory=list)
    states: list[BeaconState] = field(default_factory=list)


class ControllerCore:
    """All beacons of a site.

    Args:
        config: settings; the site's beacons that have a uid are kept.
        secret: signs commands; empty where none is asked for.
        seed: where the numbers of requests begin.
        started_ms: Unix time at which this process began.

    Raises:
        ConfigError: the site wants a beacon to send what none can.
    """

    def __init__(self, config: BeaconControllerConfig, secret: bytes, seed: int, started_ms: int) -> None:
        self._config = config
        self._random = random.Random(seed)  # noqa: S311 - numbers that must differ, not be secret
        self.authority = Authority(config, secret, started_ms)
        self._keepers: dict[str, Keeper] = {}
        for beacon in config.beacons:
            if not beacon.uid:
                continue
            try:
                keeper = Keeper(beacon, config)
            except ValueError as error:
                raise ConfigError(f"[[beacon]] {beacon.name}: {error}") from None
            self._keepers[keeper.uid] = keeper
        self._adapter = Adapter(config) if config.adapt else None
        self._lines: dict[str, Line] = {}
        self._tickets = 0
        self._replies: list[tuple[int, BeaconReply]] = []
        self._told: dict[str, tuple[BeaconState, float]] = {}
        self.counters: Counter[str] = Counter()

    @property
    def names(self) -> list[str]:
        """The beacons that are kept."""
        return [keeper.beacon.name for keeper in self._keepers.values()]

    @property
    def refusals(self) -> Refusals:
        """What was refused since the start, on the bus and on the lines."""
        total: Refusals = Counter(self.authority.refusals)
        for line in self._lines.values():
            total.update(line.refusals)
        return total

    @property
    def gauges(self) -> dict[str, float]:
        """How many beacons obey, and how many ports are left alone."""
        links = Counter(self._link_of(keeper) for keeper in self._keepers.values())
        alone = sum(line.phase == "left alone" for line in self._lines.values())
        return {"beacons": float(len(self._keepers)), "ready": float(links["ready"]), "left alone": float(alone)}

    # What comes in

    def opened(self, port: str, now_s: float) -> None:
        """Take note that a port is open."""
        if port not in self._lines:
            self._lines[port] = Line(port, self._config, self._claim, self._random.getrandbits(32))
        self.counters["ports opened"] += 1
        self._lines[port].opened(now_s)

    def closed(self, port: str, why: str) -> None:
        """Take note that a port has gone."""
        if port in self._lines:
            self.counters["ports lost"] += 1
            self._lines[port].closed(why)

    def heard(self, port: str, data: bytes, now_s: float) -> None:
        """Take what has come from a port."""
        if port in self._lines:
            self._lines[port].heard(data, now_s)

    def asked(self, asked_key: str, own_key: str, payload: bytes, wall_ms: int, now_s: float) -> int:
        """Take a command; return the ticket under which its reply will be given, once."""
        self._tickets += 1
        outcome = self.authority.check(asked_key, own_key, payload, wall_ms, now_s)
        if isinstance(outcome, Denied):
            name = own_key.rsplit("/", 2)[-2]
            reply = BeaconReply(
                name=name,
                nonce=outcome.nonce,
                outcome="refused",
                reason=outcome.reason.value,
                detail=outcome.detail[:300],
            )
            self._replies.append((self._tickets, reply))
            return self._tickets
        keeper = next(k for k in self._keepers.values() if k.beacon.name == outcome.name)
        keeper.take(self._tickets, outcome, now_s)
        if self._adapter is not None and outcome.bit_rate is not None:
            self._adapter.hold(outcome.name, now_s)
        return self._tickets

    def feed(self, message: Message, now_s: float) -> None:
        """Take what the decoder says of the links (closed loop)."""
        if self._adapter is not None:
            self._adapter.feed(message, now_s)

    # What goes out

    def step(self, now_s: float) -> Work:
        """Return all that is to be done now."""
        work = Work()
        for line in self._lines.values():
            # A command that a beacon cannot take ends without a request, and the next one is due at once.
            data = line.due(now_s)
            if data:
                work.writes.append((line.port, data))
        for keeper in self._keepers.values():
            link = self._link_of(keeper)
            keeper.expire(now_s, link)
            if self._adapter is not None and link == "ready":
                self._adapt(keeper, now_s)
            work.replies += keeper.replies
            keeper.replies.clear()
            self._tell(keeper.state(link, now_s), now_s, work)
        work.replies += self._replies
        self._replies.clear()
        for line in self._lines.values():
            if line.uid:
                self._tell(_stranger(line), now_s, work)
        return work

    def wake_s(self) -> float:
        """Return when `step` has something to do again, unless something comes in before."""
        lines = (line.wake_s() for line in self._lines.values())
        return min([*lines, *(keeper.deadline_s for keeper in self._keepers.values())], default=float("inf"))

    def _adapt(self, keeper: Keeper, now_s: float) -> None:
        if self._adapter is None or keeper.bit_rate is None:
            return
        rate = self._adapter.rate(keeper.beacon.name, keeper.bit_rate, now_s)
        if rate != keeper.bit_rate:
            self.counters["rates chosen"] += 1
            keeper.wanted_rate(rate)

    def _claim(self, uid: str, port: str) -> Keeper | str | None:
        keeper = self._keepers.get(uid.lower())
        if keeper is None:
            return None
        holder = self._holder(keeper)
        if holder is None or holder.port == port:
            return keeper
        if holder.phase == "bound" and holder.link == "ready":
            return f"uid {uid} is already on {holder.port}"
        holder.keeper = None  # it has been plugged in elsewhere
        return keeper

    def _holder(self, keeper: Keeper) -> Line | None:
        return next((line for line in self._lines.values() if line.keeper is keeper), None)

    def _link_of(self, keeper: Keeper) -> LinkWord:
        holder = self._holder(keeper)
        return "absent" if holder is None else holder.link

    def _tell(self, state: BeaconState, now_s: float, work: Work) -> None:
        """Publish a state where it says something new."""
        before, at_s = self._told.get(state.name, (None, -1e18))
        if before is not None:
            quiet_s = _COUNTERS_S if _essence(before) == _essence(state) else _STATE_S
            if now_s - at_s < quiet_s or (before.counters == state.counters and _essence(before) == _essence(state)):
                return
        self._told[state.name] = (state, now_s)
        work.states.append(state)


def _essence(state: BeaconState) -> BeaconState:
    """Return a state without what runs by itself."""
    unleased = {
        name: msgspec.structs.replace(settings, lease_s=0.0)
        for name in ("desired", "reported")
        if (settings := getattr(state, name)) is not None
    }
    return msgspec.structs.replace(state, counters={}, **unleased)


def _stranger(line: Line) -> BeaconState:
    """Return the state of a beacon that is left alone."""
    return BeaconState(
        name=f"uid-{line.uid}",
        uid=line.uid,
        port=line.port,
        link=line.link,
        desired=Settings(),
        reported=None,
        waiting=0,
        boots=0,
        counters={},
        trouble=line.trouble,
    )
