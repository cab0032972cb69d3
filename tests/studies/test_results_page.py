"""docs/results.md and the figures of README.md against what is stored."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from heliograph_services.cli.studies.results_page import CARRIED
from heliograph_services.cli.studies.stored import read_result

ROOT = Path(__file__).parents[2]
NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?|\.\d+")
LINK = re.compile(r"\]\(([^)]+)\)")
TEST = re.compile(r"`pytest (\S+\.py)")


def figures(text: str) -> Iterator[tuple[str, str, str]]:
    """Yield what, figure and stored file of each row of README's table of figures; of a test's figure, the test."""
    part = text.split("\n## Figures\n", 1)[1].split("\n## ", 1)[0]
    rows = [line.strip("|").split("|") for line in part.splitlines() if line.startswith("|")]
    stored = ""
    for what, _, figure, where in rows[2:]:
        found = LINK.search(where) or TEST.search(where)
        if found:
            stored = found.group(1)
        else:
            assert where.strip() in {"the same", "`heliograph bench decode`"}, where
        yield what.strip(), figure.strip(), stored


def numbers_in(path: Path) -> list[float]:
    """Return all numbers that a stored file or page holds."""
    return [float(one.replace(",", "")) for one in NUMBER.findall(path.read_text())]


def is_held(told: str, among: list[str], stored: list[float]) -> bool:
    """Return whether a number, as precise as it is told, is stored, or a count of another told with it.

    Rates of counts are told as such: `.9999 of 1,000,000` is held by the stored counts whose ratio it is.
    """
    plain = told.replace(",", "")
    digits = len(plain.partition(".")[2])
    value = float(plain)
    others = [float(one.replace(",", "")) for one in among]
    candidates = [*stored, *(one / n for n in others if n > 1 and n in stored for one in stored)]
    return any(round(one, digits) == value for one in candidates)


def test_the_page_of_results_says_what_the_stored_results_give() -> None:
    done = subprocess.run([sys.executable, ROOT / "bench/make_results.py", "--check"], check=False, cwd=ROOT)
    assert done.returncode == 0, "write it anew: python bench/make_results.py"


def test_every_figure_of_the_readme_is_stored() -> None:
    seen = 0
    # Means of a few runs stand on the page alone, which is made of what is stored (the test above).
    page = numbers_in(ROOT / "docs" / "results.md")
    for what, figure, where in figures((ROOT / "README.md").read_text()):
        path = ROOT / where
        assert path.is_file(), f"{what}: {where} is not there"
        stored = numbers_in(path) + page
        among = NUMBER.findall(figure)
        for told in among:
            assert is_held(told, among, stored), f"{what}: {told} of {figure!r} is not in {where}"
            seen += 1
    assert seen > 10


def test_a_number_that_nothing_holds_is_found() -> None:
    stored = [0.9970, 149898.0, 1_000_000.0, 999_890.0]
    assert is_held(".997", [".997"], stored)
    assert is_held("149,898", ["149,898"], stored)
    assert is_held(".9999", [".9999", "1,000,000"], stored)
    assert not is_held(".998", [".998"], stored)
    assert not is_held(".9970001", [".9970001"], stored)


def results() -> list[Path]:
    return sorted((ROOT / "results").rglob("*.json"))


@pytest.mark.parametrize("path", results(), ids=lambda path: path.stem)
def test_a_stored_result_is_whole_and_that_of_its_cells(path: Path) -> None:
    result: dict[str, Any] = read_result(path)
    lines = [json.loads(line) for line in path.with_suffix(".jsonl").read_text().splitlines()]
    cells = [line for line in lines if "cell" in line]
    assert result["cells_done"] == len(cells)
    assert result["cells_done"] == result["cells"] or result["size"] == CARRIED
    assert result["cpu_s"] == pytest.approx(sum(line["cpu_s"] for line in cells), abs=0.1)
    for name in ("release", "parameters", "code", "size"):
        assert result[name] == lines[0][name]
