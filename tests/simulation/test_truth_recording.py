"""`heliograph simulate`: the same bytes for one seed, what a camera would see, and one line for every mistake."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph_services.cli import simulate as command
from heliograph_services.cli.simulate import built_in
from heliograph_services.event_source.cameras.senders import Senders
from heliograph_services.event_source.simulation.contract import Drive
from heliograph_services.event_source.simulation.lights.recorded import StreamedDrive
from heliograph_services.event_source.simulation.output.record import Order, record, steps_of
from heliograph_services.event_source.simulation.output.truth import Truths
from heliograph_services.event_source.simulation.stream import SceneStream
from heliograph_services.event_source.simulation.world import load

SECONDS = 0.13
SCENE = """
[camera]
sensor = "ideal"
path = {{ kind = "still", at_m = [0.0, 0.0, 5.0] }}
[[beacon]]
name = "firmware"
protocol = "seed11"
bit_rate = 1000
edges = "{edges}"
path = {{ kind = "still", at_m = [0.0, 0.0, 0.0] }}
[[beacon]]
name = "crane"
protocol = "seed11"
payload = 42
bit_rate = 1000
path = {{ kind = "still", at_m = [1.0, 0.0, 0.0] }}
"""


def simulated(folder: Path, name: str, *more: str, scenario: str = "five") -> tuple[Path, Path]:
    out, truth = folder / f"{name}.npz", folder / f"{name}.jsonl"
    arguments = [scenario, "-o", str(out), "--truth", str(truth), "--duration", str(SECONDS), *more]
    assert command.run(arguments) == 0
    return out, truth


def test_one_seed_is_one_recording_and_another_is_another(tmp_path: Path) -> None:
    a, b, c = (simulated(tmp_path, name, "--seed", seed) for name, seed in (("a", "5"), ("b", "5"), ("c", "6")))
    assert a[0].read_bytes() == b[0].read_bytes()
    assert a[1].read_bytes() == b[1].read_bytes()
    assert a[0].read_bytes() != c[0].read_bytes()


def test_a_recording_is_the_stream_of_its_scenario_cut_at_its_end(tmp_path: Path) -> None:
    out, truth = simulated(tmp_path, "a", "--labels", "--seed", "3")
    until_us = 130_000
    batches, labels = [], []
    for piece in SceneStream(load.load_scenario("five"), 3):
        batches.append(piece.batch.t_us)
        labels.append(piece.labels)
        if piece.until_us >= until_us:
            break
    t_us = np.concatenate(batches)
    with np.load(out) as arrays:
        assert np.array_equal(arrays["t"], t_us[t_us < until_us])
        assert np.array_equal(arrays["cause"], np.concatenate(labels)[t_us < until_us])
        assert len(arrays["t"]) > 10_000
    lines = [json.loads(line) for line in truth.read_text().splitlines()]
    assert lines[0]["duration_us"] == until_us
    assert {line["t_us"] for line in lines if line["type"] == "beacon"} == {50_000, 100_000, 130_000}


def test_steps_follow_each_other_to_the_end_of_the_recording() -> None:
    scene = SceneStream(load.load_scenario("five"), 1)
    truths = Truths(scene.world, scene.drives, "cam0", scene.sensor.name, scene.fidelity)
    steps = list(steps_of(scene, truths, 120_000))
    assert [step.t1_us for step in steps] == [50_000, 100_000, 120_000]
    assert [step.end for step in steps] == [False, False, True]
    for before, step in pairwise(steps):
        assert step.truth.t0_us == before.truth.t1_us == before.t1_us
        assert before.batch.t_us[-1] < before.t1_us <= step.batch.t_us[0]
        assert len(step.batch) == len(step.labels)


def test_images_hold_the_same_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, truth = simulated(tmp_path, "a", "--images", "40", "--sensor", "nrp")
    with np.load(out) as arrays:
        assert arrays["images"].shape == (6, 480, 640)
        assert arrays["t_us"].tolist() == [0, 25_000, 50_000, 75_000, 100_000, 125_000]
    head = json.loads(truth.read_text().splitlines()[0])
    assert (head["sensor"], head["preset"]["kind"]) == ("nrp", "images")
    assert "6 images" in capsys.readouterr().err


def test_the_result_is_told_in_a_line_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulated(tmp_path, "a", "--fidelity", "live", "--sensor", "dvxplorer", "--mode", "VARIABLE_15000")
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    for word in ("events (", "lost)", "frames sent, stream ", "fidelity live, sensor dvxplorer VARIABLE_15000, seed 0"):
        assert word in told.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["five", "--seed", "-1"], "--seed must be in"),
        (["five", "--duration", "0"], "--duration must be in"),
        (["five", "--images", "nan"], "--images must be in"),
        (["five", "--images", "30", "--labels"], "labels and a picture are made of events"),
        (["five", "--images", "30", "--plot", "p.png"], "labels and a picture are made of events"),
        (["six"], "scenario must be one of clutter, .* or a TOML file, not 'six'"),
        (["five", "--sensor", "eye"], "sensor must be one of .*, not 'eye'"),
        (["five", "--mode", "FAST"], "mode must be one of its modes"),
    ],
)
def test_a_mistake_is_told_in_a_line(arguments: Sequence[str], words: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        command.run([*arguments, "-o", str(tmp_path / "s.npz")])
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_help_lists_every_built_in_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    assert [name for name, _ in built_in()] == sorted(load.built_in())
    with pytest.raises(SystemExit):
        command.run(["--help"])
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in load.built_in())


def test_edges_of_firmware_drive_a_light_and_are_told_in_the_truth(tmp_path: Path) -> None:
    edges = tmp_path / "edges.csv"
    edges.write_text("t_ns,level\n" + "".join(f"{5_000_000 * k},{k % 2}\n" for k in range(1, 30)))
    scenario = tmp_path / "s.toml"
    scenario.write_text(SCENE.format(edges=edges))
    out, truth = simulated(tmp_path, "a", scenario=str(scenario))
    lines = [json.loads(line) for line in truth.read_text().splitlines()]
    told = [line["t_us"] for line in lines if line["type"] == "edge" and line["beacon"] == "firmware"]
    assert told == [5_000 * k for k in range(1, 26)]
    assert {line["beacon"] for line in lines if line["type"] == "frame"} == {"crane"}
    with np.load(out) as arrays:
        near = np.abs(arrays["x"].astype(int) - 320) < 10
        assert set((arrays["t"][near] // 5_000).tolist()) >= set(range(1, 25))


class Scripted(Senders):
    """Writes the edges of each chunk when the scene asks for them, as firmware in step with it would."""

    def __init__(self, sender: int) -> None:
        super().__init__(patience_s=30.0)
        self.drives: list[Drive] = []
        self._sender = sender
        self._told_us = 0

    def follow(self, drives: Sequence[Drive]) -> None:
        super().follow(drives)
        self.drives += drives

    def wait(self, until_us: int) -> None:
        while self._told_us <= until_us:
            self._told_us += 5_000
            os.write(self._sender, b"%d,%d\n" % (self._told_us * 1000, self._told_us // 5_000 % 2))
        super().wait(until_us)


def test_a_stream_of_edges_makes_the_recording_of_the_same_edges_in_a_file(tmp_path: Path) -> None:
    fifo, edges = tmp_path / "fifo", tmp_path / "edges.csv"
    os.mkfifo(fifo)
    edges.write_text("".join(f"{5_000_000 * k},{k % 2}\n" for k in range(1, 60)))
    # Opened both ways: a FIFO has no writer before it has a reader.
    sender = os.open(fifo, os.O_RDWR)
    try:
        recordings = []
        for name, source in (("fifo", fifo), ("file", edges)):
            scenario = tmp_path / f"{name}.toml"
            scenario.write_text(SCENE.format(edges=source))
            outside = Scripted(sender)
            order = Order(scenario=str(scenario), out=tmp_path / f"{name}.npz", duration_s=SECONDS)
            done: list[float] = []
            recorded = record(order, outside, done.append)
            assert isinstance(outside.drives[0], StreamedDrive) == (name == "fifo")
            recordings.append((order.out.read_bytes(), recorded.run.stream, recorded.frames))
            assert done == [0.05, 0.1, 0.13]
            assert not outside.refused()
            outside.close()
    finally:
        os.close(sender)
    assert recordings[0] == recordings[1]
    assert recordings[0][2] == 11


def test_a_silent_sender_is_waited_for_once_and_its_light_holds(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    fifo, scenario = tmp_path / "fifo", tmp_path / "s.toml"
    os.mkfifo(fifo)
    scenario.write_text(SCENE.format(edges=fifo))
    outside = Senders(patience_s=0.0)
    recorded = record(Order(scenario=str(scenario), out=tmp_path / "s.npz", duration_s=SECONDS), outside)
    outside.close()
    assert recorded.frames == 11
    assert [entry.message for entry in caplog.records if "silent" in entry.message] == [
        "who drives light 0 from outside is silent; the light holds its level"
    ]
