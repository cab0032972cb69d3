"""The metrics sink's core: messages of a site in, counts of whole seconds of camera time out.

Each camera's time is cut into seconds. A second is *matched* (frames against truth) `settle_us` after its end, and
*finished* (its leftovers are insertions, its rows and its Metrics message are made) once the second after it is
matched too. What arrives in between may come in any order; what comes later is counted as `late`.

Counters of a Metrics message are called `{camera}/{counter}`; the list is in this service's README.
"""

from __future__ import annotations

from collections import Counter

from heliograph.core import Context
from heliograph.errors import Refusal, Refusals
from heliograph.messages import Data, Frames, Health, Identification, Link, Message, Metrics, Tracks
from heliograph.truth import Truth
from heliograph_services.metrics_sink.book import Book
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.processes import Processes
from heliograph_services.metrics_sink.rows import Row

SERVICE = "metrics_sink"
# A site has a handful of cameras; names beyond this are damage, and each would cost a book.
CAMERAS_LIMIT = 64


class MetricsCore:
    """Counts of everything that the other services publish; see the module."""

    def __init__(self, config: MetricsSinkConfig, context: Context) -> None:
        self._config = config
        self._context = context
        self._books: dict[str, Book] = {}
        self._processes = Processes()
        self._rows: list[Row] = []
        self.refusals: Refusals = Counter()
        self.counters: dict[str, int] = {"seconds": 0, "late": 0, "dropped": 0}
        self.gauges: dict[str, float] = {"cameras": 0.0, "waiting": 0.0}

    def feed(self, message: Message) -> list[Message]:
        """Take one message and return the Metrics of the seconds that are finished by it."""
        if isinstance(message, Health):
            self._rows += self._processes.take(message)
            self.counters["dropped"] = self._dropped()
            return []
        if not isinstance(message, Frames | Identification | Data | Link | Tracks | Truth):
            return []
        book = self._books.get(message.camera)
        if book is None:
            if len(self._books) >= CAMERAS_LIMIT:
                self.refusals[Refusal.OTHER_CAMERA] += 1
                return []
            book = self._books[message.camera] = Book(message.camera, self._config)
        return self._collect(book, book.take(message))

    def ready(self, message: Message) -> bool:  # noqa: ARG002 - the contract of a core
        """Return True: the sink waits for nobody."""
        return True

    def tick(self, now_us: int) -> list[Message]:
        """Finish what silence has made old; with several cameras one time says nothing of the others'."""
        if len(self._books) != 1:
            return []
        (book,) = self._books.values()
        is_old = book.clock_us is not None and now_us - book.clock_us > self._config.settle_us
        return self._collect(book, book.idle()) if is_old else []

    def idle(self) -> list[Message]:
        """Finish what waits, on all cameras: nothing has come from any of them for long."""
        return [message for book in self._books.values() for message in self._collect(book, book.idle())]

    def close(self) -> list[Message]:
        """Finish everything that waits: the service stops."""
        return [message for book in self._books.values() for message in self._collect(book, book.close())]

    def take_rows(self) -> list[Row]:
        """Return the rows made since the last call; a later row of the same key replaces an older one."""
        rows, self._rows = self._rows, []
        return rows

    def rows_so_far(self) -> list[Row]:
        """Return what is known of the seconds that are not finished (`Book.rows_so_far`)."""
        return [row for book in self._books.values() for row in book.rows_so_far()]

    def _dropped(self) -> int:
        return self._processes.dropped + sum(each.dropped for each in self._books.values())

    def _collect(self, book: Book, finished: list[tuple[int, dict[str, int]]]) -> list[Message]:
        self._rows += book.take_rows()
        self.refusals.update(book.take_refusals())
        self.counters["seconds"] += len(finished)
        self.counters["late"] = sum(each.late for each in self._books.values())
        self.counters["dropped"] = self._dropped()
        self.gauges["cameras"] = float(len(self._books))
        self.gauges["waiting"] = float(sum(each.waiting for each in self._books.values()))
        return [
            Metrics(
                service=SERVICE,
                instance=self._context.instance,
                t0_us=second * 1_000_000,
                t1_us=(second + 1) * 1_000_000,
                counters={f"{book.camera}/{name}": n for name, n in sorted(counts.items())},
                gauges={f"{book.camera}/sightings": float(book.sightings)},
            )
            for second, counts in finished
        ]


def make_core(config: MetricsSinkConfig, context: Context) -> MetricsCore:
    """Return the core of a configuration."""
    return MetricsCore(config, context)
