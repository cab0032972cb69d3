"""Rows into tables: the numbers that stand for names, and the statements. One `Writer` an open connection."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from heliograph_services.metrics_sink.rows import (
    AcquisitionRow,
    CountRow,
    HealthRow,
    LevelRow,
    ProcessCountRow,
    ProcessRow,
    Row,
    SightingRow,
)

MINUTE_S: Final = 60
_COLUMNS: Final = {
    "count": 4,
    "span": 4,
    "sighting": 13,
    "acquisition": 7,
    "health": 3,
    "rate": 4,
    "level": 5,
    "hop": 7,
}
_INSERT: Final = {
    table: f"INSERT OR REPLACE INTO {table} VALUES ({','.join('?' * n)})"  # noqa: S608 - our own names
    for table, n in _COLUMNS.items()
}
_Value = int | float | str | None


@dataclass(slots=True)
class Touched:
    """The minutes in which rows were written: (stream or process, minute)."""

    streams: set[tuple[int, int]] = field(default_factory=set)
    processes: set[tuple[int, int]] = field(default_factory=set)


class Writer:
    """Writes rows within the caller's transaction.

    Args:
        connection: open, with the tables of `schema`.
        run: the row of `run` that they belong to.
    """

    def __init__(self, connection: sqlite3.Connection, run: int) -> None:
        self._connection = connection
        self._run = run
        self._names: dict[str, int] = {}
        self._streams: dict[tuple[str, int], int] = {}
        self._processes: dict[tuple[str, str, int], int] = {}

    def insert(self, rows: Iterable[Row], wall_s: float) -> Touched:
        """Write rows; return where their minutes must be added anew.

        Raises:
            sqlite3.Error: they cannot be written now.
        """
        touched = Touched()
        lines: dict[str, list[tuple[_Value, ...]]] = {table: [] for table in _INSERT}
        for row in rows:
            if isinstance(row, CountRow):
                stream, second = self._stream(row.camera, row.epoch), row.t0_us // 1_000_000
                lines["count"].append((stream, second, self._name(row.name), row.n))
                touched.streams.add((stream, second // MINUTE_S))
            elif isinstance(row, SightingRow):
                lines["sighting"].append((self._stream(row.camera, row.epoch), *_sighting(row), wall_s))
            elif isinstance(row, AcquisitionRow):
                lines["acquisition"].append((self._stream(row.camera, row.epoch), *_acquisition(row), wall_s))
            else:
                process = self._process(row, wall_s)
                table, values = self._of_process(row)
                lines[table].append((process, *values))
                if not isinstance(row, HealthRow):
                    touched.processes.add((process, row.second // MINUTE_S))
        lines["span"] = [(stream, minute, wall_s, 1) for stream, minute in sorted(touched.streams)]
        for table, values_of_rows in lines.items():
            self._connection.executemany(_INSERT[table], values_of_rows)
        return touched

    def _of_process(self, row: ProcessRow) -> tuple[str, tuple[_Value, ...]]:
        if isinstance(row, HealthRow):
            return "health", (self._name(row.name), row.value)
        if isinstance(row, ProcessCountRow):
            return "rate", (row.second, self._name(row.name), row.n)
        if isinstance(row, LevelRow):
            return "level", (row.second, self._name(row.name), row.value, 1)
        return "hop", (row.second, self._name(row.hop), row.n, row.p50_us, row.p95_us, row.p99_us)

    def _stream(self, camera: str, epoch: int) -> int:
        found = self._streams.get((camera, epoch))
        if found is None:
            found = self._id("stream", ("run", "camera", "epoch"), (self._run, camera, epoch))
            self._streams[camera, epoch] = found
        return found

    def _process(self, row: ProcessRow, wall_s: float) -> int:
        key = (row.service, row.instance, row.pid)
        found = self._processes.get(key)
        if found is None:
            # Its start, by its uptime: what the first row of a series says, and at the latest now.
            uptime_s = 0 if isinstance(row, HealthRow) else row.second
            columns = ("run", "service", "instance", "pid")
            found = self._id("process", columns, (self._run, *key), {"started_wall_s": wall_s - uptime_s})
            self._processes[key] = found
        return found

    def _name(self, text: str) -> int:
        found = self._names.get(text)
        if found is None:
            found = self._names[text] = self._id("name", ("text",), (text,))
        return found

    def _id(
        self, table: str, columns: tuple[str, ...], values: tuple[_Value, ...], rest: dict[str, _Value] | None = None
    ) -> int:
        """Return the id of a row of an index table, made where it is new."""
        given = dict(zip(columns, values, strict=True)) | (rest or {})
        names, marks = ", ".join(given), ",".join("?" * len(given))
        insert = f"INSERT OR IGNORE INTO {table} ({names}) VALUES ({marks})"  # noqa: S608 - our own names
        self._connection.execute(insert, tuple(given.values()))
        where = " AND ".join(f"{column} = ?" for column in columns)
        (found,) = self._connection.execute(f"SELECT id FROM {table} WHERE {where}", values).fetchone()  # noqa: S608
        return int(found)


def _sighting(row: SightingRow) -> tuple[_Value, ...]:
    return (
        row.track,
        row.beacon,
        row.protocol,
        row.first_us,
        row.last_us,
        row.first_x_px,
        row.first_y_px,
        row.last_x_px,
        row.last_y_px,
        row.frames,
        int(row.ended),
    )


def _acquisition(row: AcquisitionRow) -> tuple[_Value, ...]:
    return row.beacon, row.began_us, row.lasted_us, row.occluded_us, row.acquired_us
