"""The metrics sink as the shell runs it: the core, and the file behind it."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

from heliograph.core import Context
from heliograph.errors import Refusals
from heliograph.messages import Health, Message, Metrics
from heliograph.units import US_PER_S
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.core import MetricsCore
from heliograph_services.metrics_sink.exposition import Exposition
from heliograph_services.metrics_sink.scrape import Scrape
from heliograph_services.metrics_sink.store import SqliteStore
from heliograph_services.metrics_sink.tiers import Keep

_LOG = logging.getLogger(__name__)

# Of frames sent in sight; a decoder that has just begun compiles its kernels for a minute before it is announced, but
# a source that waits for it sends nothing until then.
UNREAD_S: Final = 5
# How often the page for Prometheus is made: scrapers come every 5 to 60 s.
PAGE_S: Final = 1.0


class MetricsSink:
    """A core (heliograph.core.Core) that also keeps its rows.

    The processes' health reports come once a second whatever the cameras do: they are what this service's sense of
    silence hangs on, since nothing paces it.

    Raises:
        FileError: the file exists and is no metrics file of this version.
        ConfigError: the port for Prometheus is taken.
    """

    def __init__(
        self, config: MetricsSinkConfig, context: Context, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._core = MetricsCore(config, context)
        keep = Keep(config.keep_seconds_h, config.keep_days)
        self._store = SqliteStore(config.file, context.boot, clock, keep=keep) if config.file else None
        self._scrape = Scrape(config.prometheus_port) if config.prometheus_port else None
        self._exposition = Exposition()
        self._page_s = clock()
        self._clock = clock
        self._quiet_s = config.settle_us / US_PER_S
        self._is_lockstep = context.lockstep
        self._unread = Unread()
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
        if isinstance(message, Health):
            self._exposition.hear(message, self._clock())
        return self._kept(results)

    def ready(self, message: Message) -> bool:
        """Return True: the sink waits for nobody."""
        return self._core.ready(message)

    def tick(self, now_us: int) -> list[Message]:
        """Finish what silence has made old."""
        return self._kept(self._core.tick(now_us))

    def close(self) -> list[Message]:
        """Finish all that waits, write it, and close the file."""
        results = self._kept(self._core.close())
        if self._store is not None:
            self._store.close()
        if self._scrape is not None:
            self._scrape.close()
        return results

    def _kept(self, results: list[Message]) -> list[Message]:
        """Keep what the core has made; return its messages."""
        for result in results:
            if isinstance(result, Metrics):
                self._unread.note(result)
        if self._scrape is not None:
            for result in results:
                if isinstance(result, Metrics):
                    self._exposition.add(result)
            if self._clock() >= self._page_s:
                self._page_s = self._clock() + PAGE_S
                self._scrape.page = self._exposition.page(self._clock())
        self._keep()
        return results

    def _keep(self) -> None:
        rows = self._core.take_rows()
        self.counters.update(self._core.counters)
        self.gauges.update(self._core.gauges)
        store = self._store
        if store is None:
            return
        if store.is_due and not store.is_failing:
            # While the disk fails they would only push out rows that are final.
            rows = rows + self._core.rows_so_far()
        store.write(rows)
        self.counters["store: rows"] = store.written
        self.counters["store: disk failures"] = store.failures
        self.counters["store: rows lost"] = store.dropped
        self.counters["store: rows pruned"] = store.pruned
        self.gauges["store: rows waiting"] = float(store.waiting)


class Unread:
    """Says once that a camera's truth tells of frames and nobody reads any: a site without its decoder, most often."""

    def __init__(self) -> None:
        self._seconds: Counter[str] = Counter()

    def note(self, message: Metrics) -> None:
        """Take the counts of a finished second."""
        cameras = {name.partition("/")[0] for name in message.counters}
        for camera in cameras:
            sent = any(name.startswith(f"{camera}/sent_visible/") for name in message.counters)
            if message.counters.get(f"{camera}/frames"):
                del self._seconds[camera]
            elif sent:
                self._seconds[camera] += 1
                if self._seconds[camera] == UNREAD_S:
                    _LOG.warning("%s: truth without frames for %d s: does a decoder run?", camera, UNREAD_S)


def make_core(config: MetricsSinkConfig, context: Context) -> MetricsSink:
    """Return the service's core.

    Raises:
        FileError: the file exists and is no metrics file of this version.
    """
    return MetricsSink(config, context)


def warm() -> None:
    """Do nothing: there are no kernels to compile here."""
