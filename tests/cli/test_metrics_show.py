"""`heliograph metrics show`: the table and the object say what the file holds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from heliograph.core import Context
from heliograph.messages import Message
from heliograph_services.cli.__main__ import main
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.service import make_core
from support.truth_scenes import Said, Sent, link, state, truth

UNTIL_US = 3_000_000
CONTEXT = Context(instance="metrics_sink", boot="b0", lockstep=False)


def kept(path: Path, *, with_truth: bool) -> None:
    core = make_core(MetricsSinkConfig(file=str(path)), CONTEXT)
    messages: list[Message] = [*Said(refused={"parity": 1}).all_of(Sent(), UNTIL_US).messages(), state(60_000)]
    messages += [link(1_500_000, 0.75), *(truth([Sent()], UNTIL_US) if with_truth else [])]
    for message in sorted(messages, key=lambda each: each.time_us):
        core.feed(message)
    core.close()


def test_the_table_shows_accuracy_with_n_and_an_interval(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "m.sqlite"
    kept(path, with_truth=True)
    assert main(["metrics", "show", str(path)]) == 0
    out = capsys.readouterr().out
    assert "MAR sent, visible       1.0000  [" in out
    assert "226 of 226" in out
    assert "identifications judged 1: 0 false alarms, 0 confusions" in out
    # The path of a temporary file is as long as it is.
    assert all(len(line) <= 80 for line in out.splitlines()[1:])


def test_without_truth_the_table_says_so_and_shows_the_estimate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.sqlite"
    kept(path, with_truth=False)
    assert main(["metrics", "show", str(path)]) == 0
    assert "no truth: accuracy is not known; MAR estimated 0.750" in capsys.readouterr().out
    assert main(["metrics", "show", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["type"], found["accuracy"], found["mar_estimated"]) == ("metrics", None, 0.75)


def test_a_missing_file_is_one_line_and_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["metrics", "show", str(tmp_path / "none.sqlite")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no such metrics file" in line
