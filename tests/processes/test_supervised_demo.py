"""The demo as a newcomer runs it: separate processes, one killed midway, and a last line that a program reads."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.processes
SITE = ["crate", "foreman", "forklift", "mason", "pallet", "pipes", "truck", "welder"]
FIVE = ["crane", "gate", "lift", "mixer", "truck"]
# Supervisor, router, tracker, decoder and metrics sink; the source comes when they are warm.
PROCESSES_AT_FIRST = 5


@pytest.fixture
def short_folder() -> Iterator[Path]:
    """Return a folder whose path leaves room for a socket's."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@contextmanager
def demo(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    run = subprocess.Popen(
        [sys.executable, "-m", "heliograph_services.cli.demo", "--headless", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env=os.environ | {"TMPDIR": str(folder)},
    )
    try:
        yield run
    finally:
        run.kill()
        run.communicate(timeout=60)


def until(condition: Callable[[], object], what: str, timeout_s: float = 60.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, f"waited for {what}"
        time.sleep(0.05)


def running_below(folder: Path) -> list[str]:
    """Return the command lines of processes that name a file below the folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode().split("\0")
        except OSError:
            continue
        if any(word.startswith(str(folder)) for word in words):
            found.append(" ".join(words))
    return found


def test_every_beacon_is_identified_also_while_the_tracker_is_dead(short_folder: Path) -> None:
    with demo(short_folder, "--scenario", "five", "--duration", "6", "--kill-tracker", "--no-firmware") as run:
        out, err = run.communicate(timeout=110)
    assert run.returncode == 0, err
    lines = out.splitlines()
    result = json.loads(lines[-1])
    assert result["identified"] == result["expected"] == FIVE
    assert result["missing"] == result["unexpected"] == []
    assert result["processes"] == 5
    assert result["restarts"] == 1
    assert result["tracker_back_s"] is not None
    assert sorted(result["refreshed_meanwhile"]) == FIVE
    assert result["frames"] > 0
    assert 0 < result["mar"] <= 1
    for name in FIVE:
        assert any(name in line and "accepted" in line for line in lines[:-1])
    assert list(short_folder.iterdir()) == []


def test_the_demo_flies_over_the_site_and_finds_every_beacon_that_is_to_be_seen(short_folder: Path) -> None:
    with demo(short_folder, "--duration", "5") as run:
        out, err = run.communicate(timeout=110)
    assert run.returncode == 0, err
    result = json.loads(out.splitlines()[-1])
    assert len(result["expected"]) >= 5
    assert set(result["expected"]) <= set(result["identified"])
    assert sorted(result["expected"] + result["not_in_view_long_enough"]) == SITE
    assert (result["scenario"], result["sensor"], result["fidelity"]) == (
        "construction_site",
        "dvxplorer_mini",
        "live",
    )
    assert 0.5 < result["mar"] <= 1
    # Its own firmware speaks at the end, where there is a C compiler.
    assert result["firmware"].get("heard") is True or "not here" in result["firmware"]["skipped"]
    assert list(short_folder.iterdir()) == []


def test_ctrl_c_ends_everything_and_leaves_nothing(short_folder: Path) -> None:
    with demo(short_folder, "--duration", "60") as run:
        until(lambda: len(running_below(short_folder)) >= PROCESSES_AT_FIRST, "the processes")
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=60)
    assert run.returncode == 130
    assert running_below(short_folder) == []
    assert list(short_folder.iterdir()) == []


def test_a_killed_demo_leaves_no_process_behind(short_folder: Path) -> None:
    with demo(short_folder, "--duration", "60") as run:
        until(lambda: len(running_below(short_folder)) >= PROCESSES_AT_FIRST, "the processes")
        run.kill()
        run.communicate(timeout=60)
    until(lambda: running_below(short_folder) == [], "the end of all processes")


def test_a_scene_that_does_not_exist_is_one_line_and_status_2(short_folder: Path) -> None:
    with demo(short_folder, "--scenario", "six") as run:
        out, err = run.communicate(timeout=60)
    assert run.returncode == 2
    assert out == ""
    assert err.count("\n") == 1
    assert "six" in err
    assert "five" in err
