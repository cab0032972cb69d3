"""The metrics sink as the shell runs it: the core, and the file behind it."""

from __future__ import annotations

import time
from collections.abc import Callable

from heliograph.core import Context
from heliograph.errors import Refusals
from heliograph.messages import Health, Message
from heliograph.units import US_PER_S
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.core import MetricsCore
from heliograph_services.metrics_sink.store import SqliteStore


class MetricsSink:
    """A core (heliograph.core.Core) that also keeps its rows.

    The processes' health reports come once a second whatever the cameras do: they are what this service's sense of
    silence hangs on, since nothing paces it.

    Raises:
        FileError: the file exists and is no metrics file of this version.
    """

    def __init__(
        self, config: MetricsSinkConfig, context: Context, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._core = MetricsCore(config, context)
        self._store = SqliteStore(config.file, context.boot, clock) if config.file else None
        self._clock = clock
        self._quiet_s = config.settle_us / US_PER_S
        self._is_lockstep = context.lockstep
        self._heard_s = clock()
        self.refusals: Refusals = self._core.refusals
        self.counters: dict[str, int] = {}
        self.gauges: dict[str, float] = {}
        self._keep()

    def feed(self, message: Message) -> list[Message]:
        """Take one message; return the Metrics of the seconds that are finished by it."""
        results = self._core.feed(message)
        if not isinstance(message, Health):
            self._heard_s = self._clock()
        elif not self._is_lockstep and self._clock() - self._heard_s > self._quiet_s:
            results += self._core.idle()
        self._keep()
        return results

    def ready(self, message: Message) -> bool:
        """Return True: the sink waits for nobody."""
        return self._core.ready(message)

    def tick(self, now_us: int) -> list[Message]:
        """Finish what silence has made old."""
        results = self._core.tick(now_us)
        self._keep()
        return results

    def close(self) -> list[Message]:
        """Finish all that waits, write it, and close the file."""
        results = self._core.close()
        self._keep()
        if self._store is not None:
            self._store.close()
        return results

    def _keep(self) -> None:
        rows = self._core.take_rows()
        self.counters.update(self._core.counters)
        self.gauges.update(self._core.gauges)
        store = self._store
        if store is None:
            return
        store.write(rows)
        self.counters["store: rows"] = store.written
        self.counters["store: disk failures"] = store.failures
        self.counters["store: rows lost"] = store.dropped
        self.gauges["store: rows waiting"] = float(store.waiting)


def make_core(config: MetricsSinkConfig, context: Context) -> MetricsSink:
    """Return the service's core.

    Raises:
        FileError: the file exists and is no metrics file of this version.
    """
    return MetricsSink(config, context)


def warm() -> None:
    """Do nothing: there are no kernels to compile here."""
