"""The read-out of asynchronous sensors (DAVIS346, IMX636, GenX320): pixels ask for a bus, one event passes at a time.

::

    d_k = max(t_k, d_(k-1) + 1 / bus_hz)          the time at which event k passes, and its time stamp, rounded down
    k waits from t_k to d_k; where `queue_events` wait already, it is lost and counted

First come, first served (assumed: the real arbiters go by rows, so that within a burst the order of rows differs; what
passes a second, and for how long a burst is delayed, does not depend on the order). Nothing else is lost or changed.
Not simulated: event rate controllers, filters and USB links behind the sensor.
"""

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np

from heliograph.events import EventBatch
from heliograph_services.event_source.simulation.contract import Labels, PixelEvents
from heliograph_services.event_source.simulation.readout.numbers import AerNumbers

COUNTERS: Final = ("events in", "read", "lost: bus full", "waiting")


class AerReadout:
    """Passes the events of one sensor's pixels over its bus.

    Args:
        numbers: of the bus.
        width: pixels.
        height: pixels.
    """

    def __init__(self, numbers: AerNumbers, width: int, height: int) -> None:
        del height
        self._width = width
        self._spacing_us = 1e6 / numbers.bus_hz
        self._resolution_us = numbers.resolution_us
        # When the last `queue_events` events passed: the oldest is the one that must have passed for the next to wait.
        self._passed_us = np.full(numbers.queue_events, -np.inf)
        self._accepted = 0
        self._until_us = 0
        self._waiting = _Waiting.none()
        self.counters: dict[str, int] = dict.fromkeys(COUNTERS, 0)

    @property
    def until_us(self) -> int:
        """All events before this time have been returned."""
        return self._until_us

    def feed(self, events: PixelEvents, until_us: float) -> tuple[EventBatch, Labels]:
        """Return the events that have passed by until_us, in the order in which they did, and the cause of each.

        Args:
            events: all in [the previous until_us, until_us).
            until_us: the pixels have no more events before this time.
        """
        d_us, taken = _pass(events.t_us, self._spacing_us, self._passed_us, self._accepted)
        self._accepted += int(np.count_nonzero(taken))
        queue = self._waiting.followed_by(d_us[taken], events.pixel[taken], events.on[taken], events.cause[taken])
        n = int(np.searchsorted(queue.d_us, until_us, side="left"))
        passed, self._waiting = queue.part(0, n), queue.part(n, len(queue.d_us))
        self._until_us = int(until_us // self._resolution_us) * self._resolution_us
        self.counters["events in"] += len(events)
        self.counters["read"] += n
        self.counters["lost: bus full"] += len(events) - int(np.count_nonzero(taken))
        self.counters["waiting"] = len(self._waiting.d_us)
        batch = EventBatch(
            (passed.d_us // self._resolution_us).astype(np.int64) * self._resolution_us,
            (passed.pixel % self._width).astype(np.uint16),
            (passed.pixel // self._width).astype(np.uint16),
            passed.on,
        )
        return batch, passed.cause


class _Waiting:
    """Events with the times at which they pass."""

    def __init__(self, d_us: Any, pixel: Any, on: Any, cause: Any) -> None:
        self.d_us, self.pixel, self.on, self.cause = d_us, pixel, on, cause

    @classmethod
    def none(cls) -> _Waiting:
        return cls(np.empty(0), np.empty(0, np.int64), np.empty(0, np.bool_), np.empty(0, np.int16))

    def part(self, start: int, stop: int) -> _Waiting:
        return _Waiting(*(a[start:stop] for a in (self.d_us, self.pixel, self.on, self.cause)))

    def followed_by(self, d_us: Any, pixel: Any, on: Any, cause: Any) -> _Waiting:
        if not len(self.d_us):
            return _Waiting(d_us, pixel, on, cause)
        pairs = ((self.d_us, d_us), (self.pixel, pixel), (self.on, on), (self.cause, cause))
        return _Waiting(*(np.concatenate(pair) for pair in pairs))


@numba.njit(cache=True, nogil=True)
def _pass(t_us: Any, spacing_us: Any, passed_us: Any, accepted: Any) -> Any:
    """Return when each event passes (n,) float64, and whether it does (n,) bool; passed_us is a ring."""
    n, depth = len(t_us), len(passed_us)
    d_us, taken = np.empty(n, np.float64), np.zeros(n, np.bool_)
    last_us = passed_us[(accepted - 1) % depth]
    for i in range(n):
        d_us[i] = np.inf
        if passed_us[accepted % depth] > t_us[i]:
            continue
        last_us = max(t_us[i], last_us + spacing_us)
        d_us[i], taken[i], passed_us[accepted % depth] = last_us, True, last_us
        accepted += 1
    return d_us, taken
