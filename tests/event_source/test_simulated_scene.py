"""The ideal generator: what it says about itself is so, and chunking changes nothing."""

from __future__ import annotations

import json
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import ConfigError
from heliograph.events import EventBatch, concatenate
from heliograph.truth import Truth
from heliograph.wire import pack_body
from heliograph_services.cli import simulate as command
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.simulation.emitter import Emitter, emitter_of
from heliograph_services.event_source.simulation.scenario import Scenario, built_in, load_scenario, parse_scenario
from heliograph_services.event_source.simulation.scene import STEP_US, Scene, SceneStream
from heliograph_services.event_source.stream import open_stream
from support.recordings import LIVE, LOCKSTEP, events_of, messages_of, onsets_of, opened

STEADY = """
noise_hz = 0
jitter_us = 0
latency_us = 100
[[beacon]]
name = "a"
protocol = "seed11"
payload = 42
bit_rate = 1000
radius_px = 2.0
events_per_edge = [2, 2]
path = { kind = "still", x_px = 50, y_px = 40 }
"""
# The LED's levels for payload 42, by hand: 1110 101010 1, and round again.
BITS_42 = [1, 1, 1, 0, 1, 0, 1, 0, 1, 0, 1]


def simulated(scenario: str, seconds: float, window_us: int = 2_000, seed: int = 0) -> EventBatch:
    config = EventSourceConfig(
        backend="simulated", scenario=scenario, duration_s=seconds, window_us=window_us, seed=seed
    )
    return events_of(messages_of(open_stream(config, LIVE)))


def equal(a: EventBatch, b: EventBatch) -> bool:
    pairs = ((a.t_us, b.t_us), (a.x_px, b.x_px), (a.y_px, b.y_px), (a.on, b.on))
    return all(np.array_equal(left, right) for left, right in pairs)


@pytest.mark.parametrize("window_us", [300, 2_100, 70_000])
def test_the_window_changes_no_event(window_us: int) -> None:
    # 210 ms are whole windows of each of these lengths.
    assert equal(simulated("five", 0.21, window_us), simulated("five", 0.21, 10_000))


def test_seeds_differ_and_repeat() -> None:
    assert equal(simulated("five", 0.05, seed=7), simulated("five", 0.05, seed=7))
    assert not equal(simulated("five", 0.05, seed=7), simulated("five", 0.05, seed=8))


def test_a_still_beacon_blinks_as_worked_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(STEADY)
    batch = simulated(str(path), 0.022)
    levels = [1, *BITS_42, *BITS_42]  # of the round before, its last bit
    wanted = []
    for i, (before, now) in enumerate(pairwise(levels)):
        if before != now:
            # 13 pixels lie within 2 of a pixel's centre; two events each, 25 us apart, 100 us behind the edge.
            wanted += [(i * 1_000 + 100 + k * 25, bool(now)) for k in (0, 1) for _ in range(13)]
    assert list(zip(batch.t_us.tolist(), batch.on.tolist(), strict=True)) == wanted
    assert set(batch.x_px.tolist()) == {48, 49, 50, 51, 52}


def test_a_moving_lit_disc_sends_on_before_it_and_off_behind_it() -> None:
    scenario = parse_scenario(
        STEADY.replace(
            '{ kind = "still", x_px = 50, y_px = 40 }',
            '{ kind = "waypoints", points = [[0.0, 20.0, 40.0], [1.0, 220.0, 40.0], [2.0, 20.0, 40.0]] }',
        ).replace("bit_rate = 1000", "bit_rate = 1"),
        "moving",
    )
    # At 1 bit/s the LED is lit for the first three seconds: what there is comes from motion alone.
    stream = SceneStream(Scene(scenario, 0))
    batch = concatenate([stream.next() for _ in range(90)])
    # The latency is 100 us. The uppermost and lowest pixels of the disc come and go in one place: left out here.
    at_px = 20 + (batch.t_us - 100) * 200e-6
    inner = np.abs(batch.y_px.astype(np.int64) - 40) <= 1
    assert np.array_equal((batch.x_px > at_px)[inner], batch.on[inner])
    # In each of the three rows, each pixel of the way sends one ON and one OFF.
    assert abs(int(batch.on[inner].sum()) - 3 * 180) <= 3
    assert abs(int((~batch.on[inner]).sum()) - 3 * 180) <= 3


def test_nothing_comes_before_its_cause_or_leaves_its_step() -> None:
    scene = Scene(load_scenario("five"), 3)
    for step in range(3):
        t_us = scene.caused(step).t_us
        assert step * STEP_US <= t_us.min()
        assert t_us.max() < (step + 2) * STEP_US


