"""How a source's steps leave: at the camera's pace, at a factor of it, or in lockstep.

In lockstep the next step leaves when every awaited service has published `progress` up to the last one, and the first
when all of them are present and warm.
"""

from __future__ import annotations

import logging
import math
import secrets
import threading
import time
from collections.abc import Sequence
from typing import Any, Final

from heliograph.core import Context
from heliograph.errors import Refusal, by_name
from heliograph.keys import parse
from heliograph.messages import TIME_LIMIT_US, Progress
from heliograph.shell.bus import Bus, connected
from heliograph.shell.health import HealthReporter, Pulse
from heliograph.shell.links import client_config
from heliograph.shell.process import Stop, keep_out_of_collections
from heliograph.shell.run import Launch
from heliograph.shell.source import Source, Step, Stream

_LOG = logging.getLogger(__name__)
_WAIT_S: Final = 0.05
# Somebody is awaited this long before a line says whom.
_PATIENCE_S: Final = 5.0
# The streams that the awaited services report their progress on.
_WATERMARKED: Final = ("events", "onsets")
# A live source that falls further behind its pace gives up the lost time rather than hurry after it.
_LATE_LIMIT_S: Final = 0.5
# A camera's clock that leaps further than this within a step (a damaged file, a pause) is not slept through.
_JUMP_US: Final = 60_000_000


class _Awaited:
    """The services that a lockstep source waits for: present, and how far."""

    def __init__(self, bus: Bus, services: Sequence[str]) -> None:
        self._services = tuple(services)
        self._bus = bus
        self._here: set[str] = set()
        self._t_us: dict[str, int] = {}
        self._asked_us = -TIME_LIMIT_US
        self._changed = threading.Condition()

    def on_live(self, key_text: str, present: bool) -> None:
        found = parse(key_text)
        if found is None:
            return
        with self._changed:
            if present:
                self._here.add(found.parts[0])
            else:
                self._here.discard(found.parts[0])
            self._changed.notify_all()

    def present(self, stop: Stop, at_most_s: float = math.inf) -> bool:
        """Wait until all are there, or for so long; return False where a stop came first."""
        since = told = time.monotonic()
        with self._changed:
            while missing := [name for name in self._services if name not in self._here]:
                if stop:
                    return False
                now = time.monotonic()
                if now - since > at_most_s:
                    _LOG.warning("beginning without %s", ", ".join(missing))
                    return True
                if now - told > _PATIENCE_S:
                    told = now
                    _LOG.warning("waiting for %s to start", ", ".join(missing))
                self._changed.wait(_WAIT_S)
        return True

    def done(self, stop: Stop, t_us: int, sent_us: int) -> bool:
        """Wait until all are through with t_us; return False where a stop came first.

        Nobody can be through with more than was sent (sent_us): such a word is refused, not believed.
        """
        if t_us < self._asked_us:  # a new stream, whose time begins anew
            self._t_us.clear()
        self._asked_us = t_us

        def waiting() -> list[str]:
            return [name for name in self._services if self._t_us.get(name, t_us - 1) < t_us]

        inbox = self._bus.inbox
        since = time.monotonic()
        while waiting():
            if stop:
                return False
            sample = inbox.get(_WAIT_S) if inbox else None
            if sample is not None:
                opened = self._bus.open(sample)
                if opened is not None and isinstance(opened[1], Progress):
                    self._take(opened[1], sent_us)
            elif time.monotonic() - since > _PATIENCE_S:
                since = time.monotonic()
                _LOG.warning("waiting for %s to finish %d us", ", ".join(waiting()), t_us)
        return True

    def _take(self, progress: Progress, sent_us: int) -> None:
        if progress.service not in self._services:
            return
        if progress.t_us > sent_us:
            self._bus.refusals[Refusal.TIME_JUMP] += 1
            return
        self._t_us[progress.service] = max(progress.t_us, self._t_us.get(progress.service, progress.t_us))


def serve(source: Source[Any], launch: Launch[Any], stop: Stop) -> int:
    """Open the camera and the bus, and send until the stream ends or a stop comes; return the exit status."""
    context = Context(launch.instance, secrets.token_hex(3), launch.site.lockstep)
    stream = source.make(launch.config, context)
    keep_out_of_collections()
    with connected(client_config(launch.site.bus), launch.site.site, f"{launch.kind}/{launch.instance}", stop) as bus:
        if bus is None:
            return 0
        pulse = Pulse()
        pulse.counters = lambda: {f"refused: {n}": c for n, c in by_name(stream.refusals).items()} | stream.counters
        pulse.gauges = lambda: dict(stream.gauges)
        reporter = HealthReporter(bus, launch.kind, launch.instance, pulse)
        bus.announce(launch.kind, launch.instance)
        try:
            finished = _lockstep(bus, launch, stream, stop) if context.lockstep else _paced(bus, launch, stream, stop)
        finally:
            reporter.close()
        _LOG.info(
            "the recording has ended" if finished else "stopped",
            extra={"fields": {"refused": by_name(stream.refusals), **stream.counters}},
        )
    return 0


def _send(bus: Bus, step: Step) -> None:
    for message in step.messages:
        bus.publish(message)


def _lockstep(bus: Bus, launch: Launch[Any], stream: Stream, stop: Stop) -> bool:
    """Send each step when the last one is finished everywhere; return whether the stream came to its end."""
    camera = launch.config.camera
    bus.subscribe({"progress": Progress}, {"progress": (camera,)})
    awaited = _Awaited(bus, launch.config.wait_for)
    bus.watch("live", awaited.on_live)
    if not awaited.present(stop):
        return False
    _LOG.info("lockstep", extra={"fields": {"wait_for": list(launch.config.wait_for)}})
    marks: dict[str, int] = {}
    for step in stream:
        _send(bus, step)
        marks |= {message.SCHEMA: message.time_us for message in step.messages if message.SCHEMA in _WATERMARKED}
        # Onsets come less often than events: no service can be further than what it was sent.
        if len(marks) == len(_WATERMARKED) and not awaited.done(stop, min(marks.values()), max(marks.values())):
            return False
    return True


def _paced(bus: Bus, launch: Launch[Any], stream: Stream, stop: Stop) -> bool:
    """Send each step when the wall clock has reached it; return whether the stream came to its end."""
    pace = launch.config.pace
    if launch.config.await_s > 0:
        awaited = _Awaited(bus, launch.config.wait_for)
        bus.watch("live", awaited.on_live)
        if not awaited.present(stop, launch.config.await_s):
            return False
    start: tuple[float, int] | None = None
    before_us = 0
    for step in stream:
        if pace > 0:
            now = time.monotonic()
            if start is None:
                start, before_us = (now, step.t1_us), step.t1_us
            ahead_s = (step.t1_us - start[1]) / 1e6 / pace - (now - start[0])
            if ahead_s < -_LATE_LIMIT_S or step.t1_us - before_us > _JUMP_US:
                start = (now, step.t1_us)
                stream.counters["pace restarts"] = stream.counters.get("pace restarts", 0) + 1
            elif ahead_s > 0 and stop.wait(ahead_s):
                return False
            before_us = step.t1_us
        if stop:
            return False
        _send(bus, step)
    return True
