"""docs/results.md and the figures of README.md against what is stored."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from heliograph_services.cli.studies.catalogue import STUDIES, load
from heliograph_services.cli.studies.pictures import draw
from heliograph_services.cli.studies.results_page import CARRIED
from heliograph_services.cli.studies.stored import read_cells, read_result, result_of
from heliograph_services.cli.studies.study import Dots

ROOT = Path(__file__).parents[2]
NUMBER = re.compile(r"\d+(?:,\d{3})*(?:\.\d+)?|\.\d+")


def figures_of_readme() -> Any:
    """Return `bench/readme_figures.py` as a module."""
    sys.path.insert(0, str(ROOT / "bench"))
    try:
        return importlib.import_module("readme_figures")
    finally:
        sys.path.remove(str(ROOT / "bench"))


def test_the_page_of_results_and_the_figures_of_the_readme_are_what_the_stored_results_give() -> None:
    check = [sys.executable, "bench/make_results.py", "--check"]
    done = subprocess.run(check, check=False, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, f"{done.stderr}write it anew: python bench/make_results.py"


def test_any_digit_of_a_figure_of_the_readme_is_noticed() -> None:
    figures = figures_of_readme()
    readme = (ROOT / "README.md").read_text()
    table = figures.TABLE.search(readme)
    assert table
    told = 0
    for row in table[0].splitlines()[2:]:
        figure = row.split(" | ")[2]
        for found in NUMBER.finditer(figure):
            last = found.end() - 1
            other = figure[:last] + str((int(figure[last]) + 1) % 10) + figure[last + 1 :]
            changed = readme.replace(row, row.replace(f"| {figure} |", f"| {other} |"))
            assert changed != readme
            assert figures.written(changed) == readme, f"{figure} told as {other}"
            told += 1
    assert told > 40


def test_a_readme_without_its_figures_is_refused() -> None:
    with pytest.raises(ValueError, match="no table of figures"):
        figures_of_readme().written("# heliograph\n")


def test_no_share_below_one_is_told_as_one() -> None:
    told = [figures_of_readme().share(value) for value in (1.0, 0.99992, 0.9994, 0.99951, 0.5, 0.0)]
    assert told == ["1.000", ".9999", ".999", ".9995", ".500", ".000"]


def results() -> list[Path]:
    return sorted((ROOT / "results").rglob("*.json"))


@pytest.mark.parametrize("path", results(), ids=lambda path: path.stem)
def test_a_stored_result_is_whole_and_that_of_its_cells(path: Path) -> None:
    result: dict[str, Any] = read_result(path)
    head, looks, found = read_cells(path.with_suffix(".jsonl"))
    assert result["cells_done"] == len(found)
    assert result["cpu_s"] == pytest.approx(sum(one.cpu_s for one in found.values()), abs=0.1)
    for name in ("release", "parameters", "code", "size"):
        assert result[name] == head[name]
    if result["size"] == CARRIED:
        return
    assert result["cells_done"] == result["cells"]
    study = load(result["study"])
    cells = study.all_cells(head["size"], head["release"])
    if len(cells) < len(found):
        pytest.skip("the recorded scene is not here (HELIOGRAPH_SCENE_DATA): its cells cannot be listed")
    again = result_of(study, head, looks, found, cells)
    assert result == json.loads(json.dumps(again)), "tell it anew: python bench/retell.py"


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_has_a_plot_beside_its_result(name: str) -> None:
    study = load(name)
    assert study.panels or study.picture
    assert f"](../results/{name}.png)" in (ROOT / "docs" / "results.md").read_text()
    assert (ROOT / "results" / f"{name}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["moving", "methods", "false_alarms"])
def test_dots_are_the_figures_of_the_tables(name: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    _, _, found = read_cells(ROOT / "results" / f"{name}.jsonl")
    done = list(found.values())
    study = load(name)
    assert study.panels
    panels = study.panels(done)
    told = {figure for table in study.tables(done) for row in table.rows for figure in row.figures.values()}
    shown = [
        figure
        for panel in panels
        if isinstance(panel, Dots)
        for some in panel.dots.values()
        for figure in some
        if figure.value is not None
    ]
    assert len(shown) > 20
    assert told.issuperset(shown)
    draw(study, done, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 20_000
