"""A scene as files: the same bytes for the same steps, the truth line by line, and nothing half written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heliograph.errors import ConfigError, FileError
from heliograph.events import EventBatch
from heliograph.truth import Truth
from heliograph_services.event_source.simulation.contract import Labels
from heliograph_services.event_source.simulation.lights import drive_of
from heliograph_services.event_source.simulation.output import plot
from heliograph_services.event_source.simulation.output.plot import Picture, title_of
from heliograph_services.event_source.simulation.output.truth import Truths
from heliograph_services.event_source.simulation.output.write import Run, write_files
from heliograph_services.event_source.simulation.readout.presets import load_preset
from heliograph_services.event_source.simulation.world.load import load_scenario
from heliograph_services.event_source.simulation.world.world import World

SCENARIO = "construction_site"
SEED = 7
WINDOW_US = 10_000
DURATION_US = 400_000


@dataclass(frozen=True)
class Window:
    t1_us: int
    batch: EventBatch
    labels: Labels | None
    truth: Truth | None
    end: bool


def scene() -> tuple[Run, World]:
    scenario = load_scenario(SCENARIO)
    sensor = load_preset("dvxplorer_mini", "", {"pixel.threshold_on": 0.25})
    world = World(scenario, sensor.width, sensor.height, sensor.pitch_um, SEED)
    run = Run(
        scenario=SCENARIO,
        seed=SEED,
        fidelity="full",
        stream="640x480-1",
        duration_us=DURATION_US,
        sensor=sensor,
        focal_mm=3.6,
        f_number=2.0,
        beacons=world.beacons,
    )
    return run, world


def steps(world: World, *, labelled: bool = True) -> Iterator[Window]:
    """Windows with some events each, truth every 50 ms."""
    drives = [drive_of(beacon, SEED, i) for i, beacon in enumerate(world.beacons)]
    truths = Truths(world, drives, "cam0", "dvxplorer_mini", "full")
    random = np.random.default_rng(1)
    for t1_us in range(WINDOW_US, DURATION_US + 1, WINDOW_US):
        n = 200
        t_us = np.sort(random.integers(t1_us - WINDOW_US, t1_us, n))
        x_px, y_px = random.integers(0, 640, n).astype(np.uint16), random.integers(0, 480, n).astype(np.uint16)
        batch = EventBatch(t_us, x_px, y_px, random.random(n) < 0.5)
        labels = random.integers(-4, 8, n).astype(np.int16) if labelled else None
        truth = None if t1_us % 50_000 else truths.window(t1_us - 50_000, t1_us)
        yield Window(t1_us, batch, labels, truth, t1_us == DURATION_US)


def lines_of(path: Path, kind: str) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    return [line for line in lines if line["type"] == kind]


def test_files_hold_the_events_the_causes_and_the_truth(tmp_path: Path) -> None:
    run, world = scene()
    out, truth = tmp_path / "s.npz", tmp_path / "s.jsonl"
    written = write_files(run, steps(world), out, truth, labels=True)
    windows = list(steps(world))
    with np.load(out) as arrays:
        assert set(arrays) == {"t", "x", "y", "on", "cause", "width", "height"}
        assert arrays["cause"].dtype == np.int16
        assert np.array_equal(arrays["t"], np.concatenate([w.batch.t_us for w in windows]))
        assert np.array_equal(arrays["cause"], np.concatenate([w.labels for w in windows if w.labels is not None]))
        assert (int(arrays["width"]), int(arrays["height"])) == (640, 480)
    truths = [w.truth for w in windows if w.truth is not None]
    assert (written.events, written.frames) == (8_000, sum(len(t.frame_t1_us) for t in truths))
    (head,) = lines_of(truth, "scenario")
    assert (head["sensor"], head["mode"], head["fidelity"]) == ("dvxplorer_mini", "VARIABLE_5000", "full")
    assert head["preset"]["pixel"]["threshold_on"] == 0.25
    assert head["preset"]["readout"]["mode"] == "VARIABLE_5000"
    assert [beacon["name"] for beacon in head["beacons"]] == [spec.name for spec in world.beacons]
    states = lines_of(truth, "beacon")
    assert len(states) == 8 * len(world.beacons)
    for line in states:
        truth_of_it = truths[line["t_us"] // 50_000 - 1]
        i = truth_of_it.beacon.index(line["beacon"])
        assert line["x_px"] == pytest.approx(truth_of_it.x_px[i], abs=6e-4)
        assert line["z_m"] == pytest.approx(truth_of_it.z_m[i], abs=6e-5)
    assert len(lines_of(truth, "frame")) == written.frames
    edges = lines_of(truth, "edge")
    assert len(edges) == sum(len(t.edge_us) for t in truths)
    assert [edge["t_us"] for edge in edges] == sorted(edge["t_us"] for edge in edges)


def test_visible_lines_are_the_intervals_of_the_states(tmp_path: Path) -> None:
    run, world = scene()
    truth = tmp_path / "s.jsonl"
    write_files(run, steps(world), tmp_path / "s.npz", truth)
    seen: dict[str, set[int]] = {}
    for line in lines_of(truth, "visible"):
        assert line["t0_us"] < line["t1_us"]
        seen.setdefault(line["beacon"], set()).update(range(line["t0_us"] + 50_000, line["t1_us"] + 1, 50_000))
    stated: dict[str, set[int]] = {}
    for line in lines_of(truth, "beacon"):
        if line["visible"]:
            stated.setdefault(line["beacon"], set()).add(line["t_us"])
    assert seen == stated


def test_the_same_scene_is_the_same_bytes_and_labels_change_no_event(tmp_path: Path) -> None:
    run, world = scene()
    for name, labels in (("a", False), ("b", False), ("c", True)):
        write_files(run, steps(world), tmp_path / f"{name}.npz", tmp_path / f"{name}.jsonl", labels=labels)
    for kind in ("npz", "jsonl"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
    with np.load(tmp_path / "a.npz") as plain, np.load(tmp_path / "c.npz") as labelled:
        assert set(plain) == set(labelled) - {"cause"}
        assert all(np.array_equal(plain[name], labelled[name]) for name in plain)


def test_every_step_is_watched_once_it_is_written(tmp_path: Path) -> None:
    run, world = scene()
    watched: list[int] = []
    write_files(run, steps(world), tmp_path / "s.npz", watch=lambda step: watched.append(step.t1_us))
    assert watched == list(range(WINDOW_US, DURATION_US + 1, WINDOW_US))


def test_what_breaks_off_leaves_no_file(tmp_path: Path) -> None:
    run, world = scene()

    def broken() -> Iterator[Window]:
        yield next(steps(world))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_files(run, broken(), tmp_path / "s.npz", tmp_path / "s.jsonl")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("missing", ["out", "truth"])
def test_a_folder_that_is_not_there_is_told_in_one_line(missing: str, tmp_path: Path) -> None:
    run, world = scene()
    places = {"out": tmp_path / "s.npz", "truth": tmp_path / "s.jsonl"}
    places[missing] = tmp_path / "none" / "f"
    with pytest.raises(FileError, match="none/f: No such file"):
        write_files(run, steps(world), places["out"], places["truth"])


@pytest.mark.parametrize("labelled", [True, False])
def test_a_picture_is_drawn_of_scene_and_stream(labelled: bool, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    run, world = scene()
    picture = Picture(tmp_path / "s.png", run, world)
    write_files(run, steps(world, labelled=labelled), tmp_path / "s.npz", watch=picture.watch)
    picture.save()
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "s.png").stat().st_size > 20_000


def test_a_picture_names_all_that_it_depends_on() -> None:
    run, _ = scene()
    wanted = "construction_site: dvxplorer_mini VARIABLE_5000, 3.6 mm f/2, fidelity full, seed 7 (simulated)"
    assert title_of(run) == wanted


def test_without_matplotlib_the_option_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run, world = scene()
    monkeypatch.setattr(plot, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install 'heliograph\[analysis\]'"):
        Picture(tmp_path / "s.png", run, world)


def test_a_picture_without_a_folder_is_told_before_the_run(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    run, world = scene()
    with pytest.raises(FileError, match=r"none/s\.png: No such file"):
        Picture(tmp_path / "none" / "s.png", run, world)
