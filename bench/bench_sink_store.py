"""A week in the metrics file: its size against the computed one, queries, retention.

A site of one camera, five beacons and four processes (no truth), 42 rows a second. The first hour goes through the
store, second by second, as live; then SQLite copies the hour on, all tiers, until `--hours` are there (each row as the
store would have written it, without its cost in Python). Sightings: one beacon comes and goes every ten minutes.

Size, by SQLite's record format: a cell of a table without rowid has a length (1 byte), a pointer (2), a header of
1 + columns bytes, and each integer in the fewest of 0, 1, 2, 3, 4, 6 or 8 bytes (0 and 1 in none), a real in 8. Pages
are not full: `fill` is computed over measured, and the week's must be that of the first hour.

Queries: `heliograph metrics show` without printing, each REPEATS times in this process, file in the page cache; the
slowest counts. Retention: the host's clock a day further, `prune` until nothing is left to prune; the longest turn is
how long the sink's loop waits.

Run: OMP_NUM_THREADS=1 python bench/bench_sink_store.py [--hours 168] [-o FILE] (a minute of one core for a week)
"""

from __future__ import annotations

import argparse
import json
import platform
import sqlite3
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from heliograph_services.metrics_sink.rows import CountRow, HopRow, LevelRow, ProcessCountRow, Row, SightingRow
from heliograph_services.metrics_sink.store import SqliteStore
from heliograph_services.metrics_sink.summary import summarise
from heliograph_services.metrics_sink.tiers import Keep, prune

