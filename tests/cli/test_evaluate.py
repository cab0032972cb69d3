"""`heliograph evaluate`: resumable, the same on any cores, and one line for every mistake."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from heliograph_services.cli.__main__ import main
from heliograph_services.cli.studies import catalogue
from heliograph_services.cli.studies.catalogue import COST_S, STUDIES, load
from heliograph_services.cli.studies.study import Cell, Done, seed_of
from heliograph_services.cli.studies.workers import run_all
from support import toy_study

Toy = Callable[..., int]


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Toy:
    """Run the toy study."""
    module = ModuleType("heliograph_services.cli.studies.toy")
    module.STUDY = toy_study.STUDY  # type: ignore[attr-defined]  # a module made here
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(catalogue.STUDIES, "toy", "coins")

    def run(out: Path, *more: str) -> int:
        return main(["evaluate", "toy", "--jobs", "1", "--release", "9.9", "--out", str(out), *more])

    return run


def only_line(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the only line on stderr."""
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def stored(out: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((out / "toy.json").read_text())
    return result


def test_a_study_leaves_cells_a_result_a_plot_and_a_page(toy: Toy, tmp_path: Path) -> None:
    assert toy(tmp_path) == 0
    result = stored(tmp_path)
    assert (result["release"], result["size"], result["cells_done"], result["cells"]) == ("9.9", "full", 12, 12)
    assert result["looks"] == 1
    assert all(result[name] for name in ("commit", "parameters", "code", "preset", "evidence", "machine"))
    assert result["seeds"]["count"] == 12
    assert result["seeds"]["first"] >= 1000
    assert (tmp_path / "toy.png").stat().st_size > 1000
    page = (tmp_path / "results.md").read_text()
    for row in result["tables"][0]["rows"]:
        assert f"{row['figures']['ours']['value']:.4f}" in page
        assert row["n"] in page


def test_development_has_the_seeds_0_to_99() -> None:
    seeds = [cell.seed for cell in toy_study.STUDY.all_cells("full", "development")]
    assert max(seeds) < 100
    assert min(cell.seed for cell in toy_study.STUDY.all_cells("full", "1.0")) >= 1000


def test_who_reads_does_not_change_the_seed() -> None:
    one, two = ({"arms": arms, "rate": 5.0} for arms in (["ours"], ["ours", "module:peer"]))
    assert seed_of(toy_study.STUDY, "1.0", one) == seed_of(toy_study.STUDY, "1.0", two)


def test_a_second_run_gives_the_same_figures(toy: Toy, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert toy(tmp_path / name) == 0
    assert stored(tmp_path / "a")["tables"] == stored(tmp_path / "b")["tables"]


def test_an_interrupted_study_goes_on_and_ends_as_if_it_had_not_been(
    toy: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert toy(tmp_path / "whole") == 0
    ran: list[str] = []

    def tired(cell: Cell, stop: bool = True) -> dict[str, Any]:
        if stop and len(ran) == 5:
            raise KeyboardInterrupt
        ran.append(cell.key)
        return toy_study.run(cell)

    study = toy_study.STUDY
    module = sys.modules["heliograph_services.cli.studies.toy"]
    fields = {name: getattr(study, name) for name in study.__slots__}
    monkeypatch.setattr(module, "STUDY", type(study)(**fields | {"run": tired}))
    cut = tmp_path / "cut"
    assert toy(cut) == 130
    monkeypatch.setattr(module, "STUDY", type(study)(**fields | {"run": lambda cell: tired(cell, stop=False)}))
    capsys.readouterr()
    assert toy(cut) == 2
    assert "--resume" in only_line(capsys)
    with (cut / "toy.jsonl").open("a") as file:
        file.write('{"cell": {"p"')  # what a cut leaves
    assert toy(cut, "--resume") == 0
    assert len(ran) == len(set(ran)) == 12
    assert stored(cut)["tables"] == stored(tmp_path / "whole")["tables"]
    assert stored(cut)["looks"] == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["evaluate", "moon"], "a study must be one of scene, bit_rate"),
        (["evaluate", "bit_rate", "--jobs", "0"], "--jobs must be in [1, 1024], not 0"),
        (["evaluate", "bit_rate", "--release", ""], "--release must have 1 to 64 characters"),
        (["evaluate", "--page", "--out", "/nowhere/at/all"], "/nowhere/at/all: no folder of results"),
        (["evaluate", "bit_rate", "--peer", "nobody:here", "--out", "/tmp/none"], "a peer must be MODULE:NAME"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert said in only_line(capsys)


def test_another_release_is_refused(toy: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert toy(tmp_path, "--quick") == 0
    capsys.readouterr()
    assert toy(tmp_path, "--quick", "--resume", "--release", "10") == 2
    assert "its release is 9.9, not 10" in only_line(capsys)


@pytest.mark.parametrize(
    "line", ["no JSON", '{"cell": {"p": 0.1}}', "[]", '{"cell": 3, "seed": 1, "counts": {}, "cpu_s": 0}']
)
def test_a_broken_line_is_named(line: str, toy: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert toy(tmp_path) == 0
    path = tmp_path / "toy.jsonl"
    lines = path.read_text().splitlines()
    lines[3] = line
    path.write_text("\n".join(lines) + "\n")
    capsys.readouterr()
    assert toy(tmp_path, "--resume") == 2
    assert "toy.jsonl: line 4 is broken" in only_line(capsys)


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"schema": 2}', '{"schema": 1, "study": "toy"}'])
def test_a_broken_result_is_one_line(text: str, toy: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert toy(tmp_path) == 0
    (tmp_path / "toy.json").write_text(text)
    capsys.readouterr()
    assert main(["evaluate", "--page", "--out", str(tmp_path)]) == 2
    assert "toy.json: no result of `heliograph evaluate`" in only_line(capsys)


def test_a_disk_without_room_is_one_line(
    toy: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    assert toy(tmp_path) == 2
    assert "toy.jsonl: cannot be written: No space left on device" in only_line(capsys)


def test_cells_are_the_same_on_two_cores() -> None:
    jobs = [("toy", cell) for cell in toy_study.STUDY.all_cells("full", "1.0")]

    def counted(cores: int) -> dict[str, Any]:
        found: list[tuple[str, Done]] = list(run_all(jobs, cores, toy_study.done_of))
        return {done.cell.key: done.counts for _, done in found}

    alone = counted(1)
    assert counted(2) == alone
    assert len(alone) == 12


def test_recordings_that_are_not_here_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HELIOGRAPH_BEACON_DATA", str(tmp_path))
    assert main(["evaluate", "recordings", "--out", str(tmp_path / "out")]) == 2
    assert "no sonnet.txt, 504hz_100m.mat, 3125hz_30m.mat; not shipped" in only_line(capsys)
    assert not (tmp_path / "out").exists()


def test_the_list_and_the_help_say_every_study_and_its_cost(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "list"]) == 0
    listed = [line.split()[:3] for line in capsys.readouterr().out.splitlines()]
    assert listed == [[name, *map(str, COST_S[name])] for name in STUDIES]
    with pytest.raises(SystemExit):
        main(["evaluate", "--help"])
    said = capsys.readouterr().out
    assert all(f"  {name} " in said for name in STUDIES)


def test_a_full_run_costs_at_most_twelve_thousand_cpu_seconds_and_a_quick_one_minutes() -> None:
    assert sum(full for full, _ in COST_S.values()) <= 12_000
    assert sum(quick for _, quick in COST_S.values()) <= 600


def test_a_long_run_listens_to_clutter_for_three_hours_a_protocol() -> None:
    study = load("false_alarms")
    lights = [one for one in study.cells("long") if one["part"] == "lights" and one["protocol"] == "seed11"]
    # A camera has 32 lights, which a cell hears for its seconds.
    assert 3.0 <= sum(one["seconds"] for one in lights) / 3600.0 < 3.3
    assert all(one in study.cells("long") for one in study.cells("full"))


@pytest.mark.parametrize("name", list(STUDIES))
def test_every_study_has_cells_that_differ_and_survive_json(name: str) -> None:
    study = load(name)
    assert study.name == name
    for size in ("quick", "full"):
        cells = study.all_cells(size, "1.0")
        assert cells
        assert all(Cell(json.loads(json.dumps(cell.parameters)), cell.seed) == cell for cell in cells)
    assert len(study.all_cells("quick", "1.0")) <= 12
