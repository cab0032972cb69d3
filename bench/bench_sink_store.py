"""A week in the metrics file: its size against the computed one, queries and their plans, retention.

A site of one camera, five beacons and four processes, 42 rows a second; and again with a truth, 88 rows a second. The
first hour goes through the store, second by second, as live. The other hours are that hour's rows with their time moved
on, in the order in which they would have come, a transaction an hour: each row as the store would have written it,
without its cost in Python.
Sightings: one beacon comes and goes every ten minutes.

Size, by SQLite's record format, computed before the week is written: a cell of a table without rowid has a length
(1 byte), a pointer (2), a header of 1 + columns bytes, and each integer in the fewest of 0, 1, 2, 3, 4, 6 or 8 bytes
(0 and 1 in none), a real in 8. Pages are not full: `fill` is the hour's cells over the hour's file; the computed size
is the week's cells over that.

Queries: `heliograph metrics show` without printing, REPEATS times in this process, file in the page cache; median and
slowest. Of every statement of them SQLite tells the plan: none may go through all rows of a series. Retention: the
host's clock a day further, `prune` until nothing is left to prune; the longest turn is how long the sink's loop waits.

Run: OMP_NUM_THREADS=1 python bench/bench_sink_store.py [--hours 168] [-o FILE] (two minutes of one core)
"""

from __future__ import annotations

import argparse
import json
import platform
import sqlite3
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

sys.path[:0] = [str(Path(__file__).parents[1] / "tests")]

from heliograph_services.metrics_sink.rows import (  # noqa: E402
    CountRow,
    HopRow,
    LevelRow,
    ProcessCountRow,
    Row,
    SightingRow,
)
from heliograph_services.metrics_sink.schema import SERIES, TIERS  # noqa: E402
from heliograph_services.metrics_sink.store import SqliteStore  # noqa: E402
from heliograph_services.metrics_sink.summary import summarise  # noqa: E402
from heliograph_services.metrics_sink.tiers import Keep, prune  # noqa: E402
from support.plans import plans_of  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "sink_store.json"
REPEATS: Final = 7
HOUR_S: Final = 3_600
DAY_S: Final = 86_400
COUNTS: Final = {
    "frames": 450, "seconds": 1, "refused/parity": 3, "refused/weak": 12, "refused/no bit clock found": 2,
    "observed_us": 1_000_000, "track_us": 6_000_000, "mar_estimates": 5, "mar_estimate_ppm": 4_950_000,
    "characters": 40,
}  # fmt: skip
PROCESSES: Final = {
    "event_source": (("published: events", "published: onsets"), ()),
    "tracker": (("published: tracks", "bytes out"), ("late", "bus", "wait", "core", "publish")),
    "decoder": (("published: frames", "published: ids"), ("late", "bus", "wait", "core", "publish", "whole")),
    "metrics_sink": (("published: metrics", "bytes out"), ("late", "bus", "wait", "core", "publish")),
}
TRUTH: Final = {
    f"{name}/beacon{i}": n
    for i in range(5)
    for name, n in (
        ("sent_visible", 90), ("right_visible", 89), ("sent_in_view", 90), ("right_in_view", 89), ("bits_visible", 990),
        ("bits_right", 985), ("bits_matched", 990), ("payload_bits", 534), ("visible_us", 990_000),
    )
} | {"right/seed11": 445}  # fmt: skip


def second_of(second: int, *, truth: bool) -> list[Row]:
    """Return a second's rows; the numbers vary as much as theirs would."""
    vary = (second * 2_654_435_761) % 97
    rows: list[Row] = [CountRow("cam0", 0, 1_000_000 * second, name, n + vary % n) for name, n in COUNTS.items()]
    # What is right may not vary beyond what was sent.
    rows += [CountRow("cam0", 0, 1_000_000 * second, name, n) for name, n in (TRUTH if truth else {}).items()]
    for pid, (kind, (rates, hops)) in enumerate(PROCESSES.items(), 100):
        process = (kind, kind, pid)
        rows += [ProcessCountRow(*process, second, name, 1_000 + vary) for name in rates]
        levels = {"queue": float(vary % 4), "cpu_share": 0.25 + vary / 1e3}
        rows += [LevelRow(*process, second, name, value) for name, value in levels.items()]
        rows += [HopRow(*process, second, hop, 1_000, 900 + vary, 2_000 + vary, 5_000 + vary) for hop in hops]
    if second % 600 == 0:
        place = (100.0, 100.0, 120.0, 90.0)
        began_us = 1_000_000 * second
        rows.append(
            SightingRow(
                "cam0", 0, f"t-{second}", "crane", "seed11", began_us, began_us + 590_000_000, *place, 53_100, True
            )
        )
    return rows


