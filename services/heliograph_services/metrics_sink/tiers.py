"""Minutes and hours made of seconds, and what is let go of when it is old.

A minute is added anew from all of its seconds, an hour from all of its minutes, in the transaction that wrote one of
them: so the tiers always agree, and a second that is written again changes nothing twice. Percentiles cannot be added:
a minute of a hop has the mean of its seconds' p50, by their n, and the greatest p95 and p99. Seconds are kept for
`seconds_h` hours, all else for `days` days of the host's clock. Rows are deleted a few minutes' worth at a time, so
that the loop that feeds the sink never waits long; the file does not shrink, its free pages are used again.
"""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from typing import Final

from heliograph_services.metrics_sink.schema import SERIES, TIERS
from heliograph_services.metrics_sink.tables import MINUTE_S, Touched

MINUTES_AN_HOUR: Final = 60
HOUR_S: Final = 3_600
DAY_S: Final = 86_400
# At most so many minutes of a stream or process a turn: some 100,000 rows, a tenth of a second.
PRUNED_MINUTES: Final = 30
# A computer without a battery behind its clock starts in 1970: before this (2020-01-01) nothing has an age.
NO_CLOCK_S: Final = 1_577_836_800.0

_ADDED: Final = {
    "count": "sum(n)",
    "rate": "sum(n)",
    "level": "max(value), sum(n)",
    "hop": "sum(n), sum(n * p50_us) / max(sum(n), 1), max(p95_us), max(p99_us)",
}
_PROCESS_SERIES: Final = tuple(table for table, (owner, _) in SERIES.items() if owner == "process")
_UPPER: Final = {"_minute": "", "_hour": "_minute"}
# A minute has as many seconds as an hour has minutes. ?1 the stream or process, ?2 the minute or hour.
_ROLL_UP: Final = {
    table + tier: f"INSERT OR REPLACE INTO {table}{tier} SELECT {owner}, ?2, name, {_ADDED[table]} FROM {table}{below}"  # noqa: S608
    f" WHERE {owner} = ?1 AND {TIERS[below][0]} BETWEEN 60 * ?2 AND 60 * ?2 + 59 GROUP BY name"
    for table, (owner, _) in SERIES.items()
    for tier, below in _UPPER.items()
}


@dataclass(frozen=True, slots=True)
class Keep:
    """How long rows are kept, by the host's clock; 0 keeps for ever."""

    seconds_h: float = 0.0
    days: float = 0.0


