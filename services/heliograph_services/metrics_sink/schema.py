"""The tables of the metrics file, and the two ways to open it.

::

    meta        schema version (one row)
    run         one row a start of a sink: its boot word, and wall-clock times of its first and last commit
    name        names of counters, gauges and hops, so that a row of a series takes a few bytes
    stream      a camera's epoch within a run
    count       (stream, second, name) -> n; count_minute and count_hour: the same, added
    span        (stream, minute) -> wall-clock time of its last row (what retention goes by), and whether it has seconds
    sighting    (stream, track, first_us)
    acquisition (stream, beacon, began_us)
    process     a process within a run, and the wall-clock time of its start
    health      (process, name) -> newest value of each counter and gauge
    rate        (process, second, name) -> n, by how much a counter rose; rate_minute, rate_hour: added
    level       (process, second, name) -> value of a gauge, n = 1; _minute, _hour: the greatest, n seconds
    hop         (process, second, name) -> n, p50_us, p95_us, p99_us; _minute, _hour: n added, the mean p50, and the
                greatest p95 and p99 of its seconds

All rows are written with INSERT OR REPLACE under these keys: writing a row twice changes nothing. Times `_wall_s` are
Unix seconds of this host; seconds of a stream are its camera's time, seconds of a process its uptime. The keys serve
`show`; what is of a time by the host's clock (retention, `--last`) goes by the indexes `..._age`.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Final

from heliograph.errors import FileError

VERSION: Final = 2
# "helg" in ASCII: tells our files from any other SQLite database.
APPLICATION_ID: Final = 0x68656C67

# The ending of a table's name -> the column of its time, and how many seconds a step has.
TIERS: Final = {"": ("second", 1), "_minute": ("minute", 60), "_hour": ("hour", 3_600)}
# table -> what its rows are owned by, and the columns behind owner, time and name
SERIES: Final = {
    "count": ("stream", {"n": "INTEGER"}),
    "rate": ("process", {"n": "INTEGER"}),
    "level": ("process", {"value": "REAL", "n": "INTEGER"}),
    "hop": ("process", dict.fromkeys(("n", "p50_us", "p95_us", "p99_us"), "INTEGER")),
}
_SERIES_SQL: Final = "".join(
    f"CREATE TABLE {table}{tier} ({owner} INTEGER NOT NULL REFERENCES {owner}(id), {time} INTEGER NOT NULL,"
    f" name INTEGER NOT NULL REFERENCES name(id), {', '.join(f'{c} {kind} NOT NULL' for c, kind in columns.items())},"
    f" PRIMARY KEY ({owner}, {time}, name)) WITHOUT ROWID;\n"
    for table, (owner, columns) in SERIES.items()
    for tier, (time, _) in TIERS.items()
)
TABLES: Final = f"""
CREATE TABLE meta (version INTEGER NOT NULL);
CREATE TABLE run (
  id INTEGER PRIMARY KEY, boot TEXT NOT NULL, started_wall_s REAL NOT NULL, written_wall_s REAL NOT NULL);
CREATE TABLE name (id INTEGER PRIMARY KEY, text TEXT NOT NULL UNIQUE);
CREATE TABLE stream (
  id INTEGER PRIMARY KEY, run INTEGER NOT NULL REFERENCES run(id), camera TEXT NOT NULL, epoch INTEGER NOT NULL,
  UNIQUE (run, camera, epoch));
CREATE TABLE span (
  stream INTEGER NOT NULL REFERENCES stream(id), minute INTEGER NOT NULL, wall_s REAL NOT NULL,
  has_seconds INTEGER NOT NULL, PRIMARY KEY (stream, minute)) WITHOUT ROWID;
CREATE TABLE sighting (
  stream INTEGER NOT NULL REFERENCES stream(id), track TEXT NOT NULL, beacon TEXT NOT NULL, protocol TEXT NOT NULL,
  first_us INTEGER NOT NULL, last_us INTEGER NOT NULL, first_x_px REAL NOT NULL, first_y_px REAL NOT NULL,
  last_x_px REAL NOT NULL, last_y_px REAL NOT NULL, frames INTEGER NOT NULL, ended INTEGER NOT NULL,
  wall_s REAL NOT NULL, PRIMARY KEY (stream, track, first_us)) WITHOUT ROWID;