def through_the_store(path: Path, seconds: int, *, truth: bool) -> dict[str, float]:
    """Write the first seconds as the sink does, a commit a second; return what a row and a commit cost."""
    wall_s = time.time() - 14 * DAY_S
    now = [0.0]
    store = SqliteStore(path, "bench", lambda: now[0], wall=lambda: wall_s + now[0])
    began_s = time.process_time()
    commits_s = []
    for second in range(seconds):
        rows = second_of(second, truth=truth)
        now[0] = second + 1.0
        commit_s = time.perf_counter()
        store.write(rows)
        commits_s.append(time.perf_counter() - commit_s)
    store.close()
    cpu_s = time.process_time() - began_s
    return {"cpu_us_a_row": round(1e6 * cpu_s / store.written, 2), "cpu_ms_a_second": round(1e3 * cpu_s / seconds, 2),
            "median_commit_ms": round(1e3 * statistics.median(commits_s), 2),
            "slowest_commit_ms": round(1e3 * max(commits_s), 1)}  # fmt: skip


def every_series() -> list[tuple[str, str, str, int, list[str]]]:
    """Return (table, what its rows are owned by, its time, seconds a step, its other columns) of all tiers."""
    return [
        (table + tier, owner, time_, step_s, list(columns))
        for table, (owner, columns) in SERIES.items()
        for tier, (time_, step_s) in TIERS.items()
    ]


def size_of(column: str) -> str:
    """Return SQL for the bytes that a value takes in a record."""
    return (
        f"CASE WHEN typeof({column}) = 'real' AND {column} != CAST({column} AS INTEGER) THEN 8"
        f" WHEN {column} IN (0, 1) THEN 0 WHEN abs({column}) < 128 THEN 1 WHEN abs({column}) < 32768 THEN 2"
        f" WHEN abs({column}) < 8388608 THEN 3 WHEN abs({column}) < 2147483648 THEN 4"
        f" WHEN abs({column}) < 140737488355328 THEN 6 ELSE 8 END"
    )


def computed(path: Path, hours: int) -> tuple[int, int]:
    """Return the bytes of all cells of the series after so many hours like the first, and how many they are."""
    connection = sqlite3.connect(path)
    total = rows = 0
    for table, owner, time_, step_s, columns in every_series():
        rest = " + ".join(size_of(column) for column in (owner, "name", *columns))
        n, payload = connection.execute(f"SELECT count(*), ifnull(sum({rest}), 0) FROM {table}").fetchone()
        steps = HOUR_S // step_s
        # The rows of a step of the hour, for each step of the hours.
        (times,) = connection.execute(
            f"WITH RECURSIVE at(i) AS (VALUES (0) UNION ALL SELECT i + 1 FROM at WHERE i + 1 < {hours * steps}),"
            f" held(step, n) AS MATERIALIZED (SELECT {time_}, count(*) FROM {table} GROUP BY 1)"
            f" SELECT ifnull(sum(held.n * ({size_of('i')})), 0) FROM at JOIN held ON held.step = i % {steps}"
        ).fetchone()
        total += hours * (payload + n * (3 + 1 + 3 + len(columns))) + times
        rows += hours * n
    connection.close()
    return total, rows


