"""The simulated camera: one seed, one stream, however it is cut; truth, files and images belong to it."""

from __future__ import annotations

import json
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from heliograph.events import EventBatch
from heliograph.streams import Image
from heliograph.truth import Truth
from heliograph.wire import pack_body
from heliograph_services.cli import simulate as command
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.simulation.world.load import load_scenario
from heliograph_services.event_source.stream import open_stream
from support.recordings import LIVE, LOCKSTEP, events_of, messages_of, onsets_of, opened

# A moving camera over texture with everything in it, a scanned sensor; an asynchronous one; images that are compared.
SCENES = ("construction_site", "five", "construction_site_nrp")


def simulated(scenario: str, seconds: float, window_us: int = 2_000, seed: int = 0) -> EventBatch:
    config = EventSourceConfig(
        backend="simulated", scenario=scenario, duration_s=seconds, window_us=window_us, seed=seed
    )
    return events_of(messages_of(open_stream(config, LIVE)))


def equal(a: EventBatch, b: EventBatch) -> bool:
    pairs = ((a.t_us, b.t_us), (a.x_px, b.x_px), (a.y_px, b.y_px), (a.on, b.on))
    return all(np.array_equal(left, right) for left, right in pairs)


@pytest.mark.parametrize("scenario", SCENES)
@pytest.mark.parametrize("window_us", [300, 1_000, 2_000, 5_000, 70_000])
def test_the_length_of_a_batch_changes_no_event(scenario: str, window_us: int) -> None:
    # 210 ms are whole windows of each of these lengths.
    assert equal(simulated(scenario, 0.21, window_us), reference(scenario))


@cache
def reference(scenario: str) -> EventBatch:
    batch = simulated(scenario, 0.21, 10_000)
    assert len(batch) > 1_000
    return batch


@pytest.mark.parametrize("scenario", SCENES[:2])
def test_a_seed_repeats_itself_and_another_differs(scenario: str) -> None:
    assert equal(simulated(scenario, 0.05, seed=7), simulated(scenario, 0.05, seed=7))
    assert not equal(simulated(scenario, 0.05, seed=7), simulated(scenario, 0.05, seed=8))


def test_images_of_the_view_come_as_often_as_asked_and_change_no_event() -> None:
    config = EventSourceConfig(backend="simulated", scenario="construction_site", duration_s=0.21, image_hz=20.0)
    messages = messages_of(open_stream(config, LIVE))
    images = [m for m in messages if isinstance(m, Image)]
    assert [image.t_us for image in images] == [0, 50_000, 100_000, 150_000, 200_000]
    assert all(image.grey.shape == (480, 640) and 20 < image.grey.mean() < 230 for image in images)
    assert equal(events_of(messages), reference("construction_site"))


def test_truth_is_the_same_in_sum_however_it_is_cut_and_agrees_with_the_events() -> None:
    frames = []
    for window_us in (2_000, 10_000):
        config = EventSourceConfig(backend="simulated", scenario="five", duration_s=1.0, window_us=window_us)
        truths = [m for m in messages_of(open_stream(config, LIVE)) if isinstance(m, Truth)]
        assert truths[0].t0_us == 0
        assert truths[-1].t1_us == 1_000_000
        assert all(a.t1_us == b.t0_us for a, b in pairwise(truths))
        assert all(pack_body(Truth.from_body(m.to_body())) == pack_body(m) for m in truths)
        rows = [
            (m.frame_t1_us[i], m.beacon[m.frame_beacon[i]], m.frame_payload[i], m.frame_visible[i])
            for m in truths
            for i in range(len(m.frame_t1_us))
        ]
        frames.append(rows)
    assert sorted(frames[0]) == sorted(frames[1])
    crane = [row for row in frames[0] if row[1] == "crane"]
    assert crane == [(11_000 * (k + 1), "crane", 42, True) for k in range(90)]
    gate = sorted(row for row in frames[0] if row[1] == "gate")
    text = load_scenario("five").beacons[4].text or ""
    assert "".join(chr(row[2]) for row in gate)[: len(text)] == text


def test_a_simulated_scene_and_its_file_are_one_stream(tmp_path: Path) -> None:
    out, truth = tmp_path / "s.npz", tmp_path / "s.jsonl"
    assert command.run(["five", "-o", str(out), "--truth", str(truth), "--duration", "0.4", "--seed", "5"]) == 0
    config = EventSourceConfig(backend="simulated", scenario="five", duration_s=0.4, seed=5)
    live, played = open_stream(config, LOCKSTEP), opened(out)
    assert live.camera.stream == played.camera.stream
    scene = [m for m in messages_of(live) if not isinstance(m, Truth)]
    assert [pack_body(m) for m in messages_of(played)] == [pack_body(m) for m in scene]
    assert onsets_of(scene)
    lines = [json.loads(line) for line in truth.read_text().splitlines()]
    assert {line["type"] for line in lines} == {"scenario", "beacon", "visible", "frame", "edge"}
    assert (lines[0]["stream"], lines[0]["duration_us"]) == (live.camera.stream, 400_000)
    assert [line["beacon"] for line in lines if line["type"] == "visible"] == [b["name"] for b in lines[0]["beacons"]]
    again = tmp_path / "again.npz"
    command.run(["five", "-o", str(again), "--duration", "0.4", "--seed", "5"])
    assert again.read_bytes() == out.read_bytes()
