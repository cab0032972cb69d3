"""The writer of the metrics file: SQLite in WAL mode, one writer, at most one commit a second.

The sink must outlive its disk. Where a commit fails (locked, full, read-only, directory gone), the rows stay in memory,
the newest of each key and at most `ROWS_LIMIT`, one line goes to the log, a counter counts, and the next second tries
again. A process
that is killed loses what came after the last commit, never a committed row (WAL; `synchronous = NORMAL` leaves the last
commits at risk in a power cut alone).
"""

from __future__ import annotations

import logging
import sqlite3
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from heliograph.errors import FileError
from heliograph_services.metrics_sink import schema
from heliograph_services.metrics_sink.rows import Key, Row
from heliograph_services.metrics_sink.tables import Writer
from heliograph_services.metrics_sink.tiers import Keep, prune, roll_up

_LOG = logging.getLogger(__name__)

COMMIT_S: Final = 1.0
# At 100 rows a second: a quarter of an hour without a disk, in about 20 MB.
ROWS_LIMIT: Final = 100_000
# Where nothing is old, it is looked again after a minute.
PRUNE_S: Final = 60.0
# The write-ahead log is cut to this when it has been moved into the file: a reader can make it grow.
LOG_LIMIT: Final = 8 * 2**20
# The loop that feeds the sink waits for the disk no longer than this.
BUSY_S: Final = 0.05


class SqliteStore:
    """Writes rows to a file; see the module.

    Args:
        path: the file; its directory is made where it is missing.
        boot: the word of this start, kept with the run.
        clock: seconds that never fall; for tests.
        rows_limit: most rows that wait for the disk.
        keep: how long rows are kept.
        wall: Unix seconds; for tests.

    Raises:
        FileError: the file exists and is no metrics file of this version.
    """

    def __init__(
        self,
        path: str | Path,
        boot: str = "",
        clock: Callable[[], float] = time.monotonic,
        rows_limit: int = ROWS_LIMIT,
        keep: Keep | None = None,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self.pruned = 0
        self.failures = 0
        self.dropped = 0
        self.written = 0
        self._path = Path(path)
        self._boot = boot
        self._clock = clock
        self._wall = wall
        self._waiting: dict[Key, Row] = {}
        self._rows_limit = rows_limit
        self._connection: sqlite3.Connection | None = None
        self._run: int | None = None
        self._writer: Writer | None = None
        self._keep = keep or Keep()
        self._prune_s = clock()
        self._started_wall_s = wall()
        self._failing = False
        self._due_s = clock() + COMMIT_S
        self._attempt(starting=True)

    @property
    def waiting(self) -> int:
        """The number of rows that are not on the disk."""
        return len(self._waiting)

    @property
    def is_failing(self) -> bool:
        """Whether the last commit failed."""
        return self._failing

    @property
    def is_due(self) -> bool:
        """Whether the next `write` commits."""
        return self._clock() >= self._due_s

    def write(self, rows: Iterable[Row]) -> None:
        """Take rows; commit all that wait once a second. Call it without rows, too, so that none grow old."""
        for row in rows:
            key = row.key
            self._waiting.pop(key, None)
            self._waiting[key] = row
        while len(self._waiting) > self._rows_limit:
            del self._waiting[next(iter(self._waiting))]
            self.dropped += 1
        now_s = self._clock()
        if now_s >= self._due_s:
            self._due_s = now_s + COMMIT_S
            if self._waiting or now_s >= self._prune_s:
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
            self._prune(connection)
        except (sqlite3.Error, OSError, FileError) as error:
            if starting and isinstance(error, FileError):
                raise
            if starting and type(error) is sqlite3.DatabaseError:
                # Of this class itself is "malformed"; locked, full and read-only are of one below it, and pass.
                self._disconnect()
                raise FileError(f"{self._path}: cannot be written as a metrics file: {error}") from None
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
            connection.execute(f"PRAGMA journal_size_limit = {LOG_LIMIT}")
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
        self._connection, self._run, self._writer = None, None, None

    def _commit(self, connection: sqlite3.Connection) -> None:
        now_s = self._wall()
        connection.execute("BEGIN IMMEDIATE")
        try:
            if self._writer is None:
                self._run = self._run_id(connection, now_s)
                self._writer = Writer(connection, self._run)
            roll_up(connection, self._writer.insert(self._waiting.values(), now_s))
            connection.execute("UPDATE run SET written_wall_s = ? WHERE id = ?", (now_s, self._run))
            connection.execute("COMMIT")
        except sqlite3.Error:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        self.written += len(self._waiting)
        self._waiting.clear()

    def _prune(self, connection: sqlite3.Connection) -> None:
        """Let go of some of what is old; in a transaction of its own, after what is new is safe."""
        if self._clock() < self._prune_s:
            return
        connection.execute("BEGIN IMMEDIATE")
        try:
            pruned = prune(connection, self._keep, self._wall())
            connection.execute("COMMIT")
        except sqlite3.Error:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        self.pruned += pruned
        if not pruned:
            self._prune_s = self._clock() + PRUNE_S

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