def go_on(path: Path, hours: int) -> None:
    """Repeat the hour that is there until there are so many."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode = OFF")
    connection.execute("PRAGMA synchronous = OFF")
    connection.execute("PRAGMA temp_store = MEMORY")
    for table, owner, time_, _, _ in every_series():
        connection.execute(f"CREATE TEMP TABLE hour_{table} AS SELECT * FROM {table} ORDER BY {time_}, {owner}, name")
    for table in ("span", "sighting"):
        connection.execute(f"CREATE TEMP TABLE hour_{table} AS SELECT * FROM {table}")
    for hour in range(1, hours):
        connection.execute("BEGIN")
        for table, owner, time_, step_s, columns in every_series():
            connection.execute(
                f"INSERT INTO {table} SELECT {owner}, {time_} + {hour * HOUR_S // step_s}, name, {', '.join(columns)}"
                f" FROM hour_{table} ORDER BY rowid"
            )
        connection.execute(
            f"INSERT INTO span SELECT stream, minute + {60 * hour}, wall_s + {HOUR_S * hour}, has_seconds"
            " FROM hour_span"
        )
        us = HOUR_S * 1_000_000 * hour
        connection.execute(
            f"INSERT INTO sighting SELECT stream, track || '-{hour}', beacon, protocol, first_us + {us},"
            f" last_us + {us}, first_x_px, first_y_px, last_x_px, last_y_px, frames, ended, wall_s + {HOUR_S * hour}"
            " FROM hour_sighting"
        )
        connection.execute(f"UPDATE run SET written_wall_s = written_wall_s + {HOUR_S}")
        connection.execute("COMMIT")
    connection.execute("PRAGMA journal_mode = WAL")
    connection.close()


def timed(query: Callable[[], Any]) -> dict[str, float]:
    """Return the median and the slowest time of a query, wall-clock ms, and the median of its CPU time."""
    times, cpu = [], []
    for _ in range(REPEATS):
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        query()
        times.append(1e3 * (time.perf_counter() - began_s))
        cpu.append(1e3 * (time.process_time() - began_cpu_s))
    return {"median_ms": round(statistics.median(times), 1), "slowest_ms": round(max(times), 1),
            "cpu_median_ms": round(statistics.median(cpu), 1)}  # fmt: skip


def retention(path: Path, keep_h: float) -> dict[str, Any]:
    """Let the host's clock go on by a day; return what went, in how many turns, and the longest."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA synchronous = NORMAL")
    (now_s,) = connection.execute("SELECT max(written_wall_s) FROM run").fetchone()
    turns_s, pruned = [], 0
    while True:
        began_s = time.perf_counter()
        connection.execute("BEGIN IMMEDIATE")
        n = prune(connection, Keep(keep_h, 90.0), now_s + DAY_S)
        connection.execute("COMMIT")
        turns_s.append(time.perf_counter() - began_s)
        if not n:
            break
        pruned += n
    left = {
        table: connection.execute(f"SELECT min({time_}), max({time_}) FROM {table}").fetchone()
        for table, _, time_, _, _ in every_series()
    }
    (free,) = connection.execute("PRAGMA freelist_count").fetchone()
    (pages,) = connection.execute("PRAGMA page_count").fetchone()
    connection.close()
    return {"rows": pruned, "turns": len(turns_s) - 1, "median_turn_ms": round(1e3 * statistics.median(turns_s), 1),
            "longest_turn_ms": round(1e3 * max(turns_s), 1), "first_and_last_left": left,
            "free_to_be_used_again": round(free / pages, 3)}  # fmt: skip


def run(hours: int, *, truth: bool) -> dict[str, Any]:
    """Return what was measured."""
    with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as folder:
        path = Path(folder) / "week.sqlite"
        result: dict[str, Any] = {"store": through_the_store(path, HOUR_S, truth=truth)}
        cells, rows = computed(path, 1)
        fill = cells / path.stat().st_size
        result["hour"] = {"rows": rows, "mb": round(path.stat().st_size / 1e6, 2), "fill": round(fill, 3)}
        cells, expected = computed(path, hours)
        began_s = time.perf_counter()
        go_on(path, hours)
        connection = sqlite3.connect(path)
        rows = sum(connection.execute(f"SELECT count(*) FROM {row[0]}").fetchone()[0] for row in every_series())
        connection.close()
        size = path.stat().st_size
        result["size"] = {"rows": rows, "rows_expected": expected, "computed_mb": round(cells / fill / 1e6, 1),
                          "seen_mb": round(size / 1e6, 1), "seen_of_computed": round(size * fill / cells, 3),
                          "bytes_a_row": round(size / rows, 2),
                          "filled_in_s": round(time.perf_counter() - began_s, 1)}  # fmt: skip
        queries: dict[str, Callable[[], Any]] = {
            "show": lambda: summarise(path),
            "show --last 7d": lambda: summarise(path, last_s=7.0 * DAY_S),
            "show --last 2d": lambda: summarise(path, last_s=2.0 * DAY_S - 60),
            "show --last 1d": lambda: summarise(path, last_s=1.0 * DAY_S),
            "show --last 2h": lambda: summarise(path, last_s=2.0 * HOUR_S - 60),
            "show --last 10m": lambda: summarise(path, last_s=600.0),
        }
        result["queries"] = {name: timed(query) for name, query in queries.items()}
        result["plans"] = sorted({line for query in queries.values() for line in plans_of(path, query)})
        found = summarise(path)
        result["seen"] = {"frames": found.frames, "seconds": found.seconds, "sightings": len(found.sightings)}
        result["retention"] = retention(path, float(hours))
        after = summarise(path)
        result["after"] = {"seconds": after.seconds, "sightings": len(after.sightings)}
        return result


def main() -> None:
    """Measure, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=int, default=168)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    result = {"evidence": "simulated", "machine": platform.machine(), "python": platform.python_version()}
    result |= {"sqlite": sqlite3.sqlite_version, "hours": args.hours}
    for name, truth in (("without_truth", False), ("with_truth", True)):
        result[name] = run(args.hours, truth=truth)
        print(name, *(f"  {key}: {value}" for key, value in result[name].items()), sep="\n")
    args.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
