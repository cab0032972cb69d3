"""What a process says of itself once a second, from its own thread: a stuck core still reports that it is stuck."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Final, Literal

from heliograph.errors import by_name
from heliograph.messages import Health
from heliograph.shell.bus import Bus

_LOG = logging.getLogger(__name__)

_PERIOD_S: Final = 1.0
# A source sends a heartbeat at least every few ms; two seconds without input are a fault on the way.
_STARVED_S: Final = 2.0
# No input of a sane size takes the core a second; warm-up is over before the first.
_STUCK_S: Final = 2.0

State = Literal["warming", "running", "starved", "stuck", "stopping"]


class Pulse:
    """What the working thread leaves for the reporter: two time stamps and the numbers of its core."""

    def __init__(self) -> None:
        self.input_ns: int | None = None
        self.busy_since_ns: int | None = None
        self.hungry = False  # whether it ought to have input all the time
        self.counters: Callable[[], dict[str, int]] = dict
        self.gauges: Callable[[], dict[str, float]] = dict


class HealthReporter:
    """Publishes `Health` each second until it is closed."""

    def __init__(self, bus: Bus, service: str, instance: str, pulse: Pulse) -> None:
        self._bus = bus
        self._service = service
        self._instance = instance
        self._pulse = pulse
        self._start_ns = time.monotonic_ns()
        self._cpu = (self._start_ns, time.process_time_ns())
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="health")
        self._thread.start()

    def close(self) -> None:
        """Send a last report and end."""
        self._end.set()
        self._thread.join(timeout=_PERIOD_S)

    def _run(self) -> None:
        while not self._end.wait(_PERIOD_S):
            self._report(None)
        self._report("stopping")

    def _report(self, state: State | None) -> None:
        try:
            self._bus.publish(self._health(state))
        except Exception:  # noqa: BLE001 - the reporter must not end a process that works
            _LOG.exception("health report failed")

    def _health(self, state: State | None) -> Health:
        now = time.monotonic_ns()
        pulse = self._pulse
        cpu = time.process_time_ns()
        share = (cpu - self._cpu[1]) / max(1, now - self._cpu[0])
        self._cpu = (now, cpu)
        age_s = None if pulse.input_ns is None else (now - pulse.input_ns) / 1e9
        return Health(
            service=self._service,
            instance=self._instance,
            pid=os.getpid(),
            state=state or self._state(now, age_s),
            uptime_s=round((now - self._start_ns) / 1e9, 3),
            input_age_s=None if age_s is None else round(max(0.0, age_s), 3),
            cpu_share=round(share, 4),
            counters=self._counters(),
            gauges=self._gauges(),
        )

    def _state(self, now: int, age_s: float | None) -> State:
        busy = self._pulse.busy_since_ns
        if busy is not None and (now - busy) / 1e9 > _STUCK_S:
            return "stuck"
        uptime_s = (now - self._start_ns) / 1e9
        if self._pulse.hungry and (uptime_s if age_s is None else age_s) > _STARVED_S:
            return "starved"
        return "running"

    def _counters(self) -> dict[str, int]:
        bus = self._bus
        counters = {f"refused: {name}": n for name, n in by_name(bus.refusals).items()}
        for label, counts in (
            ("published", bus.published),
            ("received", bus.received),
            ("missing", bus.gaps.missing),
            ("dropped", bus.inbox.dropped if bus.inbox else {}),
        ):
            counters |= {f"{label}: {topic}": n for topic, n in counts.items()}
        return counters | {"bytes out": bus.bytes_out} | self._pulse.counters()

    def _gauges(self) -> dict[str, float]:
        depth = self._bus.inbox.depth() if self._bus.inbox else 0
        return {"queue": float(depth)} | self._pulse.gauges()
