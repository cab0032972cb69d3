"""Compares two runs of `heliograph evaluate`: which cells counted the same, and which figures left their intervals.

    python bench/repeat_results.py FIRST SECOND [--out FILE]    folders of results; writes bench/results/repeated.json

Cells of both are compared by study, parameters and seed. Their counts must be the same to the last digit, but for CPU
times; of a cell that both ran with other readers, what both readers made of it. A study of real processes and of
times (`timing`) has no equal cells: of each of its rows with an interval, the second value lies within the first's
interval, or outside. A difference is listed, with its cell or row. `cpu_s` is what the cells of both took in each run:
where the same work took longer, the machine was another, or had other tenants. Exit status 1 where cells differ, 2
where there is nothing to compare.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

RESULT: Final = Path(__file__).parent / "results" / "repeated.json"
Cells = dict[str, dict[str, Any]]
# How many differences of a study are printed; all are stored.
LISTED: Final = 20


def cells_of(path: Path) -> Cells:
    """Return the counts of a study's cells, by parameters (but the readers) and seed."""
    out: Cells = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        one = json.loads(line)
        if "cell" in one:
            what = {name: value for name, value in one["cell"].items() if name != "arms"}
            out[f"{json.dumps(what, sort_keys=True)} seed {one['seed']}"] = timeless(one["counts"])
    return out


def cpu_s_of(first: Path, second: Path) -> list[float]:
    """Return what the cells that both files hold took in each, in CPU seconds."""
    took: list[dict[str, float]] = []
    for path in (first, second):
        lines = map(json.loads, path.read_text(encoding="utf-8").splitlines())
        took.append({json.dumps([one["cell"], one["seed"]]): one["cpu_s"] for one in lines if "cell" in one})
    both = took[0].keys() & took[1].keys()
    return [round(sum(one[key] for key in both), 1) for one in took]


def timeless(value: Any) -> Any:
    """Return counts without CPU times."""
    if isinstance(value, dict):
        return {name: timeless(one) for name, one in value.items() if name != "cpu_s"}
    return [timeless(one) for one in value] if isinstance(value, list) else value


def same(first: Any, second: Any) -> bool:
    """Return whether counts are equal; of readers (`blocks`, `inserted`), those that both have."""
    if not isinstance(first, dict) or not isinstance(second, dict):
        return bool(first == second)
    out = True
    for name in {*first, *second}:
        if name in first and name in second:
            one, other = first[name], second[name]
            if name in ("blocks", "inserted") and isinstance(one, dict):
                both = one.keys() & other.keys()
                out &= {arm: one[arm] for arm in both} == {arm: other[arm] for arm in both}
            else:
                out &= one == other
        else:
            out = False
    return out


def equal_cells(first: Path, second: Path) -> dict[str, Any]:
    """Return how many cells of a study are in both, and which differ."""
    one, other = cells_of(first), cells_of(second)
    both = sorted(one.keys() & other.keys())
    differ = [key for key in both if not same(one[key], other[key])]
    return {
        "cells": len(both),
        "equal": len(both) - len(differ),
        "only_first": len(one) - len(both),
        "only_second": len(other) - len(both),
        "differ": differ,
    }


def within(first: Path, second: Path) -> dict[str, Any]:
    """Return how many figures of the second lie in the intervals of the first, and which do not."""
    rows = [
        {(table["title"], row["what"], name): figure for table in json.loads(path.read_text())["tables"]
         for row in table["rows"] for name, figure in row["figures"].items()}
        for path in (first, second)
    ]  # fmt: skip
    inside, outside = 0, []
    for key in sorted(rows[0].keys() & rows[1].keys()):
        mine, theirs = rows[0][key], rows[1][key]
        if None in (mine["low"], mine["high"], theirs["value"]):
            continue
        if mine["low"] <= theirs["value"] <= mine["high"]:
            inside += 1
        else:
            outside.append(f"{' / '.join(key)}: {theirs['value']} not in [{mine['low']} {mine['high']}]")
    return {"figures": inside + len(outside), "within": inside, "outside": outside}


def compared(first: Path, second: Path) -> dict[str, Any]:
    """Return, for each study that both folders hold, what is equal, and where and by which code each was run."""
    studies: dict[str, Any] = {}
    looks: dict[str, Any] = {}
    for path in sorted(first.glob("*.json")):
        other = second / path.name
        if not other.is_file():
            continue
        heads = [json.loads(one.read_text(encoding="utf-8")) for one in (path, other)]
        looks[path.stem] = [{"commit": head["commit"], "machine": head["machine"]} for head in heads]
        cells = [one.with_suffix(".jsonl") for one in (path, other)]
        found = within(path, other) if heads[0]["timing"] else equal_cells(*cells)
        studies[path.stem] = found | {"cpu_s": cpu_s_of(*cells)}
    return {"studies": studies, "looks": looks}


def main() -> int:
    """Compare; return 1 where cells differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("--out", type=Path, default=RESULT)
    arguments = parser.parse_args()
    out = compared(arguments.first, arguments.second)
    if not any(one.get("cells", 0) + one.get("figures", 0) for one in out["studies"].values()):
        parser.error(f"{arguments.first} and {arguments.second} have no cell of a study in common")
    arguments.out.write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")
    for name, one in out["studies"].items():
        first_s, second_s = one["cpu_s"]
        told = "  ".join(f"{key} {value}" for key, value in one.items() if isinstance(value, int))
        print(f"{name:14}{told}  CPU s {first_s:.0f}, {second_s:.0f}")
        different = one.get("differ") or one.get("outside") or []
        print("".join(f"    {line}\n" for line in different[:LISTED]), end="")
        if len(different) > LISTED:
            print(f"    and {len(different) - LISTED} more: {arguments.out}")
    return int(any(one.get("differ") for one in out["studies"].values()))


if __name__ == "__main__":
    sys.exit(main())
