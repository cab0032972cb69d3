"""The tracker's study: many beacons, crossings, occlusions, a hand, a spinning disc; beside the genie.

    python bench/study_tracker.py moving|identities|crowd|crossings|occlusions|handheld|spin|all
        [--cost] [--first 1000] [--n N] [--jobs 2] [--folder bench/results/tracker] [--summary] [--told]
        [--page docs/tracker.md]

One run is one line of FOLDER/STUDY.jsonl; a study that is broken off goes on where it was, unless the code under it has
changed (a hash of it is in every line). `--cost` prints what a study would take; `--summary` only sums up what is
there; `--page` writes the page of all studies. Seeds from 1000 on; 0 to 99 are for development (`--first 0`).

moving      20 beacons, a new payload for every frame: MAR_sent of ours and the genie's, paired, outside and inside
            close pairs; wrong frames; places; where frames were lost. seed11 at six rates, two sensors, 0 to 400 and
            400 to 2,000 px/s, even ground under a still camera (noise) or textured under a swaying one.
identities  20 beacons with payloads of their own, 60 s: swaps, acquisition, MOTA, IDF1, GOSPA, RMSE
crowd       the built-in one: 100 beacons; identified within 3 s, swaps in 30 s
crossings   two beacons, four kinds: do they keep their numbers, and their identities
occlusions  hidden for 0.5 s: the same number and payload 0.5 s afterwards
handheld    the built-in one: MAR_sent, its lower bound
spin        the built-in one: MAR_sent over speed, ours and the genie's

Evidence: simulated. K = 1. In lockstep, tracks at the tracker's default period. Nothing is tuned on these runs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Final

import heliograph
import heliograph_services
from heliograph_services.cli.studies import tracker_page, tracker_tables
from heliograph_services.cli.studies.crowds import KINDS, RATES
from heliograph_services.cli.studies.tracker_rows import RUNS

Row = dict[str, Any]

SENSORS: Final = ("mini", "imx636")
MOVES: Final = ("slow", "fast")
# Runs of each condition unless --n says otherwise: what two cores do in half an hour, all studies together.
REPEATS: Final = {
    "moving": 3, "identities": 1, "crowd": 1, "crossings": 50, "occlusions": 10, "handheld": 3, "spin": 2,
}  # fmt: skip
# Of `moving`, bit/s: these over the even ground get all the repeats; the other conditions a third of them.
OFTEN: Final = (1000.0, 2000.0, 5000.0)
# CPU seconds of a run, all readers and the scoring together, from development runs of these or shorter.
CPU_S: Final = {
    "moving": 11.0, "identities": 125.0, "crowd": 160.0, "crossings": 2.2, "occlusions": 7.0, "handheld": 95.0,
    "spin": 40.0,
}  # fmt: skip


def plan(study: str, first: int, n: int, *, told: bool) -> list[Row]:
    """Return the arguments of every run of a study; each has a seed of its own."""
    conditions: list[Row]
    if study == "moving":
        readers = ["ours", "told", "genie"] if told else ["ours", "genie"]
        conditions = [
            {"sensor": sensor, "move": move, "bit_rate": rate, "seconds": 3.5, "background": ground, "readers": readers}
            for ground in ("noise", "texture")
            for sensor in SENSORS
            for move in MOVES
            for rate in RATES
            # The ground's own events do not depend on the beacons' rate: two of them there.
            if ground == "noise" or rate in {1000.0, 3500.0}
        ]
    elif study == "identities":
        conditions = [
            {"sensor": sensor, "move": move, "bit_rate": rate, "seconds": 60.0, "background": "noise"}
            for sensor, rate in (("mini", 1000.0), ("imx636", 2000.0))
            for move in MOVES
        ]
    elif study == "crossings":
        conditions = [{"kind": kind} for kind in KINDS]
    elif study == "occlusions":
        conditions = [
            {"motion": motion, "camera": camera}
            for motion in ("constant", "turning")
            for camera in ("still", "panning")
        ]
    else:
        conditions = [{"seconds": {"crowd": 30.0, "handheld": 15.0, "spin": 40.0}[study]}]
    rare = max(1, n // 3)
    runs = [
        dict(condition)
        for i in range(n)
        for condition in conditions
        if i < rare or study != "moving" or (condition["background"] == "noise" and condition["bit_rate"] in OFTEN)
    ]
    for i, run in enumerate(runs):
        run["seed"] = first + i
        if study in {"crossings", "occlusions"}:
            run["bit_rate"] = RATES[i // len(conditions) % len(RATES)]
    return runs


def code_hash() -> str:
    """Return a hash of the source under study: what is shared, and the services."""
    digest = hashlib.sha256()
    for package in (heliograph, heliograph_services):
        root = Path(package.__path__[0])
        for path in sorted(root.rglob("*.py")):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def commit() -> str:
    """Return the commit that is checked out, `-dirty` if changed; `unknown` outside a clone."""
    asked = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--exclude", "*"]
    try:
        return subprocess.run(asked, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def stored(path: Path, code: str | None) -> list[Row]:
    """Return the rows of a file: those of this code, or all."""
    if not path.exists():
        return []
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    return [row for row in rows if code is None or row["code"] == code]


def one(study: str, run: Row) -> Row:
    """Run one run in a process of its own."""
    return RUNS[study](**run)


def execute(study: str, runs: Iterable[Row], path: Path, code: str, jobs: int) -> None:
    """Run what is not there yet, a line each."""
    done = {json.dumps(row["run"], sort_keys=True) for row in stored(path, code)}
    left = [run for run in runs if json.dumps(run, sort_keys=True) not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    began_s, head = time.monotonic(), {"study": study, "code": code, "commit": commit(), "evidence": "simulated"}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool, path.open("a", encoding="utf-8") as file:
        waiting = {pool.submit(one, study, run): run for run in left}
        for i, future in enumerate(as_completed(waiting), 1):
            row = {**head, "run": waiting[future], **future.result()}
            file.write(json.dumps(row) + "\n")
            file.flush()
            took_s = time.monotonic() - began_s
            print(f"\r{study}: {i} of {len(left)} runs, {took_s:.0f} s", end="", file=sys.stderr, flush=True)
    if left:
        print(file=sys.stderr)


def main() -> None:
    """Run studies and sum them up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=[*RUNS, "all"])
    parser.add_argument("--cost", action="store_true", help="print what it would take, and stop")
    parser.add_argument("--first", type=int, default=1000, help="the first seed")
    parser.add_argument("--n", type=int, help="runs of each condition")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent / "results" / "tracker")
    parser.add_argument("--summary", action="store_true", help="sum up what is there, of whatever code")
    parser.add_argument("--told", action="store_true", help="moving: also the decoder that is told the truth")
    parser.add_argument("--page", type=Path, help="where the page of all studies is written")
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    code = code_hash()
    for study in RUNS if arguments.study == "all" else [arguments.study]:
        runs = plan(study, arguments.first, arguments.n or REPEATS[study], told=arguments.told)
        path = arguments.folder / f"{study}.jsonl"
        if arguments.cost:
            print(
                f"{study:<11} {len(runs):>4} runs of about {CPU_S[study]:.0f} CPU s: {len(runs) * CPU_S[study]:.0f} s"
            )
            continue
        if not arguments.summary:
            execute(study, runs, path, code, arguments.jobs)
        rows = stored(path, None if arguments.summary else code)
        print("\n".join(tracker_tables.lines(study, rows)), flush=True)
    if arguments.page and not arguments.cost:
        found = {study: stored(arguments.folder / f"{study}.jsonl", None) for study in RUNS}
        arguments.page.write_text(tracker_page.page(found), encoding="utf-8")


if __name__ == "__main__":
    main()