CREATE TABLE acquisition (
  stream INTEGER NOT NULL REFERENCES stream(id), beacon TEXT NOT NULL, began_us INTEGER NOT NULL,
  lasted_us INTEGER NOT NULL, occluded_us INTEGER, acquired_us INTEGER, wall_s REAL NOT NULL,
  PRIMARY KEY (stream, beacon, began_us)) WITHOUT ROWID;
CREATE TABLE process (
  id INTEGER PRIMARY KEY, run INTEGER NOT NULL REFERENCES run(id), service TEXT NOT NULL, instance TEXT NOT NULL,
  pid INTEGER NOT NULL, started_wall_s REAL NOT NULL, UNIQUE (run, service, instance, pid));
CREATE TABLE health (
  process INTEGER NOT NULL REFERENCES process(id), name INTEGER NOT NULL REFERENCES name(id), value REAL NOT NULL,
  PRIMARY KEY (process, name)) WITHOUT ROWID;
CREATE INDEX span_age ON span(wall_s);
CREATE INDEX span_seconds_age ON span(wall_s) WHERE has_seconds;
CREATE INDEX sighting_age ON sighting(wall_s);
CREATE INDEX acquisition_age ON acquisition(wall_s);
{_SERIES_SQL}"""
_NAMES: Final = frozenset(line.split()[2] for line in TABLES.splitlines() if line.startswith("CREATE TABLE"))


def create(connection: sqlite3.Connection) -> None:
    """Make the tables where the file is new.

    Raises:
        FileError: the file is another database, or of another version.
        sqlite3.Error: it cannot be written now.
    """
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if application != APPLICATION_ID and tables == 0:
        # In one transaction, so that a process killed here leaves no half of a file.
        connection.executescript(f"BEGIN IMMEDIATE; PRAGMA application_id = {APPLICATION_ID}; {TABLES}")
        connection.execute("INSERT INTO meta VALUES (?)", (VERSION,))
        connection.execute("COMMIT")
        return
    _check(connection, application)


def open_read(path: Path) -> sqlite3.Connection:
    """Return a connection that only reads.

    Raises:
        FileError: the file is missing, or no metrics file of this version.
    """
    if not path.is_file():
        raise FileError(f"{path}: no such metrics file")
    uri = f"{path.resolve().as_uri()}?mode=ro"
    try:
        try:
            return _opened(uri, str(path))
        except sqlite3.OperationalError:
            # A file in WAL mode wants its companions beside it; on a read-only medium there is none, nor a writer.
            if Path(f"{path}-wal").exists():
                raise
            return _opened(f"{uri}&immutable=1", str(path))
    except sqlite3.Error as error:
        raise FileError(f"{path}: cannot be read as a metrics file: {error}") from None


def _opened(uri: str, label: str) -> sqlite3.Connection:
    connection = sqlite3.connect(uri, uri=True, timeout=1.0)
    try:
        (application,) = connection.execute("PRAGMA application_id").fetchone()
        _check(connection, application, label)
    except (sqlite3.Error, FileError):
        connection.close()
        raise
    return connection


def _check(connection: sqlite3.Connection, application: int, path: str = "") -> None:
    label = path or str(connection.execute("PRAGMA database_list").fetchone()[2])
    if application != APPLICATION_ID:
        raise FileError(f"{label}: a database, but not a metrics file of heliograph")
    found = connection.execute("SELECT version FROM meta").fetchone()
    if found is None or found[0] != VERSION:
        version = "no version" if found is None else f"version {found[0]}"
        raise FileError(f"{label}: metrics of {version}, this program has version {VERSION}: move the file away")
    there = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if missing := _NAMES - there:
        raise FileError(f"{label}: a damaged metrics file: it has no table {', '.join(sorted(missing))}")
