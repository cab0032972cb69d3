"""Write docs/results.md, and README's figures, from stored results: studies (results/, `heliograph evaluate`), then
benches (bench/results).

    python bench/make_results.py [--check]

`--check` writes nothing and fails if either is not what the results give, and says which. A section of the page whose
results are not there is left out. Bounds are for 95 %: of nothing found in T, 3 / T (ln 20 = 3.0).
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

import link_sections
import readme_figures
from link_sections import table

from heliograph_services.cli.studies import results_page

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "bench" / "results"
PAGE = ROOT / "docs" / "results.md"
README = ROOT / "README.md"
HEAD = """# Results

Written by `bench/make_results.py` from stored results: those of the studies (`heliograph evaluate`, in `results`), then
those of the benches (`bench/results`); definitions: [metrics](metrics.md). Nothing is ranked across kinds of evidence;
the paper's values are quoted. *Worse*: others that were measured here read more than ours, beyond chance (95 %, paired
where the frames are the same). A bound is what nothing found excludes with 95 %: 3 / T.
"""


# How many differences of two runs are listed on the page.
LISTED = 20
# The column of a study's tables that says where ours is worse.
WORSE = "where we are worse"


def number(value: float) -> str:
    """Return a number as people read it."""
    if value >= 1e5 or 0.0 < value < 1e-2:
        return f"{value:.1e}"
    return f"{value:,.0f}" if value >= 100 else f"{value:.2g}"


def bound(found: int, amount: float) -> str:
    """Return the 95 % bound of a rate: 3 / T where nothing was found, else found / T."""
    if amount <= 0.0:
        return "-"
    return f"< {number(3.0 / amount)}" if not found else f"**{number(found / amount)}**"


def frames_section() -> str:
    """Random frames through the decisions."""
    path = RESULTS / "false_frames.json"
    if not path.is_file():
        return ""
    stored = json.loads(path.read_text())
    lines = []
    for name, row in stored["rows"].items():
        counts = row["counts"]
        stages = ", ".join(
            f"{key.split('_')[1]}: {value:,}" for key, value in counts.items() if key.startswith("equal_")
        )
        lines.append((name, f"{counts['frames']:,}", f"{counts['accepted']:,}", stages, counts["identities"],
                      bound(counts["identities"], counts["frames"])))  # fmt: skip
    head = ("code, light", "frames", "accepted", "rows of equal (uart: good) ones", "identities", "a frame")
    return (
        "## Random frames\n\n"
        "Random bits at the very clock, each bit position taken for the beginning of a frame, through the decisions of"
        " the receivers (`bench/random_frames.py`). `clear`: 20 events a change, `dim`: 3. Rows of equal frames are"
        " counted whatever their evidence; an identity asks for that too. Evidence: simulated, at the level of slots"
        " and bits.\n\n" + table(head, lines) + "\n"
    )


def repeated_section() -> str:
    """What a second run of the studies changed."""
    path = RESULTS / "repeated.json"
    if not path.is_file():
        return ""
    stored = json.loads(path.read_text())
    rows = []
    for name, one in stored["studies"].items():
        first, second = (f"{look['commit']}, {look['machine']['cpu']}" for look in stored["looks"][name])
        if "cells" in one:
            alone = one["only_first"] + one["only_second"]
            equal = f"{one['equal']} of {one['cells']} cells" + (f"; {alone} in one run alone" if alone else "")
            told = (equal, _listed(one["differ"]))
        else:
            told = (f"{one['within']} of {one['figures']} figures within", _listed(one["outside"]))
        rows.append((name, first, second, " / ".join(f"{value:,.0f}" for value in one["cpu_s"]), *told))
    totals = [sum(one["cpu_s"][i] for one in stored["studies"].values()) for i in (0, 1)]
    said = (
        "## A second run\n\nAll studies were run twice, from the same seeds. Counts are equal or not; of the study"
        " with real processes each second figure lies in the first's interval, or is listed. The same cells took"
        f" {totals[0]:,.0f} CPU s, then {totals[1]:,.0f}: the machine is shared. Three runs leave an interval that a"
        " second three, as wide apart, miss once in eleven times. `bench/repeat_results.py`.\n\n"
    )
    return said + table(("study", "first", "second", "CPU s", "equal", "different"), rows) + "\n"


def _listed(different: list[str]) -> str:
    more = f"; and {len(different) - LISTED} more (`bench/results/repeated.json`)" if len(different) > LISTED else ""
    return ("; ".join(different[:LISTED]) or "-") + more


def contents(parts: list[str]) -> str:
    """Return a list of the sections, with how many rows of each had somebody else to beat, and how many were lost."""
    rows = []
    for part in parts:
        title = part.partition("\n")[0].lstrip("#").strip()
        anchor = re.sub(r"[^a-z0-9 _-]", "", title.lower()).replace(" ", "-")
        compared, worse = compared_rows(part)
        rows.append((f"[{title}](#{anchor})", compared or "-", worse if compared else "-"))
    return (
        table(("section", "rows with others beside ours", "ours worse than one of them, or than the genie"), rows)
        + "\n"
    )


def compared_rows(part: str) -> tuple[int, int]:
    """Return how many rows of a section's tables were compared with others, and in how many of them ours is worse."""
    column = None
    compared = worse = 0
    for line in part.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|"):
            column = None
        elif column is None:
            column = cells.index(WORSE) if WORSE in cells else -1
        elif column >= 0 and cells[column] not in {"-", "---"}:
            compared += 1
            worse += cells[column] != "nowhere"
    return compared, worse


def sections() -> list[Callable[[], str]]:
    """Return what writes the sections of benches, in their order."""
    return [*link_sections.sections(), frames_section, repeated_section]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    studies = results_page.sections(ROOT / "results", "../results/")
    parts = [*studies, *(part for part in (section() for section in sections()) if part)]
    pages = {
        PAGE: "\n".join([HEAD, contents(parts), *parts]),
        README: readme_figures.written(README.read_text()),
    }
    old = [path for path, text in pages.items() if not path.is_file() or path.read_text() != text]
    for path in old:
        if arguments.check:
            print(f"{path.relative_to(ROOT)} does not say what the stored results give", file=sys.stderr)
        else:
            path.write_text(pages[path])
    return int(arguments.check and bool(old))


if __name__ == "__main__":
    sys.exit(main())