def test_noise_is_as_frequent_and_as_even_as_it_says() -> None:
    batch = simulated("empty", 5.0)
    assert abs(len(batch) - 100_000) < 5 * np.sqrt(100_000)
    assert abs(float(batch.on.mean()) - 0.5) < 0.01
    counts, _, _ = np.histogram2d(batch.x_px, batch.y_px, bins=(8, 8), range=((0, 640), (0, 480)))
    assert np.abs(counts - len(batch) / 64).max() < 5 * np.sqrt(len(batch) / 64)


def test_the_five_never_cross_never_leave_and_are_what_the_sites_list() -> None:
    scenario = load_scenario("five")
    t_us = np.arange(0, 120_000_000, 20_000, dtype=np.float64)
    paths = [spec.path.at(t_us) for spec in scenario.beacons]
    for spec, (x, y) in zip(scenario.beacons, paths, strict=True):
        assert x.min() > 2 * spec.radius_px
        assert x.max() < 640 - 2 * spec.radius_px
        assert y.min() > 2 * spec.radius_px
        assert y.max() < 480 - 2 * spec.radius_px
        fastest = np.hypot(np.diff(x), np.diff(y)).max() / 0.02
        assert 50 < fastest <= 200.0
        assert fastest <= spec.path.speed_px_s()
    for a, b in combinations(range(5), 2):
        widest = 2 * max(scenario.beacons[a].radius_px, scenario.beacons[b].radius_px)
        assert np.hypot(paths[a][0] - paths[b][0], paths[a][1] - paths[b][1]).min() > 4 * widest
    assert [b.name for b in scenario.beacons] == ["crane", "lift", "truck", "mixer", "gate"]
    assert [spec.beacon.payload for spec in scenario.beacons] == [42, 21, 51, 77, None]


@given(st.lists(st.integers(0, 400_000), min_size=1, max_size=6))
@settings(max_examples=25)
def test_edges_and_frames_do_not_depend_on_how_time_is_cut(cuts: list[int]) -> None:
    emitter = Emitter([(1, (1, 0, 0, 1, 1)), (2, (0, 1, 0, 1))], 700.0, gap_bits=3, start_us=317.0)
    edges = [0, *sorted(cuts), 500_000]
    parts = [emitter.edges(a, b) for a, b in pairwise(edges)]
    whole_t, whole_on = emitter.edges(0, 500_000)
    assert np.array_equal(np.concatenate([t for t, _ in parts]), whole_t)
    assert np.array_equal(np.concatenate([on for _, on in parts]), whole_on)
    frames = [frame for a, b in pairwise(edges) for frame in emitter.frames_ended(a, b)]
    assert frames == emitter.frames_ended(0, 500_000)
    assert {frame.payload for frame in frames} == {1, 2}
    # Between two edges the light is what the edge before has made it.
    between = (whole_t[:-1] + whole_t[1:]) / 2
    assert np.array_equal(emitter.lit(between), whole_on[:-1])


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


def test_a_text_beacon_sends_its_text_character_by_character() -> None:
    spec = load_scenario("still").beacons[4]
    frames = emitter_of(spec).frames_ended(0, 2_000_000)
    text = "".join(chr(frame.payload) for frame in frames)
    assert (spec.text or "") * 2 in text + text


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


def test_every_built_in_scene_loads() -> None:
    assert {"five", "still", "empty"} <= set(built_in())
    for name in built_in():
        assert isinstance(load_scenario(name), Scenario)
        Scene(load_scenario(name), 0)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (STEADY.replace("payload = 42", ""), "payload or text"),
        (STEADY.replace("payload = 42", "payload = 14"), "beacon a: payload 14 cannot be sent"),
        (STEADY.replace('"seed11"', '"smoke"'), "protocol must be one of"),
        (STEADY.replace("bit_rate = 1000", "bit_rate = 0"), "bit_rate"),
        (STEADY.replace("[2, 2]", "[3, 2]"), "events_per_edge"),
        (STEADY.replace('"still"', '"teleport"'), "kind"),
        (STEADY + 'extra = "?"', "extra"),
        (STEADY.replace("noise_hz = 0", "noise_hz = -1"), "noise_hz"),
    ],
)
def test_a_wrong_scenario_is_one_line_that_names_the_field(text: str, names: str, tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        simulated(str(path), 0.01)
    assert names.rsplit(":", maxsplit=1)[-1].strip().split(" ")[0] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_scene_is_told_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"one of empty, five, still or a TOML file, not 'six'"):
        load_scenario("six")
