"""Minutes and hours of the metrics file, and what is let go of: facts of the store, without timing."""

from __future__ import annotations

import sqlite3
import tempfile
from functools import partial
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph_services.metrics_sink.rows import CountRow, HopRow, LevelRow, ProcessCountRow, Row, SightingRow
from heliograph_services.metrics_sink.store import SqliteStore
from heliograph_services.metrics_sink.summary import summarise
from heliograph_services.metrics_sink.tiers import NO_CLOCK_S, Keep, prune
from support.plans import plans_of

DECODER = ("decoder", "decoder", 7)
WEEK_S = 168 * 3_600
NOW_S = 1_800_000_000.0


class Clocks:
    """The store's two clocks, moved by a test."""

    def __init__(self, wall_s: float = NOW_S) -> None:
        self.mono_s = 0.0
        self.wall_s = wall_s

    def store(self, path: Path, keep: Keep) -> SqliteStore:
        return SqliteStore(path, clock=lambda: self.mono_s, keep=keep, wall=lambda: self.wall_s)

    def on(self, seconds: float) -> None:
        self.mono_s += seconds
        self.wall_s += seconds


def second_of(second: int, n: int = 1) -> list[Row]:
    return [
        CountRow("cam0", 0, second * 1_000_000, "frames", n),
        CountRow("cam0", 0, second * 1_000_000, "seconds", 1),
        ProcessCountRow(*DECODER, second, "published: frames", n),
        LevelRow(*DECODER, second, "queue", float(n)),
        HopRow(*DECODER, second, "whole", n, 10 * n, 20 * n, 30 * n),
    ]


def found(path: Path, query: str) -> list[tuple[float, ...]]:
    with sqlite3.connect(path) as connection:
        return connection.execute(query).fetchall()


