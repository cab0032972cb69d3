"""Sections of docs/results.md, one a stored result: nothing is computed here, every number is the result's own.

A section says what was done, with which sensor, commit, parameters, release and seeds; its tables have the paper's
value (quoted, never ranked), whoever else was measured, ours, and where ours is worse.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from heliograph_services.cli.studies.catalogue import STUDIES
from heliograph_services.cli.studies.stored import read_result
from heliograph_services.cli.studies.study import Figure

# A result that an older program made.
CARRIED: Final = "carried"
# The folder, beside the results of full runs, of those of long ones.
LONG: Final = "long"
HEAD: Final = """# Results of the studies

Written by `heliograph evaluate`; definitions: docs/metrics.md. The paper's values are quoted and never ranked against
others: another simulator, or hardware. *Worse*: others that were measured here read more than ours, beyond chance
(95 %, paired where the frames are the same). Nothing is ranked across kinds of evidence.
"""


def section(result: dict[str, Any], plot: str | None = None) -> str:
    """Return a study's section in Markdown.

    Args:
        result: as stored.
        plot: where its plot is, from the page; None: it has none.
    """
    seeds = result["seeds"]
    is_long = result["size"] in {LONG, CARRIED}
    lines = [f"## {result['title']}{', a long run' if is_long else ''}", "", result["about"], ""]
    if result["size"] == CARRIED:
        lines += ["**Carried over: run before there was this command, with the commit and seeds below.**", ""]
    size = LONG if is_long else result["size"]
    lines.append(
        f"`heliograph evaluate {result['study']} --{size} --release {result['release']}`. Preset:"
        f" {result['preset']}. Commit {result['commit']}, parameters `{result['parameters']}`, code `{result['code']}`,"
        f" {seeds['count']} seeds from {seeds['first']} to {seeds['last']}, looked at {_times(result['looks'])};"
        f" {result['cells_done']} of {result['cells']} cells, {result['cpu_s']:.0f} CPU s."
    )
    if result["size"] == "quick":
        lines += ["", "**Quick: a trial of the command, too short for conclusions.**"]
    if plot is not None:
        lines += ["", f"![{result['title']}]({plot})"]
    for table in result["tables"]:
        if table["rows"]:
            lines += ["", *_table(table)]
    return "\n".join(lines) + "\n"


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"


def _table(table: dict[str, Any]) -> list[str]:
    head = ["", "evidence", "paper (quoted)", *table["columns"], "where we are worse", "n"]
    lines = [f"### {table['title']}", "", _line(head), _line(["---"] * len(head))]
    for row in table["rows"]:
        figures = [str(Figure(**row["figures"][name])) if name in row["figures"] else "-" for name in table["columns"]]
        # Nowhere is said only where somebody else was measured, too.
        compared = sum(figures[i] != "-" for i in range(len(figures))) > 1 and "ours" in table["columns"]
        worse = row["worse"] or ("nowhere" if compared else "-")
        lines.append(_line([row["what"], row["evidence"], row["published"], *figures, worse, row["n"]]))
    if table["note"]:
        lines += ["", table["note"]]
    return lines


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def sections(folder: Path, plots: str = "") -> list[str]:
    """Return the sections of all results in a folder, in the studies' order, each before its long run.

    Args:
        folder: with STUDY.json and STUDY.png.
        plots: the folder as seen from the page; empty: the page is in it.

    Raises:
        FileError: a result is broken.
    """
    out = []
    for path in (folder / beside / f"{name}.json" for name in STUDIES for beside in ("", LONG)):
        if path.exists():
            plot = path.with_suffix(".png")
            where = f"{plots}{plot.relative_to(folder).as_posix()}"
            out.append(section(read_result(path), where if plot.exists() else None))
    return out


def page(folder: Path) -> str:
    """Return the page of all results in a folder.

    Raises:
        FileError: a result is broken.
    """
    return "\n".join([HEAD, *sections(folder)])
