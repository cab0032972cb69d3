"""Small recordings for tests: random events, and files of every format made of them by faery."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import faery
import numpy as np

from heliograph.core import Context
from heliograph.events import EventBatch, concatenate
from heliograph.messages import Message
from heliograph.streams import Events, Onsets
from heliograph_services.event_source.cameras.formats.npz import write_npz
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import SourceStream, open_stream

WIDTH, HEIGHT = 320, 240
LOCKSTEP = Context(instance="test", boot="0", lockstep=True)
LIVE = Context(instance="test", boot="0", lockstep=False)
# What faery writes: the name of a file, and the options of its writer.
BY_FAERY: dict[str, dict[str, Any]] = {
    "a.aedat4": {}, "three.raw": {"version": "evt3"}, "two.raw": {"version": "evt2"}, "d.dat": {}, "s.es": {},
    "c.csv": {},
}  # fmt: skip


def random_events(n: int = 20_000, seconds: float = 0.3, start_us: int = 5_000_000, seed: int = 0) -> EventBatch:
    """Return events all over the sensor, several of them at one time."""
    random = np.random.default_rng(seed)
    t = np.sort(random.integers(start_us, start_us + int(seconds * 1e6), n)).astype(np.int64)
    x = random.integers(0, WIDTH, n).astype(np.uint16)
    return EventBatch(t, x, random.integers(0, HEIGHT, n).astype(np.uint16), random.random(n) < 0.5)


def sorted_within_times(batch: EventBatch) -> EventBatch:
    """Return the events ordered by (t, y, x, on): formats may reorder events of one time."""
    order = np.lexsort((batch.on, batch.x_px, batch.y_px, batch.t_us))
    return EventBatch(batch.t_us[order], batch.x_px[order], batch.y_px[order], batch.on[order])


def write_by_faery(path: Path, batch: EventBatch, options: dict[str, Any]) -> Path:
    """Write a file with faery and return its path."""

    class Stream(faery.FiniteEventsStream):  # type: ignore[misc]  # faery ships no types
        def dimensions(self) -> tuple[int, int]:
            return (WIDTH, HEIGHT)

        def time_range(self) -> Any:
            return (
                faery.Time(microseconds=int(batch.t_us[0])),
                faery.Time(microseconds=int(batch.t_us[-1]) + 1),
            )

        def __iter__(self) -> Iterator[Any]:
            for start in range(0, len(batch), 3000):
                part = batch.part(start, start + 3000)
                packet = np.zeros(len(part), faery.EVENTS_DTYPE)
                packet["t"], packet["x"], packet["y"], packet["on"] = part.t_us, part.x_px, part.y_px, part.on
                yield packet

    Stream().to_file(path, zero_t0=False, **options)
    return path


def write_every_format(folder: Path, batch: EventBatch) -> list[Path]:
    """Write the events in every format but MATLAB, and return the paths."""
    paths = [write_by_faery(folder / name, batch, options) for name, options in BY_FAERY.items()]
    write_npz(folder / "n.npz", WIDTH, HEIGHT, [batch])
    return [*paths, folder / "n.npz"]


def opened(path: Path | str, context: Context = LOCKSTEP, **settings: Any) -> SourceStream:
    """Return the stream of a recording."""
    return open_stream(EventSourceConfig(file=str(path), **settings), context)


def messages_of(stream: SourceStream) -> list[Message]:
    """Return all records of a stream."""
    return [message for step in stream for message in step.messages]


def events_of(messages: list[Message]) -> EventBatch:
    """Return the events of the records, joined."""
    return concatenate([m.batch for m in messages if isinstance(m, Events)])


def onsets_of(messages: list[Message]) -> list[tuple[int, int, int, int, int]]:
    """Return (time of the tick, y, x, on, off) of the records' onsets."""
    rows = []
    for m in messages:
        if isinstance(m, Onsets):
            t = m.t0_us + m.tick.astype(np.int64) * m.tick_us
            columns = (t, m.y_px, m.x_px, m.on_count, m.off_count)
            rows += list(zip(*(column.tolist() for column in columns), strict=True))
    return rows
