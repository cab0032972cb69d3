"""Counts read from the metrics file: of a run, or of its last hours, from the tier that suits the length.

The blocks of the intervals are a beacon's seconds, as docs/metrics.md has it, while these are at most `CELLS_LIMIT`
numbers; beyond, minutes; beyond that, hours. Longer blocks err to the wide side, and a week is read in the time of an
hour. Where the seconds have been pruned, minutes take their place.
"""

from __future__ import annotations

import sqlite3
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import FileError
from heliograph_services.metrics_sink.schema import TIERS

# 1.5 us each in Python: a tenth of a second. With five beacons and their truth 24 minutes of seconds, a day of minutes.
CELLS_LIMIT: Final = 80_000
# Ten processes have a hundred numbers a minute: a day of them is added up in a twentieth of a second.
PROCESS_MINUTES_UP_TO_S: Final = 86_400
# Before any clock (30,000 years ago); SQL has no word for infinity.
EVER_S: Final = -1e12
_MINUTE_S: Final = 60
_TIER_OF: Final = {step_s: (tier, time) for tier, (time, step_s) in TIERS.items()}
# table -> what is added of a process's steps, and of the processes of one name.
_FIGURES: Final = {
    "rate": ("sum(t.n) AS n", "sum(s.n)"),
    "level": ("max(t.value) AS value, sum(t.n) AS n", "max(s.value), sum(s.n)"),
    "hop": (
        "sum(t.n) AS n, sum(t.n * t.p50_us) AS p50_sum, max(t.p95_us) AS p95_us, max(t.p99_us) AS p99_us",
        "sum(s.n), sum(s.p50_sum) * 1.0 / max(sum(s.n), 1), max(s.p95_us), max(s.p99_us)",
    ),
}

Counts = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Span:
    """What is read: a run, and of each of its streams the minutes [first, last].

    Args:
        run: its number.
        boot: its boot word.
        since_wall_s: rows written before are left out; EVER_S for none.
        streams: stream -> first and last minute.
        block_s: the length of a block: 1, 60 or 3600 s.
        process_step_s: of what the processes' numbers are read: 60 or 3600 s.
    """

    run: int
    boot: str
    since_wall_s: float
    streams: dict[int, tuple[int, int]]
    block_s: int
    process_step_s: int


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
        return Span(0, "", EVER_S, {}, 1, _MINUTE_S)
    run_id, boot, written_s = newest
    since_s = EVER_S if last_s is None else written_s - last_s
    rows = connection.execute(
        "SELECT p.stream, min(p.minute), max(p.minute), min(p.has_seconds) FROM span p JOIN stream s ON s.id = p.stream"
        " WHERE s.run = ? AND p.wall_s >= ? GROUP BY p.stream",
        (run_id, since_s),
    ).fetchall()
    streams = {stream: (first, last) for stream, first, last, _ in rows}
    block_s = _block_s(connection, streams, has_seconds=all(row[3] for row in rows))
    (began_s,) = connection.execute("SELECT min(started_wall_s) FROM process WHERE run = ?", (run_id,)).fetchone()
    length_s = written_s - max(since_s, began_s or since_s)
    return Span(run_id, boot, since_s, streams, block_s, 3_600 if length_s > PROCESS_MINUTES_UP_TO_S else _MINUTE_S)


def _block_s(connection: sqlite3.Connection, streams: dict[int, tuple[int, int]], *, has_seconds: bool) -> int:
    """Return the shortest block of which there are not too many numbers."""
    cells_a_minute = 0
    for stream, (first, last) in streams.items():
        (names,) = connection.execute(
            "SELECT count(DISTINCT name) FROM count_hour WHERE stream = ? AND hour BETWEEN ? AND ?",
            (stream, _block_of(first, 3_600)[0], _block_of(last, 3_600)[0]),
        ).fetchone()
        cells_a_minute += names * (last - first + 1)
    if has_seconds and cells_a_minute * _MINUTE_S <= CELLS_LIMIT:
        return 1
    return _MINUTE_S if cells_a_minute <= CELLS_LIMIT else 3_600


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
        tier, time = _TIER_OF[span.block_s]
        for stream, minutes in sorted(span.streams.items()):
            first, last = (_block_of(minutes[0], span.block_s)[0], _block_of(minutes[1], span.block_s)[1])
            where = f"FROM count{tier} WHERE stream = ? AND {time} BETWEEN ? AND ?"
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
            cells = {}
            for name in wanted:
                kind, _, what = names[name].partition("/")
                cells[name] = (self._blocks[kind], what)
            for at, name, n in rows:
                blocks, what = cells[name]
                blocks[what, stream, at] = n

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


def process_series(connection: sqlite3.Connection, span: Span, table: str) -> list[tuple[Any, ...]]:
    """Return (service/instance, name, figures ...) of a series of the processes, over the span.

    From its minutes, or hours where the span is long; added by number first, since words would cost most.

    Args:
        connection: of the file.
        span: what to read.
        table: `rate` (then n follows), `level` (greatest value, n) or `hop` (n, mean p50, greatest p95 and p99, us).
    """
    step_s = span.process_step_s
    tier, time = _TIER_OF[step_s]
    of_process, of_name = _FIGURES[table]
    # CROSS JOIN keeps the order: from a run's processes into the key (process, time, name).
    return connection.execute(
        f"WITH s AS MATERIALIZED (SELECT t.process, t.name, {of_process} FROM process p CROSS JOIN {table}{tier} t"  # noqa: S608
        f" ON t.process = p.id AND t.{time} >= (?2 - p.started_wall_s) / {step_s} - 1"
        " WHERE p.run = ?1 GROUP BY 1, 2)"
        f" SELECT p.service || '/' || p.instance, n.text, {of_name} FROM s JOIN process p ON p.id = s.process"
        " JOIN name n ON n.id = s.name GROUP BY 1, 2 ORDER BY 1, 2",
        (span.run, span.since_wall_s),
    ).fetchall()


def _block_of(minute: int, block_s: int) -> tuple[int, int]:
    """Return the first and the last block of a minute."""
    if block_s == 1:
        return _MINUTE_S * minute, _MINUTE_S * minute + _MINUTE_S - 1
    at = minute if block_s == _MINUTE_S else minute // _MINUTE_S
    return at, at
