"""A table of the metrics file as CSV or Parquet: names instead of numbers, one row a value.

`TABLES` names what can be had; each begins with the run. CSV is UTF-8 with a header; Parquet needs pyarrow
(`pip install "heliograph[analysis]"`). The ending of the output's name decides. Rows are written as they are read, a
few thousand at a time, so a week fits through any machine; a file that cannot be finished is taken away again.
"""

from __future__ import annotations

import csv
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

from heliograph.errors import ConfigError, FileError
from heliograph_services.metrics_sink.schema import open_read

CHUNK: Final = 10_000
_STREAM: Final = "s.run, s.camera, s.epoch"
_PROCESS: Final = "p.run, p.service, p.instance, p.pid"
_OF_STREAM: Final = "JOIN stream s ON s.id = t.stream"
_OF_PROCESS: Final = "JOIN process p ON p.id = t.process"
_NAMED: Final = "JOIN name n ON n.id = t.name"


@dataclass(frozen=True, slots=True)
class Table:
    """A table to export: its columns' names, and the query that yields them, to be ended by a run."""

    columns: tuple[str, ...]
    query: str


def _counts(table: str, time: str) -> Table:
    return Table(
        ("run", "camera", "epoch", time, "name", "n"),
        f"SELECT {_STREAM}, t.{time}, n.text, t.n FROM {table} t {_OF_STREAM} {_NAMED}",  # noqa: S608 - our own names
    )


def _series(table: str, time: str, columns: tuple[str, ...]) -> Table:
    values = ", ".join(f"t.{column}" for column in columns)
    return Table(
        ("run", "service", "instance", "pid", "started_wall_s", time, "name", *columns),
        f"SELECT {_PROCESS}, p.started_wall_s, t.{time}, n.text, {values} FROM {table} t {_OF_PROCESS} {_NAMED}",  # noqa: S608
    )


_SIGHTING = (
    "track", "beacon", "protocol", "first_us", "last_us", "first_x_px", "first_y_px", "last_x_px", "last_y_px",
    "frames", "ended", "wall_s",
)  # fmt: skip
_ACQUISITION = ("beacon", "began_us", "lasted_us", "occluded_us", "acquired_us", "wall_s")
_HOP = ("n", "p50_us", "p95_us", "p99_us")
TABLES: Final[dict[str, Table]] = {
    "counts": _counts("count", "second"),
    "counts-minute": _counts("count_minute", "minute"),
    "counts-hour": _counts("count_hour", "hour"),
    "sightings": Table(
        ("run", "camera", "epoch", *_SIGHTING),
        f"SELECT {_STREAM}, {', '.join(f't.{name}' for name in _SIGHTING)} FROM sighting t {_OF_STREAM}",  # noqa: S608
    ),
    "acquisitions": Table(
        ("run", "camera", "epoch", *_ACQUISITION),
        f"SELECT {_STREAM}, {', '.join(f't.{name}' for name in _ACQUISITION)} FROM acquisition t {_OF_STREAM}",  # noqa: S608
    ),
    "hops": _series("hop", "second", _HOP),
    "hops-minute": _series("hop_minute", "minute", _HOP),
    "hops-hour": _series("hop_hour", "hour", _HOP),
    "rates": _series("rate", "second", ("n",)),
    "rates-minute": _series("rate_minute", "minute", ("n",)),
    "rates-hour": _series("rate_hour", "hour", ("n",)),
    "levels": _series("level", "second", ("value",)),
    "levels-minute": _series("level_minute", "minute", ("value", "n")),
    "levels-hour": _series("level_hour", "hour", ("value", "n")),
    "health": Table(
        ("run", "service", "instance", "pid", "name", "value"),
        f"SELECT {_PROCESS}, n.text, t.value FROM health t {_OF_PROCESS} {_NAMED}",  # noqa: S608
    ),
}


def export(path: str | Path, table: str, output: str | Path, run: int | None = None) -> int:
    """Write a table; return the number of its rows.

    Args:
        path: the metrics file.
        table: one of `TABLES`.
        output: a name that ends in .csv or .parquet, or "-" for CSV on stdout.
        run: only this start of the sink; all by default.

    Raises:
        ConfigError: an unknown table or ending, or pyarrow is missing.
        FileError: the metrics file is missing or damaged, or the output cannot be written.
    """
    if table not in TABLES:
        raise ConfigError(f"table must be one of {', '.join(TABLES)}, not {table!r}")
    suffix = ".csv" if str(output) == "-" else Path(output).suffix
    if suffix not in {".csv", ".parquet"}:
        raise ConfigError(f"output must end in .csv or .parquet, or be - for stdout, not {str(output)!r}")
    connection = open_read(Path(path))
    try:
        chunks = _chunks(connection, TABLES[table], run)
        if str(output) == "-":
            return _write_csv(sys.stdout, TABLES[table], chunks)
        return _to_file(Path(output), TABLES[table], chunks)
    except sqlite3.Error as error:
        raise FileError(f"{path}: cannot be read as a metrics file: {error}") from None
    finally:
        connection.close()


def _chunks(connection: sqlite3.Connection, table: Table, run: int | None) -> Iterator[list[tuple[Any, ...]]]:
    owner = "s" if table.columns[1] == "camera" else "p"
    where, values = ("", ()) if run is None else (f" WHERE {owner}.run = ?", (run,))
    # In the order in which it is stored: sorting a week would need room.
    cursor = connection.execute(f"{table.query}{where}", values)
    while rows := cursor.fetchmany(CHUNK):
        yield rows


def _to_file(output: Path, table: Table, chunks: Iterator[list[tuple[Any, ...]]]) -> int:
    try:
        if output.suffix == ".parquet":
            return _write_parquet(output, table, chunks)
        with output.open("w", newline="", encoding="utf-8") as file:
            return _write_csv(file, table, chunks)
    except OSError as error:
        with suppress(OSError):
            output.unlink(missing_ok=True)
        reason = (error.strerror or str(error)).lower()
        raise FileError(f"{output}: cannot be written: {reason}") from None


def _write_csv(file: IO[str], table: Table, chunks: Iterator[list[tuple[Any, ...]]]) -> int:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(table.columns)
    n = 0
    for rows in chunks:
        writer.writerows(rows)
        n += len(rows)
    return n


def _write_parquet(output: Path, table: Table, chunks: Iterator[list[tuple[Any, ...]]]) -> int:
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra, and heavy
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise ConfigError('Parquet needs pyarrow: pip install "heliograph[analysis]"') from None
    kinds = {"wall_s": pa.float64(), "value": pa.float64(), "ended": pa.int64()}
    texts = {"camera", "name", "track", "beacon", "protocol", "service", "instance"}

    def kind_of(name: str) -> Any:
        if name in texts:
            return pa.string()
        return pa.float64() if name.endswith(("_px", "_wall_s")) else kinds.get(name, pa.int64())

    schema = pa.schema([(name, kind_of(name)) for name in table.columns])
    n = 0
    with parquet.ParquetWriter(output, schema) as writer:
        for rows in chunks:
            columns = dict(zip(table.columns, zip(*rows, strict=True), strict=True))
            writer.write_table(pa.table({name: list(column) for name, column in columns.items()}, schema=schema))
            n += len(rows)
    return n