@given(st.lists(st.tuples(st.integers(-7200, 7200), st.integers(1, 1000)), min_size=1, max_size=25), st.data())
@settings(max_examples=15, deadline=None)
def test_minutes_and_hours_add_up_whatever_is_written_twice(
    written: list[tuple[int, int]], data: st.DataObject
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        check(SqliteStore(Path(folder) / "m.sqlite"), written, data)


def check(store: SqliteStore, written: list[tuple[int, int]], data: st.DataObject) -> None:
    newest: dict[int, int] = {}
    for second, n in written:
        newest[second] = n
        store.write(second_of(second, n))
        if data.draw(st.booleans()):
            store._attempt()
    store._attempt()
    connection = store._connection
    assert connection is not None
    for table, length in (("count_minute", 60), ("count_hour", 3600)):
        expected: dict[int, int] = {}
        for second, n in newest.items():
            expected[second // length] = expected.get(second // length, 0) + n
        time = table.removeprefix("count_")
        rows = connection.execute(
            f"SELECT {time}, n FROM {table} JOIN name ON name.id = {table}.name WHERE text = 'frames'"
        )
        assert dict(rows.fetchall()) == expected
    store.close()


def test_a_minute_and_an_hour_of_a_process_hold_sums_means_and_the_worst(tmp_path: Path) -> None:
    path = tmp_path / "m.sqlite"
    store = SqliteStore(path)
    store.write([*second_of(0, 1), *second_of(59, 3), *second_of(60, 100)])
    store.close()
    assert found(path, "SELECT n FROM rate_minute ORDER BY minute") == [(4,), (100,)]
    assert found(path, "SELECT value FROM level_minute ORDER BY minute") == [(3.0,), (100.0,)]
    # p50 is the mean over messages: (1 * 10 + 3 * 30) / 4.
    assert found(path, "SELECT n, p50_us, p95_us, p99_us FROM hop_minute WHERE minute = 0") == [(4, 25, 60, 90)]
    # (4 * 25 + 100 * 1000) / 104, of the hour.
    assert found(path, "SELECT n, p50_us, p95_us, p99_us FROM hop_hour") == [(104, 962, 2000, 3000)]
    assert found(path, "SELECT value, n FROM level_hour") == [(100.0, 3)]
    assert found(path, "SELECT n FROM rate_hour") == [(104,)]


def a_week(path: Path, clocks: Clocks, keep: Keep, step_s: int = 600) -> SqliteStore:
    """A week of one second in ten minutes, each written when it is over; a sighting each step."""
    store = clocks.store(path, keep)
    for second in range(0, WEEK_S, step_s):
        sighting = SightingRow("cam0", 0, f"t-{second}", "crane", "seed11", second, second + 1, *(0.0,) * 4, 1, True)
        store.write([*second_of(second), sighting])
        clocks.on(step_s)
        store.write([])
    return store


def test_seconds_go_after_their_hours_and_minutes_stay(tmp_path: Path) -> None:
    clocks, path = Clocks(), tmp_path / "m.sqlite"
    store = a_week(path, clocks, Keep(seconds_h=24.0, days=90.0))
    store.close()
    ((first, n),) = found(path, "SELECT min(second), count(DISTINCT second) FROM count")
    # A day of one second in ten minutes, give or take the step and the turns of pruning.
    assert WEEK_S - 86_400 - 3_600 <= first <= WEEK_S - 86_400 + 1_200
    assert 140 <= n <= 152
    assert found(path, "SELECT count(DISTINCT minute) FROM count_minute") == [(1008,)]
    assert found(path, "SELECT count(DISTINCT hour) FROM count_hour") == [(168,)]
    for series in ("rate", "level", "hop"):
        assert found(path, f"SELECT min(second) FROM {series}")[0][0] >= WEEK_S - 86_400 - 3_600
        assert found(path, f"SELECT count(*) FROM {series}_minute") == [(1008,)]
        assert found(path, f"SELECT count(*) FROM {series}_hour") == [(168,)]
    whole = summarise(path)
    assert (whole.frames, whole.seconds, whole.block_s, len(whole.sightings)) == (1008, 1008, 60, 1008)
    assert summarise(path, last_s=3_599.0).frames == 6


def test_everything_goes_after_its_days_and_runs_that_are_empty(tmp_path: Path) -> None:
    clocks, path = Clocks(), tmp_path / "m.sqlite"
    a_week(path, clocks, Keep(), 3_600).close()
    assert found(path, "SELECT count(DISTINCT second) FROM count") == [(168,)]
    clocks.on(40 * 86_400.0)
    store = clocks.store(path, Keep(seconds_h=168.0, days=30.0))
    for _ in range(20):
        clocks.on(1.0)
        store.write(second_of(0))
    store.close()
    assert found(path, "SELECT id FROM run") == [(2,)]
    for table in ("count", "count_minute", "count_hour", "span", "rate", "hop_minute", "hop_hour", "process", "stream"):
        rows = found(path, f"SELECT count(*) FROM {table}")
        assert 1 <= rows[0][0] <= 2, table
    assert found(path, "SELECT count(*) FROM sighting") == [(0,)]


def test_pages_of_what_was_let_go_are_used_again(tmp_path: Path) -> None:
    clocks, path = Clocks(), tmp_path / "m.sqlite"
    store = clocks.store(path, Keep(seconds_h=1.0, days=0.25))
    sizes = []
    for hour in range(36):
        store.write([row for second in range(3600 * hour, 3600 * hour + 600, 6) for row in second_of(second)])
        for _ in range(6):
            clocks.on(600.0)
            store.write([])
        (pages,) = store._connection.execute("PRAGMA page_count").fetchone() if store._connection else (0,)
        sizes.append(pages)
    store.close()
    assert max(sizes[12:]) <= 1.2 * sizes[12]


def test_a_computer_without_a_clock_forgets_nothing(tmp_path: Path) -> None:
    clocks, path = Clocks(wall_s=NO_CLOCK_S - 30 * 86_400.0), tmp_path / "m.sqlite"
    a_week(path, clocks, Keep(seconds_h=1.0, days=1.0), 3_600).close()
    assert found(path, "SELECT count(DISTINCT second) FROM count") == [(168,)]


def test_a_row_takes_the_bytes_that_the_page_says(tmp_path: Path) -> None:
    """docs/metrics.md: 12 to 18 bytes a count, its share of minutes and hours included."""
    path = tmp_path / "m.sqlite"
    store = SqliteStore(path)
    names = [f"counter {i}" for i in range(20)]
    for begin in range(0, 8_000, 2_000):
        seconds = range(begin, begin + 2_000)
        store.write([CountRow("cam0", 0, 1_000_000 * s, name, 900) for s in seconds for name in names])
        store._attempt()
    store.close()
    with sqlite3.connect(path) as connection:
        connection.execute("VACUUM")
    assert 10 <= path.stat().st_size / 160_000 <= 18


def test_show_of_any_length_goes_by_keys_and_never_through_all_rows(tmp_path: Path) -> None:
    clocks, path = Clocks(), tmp_path / "m.sqlite"
    a_week(path, clocks, Keep()).close()
    lengths = (None, 7 * 86_400.0, 86_400.0, 7_200.0, 60.0)
    lines = {line for last_s in lengths for line in plans_of(path, partial(summarise, path, last_s=last_s))}
    # `s` is what has been added up already; names are some hundreds.
    assert {line for line in lines if line.startswith("SCAN")} <= {"SCAN name", "SCAN s"}
    assert any(line.startswith("SEARCH t USING PRIMARY KEY (process=? AND hour>?") for line in lines)
    assert any(line.startswith("SEARCH t USING PRIMARY KEY (process=? AND minute>?") for line in lines)


def test_what_is_old_is_found_by_its_age(tmp_path: Path) -> None:
    """Retention looks once a minute for what is too old: by an index, or it would read 90 days each time."""
    path = tmp_path / "m.sqlite"
    SqliteStore(path).close()
    statements: list[str] = []
    with sqlite3.connect(path) as connection:
        connection.set_trace_callback(statements.append)
        prune(connection, Keep(1.0, 1.0), NOW_S)
        connection.set_trace_callback(None)
        lines = {line for each in statements for *_, line in connection.execute(f"EXPLAIN QUERY PLAN {each}")}
    assert {line for line in lines if line.startswith("SCAN")} <= {"SCAN process", "SCAN run"}
    for table in ("span", "sighting", "acquisition"):
        assert any(line.startswith(f"SEARCH {table} ") and f"{table}_age (wall_s<?)" in line for line in lines)


def test_the_blocks_are_seconds_then_minutes_then_hours(tmp_path: Path) -> None:
    """While there are not too many numbers: with 20 counters 66 minutes of seconds, 66 hours of minutes."""
    for hours, block_s in ((1, 1), (2, 60), (66, 60), (68, 3_600)):
        path = tmp_path / f"{hours}.sqlite"
        store = SqliteStore(path)
        for second in (0, 3_600 * hours - 1):
            store.write([CountRow("cam0", 0, 1_000_000 * second, f"counter {i}", 1) for i in range(20)])
        store.close()
        assert summarise(path).block_s == block_s
