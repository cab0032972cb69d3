"""The loop of a service: bytes from the inbox, through the core, to the bus."""

from __future__ import annotations

import logging
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final

from heliograph.core import Core
from heliograph.errors import Refusal, by_name
from heliograph.messages import Message, Progress
from heliograph.shell.bus import Bus
from heliograph.shell.health import HealthReporter, Pulse
from heliograph.shell.hops import Hops
from heliograph.shell.inbox import Inbox, Sample
from heliograph.shell.process import Stop
from heliograph.wire import SCHEMAS, Header

if TYPE_CHECKING:
    from heliograph.shell.run import Launch, Service

_LOG = logging.getLogger(__name__)

_WAIT_S: Final = 0.1
# After this silence the core is told the time: longer than any heartbeat of a source, shorter than any time-out.
_SILENCE_S: Final = 0.25
# A core that faults on each of so many inputs in a row is broken, and a fresh process is the better one.
_FAULTS_LIMIT: Final = 50


class LockstepBroken(Exception):  # noqa: N818 - a state, told as one line
    """Something was lost in a run that may lose nothing."""


class Runner:
    """Feeds one core from one bus; see `heliograph.shell.run`."""

    def __init__(self, service: Service[Any], launch: Launch[Any], core: Core, bus: Bus) -> None:
        self._service = service
        self._launch = launch
        self._lockstep = launch.site.lockstep
        self._core = core
        self._bus = bus
        self._held: deque[Message] = deque()
        self._pulse = Pulse()
        self._pulse.hungry = bool(service.paced_by) and not self._lockstep
        self._pulse.counters = self._counters
        self._hops = Hops()
        self._pulse.gauges = lambda: dict(core.gauges) | self._hops.take()
        # In lockstep the sender waits for us: nothing to time.
        self._timed = "" if self._lockstep else service.timed or service.paced_by
        self._through_ns = 0
        self._frames_us: int | None = None
        self._faults = 0
        self._faults_in_row = 0
        self._last_us: int | None = None
        self._last_ns = 0

    def run(self, stop: Stop) -> int:
        """Work until the stop; return the exit status."""
        schemas = {**SCHEMAS, **self._service.extra_schemas}
        camera = getattr(self._launch.config, "camera", None)
        parts = {name: (camera,) for name, own in self._service.inputs.items() if own and camera}
        inbox = self._bus.subscribe({name: schemas[name] for name in self._service.inputs}, parts, self._service.queue)
        self._bus.announce(self._launch.kind, self._launch.instance)
        _LOG.info("running", extra={"fields": {"site": self._launch.site.site, "lockstep": self._lockstep}})
        reporter = HealthReporter(self._bus, self._launch.kind, self._launch.instance, self._pulse)
        try:
            while not stop:
                sample = inbox.get(_WAIT_S)
                if sample is not None:
                    self._take(sample)
                self._tick_in_silence()
                if self._faults_in_row >= _FAULTS_LIMIT:
                    _LOG.error("core faulted on %d inputs in a row: giving up", self._faults_in_row)
                    return 1
            if not self._service.paced_by:
                self._drain(inbox)
        except LockstepBroken as error:
            _LOG.error("lockstep broken: %s", error)
            return 1
        finally:
            reporter.close()
            close = getattr(self._core, "close", None)
            if close is not None:
                close()
        _LOG.info("stopped", extra={"fields": {"refused": by_name(self._core.refusals)}})
        return 0

    def _drain(self, inbox: Inbox) -> None:
        """Take what had arrived before the stop: of a service that nobody paces it would be lost without a word."""
        for _ in range(inbox.depth()):
            sample = inbox.get(0.0)
            if sample is not None:
                self._take(sample)

    def _take(self, sample: Sample) -> None:
        took_ns = time.monotonic_ns()
        opened = self._bus.open(sample)
        if opened is None:
            return
        header, message = opened
        self._number(sample, header)
        self._pulse.input_ns = time.monotonic_ns()
        if self._lockstep and self._service.paced_by == message.SCHEMA:
            self._held.append(message)
        else:
            self._feed(message)
            if self._timed == message.SCHEMA:
                self._hops.note(header, sample.arrived_ns, took_ns, self._through_ns, self._frames_us)
        while self._held and self._core.ready(self._held[0]):
            self._feed(self._held.popleft())

    def _number(self, sample: Sample, header: Header) -> None:
        strict = self._lockstep and bool(self._service.paced_by)
        missing = self._bus.gaps.see(sample.topic, sample.key, header, from_start=strict)
        if strict and missing:
            raise LockstepBroken(f"{missing} messages missing before {header.schema} number {header.seq}")
        dropped = self._bus.inbox.dropped if self._bus.inbox else {}
        if strict and any(dropped.values()):
            raise LockstepBroken(f"queue overflowed: {dict(dropped)}")

    def _feed(self, message: Message) -> None:
        self._pulse.busy_since_ns = time.monotonic_ns()
        try:
            results = self._core.feed(message)
            self._faults_in_row = 0
        except Exception:
            # The checks of the wire are the wall; what still gets through must not end a process in the field.
            if self._lockstep:
                raise
            self._faults += 1
            self._faults_in_row += 1
            if self._faults_in_row == 1:
                _LOG.exception("core refused %s at %d us", message.SCHEMA, message.time_us)
            return
        finally:
            self._pulse.busy_since_ns = None
            self._through_ns, self._frames_us = time.monotonic_ns(), None
        for result in results:
            self._bus.publish(result)
            if result.SCHEMA == "frames":
                self._frames_us = result.time_us
        if self._service.paced_by == message.SCHEMA:
            self._after_input(message)

    def _after_input(self, message: Message) -> None:
        self._last_us = message.time_us
        self._last_ns = time.monotonic_ns()
        if self._lockstep:
            self._bus.publish(
                Progress(
                    camera=getattr(message, "camera"),  # noqa: B009 - every paced record has it
                    service=self._launch.kind,
                    t_us=message.time_us,
                    done=getattr(message, "end", False),
                    published=self._bus.counts(),
                )
            )

    def _tick_in_silence(self) -> None:
        if self._lockstep or self._last_us is None:
            return
        silence_ns = time.monotonic_ns() - self._last_ns
        if silence_ns < _SILENCE_S * 1e9:
            return
        try:
            results = self._core.tick(self._last_us + silence_ns // 1000)
        except Exception:  # noqa: BLE001 - as in _feed
            self._faults += 1
            self._faults_in_row += 1
            _LOG.exception("core refused a tick")
            return
        for result in results:
            self._bus.publish(result)

    def _counters(self) -> dict[str, int]:
        counters = {f"refused: {name}": n for name, n in by_name(self._core.refusals).items()}
        if self._faults:
            counters[f"refused: {Refusal.CORE_FAULT.value}"] = self._faults
        return counters | dict(self._core.counters)