RESULT: Final = Path(__file__).parent / "results" / "sink_store.json"
REPEATS: Final = 5
HOUR_S: Final = 3_600
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
# table -> (columns, what its rows are owned by, its time, seconds a step)
SERIES: Final = {
    f"{table}{tier}": (columns, owner, tier[1:] or "second", step)
    for table, columns, owner in (
        ("count", ("n",), "stream"),
        ("rate", ("n",), "process"),
        ("level", ("value", "n"), "process"),
        ("hop", ("n", "p50_us", "p95_us", "p99_us"), "process"),
    )
    for tier, step in (("", 1), ("_minute", 60), *((("_hour", HOUR_S),) if table == "count" else ()))
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
    wall_s = time.time() - 14 * 86_400.0
    now = [0.0]
    store = SqliteStore(path, "bench", lambda: now[0], wall=lambda: wall_s + now[0])
    began_s, slowest_s = time.process_time(), 0.0
    for second in range(seconds):
        rows = second_of(second, truth=truth)
        now[0] = second + 1.0
        commit_s = time.perf_counter()
        store.write(rows)
        slowest_s = max(slowest_s, time.perf_counter() - commit_s)
    store.close()
    cpu_s = time.process_time() - began_s
    return {"cpu_us_a_row": round(1e6 * cpu_s / store.written, 2), "cpu_ms_a_second": round(1e3 * cpu_s / seconds, 2),
            "slowest_commit_ms": round(1e3 * slowest_s, 1)}  # fmt: skip


def copied_on(path: Path, hours: int) -> None:
    """Repeat the hour that is there until there are so many."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA synchronous = OFF")
    for hour in range(1, hours):
        connection.execute("BEGIN")
        for table, (columns, owner, clock, step) in SERIES.items():
            shift = hour * HOUR_S // step
            connection.execute(
                f"INSERT INTO {table} SELECT {owner}, {clock} + {shift}, name, {', '.join(columns)} FROM {table}"
                f" WHERE {clock} < {HOUR_S // step}"
            )
        connection.execute(
            f"INSERT INTO span SELECT stream, minute + {60 * hour}, wall_s + {HOUR_S * hour}, has_seconds FROM span"
            " WHERE minute < 60"
        )
        us = HOUR_S * 1_000_000 * hour
        connection.execute(
            f"INSERT INTO sighting SELECT stream, track || '-{hour}', beacon, protocol, first_us + {us},"
            f" last_us + {us},"
            f" first_x_px, first_y_px, last_x_px, last_y_px, frames, ended, wall_s + {HOUR_S * hour} FROM sighting"
            f" WHERE first_us < {HOUR_S * 1_000_000}"
        )
        connection.execute(f"UPDATE run SET written_wall_s = written_wall_s + {HOUR_S}")
        connection.execute("COMMIT")
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.close()


def computed_bytes(path: Path) -> tuple[int, int]:
    """Return the bytes of all cells of the series by the format of the module, and their number."""
    connection = sqlite3.connect(path)
    total = rows = 0
    for table, (columns, owner, clock, _) in SERIES.items():
        own = (owner, clock, "name", *columns)
        size = " + ".join(
            f"CASE WHEN typeof({c}) = 'real' AND {c} != CAST({c} AS INTEGER) THEN 8 WHEN {c} IN (0, 1) THEN 0"
            f" WHEN abs({c}) < 128 THEN 1 WHEN abs({c}) < 32768 THEN 2 WHEN abs({c}) < 8388608 THEN 3"
            f" WHEN abs({c}) < 2147483648 THEN 4 WHEN abs({c}) < 140737488355328 THEN 6 ELSE 8 END"
            for c in own
        )
        n, payload = connection.execute(f"SELECT count(*), ifnull(sum({size}), 0) FROM {table}").fetchone()
        total += payload + n * (3 + 1 + len(own))
        rows += n
    connection.close()
    return total, rows


def timed(query: Callable[[], Any]) -> dict[str, float]:
    """Return the first and the slowest time of a query, ms."""
    times = []
    for _ in range(REPEATS):
        began_s = time.perf_counter()
        query()
        times.append(1e3 * (time.perf_counter() - began_s))
    return {"first_ms": round(times[0], 1), "slowest_ms": round(max(times), 1)}


def retention(path: Path, keep_h: float) -> dict[str, Any]:
    """Let the host's clock go on by a day; return what went, in how many turns, and the longest."""
    connection = sqlite3.connect(path, isolation_level=None)
    (now_s,) = connection.execute("SELECT max(written_wall_s) FROM run").fetchone()
    turns, longest_s, pruned = 0, 0.0, 0
    while True:
        began_s = time.perf_counter()
        connection.execute("BEGIN IMMEDIATE")
        n = prune(connection, Keep(keep_h, 90.0), now_s + 86_400.0)
        connection.execute("COMMIT")
        longest_s = max(longest_s, time.perf_counter() - began_s)
        if not n:
            break
        turns, pruned = turns + 1, pruned + n
    left = {
        table: connection.execute(f"SELECT min({row[2]}), max({row[2]}) FROM {table}").fetchone()
        for table, row in SERIES.items()
    }
    connection.close()
    return {"rows": pruned, "turns": turns, "longest_turn_ms": round(1e3 * longest_s, 1), "left": left}


def run(hours: int, *, truth: bool) -> dict[str, Any]:
    """Return what was measured."""
    with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as folder:
        path = Path(folder) / "week.sqlite"
        result: dict[str, Any] = {"hours": hours, "truth": truth, "store": through_the_store(path, HOUR_S, truth=truth)}
        computed, rows = computed_bytes(path)
        result["hour"] = {"rows": rows, "fill": round(computed / path.stat().st_size, 3)}
        copied_on(path, hours)
        computed, rows = computed_bytes(path)
        size = path.stat().st_size
        result["size"] = {"rows": rows, "mb": round(size / 1e6, 1), "computed_mb": round(computed / 1e6, 1),
                          "fill": round(computed / size, 3), "bytes_a_row": round(size / rows, 2)}  # fmt: skip
        result["queries"] = {
            "show": timed(lambda: summarise(path)),
            "show --last 2h": timed(lambda: summarise(path, last_s=7_140.0)),
            "show --last 1d": timed(lambda: summarise(path, last_s=86_400.0)),
        }
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
    parser.add_argument(
        "--truth", action="store_true", help="with the counts of a scored stream: 46 rows a second more"
    )
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    result = {"evidence": "simulated", "machine": platform.machine(), "python": platform.python_version()}
    result |= {"sqlite": sqlite3.sqlite_version} | run(args.hours, truth=args.truth)
    args.output.write_text(json.dumps(result, indent=1) + "\n")
    print("\n".join(f"{name}: {value}" for name, value in result.items()))


if __name__ == "__main__":
    main()
