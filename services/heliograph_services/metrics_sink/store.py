"""The writer of the metrics file: SQLite in WAL mode, one writer, at most one commit a second.

The sink must outlive its disk. Where a commit fails (locked, full, read-only, directory gone), the rows stay in memory,
the newest `ROWS_LIMIT` of them, one line goes to the log, a counter counts, and the next second tries again. A process
that is killed loses what came after the last commit, never a committed row (WAL; `synchronous = NORMAL` leaves the last
commits at risk in a power cut alone).
"""

from __future__ import annotations

import logging
import sqlite3
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from heliograph.errors import FileError
from heliograph_services.metrics_sink import schema
from heliograph_services.metrics_sink.rows import AcquisitionRow, CountRow, HealthRow, Row, SightingRow

_LOG = logging.getLogger(__name__)

COMMIT_S: Final = 1.0
# At 100 rows a second: a quarter of an hour without a disk, in about 20 MB.
ROWS_LIMIT: Final = 100_000
# The loop that feeds the sink waits for the disk no longer than this.
BUSY_S: Final = 0.05


class SqliteStore:
    """Writes rows to a file; see the module.

    Args:
        path: the file; its directory is made where it is missing.
        boot: the word of this start, kept with the run.
        clock: seconds that never fall; for tests.
        rows_limit: most rows that wait for the disk.

    Raises:
        FileError: the file exists and is no metrics file of this version.
    """

    def __init__(
        self,
        path: str | Path,
        boot: str = "",
        clock: Callable[[], float] = time.monotonic,
        rows_limit: int = ROWS_LIMIT,
    ) -> None:
        self.failures = 0
        self.dropped = 0
        self.written = 0
        self._path = Path(path)
        self._boot = boot
        self._clock = clock
        self._waiting: deque[Row] = deque(maxlen=rows_limit)
        self._connection: sqlite3.Connection | None = None
        self._run: int | None = None
        self._names: dict[str, int] = {}
        self._streams: dict[tuple[str, int], int] = {}
        self._started_wall_s = time.time()
        self._failing = False
        self._due_s = clock() + COMMIT_S
        self._attempt(starting=True)

    @property
    def waiting(self) -> int:
        """The number of rows that are not on the disk."""
        return len(self._waiting)

    def write(self, rows: Iterable[Row]) -> None:
        """Take rows; commit all that wait once a second. Call it without rows, too, so that none grow old."""
        limit = self._waiting.maxlen or 0
        for row in rows:
            self.dropped += len(self._waiting) == limit
            self._waiting.append(row)
        now_s = self._clock()
        if now_s >= self._due_s:
            self._due_s = now_s + COMMIT_S
            if self._waiting:
                self._attempt()

    def close(self) -> None:
        """Commit what waits and close the file; what cannot be written is lost, and said."""
        self._attempt()
        if self._waiting:
            _LOG.error("%s: %d rows could not be written", self._path, len(self._waiting))
        self._disconnect()

    def _attempt(self, *, starting: bool = False) -> None:
        """Try to commit; a failure is counted, the first of a row of them logged.

        Another's database in our place is the operator's mistake at the start, and a failing disk later.
        """
        try:
            connection = self._connected()
            self._commit(connection)
        except (sqlite3.Error, OSError, FileError) as error:
            if starting and isinstance(error, FileError):
                raise
            self.failures += 1
            if not self._failing:
                _LOG.warning("%s: rows wait in memory: %s", self._path, error)
            self._failing = True
            self._disconnect()
            return
        if self._failing:
            _LOG.info("%s: written again", self._path)
        self._failing = False

    def _connected(self) -> sqlite3.Connection:
        if self._connection is not None and self._path.exists():
            return self._connection
        self._disconnect()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # One writer; but the shell makes the core in one thread and may close it in another.
        connection = sqlite3.connect(self._path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")
            schema.create(connection)
        except sqlite3.DatabaseError as error:
            connection.close()
            # OperationalError (locked, full, read-only) passes; its parent class says that this is no database.
            if isinstance(error, sqlite3.OperationalError):
                raise
            raise FileError(f"{self._path}: not a metrics file: {error}") from None
        except FileError:
            connection.close()
            raise
        self._connection = connection
        return connection

    def _disconnect(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection, self._run = None, None
        self._names.clear()
        self._streams.clear()

    def _commit(self, connection: sqlite3.Connection) -> None:
        now_s = time.time()
        connection.execute("BEGIN IMMEDIATE")
        try:
            if self._run is None:
                self._run = self._run_id(connection, now_s)
            self._insert(connection, list(self._waiting))
            connection.execute("UPDATE run SET written_wall_s = ? WHERE id = ?", (now_s, self._run))
            connection.execute("COMMIT")
        except sqlite3.Error:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        self.written += len(self._waiting)
        self._waiting.clear()

    def _run_id(self, connection: sqlite3.Connection, now_s: float) -> int:
        # After a reconnect the run goes on: same boot word, and ours is the last row.
        found = connection.execute(
            "SELECT id FROM run WHERE boot = ? AND started_wall_s = ?", (self._boot, self._started_wall_s)
        ).fetchone()
        if found is not None:
            return int(found[0])
        cursor = connection.execute(
            "INSERT INTO run (boot, started_wall_s, written_wall_s) VALUES (?, ?, ?)",
            (self._boot, self._started_wall_s, now_s),
        )
        return int(cursor.lastrowid or 0)

    def _insert(self, connection: sqlite3.Connection, rows: list[Row]) -> None:
        counts, sightings, acquisitions, health = [], [], [], []
        for row in rows:
            if isinstance(row, CountRow):
                stream = self._stream_id(connection, row.camera, row.epoch)
                counts.append((stream, row.t0_us // 1_000_000, self._name_id(connection, row.name), row.n))
            elif isinstance(row, SightingRow):
                sightings.append(_sighting(self._stream_id(connection, row.camera, row.epoch), row))
            elif isinstance(row, AcquisitionRow):
                stream = self._stream_id(connection, row.camera, row.epoch)
                acquisitions.append((stream, row.beacon, row.began_us, row.lasted_us, row.occluded_us, row.acquired_us))
            else:
                health.append(_health(self._run or 0, row))
        connection.executemany("INSERT OR REPLACE INTO count VALUES (?,?,?,?)", counts)
        connection.executemany("INSERT OR REPLACE INTO sighting VALUES (?,?,?,?,?,?,?,?,?,?,?,?)", sightings)
        connection.executemany("INSERT OR REPLACE INTO acquisition VALUES (?,?,?,?,?,?)", acquisitions)
        connection.executemany("INSERT OR REPLACE INTO health VALUES (?,?,?,?,?,?)", health)

    def _stream_id(self, connection: sqlite3.Connection, camera: str, epoch: int) -> int:
        if (camera, epoch) not in self._streams:
            connection.execute(
                "INSERT OR IGNORE INTO stream (run, camera, epoch) VALUES (?, ?, ?)", (self._run, camera, epoch)
            )
            (found,) = connection.execute(
                "SELECT id FROM stream WHERE run = ? AND camera = ? AND epoch = ?", (self._run, camera, epoch)
            ).fetchone()
            self._streams[camera, epoch] = int(found)
        return self._streams[camera, epoch]

    def _name_id(self, connection: sqlite3.Connection, text: str) -> int:
        if text not in self._names:
            connection.execute("INSERT OR IGNORE INTO name (text) VALUES (?)", (text,))
            (found,) = connection.execute("SELECT id FROM name WHERE text = ?", (text,)).fetchone()
            self._names[text] = int(found)
        return self._names[text]


def _sighting(stream: int, row: SightingRow) -> tuple[int | float | str, ...]:
    return (
        stream,
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


def _health(run: int, row: HealthRow) -> tuple[int | float | str, ...]:
    return run, row.service, row.instance, row.pid, row.name, row.value