def roll_up(connection: sqlite3.Connection, touched: Touched) -> None:
    """Add anew the minutes and hours in which rows were written.

    Raises:
        sqlite3.Error: the file cannot be written now.
    """
    for table, (owner, _) in SERIES.items():
        minutes = touched.streams if owner == "stream" else touched.processes
        connection.executemany(_ROLL_UP[f"{table}_minute"], sorted(minutes))
        hours = {(of, minute // MINUTES_AN_HOUR) for of, minute in minutes}
        connection.executemany(_ROLL_UP[f"{table}_hour"], sorted(hours))


def prune(connection: sqlite3.Connection, keep: Keep, now_wall_s: float) -> int:
    """Delete some of what is too old; return how many rows went. Call again until it returns 0.

    Raises:
        sqlite3.Error: the file cannot be written now.
    """
    if now_wall_s < NO_CLOCK_S:
        return 0
    before = connection.total_changes
    if keep.seconds_h:
        _prune_seconds(connection, now_wall_s - keep.seconds_h * HOUR_S)
    if keep.days:
        _prune_all(connection, now_wall_s - keep.days * DAY_S)
    return connection.total_changes - before


def _prune_seconds(connection: sqlite3.Connection, before_s: float) -> None:
    old = connection.execute(
        "SELECT stream, minute FROM span WHERE wall_s < ? AND has_seconds LIMIT ?", (before_s, PRUNED_MINUTES)
    ).fetchall()
    _delete(connection, "count", "stream", "second", [(of, MINUTE_S * m, MINUTE_S * (m + 1)) for of, m in old])
    connection.executemany("UPDATE span SET has_seconds = 0 WHERE stream = ? AND minute = ?", old)
    for process, started_s in connection.execute("SELECT id, started_wall_s FROM process").fetchall():
        until = int((before_s - started_s) // MINUTE_S) * MINUTE_S
        for table in _PROCESS_SERIES:
            found = _first(connection, table, process, "second")
            if found is not None and found < until:
                cut = min(until, found + MINUTE_S * PRUNED_MINUTES)
                _delete(connection, table, "process", "second", [(process, found, cut)])


def _prune_all(connection: sqlite3.Connection, before_s: float) -> None:
    old = connection.execute(
        "SELECT stream, minute FROM span WHERE wall_s < ? LIMIT ?", (before_s, 4 * PRUNED_MINUTES)
    ).fetchall()
    _delete(connection, "count", "stream", "second", [(of, MINUTE_S * m, MINUTE_S * (m + 1)) for of, m in old])
    _delete(connection, "count_minute", "stream", "minute", [(of, m, m + 1) for of, m in old])
    connection.executemany("DELETE FROM span WHERE stream = ? AND minute = ?", old)
    for stream, hour in sorted({(of, m // MINUTES_AN_HOUR) for of, m in old}):
        left = connection.execute(
            "SELECT 1 FROM span WHERE stream = ? AND minute >= ? AND minute < ? LIMIT 1",
            (stream, MINUTES_AN_HOUR * hour, MINUTES_AN_HOUR * (hour + 1)),
        ).fetchone()
        if left is None:
            _delete(connection, "count_hour", "stream", "hour", [(stream, hour, hour + 1)])
    for table in ("sighting", "acquisition"):
        connection.execute(f"DELETE FROM {table} WHERE wall_s < ?", (before_s,))  # noqa: S608
    for process, started_s in connection.execute("SELECT id, started_wall_s FROM process").fetchall():
        for tier in _UPPER:
            time, step_s = TIERS[tier]
            until = int((before_s - started_s) // step_s)
            for table in _PROCESS_SERIES:
                found = _first(connection, f"{table}{tier}", process, time)
                if found is not None and found < until:
                    _delete(connection, f"{table}{tier}", "process", time, [(process, found, until)])
    _prune_runs(connection, before_s)


def _prune_runs(connection: sqlite3.Connection, before_s: float) -> None:
    """Forget the runs that have nothing left."""
    old = connection.execute(
        "SELECT id FROM run WHERE written_wall_s < ? AND id < (SELECT max(id) FROM run) AND NOT EXISTS"
        " (SELECT 1 FROM span JOIN stream ON stream.id = span.stream WHERE stream.run = run.id)",
        (before_s,),
    ).fetchall()
    for (run,) in old:
        for table in ("health", *(f"{table}{tier}" for table in _PROCESS_SERIES for tier in TIERS)):
            connection.execute(
                f"DELETE FROM {table} WHERE process IN (SELECT id FROM process WHERE run = ?)",  # noqa: S608
                (run,),
            )
        for table in ("process", "stream"):
            connection.execute(f"DELETE FROM {table} WHERE run = ?", (run,))  # noqa: S608
        connection.execute("DELETE FROM run WHERE id = ?", (run,))


def _first(connection: sqlite3.Connection, table: str, process: int, time: str) -> int | None:
    (found,) = connection.execute(f"SELECT min({time}) FROM {table} WHERE process = ?", (process,)).fetchone()  # noqa: S608
    return None if found is None else int(found)


def _delete(
    connection: sqlite3.Connection, table: str, owner: str, time: str, spans: list[tuple[int, int, int]]
) -> None:
    """Delete the rows of [begin, end) of each owner."""
    connection.executemany(
        f"DELETE FROM {table} WHERE {owner} = ? AND {time} >= ? AND {time} < ?",  # noqa: S608
        spans,
    )
