"""The beacon controller as a process: its ports, its queries, and the core between them, in one loop.

Threads only move things into one queue: a thread a port (`ports`), a thread a beacon's key
(`heliograph.shell.queries`). The loop takes them out, gives the core the time, and does what it says.
"""

from __future__ import annotations

import logging
import queue
import secrets
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heliograph.beacons import BeaconReply
from heliograph.errors import ConfigError
from heliograph.keys import key
from heliograph.messages import Identification, Link
from heliograph.shell.process import Stop
from heliograph_services.beacon_controller.config import BeaconControllerConfig
from heliograph_services.beacon_controller.core import ControllerCore
from heliograph_services.beacon_controller.ports import PortEvent, Ports

if TYPE_CHECKING:
    from heliograph.shell.bus import Bus
    from heliograph.shell.health import Pulse
    from heliograph.shell.queries import Question
    from heliograph.shell.run import Launch

_LOG = logging.getLogger(__name__)
# A stop, and a state that was held back, are noticed within this.
_WAIT_S: Final = 0.05
# Bytes of a line come in pieces of a frame or more; a thousand waiting are a second of ten busy lines.
_QUEUE_LIMIT: Final = 4096
# Below, a secret can be guessed.
_SECRET_BYTES: Final = 16


def secret_of(path: str) -> bytes:
    """Return the secret that signs commands; empty where no file is named.

    Raises:
        ConfigError: the file cannot be read, or holds too little.
    """
    if not path:
        return b""
    try:
        secret = Path(path).read_bytes().strip()
    except OSError as error:
        raise ConfigError(f"secret_file {path}: {error.strerror}") from None
    if len(secret) < _SECRET_BYTES:
        raise ConfigError(f"secret_file {path}: a secret must have at least {_SECRET_BYTES} bytes, not {len(secret)}")
    return secret


def serve(launch: Launch[BeaconControllerConfig], stop: Stop) -> int:
    """Run the controller until it is stopped; return its exit status.

    Raises:
        ConfigError: the site wants a beacon to send what none can, or the secret cannot be read.
        BusError: the bus cannot be opened.
    """
    from heliograph.shell.bus import connected  # noqa: PLC0415 - zenoh, not needed for --help
    from heliograph.shell.links import client_config  # noqa: PLC0415

    secret = secret_of(launch.config.secret_file)
    core = ControllerCore(launch.config, secret, secrets.randbits(32), time.time_ns() // 1_000_000)
    source = f"{launch.kind}/{launch.instance}"
    with connected(client_config(launch.site.bus), launch.site.site, source, stop) as bus:
        if bus is None:
            return 0
        Controller(launch, core, bus).run(stop)
    return 0


class Controller:
    """The loop of the process.

    Args:
        launch: site, name and settings.
        core: what decides.
        bus: the open bus.
    """

    def __init__(self, launch: Launch[BeaconControllerConfig], core: ControllerCore, bus: Bus) -> None:
        self._launch = launch
        self._config = launch.config
        self._core = core
        self._bus = bus
        self._events: queue.Queue[PortEvent | Question] = queue.Queue(_QUEUE_LIMIT)
        self._questions: dict[int, Question] = {}
        self._cut_short = 0
        self._links: dict[str, str] = {}
        # What the reporter's thread reads: made here, so that it never sees the core at work.
        self._numbers: tuple[dict[str, int], dict[str, float]] = ({}, {})

    def run(self, stop: Stop) -> None:
        """Work until the stop."""
        from heliograph.shell.health import HealthReporter, Pulse  # noqa: PLC0415 - as in serve
        from heliograph.shell.queries import answering  # noqa: PLC0415

        pulse = Pulse()
        pulse.counters = lambda: self._numbers[0]
        pulse.gauges = lambda: self._numbers[1]
        if self._config.adapt:
            self._bus.subscribe({"ids": Identification, "link": Link})
        for name in self._core.names:
            answering(self._bus, key(self._bus.site, "beacon", name, "cmd"), self._events.put)
        ports = Ports(self._config.ports, self._config.baud, self._config.reopen_s, self._events.put)
        self._bus.announce(self._launch.kind, self._launch.instance)
        _LOG.info("running", extra={"fields": {"site": self._bus.site, "ports": self._config.ports}})
        reporter = HealthReporter(self._bus, self._launch.kind, self._launch.instance, pulse)
        try:
            while not stop:
                self._take_events(pulse)
                self._take_links()
                self._do(ports)
        finally:
            reporter.close()
            ports.close()
            for question in self._questions.values():
                question.drop()
        _LOG.info("stopped")

    def _take_events(self, pulse: Pulse) -> None:
        """Wait for the next thing, and take all that is there."""
        wait_s = min(_WAIT_S, max(0.0, self._core.wake_s() - time.monotonic()))
        try:
            event = self._events.get(timeout=wait_s) if wait_s else self._events.get_nowait()
        except queue.Empty:
            return
        pulse.input_ns = time.monotonic_ns()
        while True:
            self._take(event)
            try:
                event = self._events.get_nowait()
            except queue.Empty:
                return

    def _take(self, event: PortEvent | Question) -> None:
        now_s = time.monotonic()
        if not isinstance(event, PortEvent):
            ticket = self._core.asked(event.key, event.own_key, event.payload, time.time_ns() // 1_000_000, now_s)
            self._questions[ticket] = event
        elif event.what == "heard":
            self._core.heard(event.port, event.data, now_s)
        elif event.what == "opened":
            self._core.opened(event.port, now_s)
            _LOG.info("port %s is open", event.port)
        else:
            self._core.closed(event.port, event.why)
            _LOG.warning("port %s is lost: %s", event.port, event.why)

    def _take_links(self) -> None:
        inbox = self._bus.inbox
        while inbox is not None and (sample := inbox.get(0.0)) is not None:
            opened = self._bus.open(sample)
            if opened is not None:
                self._core.feed(opened[1], time.monotonic())

    def _do(self, ports: Ports) -> None:
        work = self._core.step(time.monotonic())
        for port, data in work.writes:
            if not ports.write(port, data):
                self._cut_short += 1
        self._numbers = self._counters(), self._core.gauges
        for ticket, reply in work.replies:
            self._answer(ticket, reply)
        for state in work.states:
            self._bus.publish(state)
            if self._links.get(state.name) != state.link:
                self._links[state.name] = state.link
                _LOG.info("beacon %s is %s", state.name, state.link, extra={"fields": {"trouble": state.trouble}})

    def _answer(self, ticket: int, reply: BeaconReply) -> None:
        question = self._questions.pop(ticket, None)
        if question is not None:
            question.answer(self._bus, reply)
        if reply.outcome == "refused":
            _LOG.warning("refused a command for %s: %s: %s", reply.name, reply.reason, reply.detail)

    def _counters(self) -> dict[str, int]:
        counters = {f"refused: {reason.value}": n for reason, n in self._core.refusals.items()}
        return counters | dict(self._core.counters) | {"writes cut short": self._cut_short}
