"""Counts read from the metrics file: of a run, or of its last hours, from the tier that suits the length.

Up to `SECONDS_UP_TO_S` the blocks of the intervals are a beacon's seconds, as docs/metrics.md has it; beyond, minutes;
beyond `MINUTES_UP_TO_S`, hours. Longer blocks err to the wide side, and a week is read in the time of an hour. Where
the seconds have been pruned, minutes take their place.
"""

from __future__ import annotations

import math
import sqlite3
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import FileError

SECONDS_UP_TO_S: Final = 2 * 3_600
MINUTES_UP_TO_S: Final = 2 * 86_400
_MINUTE_S: Final = 60
_TIERS: Final = {1: ("count", "second"), 60: ("count_minute", "minute"), 3_600: ("count_hour", "hour")}

Counts = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Span:
    """What is read: a run, and of each of its streams the minutes [first, last].

    Args:
        run: its number.
        boot: its boot word.
        since_wall_s: rows written before are left out; -inf for none.
        streams: stream -> first and last minute.
        block_s: the length of a block: 1, 60 or 3600 s.
    """

    run: int
    boot: str
    since_wall_s: float
    streams: dict[int, tuple[int, int]]
    block_s: int


def span_of(connection: sqlite3.Connection, run: int | None = None, last_s: float | None = None) -> Span:
    """Return the span of a run, by default the newest, or of its last seconds by the host's clock.

    Raises:
        FileError: there is no such run.
    """
    newest = connection.execute(
        "SELECT id, boot, written_wall_s FROM run WHERE id = ifnull(?, (SELECT max(id) FROM run))", (run,)
    ).fetchone()
    if newest is None and run is not None:
        (first, last) = connection.execute("SELECT min(id), max(id) FROM run").fetchone()
        raise FileError(f"run must be {first} to {last}, the starts that the file holds, not {run}")
    if newest is None:
        return Span(0, "", -math.inf, {}, 1)
    run_id, boot, written_s = newest
    since_s = -math.inf if last_s is None else written_s - last_s
    rows = connection.execute(
        "SELECT p.stream, min(p.minute), max(p.minute), min(p.has_seconds) FROM span p JOIN stream s ON s.id = p.stream"
        " WHERE s.run = ? AND p.wall_s >= ? GROUP BY p.stream",
        (run_id, since_s),
    ).fetchall()
    streams = {stream: (first, last) for stream, first, last, _ in rows}
    length_s = sum((last - first + 1) * _MINUTE_S for first, last in streams.values())
    block_s = 3_600 if length_s > MINUTES_UP_TO_S else _MINUTE_S
    if length_s <= SECONDS_UP_TO_S and all(has_seconds for _, _, _, has_seconds in rows):
        block_s = 1
    return Span(run_id, boot, since_s, streams, block_s)


class Tallies:
    """The counts of a span, by kind (the word before the stroke).

    Args:
        connection: of the file.
        span: what to read.
        blocked: the kinds of which the blocks are wanted, not the sums alone.
    """

    def __init__(self, connection: sqlite3.Connection, span: Span, blocked: Sequence[str]) -> None:
        self.total: dict[str, int] = defaultdict(int)
        self.by_kind: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
        self._blocks: dict[str, dict[tuple[str, int, int], int]] = defaultdict(dict)
        names = dict(connection.execute("SELECT id, text FROM name"))
        wanted = [i for i, text in names.items() if text.partition("/")[0] in blocked]
        table, time = _TIERS[span.block_s]
        for stream, minutes in sorted(span.streams.items()):
            first, last = (_block_of(minutes[0], span.block_s)[0], _block_of(minutes[1], span.block_s)[1])
            where = f"FROM {table} WHERE stream = ? AND {time} BETWEEN ? AND ?"
            for name, n in connection.execute(f"SELECT name, sum(n) {where} GROUP BY name", (stream, first, last)):
                kind, _, what = names[name].partition("/")
                self.total[kind] += n
                self.by_kind[kind][what] += n
            if not wanted:
                continue
            marks = ",".join("?" * len(wanted))
            rows = connection.execute(
                f"SELECT {time}, name, n {where} AND name IN ({marks})",
                (stream, first, last, *wanted),
            )
            for at, name, n in rows:
                kind, _, what = names[name].partition("/")
                self._blocks[kind][what, stream, at] = n

    def columns(self, by: str, *kinds: str) -> npt.NDArray[np.int64]:
        """Return (kinds, k) counts over the k blocks of the things that `by` counts; neighbours in time are beside."""
        return self._table(sorted(self._blocks[by]), kinds)

    def all_columns(self, *kinds: str, what: str | None = None) -> npt.NDArray[np.int64]:
        """Return (kinds, k) counts over all blocks in which one of the kinds counts; of one thing, or of all."""
        keys = {key for kind in kinds for key in self._blocks[kind] if what is None or key[0] == what}
        return self._table(sorted(keys), kinds)

    def _table(self, keys: list[tuple[str, int, int]], kinds: Sequence[str]) -> Counts:
        table: Counts = np.array([[self._blocks[kind].get(key, 0) for key in keys] for kind in kinds], np.int64)
        return table.reshape(len(kinds), len(keys))


def process_numbers(connection: sqlite3.Connection, span: Span, prefix: str) -> dict[str, int]:
    """Return the newest counters of all processes whose names begin so, added by what follows."""
    rows = connection.execute(
        "SELECT substr(n.text, ?1), sum(h.value) FROM health h JOIN process p ON p.id = h.process"
        " JOIN name n ON n.id = h.name WHERE p.run = ?2 AND substr(n.text, 1, ?1 - 1) = ?3 GROUP BY 1 ORDER BY 1",
        (len(prefix) + 1, span.run, prefix),
    )
    return {name: int(value) for name, value in rows if value}


def process_series(connection: sqlite3.Connection, span: Span, table: str, figures: str) -> list[tuple[Any, ...]]:
    """Return (service/instance, name, figures ...) of a series of the processes, over the span, from its minutes.

    Args:
        connection: of the file.
        span: what to read.
        table: `rate`, `level` or `hop`.
        figures: SQL aggregates over its columns (`hop` etc. as `t`).
    """
    since_s = max(span.since_wall_s, -1e12)
    return connection.execute(
        f"SELECT p.service || '/' || p.instance, n.text, {figures} FROM {table}_minute t"  # noqa: S608
        " JOIN process p ON p.id = t.process JOIN name n ON n.id = t.name"
        f" WHERE p.run = ? AND p.started_wall_s + {_MINUTE_S} * (t.minute + 1) >= ?"
        " GROUP BY 1, 2 ORDER BY 1, 2",
        (span.run, since_s),
    ).fetchall()


def _block_of(minute: int, block_s: int) -> tuple[int, int]:
    """Return the first and the last block of a minute."""
    if block_s == 1:
        return _MINUTE_S * minute, _MINUTE_S * minute + _MINUTE_S - 1
    at = minute if block_s == _MINUTE_S else minute // _MINUTE_S
    return at, at
