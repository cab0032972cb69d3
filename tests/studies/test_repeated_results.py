"""`bench/repeat_results.py`: two runs of the studies, compared cell by cell."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
HEAD = {"commit": "0123456", "machine": {"cpu": "one"}}


def a_run(folder: Path, frames: list[int], *, cpu_s: float = 1.0, arms: tuple[str, ...] = ("ours",)) -> Path:
    """Write a folder of results: a study of one cell for each count of frames."""
    folder.mkdir()
    lines: list[dict[str, Any]] = [{"schema": 1, "study": "moving"}, {"look": HEAD}]
    for seed, told in enumerate(frames):
        counts = {"blocks": {arm: [[0, told]] for arm in arms}, "cpu_s": cpu_s}
        cell = {"distance_m": 5.0, "arms": list(arms)}
        lines.append({"cell": cell, "seed": seed, "counts": counts, "cpu_s": cpu_s})
    (folder / "moving.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (folder / "moving.json").write_text(json.dumps({**HEAD, "timing": False, "tables": []}))
    return folder


def a_timing(folder: Path, value: float) -> Path:
    """Write a folder of results: a study of times, one figure within .1 of its value."""
    folder.mkdir()
    figure = {"value": value, "low": value - 0.1, "high": value + 0.1}
    table = {"title": "latency", "rows": [{"what": "5 ms", "figures": {"p50_ms": figure}}]}
    (folder / "distribution.json").write_text(json.dumps({**HEAD, "timing": True, "tables": [table]}))
    (folder / "distribution.jsonl").write_text('{"schema": 1}\n')
    return folder


def compare(first: Path, second: Path) -> tuple[int, dict[str, Any], str]:
    """Return exit status, what was written, and what was said."""
    out = first.parent / "repeated.json"
    command = [sys.executable, str(ROOT / "bench/repeat_results.py"), str(first), str(second), "--out", str(out)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    return done.returncode, json.loads(out.read_text()) if out.is_file() else {}, done.stdout + done.stderr


def test_equal_cells_that_took_other_times_are_equal(tmp_path: Path) -> None:
    status, out, _ = compare(a_run(tmp_path / "a", [10, 11]), a_run(tmp_path / "b", [10, 11], cpu_s=9.0))
    moving = out["studies"]["moving"]
    assert status == 0
    assert (moving["cells"], moving["equal"], moving["only_first"], moving["only_second"]) == (2, 2, 0, 0)
    assert moving["cpu_s"] == [2.0, 18.0]


def test_a_cell_that_counted_one_frame_less_is_found_and_named(tmp_path: Path) -> None:
    status, out, said = compare(a_run(tmp_path / "a", [10, 11]), a_run(tmp_path / "b", [10, 10]))
    assert status == 1
    assert out["studies"]["moving"]["equal"] == 1
    assert "seed 1" in said
    assert "seed 0" not in said


def test_a_cell_of_one_run_alone_is_counted_apart(tmp_path: Path) -> None:
    _, out, _ = compare(a_run(tmp_path / "a", [10, 11, 12]), a_run(tmp_path / "b", [10, 11]))
    assert (out["studies"]["moving"]["cells"], out["studies"]["moving"]["only_first"]) == (2, 1)


def test_readers_that_both_runs_had_are_compared(tmp_path: Path) -> None:
    first, second = a_run(tmp_path / "a", [10], arms=("ours", "paper")), a_run(tmp_path / "b", [10], arms=("ours",))
    assert compare(first, second)[1]["studies"]["moving"]["equal"] == 1


def test_a_time_outside_the_first_interval_is_listed(tmp_path: Path) -> None:
    status, out, _ = compare(a_timing(tmp_path / "a", 2.0), a_timing(tmp_path / "b", 2.3))
    assert status == 0  # times are no counts: told, and no fault
    told = out["studies"]["distribution"]
    assert (told["figures"], told["within"]) == (1, 0)
    assert "2.3" in told["outside"][0]


def test_two_runs_with_nothing_in_common_are_no_equal_runs(tmp_path: Path) -> None:
    empty = tmp_path / "b"
    empty.mkdir()
    status, out, said = compare(a_run(tmp_path / "a", [10]), empty)
    assert (status, out) == (2, {})
    assert "in common" in said
