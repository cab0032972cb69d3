"""The file behind the sink: what it survives, and what it never loses."""

from __future__ import annotations

import logging
import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from heliograph.errors import FileError
from heliograph_services.metrics_sink.rows import AcquisitionRow, CountRow, HealthRow, Row, SightingRow
from heliograph_services.metrics_sink.store import SqliteStore


class FakeClock:
    """Seconds that a test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def count(second: int, n: int = 1, name: str = "frames") -> CountRow:
    return CountRow("cam0", 0, second * 1_000_000, name, n)


def seconds_in(path: Path) -> list[int]:
    with sqlite3.connect(path) as connection:
        return [second for (second,) in connection.execute("SELECT second FROM count ORDER BY second")]


def store_of(path: Path, clock: FakeClock, rows_limit: int = 100) -> SqliteStore:
    return SqliteStore(path, boot="b0", clock=clock, rows_limit=rows_limit)


def test_rows_are_committed_once_a_second_and_at_the_end(tmp_path: Path) -> None:
    clock, path = FakeClock(), tmp_path / "deep" / "down" / "m.sqlite"
    store = store_of(path, clock)
    store.write([count(0)])
    assert seconds_in(path) == []
    clock.now_s = 1.0
    store.write([])
    assert seconds_in(path) == [0]
    store.write([count(1)])
    store.close()
    assert seconds_in(path) == [0, 1]


def test_a_row_of_the_same_key_replaces_the_older_one(tmp_path: Path) -> None:
    path = tmp_path / "m.sqlite"
    store = store_of(path, FakeClock())
    sighting = ("cam0", 0, "t-0", "crane", "seed11", 5)
    rows: list[Row] = [
        count(0, 3),
        count(0, 4),
        SightingRow(*sighting, 100, 1.0, 2.0, 3.0, 4.0, 7, False),
        SightingRow(*sighting, 200, 1.0, 2.0, 5.0, 6.0, 9, True),
        AcquisitionRow("cam0", 0, "crane", 0, 100, None, None),
        AcquisitionRow("cam0", 0, "crane", 0, 900, None, 80),
        HealthRow("decoder", "decoder", 7, "queue", 1.0),
        HealthRow("decoder", "decoder", 7, "queue", 2.0),
    ]
    store.write(rows)
    store.close()
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT last_us, frames, ended FROM sighting").fetchall() == [(200, 9, 1)]
        assert connection.execute("SELECT lasted_us, acquired_us FROM acquisition").fetchall() == [(900, 80)]
        assert connection.execute("SELECT value FROM health").fetchall() == [(2.0,)]
        assert connection.execute("SELECT n FROM count").fetchall() == [(4,)]


def test_two_starts_of_a_sink_are_two_runs(tmp_path: Path) -> None:
    path = tmp_path / "m.sqlite"
    for n in (3, 4):
        store = store_of(path, FakeClock())
        store.write([count(0, n)])
        store.close()
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT n FROM count ORDER BY stream").fetchall() == [(3,), (4,)]
        assert connection.execute("SELECT count(*) FROM run").fetchall() == [(2,)]


def test_a_locked_file_is_reported_once_and_nothing_is_lost(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    clock, path = FakeClock(), tmp_path / "m.sqlite"
    store = store_of(path, clock)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with caplog.at_level(logging.INFO):
        for second in range(1, 4):
            clock.now_s = float(second)
            store.write([count(second)])
    assert store.failures == 3
    assert store.waiting == 3
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    other.execute("ROLLBACK")
    other.close()
    clock.now_s = 4.0
    with caplog.at_level(logging.INFO):
        store.write([])
    assert seconds_in(path) == [1, 2, 3]
    assert [record.levelname for record in caplog.records] == ["WARNING", "INFO"]
    store.close()
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT count(*) FROM run").fetchone() == (1,)


def test_a_full_disk_keeps_rows_in_memory_until_there_is_room(tmp_path: Path) -> None:
    clock, path = FakeClock(), tmp_path / "m.sqlite"
    store = store_of(path, clock, rows_limit=10_000)
    assert store._connection is not None
    store._connection.execute("PRAGMA max_page_count = 1")  # SQLite clamps it to the size that the file has
    many = [count(second, name=f"a counter with a long name, number {second}") for second in range(2000)]
    clock.now_s = 1.0
    store.write(many)
    assert (store.failures, store.waiting) == (1, 2000)
    clock.now_s = 2.0  # a new connection has no such limit: there is room again
    store.write([])
    assert store.waiting == 0
    assert seconds_in(path) == list(range(2000))
    store.close()


def test_a_file_that_turns_read_only_keeps_rows_in_memory(tmp_path: Path) -> None:
    clock, path = FakeClock(), tmp_path / "m.sqlite"
    store = store_of(path, clock)
    assert store._connection is not None
    store._connection.execute("PRAGMA query_only = ON")  # "attempt to write a readonly database", for root, too
    clock.now_s = 1.0
    store.write([count(1)])
    assert (store.failures, store.waiting) == (1, 1)
    store.close()
    assert seconds_in(path) == [1]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write read-only files")
def test_a_read_only_file_from_the_start_is_survived(tmp_path: Path) -> None:
    clock, path = FakeClock(), tmp_path / "m.sqlite"
    store_of(path, clock).close()
    path.chmod(0o444)
    store = store_of(path, clock)
    clock.now_s = 1.0
    store.write([count(1)])
    assert store.failures >= 1
    assert store.waiting == 1
    path.chmod(0o644)
    store.close()
    assert seconds_in(path) == [1]


def test_a_place_where_no_file_can_be_is_survived_with_a_bounded_memory(tmp_path: Path) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("not a folder", encoding="utf-8")
    clock = FakeClock()
    store = store_of(blocker / "m.sqlite", clock, rows_limit=10)
    for second in range(1, 31):
        clock.now_s = float(second)
        store.write([count(second)])
    assert (store.waiting, store.dropped) == (10, 20)
    blocker.unlink()
    store.close()
    assert seconds_in(blocker / "m.sqlite") == list(range(21, 31))


def test_a_file_that_is_taken_away_is_made_anew(tmp_path: Path) -> None:
    clock, path = FakeClock(), tmp_path / "m.sqlite"
    store = store_of(path, clock)
    for file in tmp_path.iterdir():
        file.unlink()
    clock.now_s = 1.0
    store.write([count(5)])
    assert seconds_in(path) == [5]
    store.close()


def test_a_file_of_another_kind_is_an_operators_error(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("dear diary, " * 200, encoding="utf-8")
    with pytest.raises(FileError, match="not a metrics file"):
        SqliteStore(text)
    assert text.read_text(encoding="utf-8").startswith("dear diary")
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE theirs (a)")
    with pytest.raises(FileError, match="not a metrics file"):
        SqliteStore(other)


def test_a_file_that_lacks_a_table_or_is_malformed_is_an_operators_error(tmp_path: Path) -> None:
    path = tmp_path / "m.sqlite"
    SqliteStore(path).close()
    whole = path.read_bytes()
    with sqlite3.connect(path) as connection:
        connection.execute("DROP TABLE level_hour")
    with pytest.raises(FileError, match="a damaged metrics file: it has no table level_hour"):
        SqliteStore(path)
    # The run's table lies on a page that is not the first: found out when the new run is written.
    path.write_bytes(whole[:4096] + b"\xa5" * (len(whole) - 4096))
    with pytest.raises(FileError, match=f"^{path}: (not|cannot be written as) a metrics file: "):
        SqliteStore(path)


def test_a_file_that_turns_malformed_keeps_rows_in_memory(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    clock, path = FakeClock(), tmp_path / "m.sqlite"
    store = store_of(path, clock)
    store._disconnect()  # what is in the log beside it goes into the file
    whole = path.read_bytes()
    path.write_bytes(whole[:4096] + b"\xa5" * (len(whole) - 4096))
    with caplog.at_level(logging.INFO):
        for second in range(1, 4):
            clock.now_s = float(second)
            store.write([count(second)])
    assert (store.failures, store.waiting) == (3, 3)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    store.close()


def test_a_file_of_a_later_version_is_an_operators_error(tmp_path: Path) -> None:
    path = tmp_path / "m.sqlite"
    SqliteStore(path).close()
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE meta SET version = 99")
    with pytest.raises(FileError, match="version 99"):
        SqliteStore(path)


WRITER = """
import sys
from heliograph_services.metrics_sink.rows import CountRow
from heliograph_services.metrics_sink.store import SqliteStore
now = [0.0]
store = SqliteStore(sys.argv[1], "b0", clock=lambda: now[0])
for i in range(10**6):
    now[0] = i * 0.3
    store.write([CountRow("cam0", 0, i * 1_000_000, "frames", i)])
    print(i, flush=True)
"""


def test_a_killed_process_loses_nothing_older_than_a_second(tmp_path: Path) -> None:
    path = tmp_path / "m.sqlite"
    with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        newest = next(int(line) for line in process.stdout if int(line) >= 200)
        process.kill()
    kept = seconds_in(path)
    assert kept == list(range(len(kept)))
    # 0.3 s a row: all but those of the last second and the one that made it due.
    assert len(kept) >= newest - 4
