"""The tables of the metrics file, and the one way to open it for reading.

::

    meta        schema version (one row)
    run         one row a start of a sink: its boot word, and wall-clock times of its first and last commit
    name        counters' names, so that a row of `count` takes a few bytes
    stream      a camera's epoch within a run
    count       (stream, second, name) -> n
    sighting    (stream, track, first_us)
    acquisition (stream, beacon, began_us)
    health      (run, service, instance, pid, name) -> newest value

All rows are written with INSERT OR REPLACE under these keys: writing a row twice changes nothing.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Final

from heliograph.errors import FileError

VERSION: Final = 1
# "helg" in ASCII: tells our files from any other SQLite database.
APPLICATION_ID: Final = 0x68656C67

TABLES: Final = """
CREATE TABLE meta (version INTEGER NOT NULL);
CREATE TABLE run (
  id INTEGER PRIMARY KEY, boot TEXT NOT NULL, started_wall_s REAL NOT NULL, written_wall_s REAL NOT NULL);
CREATE TABLE name (id INTEGER PRIMARY KEY, text TEXT NOT NULL UNIQUE);
CREATE TABLE stream (
  id INTEGER PRIMARY KEY, run INTEGER NOT NULL REFERENCES run(id), camera TEXT NOT NULL, epoch INTEGER NOT NULL,
  UNIQUE (run, camera, epoch));
CREATE TABLE count (
  stream INTEGER NOT NULL REFERENCES stream(id), second INTEGER NOT NULL, name INTEGER NOT NULL REFERENCES name(id),
  n INTEGER NOT NULL, PRIMARY KEY (stream, second, name)) WITHOUT ROWID;
CREATE TABLE sighting (
  stream INTEGER NOT NULL REFERENCES stream(id), track TEXT NOT NULL, beacon TEXT NOT NULL, protocol TEXT NOT NULL,
  first_us INTEGER NOT NULL, last_us INTEGER NOT NULL, first_x_px REAL NOT NULL, first_y_px REAL NOT NULL,
  last_x_px REAL NOT NULL, last_y_px REAL NOT NULL, frames INTEGER NOT NULL, ended INTEGER NOT NULL,
  PRIMARY KEY (stream, track, first_us)) WITHOUT ROWID;
CREATE TABLE acquisition (
  stream INTEGER NOT NULL REFERENCES stream(id), beacon TEXT NOT NULL, began_us INTEGER NOT NULL,
  lasted_us INTEGER NOT NULL, occluded_us INTEGER, acquired_us INTEGER,
  PRIMARY KEY (stream, beacon, began_us)) WITHOUT ROWID;
CREATE TABLE health (
  run INTEGER NOT NULL REFERENCES run(id), service TEXT NOT NULL, instance TEXT NOT NULL, pid INTEGER NOT NULL,
  name TEXT NOT NULL, value REAL NOT NULL, PRIMARY KEY (run, service, instance, pid, name)) WITHOUT ROWID;
"""


def create(connection: sqlite3.Connection) -> None:
    """Make the tables where the file is new.

    Raises:
        FileError: the file is another database, or of a later version.
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
    try:
        connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=1.0)
        (application,) = connection.execute("PRAGMA application_id").fetchone()
        _check(connection, application, str(path))
    except sqlite3.Error as error:
        raise FileError(f"{path}: cannot be read as a metrics file: {error}") from None
    return connection


def _check(connection: sqlite3.Connection, application: int, path: str = "") -> None:
    label = path or str(connection.execute("PRAGMA database_list").fetchone()[2])
    if application != APPLICATION_ID:
        raise FileError(f"{label}: a database, but not a metrics file of heliograph")
    (version,) = connection.execute("SELECT version FROM meta").fetchone()
    if version != VERSION:
        raise FileError(f"{label}: metrics of version {version}, this program reads version {VERSION}")
