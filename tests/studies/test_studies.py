"""The studies' parts: scenes that load, readers that plug in, words of comparison, characters in line."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.edits import edits
from heliograph.errors import ConfigError
from heliograph.link.contract import edges_of
from heliograph.link.uart_layout import text_bits
from heliograph.messages import Identification
from heliograph_services.cli.studies import (
    bit_rate,
    contest,
    crowd_size,
    distance,
    methods,
    recordings,
    scene,
    sunlight,
    wavelength,
)
from heliograph_services.cli.studies.catalogue import load
from heliograph_services.cli.studies.contest import Scene, counts, watch
from heliograph_services.cli.studies.study import Cell, Done, worse_than
from heliograph_services.cli.studies.windows_rule import read_windows
from heliograph_services.event_source.simulation.stream import SceneStream
from heliograph_services.event_source.simulation.world.load import load_scenario
from heliograph_services.event_source.simulation.world.world import beacons_of

PEER = "heliograph_services.cli.studies.peers:paper"


def of(sent: list[int], right: list[int]) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    return np.array([sent, right], np.int64).T


def test_worse_is_said_of_paired_blocks_beyond_chance_alone() -> None:
    ours = of([100] * 30, [95] * 30)
    assert worse_than(ours, {"genie": of([100] * 30, [99] * 30)}).startswith("genie: -0.0400 [")
    assert worse_than(ours, {"genie": of([100] * 30, [95] * 30)}) == ""
    assert worse_than(ours, {"genie": of([100] * 30, [90] * 30)}) == ""
    # Other scenes: the intervals must not touch.
    assert worse_than(ours, {"other": of([100] * 20, [99] * 20)}) == "other: 0.9500 against 0.9900"
    assert worse_than(ours, {"other": of([], []).reshape(0, 2)}) == ""


@pytest.mark.parametrize("name", ["bit_rate", "distance", "methods"])
def test_scenes_of_all_kinds_load(name: str, tmp_path: Path) -> None:
    study = load(name)
    makers: dict[str, Callable[..., Scene]] = {
        "bit_rate": bit_rate.scene, "distance": distance.scene, "methods": methods.scene,
    }  # fmt: skip
    path = tmp_path / "scene.toml"
    seen = 0
    for cell in study.all_cells("full", "development")[::7]:
        scene = makers[name](cell.parameters, cell.seed)
        path.write_text(scene.text)
        beacons = load_scenario(str(path)).beacons
        assert {beacon.protocol for beacon in beacons} == {scene.protocol}
        seen += len(beacons)
    assert seen > 10


def test_a_crowd_of_every_size_loads(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    sizes = {}
    for cell in load("crowd_size").all_cells("full", "development"):
        path.write_text(crowd_size.scene(cell.parameters).text)
        sizes[cell.parameters["count"]] = len(beacons_of(load_scenario(str(path)), cell.seed))
    assert sizes == {count: count for count in crowd_size.SIZES}


def test_the_scene_keeps_who_is_named_and_draws_it_again_from_what_it_keeps() -> None:
    view = {"shape": [240, 320], "zlib": base64.b64encode(zlib.compress(bytes(240 * 320))).decode()}
    counts: dict[str, object] = {
        "view": view,
        "events": [[10, 20, 1], [11, 20, 0]],
        "beacons": [["crate", 10.0, 20.0, 1.0, True], ["pipes", 50.0, 20.0, 1.0, False]],
        "tracks": [[10.0, 20.0, 5.0, 0.0]],
        "identified": [["crate", 10.0, 20.0, True], ["pipes", 90.0, 20.0, False]],
    }
    done = Done(Cell({"scenario": "construction_site", "seconds": 4.0}, 0), counts, 1.0)
    (table,) = scene.tables([done])
    assert [figure.value for figure in table.rows[0].figures.values()] == [1.0, 2.0, 1.0]
    axis = pytest.importorskip("matplotlib.figure").Figure().subplots()
    scene.draw([done], axis)
    assert [text.get_text() for text in axis.texts] == ["crate", "pipes"]
    assert axis.get_xlim() == (-0.5, 639.5)


def test_a_name_is_right_where_the_beacon_that_bears_it_is() -> None:
    text = crowd_size.SCENARIO.format(count=2, rate=2000.0, fresh="true")
    run = watch(Scene(text, 0.8, "seed11", 2000.0), 5, ["core"])
    x_px, y_px = run.paths.places([500_000])
    fields: dict[str, Any] = {
        "camera": "cam0", "track": "t", "t_us": 500_000, "since_us": 0, "protocol": "seed11", "payload": 1,
        "vx_px_s": 0.0, "vy_px_s": 0.0, "bearing": None, "confidence": 1.0, "margin": 1.0, "frames_used": 4,
        "change": "accepted", "lost": False, "x_px": float(x_px[0, 0]) + 1.0, "y_px": float(y_px[0, 0]),
    }  # fmt: skip
    names = run.paths.names
    assert scene.is_right(Identification(**fields, beacon=names[0]), run.paths)
    assert not scene.is_right(Identification(**fields, beacon=names[1]), run.paths)
    assert not scene.is_right(Identification(**fields | {"x_px": -900.0}, beacon=names[0]), run.paths)


def test_r95_begins_where_a_scene_has_all_beacons() -> None:
    near = {(f, d) for f in distance.LENSES_MM for d in distance.DISTANCES_M if distance.is_near(f, d)}
    assert near == {(3.6, 0.5), (3.6, 1.0), (16.0, 0.5), (16.0, 1.0), (16.0, 2.0), (16.0, 5.0)}

    def done(distance_m: float, right: int) -> Done:
        blocks = [[i, s, 100, right, 0, 0, 0] for i in range(12) for s in range(6)]
        parameters = {"focal_mm": 3.6, "distance_m": distance_m}
        return Done(Cell(parameters, 0), {"blocks": {"ours": blocks}, "inserted": {"ours": 0}}, 0.0)

    held = [done(0.5, 0), done(2.0, 100), done(5.0, 99), done(11.5, 90), done(16.0, 100)]
    assert distance.r95(held, "ours").value == 5.0
    assert distance.r95([done(2.0, 90)], "ours").value == 0.0


def test_the_paper_s_receiver_plugged_in_reads_what_it_reads_built_in() -> None:
    text = crowd_size.SCENARIO.format(count=3, rate=2000.0, fresh="false")
    arms = ["paper", PEER]
    run = watch(Scene(text, 1.2, "seed11", 2000.0), 5, arms)
    found = counts(run)
    assert found["blocks"][PEER] == found["blocks"]["paper"]
    assert found["inserted"][PEER] == found["inserted"]["paper"]
    total = np.array(found["blocks"]["paper"]).sum(axis=0)
    assert total[contest.READ] > 100
    assert total[contest.BITS] == 11 * total[contest.SENT]
    # What is not read has no bit right; what is misread some.
    assert 11 * total[contest.READ] <= total[contest.BITS_READ] <= 11 * (total[contest.READ] + total[contest.MISREAD])


def test_a_truth_without_frames_and_an_arm_that_is_not_there_are_said() -> None:
    text = crowd_size.SCENARIO.format(count=1, rate=2000.0, fresh="true")
    with pytest.raises(ConfigError, match=r"the truth holds no frames that count in 0\.2 s"):
        watch(Scene(text, 0.2, "seed11", 2000.0), 5, ["core"])
    with pytest.raises(ConfigError, match="an arm must be ours, paper, paper_tuned, wang2022"):
        watch(Scene(text, 0.2, "seed11", 2000.0), 5, ["nobody"])


@given(st.text("ab c", min_size=1, max_size=30), st.text("ab c", max_size=30))
def test_characters_in_line_have_the_errors_of_the_edit_distance(sent: str, read: str) -> None:
    costs = recordings.aligned(sent, read)
    assert len(costs) == len(sent)
    assert sum(costs) == edits(sent, read).errors


@pytest.mark.parametrize("phase", [0.0, 0.25])
def test_the_window_rule_reads_clean_text(phase: float) -> None:
    text = "the quick brown fox"
    bit_us = 1000.0
    # Edges in the middle of the windows, idle before and after.
    at_us, lit = edges_of((1,) * 4 + text_bits(text) + (1,) * 14, 0.5 * bit_us, bit_us)
    at_us = np.concatenate([at_us, [at_us[-1] + 1e5]])
    lit = np.concatenate([lit, [not lit[-1]]])
    t_us = np.repeat(at_us, 20).astype(np.int64) + np.tile(np.arange(20), len(at_us))
    assert read_windows(t_us, np.repeat(lit, 20), bit_us, 1.0, phase) == text
    assert read_windows(t_us[:0], np.repeat(lit, 20)[:0], bit_us) == ""


def test_first_k_keeps_the_beginning_of_every_burst() -> None:
    t_us = np.array([0, 1, 2, 3, 1000, 1001, 1002], np.int64)
    on = np.array([True, True, False, False, False, False, False])
    left, kept = recordings.thinned(t_us, on, "first", 1.0, 1000.0, 0)
    assert left.tolist() == [0, 2, 1000]
    assert kept.tolist() == [True, False, False]
    assert len(recordings.thinned(t_us, on, "at random", 1.0, 1000.0, 0)[0]) == 7


def test_sunlight_is_that_of_the_standard_and_an_led_s_power_comes_out() -> None:
    # ASTM G173-03 (global), 350 to 1125 nm, integrated with the standard's own steps: 798.5 W/m2.
    assert np.trapezoid(sunlight.AM15G_W_M2_NM, sunlight.wavelengths_nm()) == pytest.approx(798.5, rel=2e-3)
    # Away from absorption lines a mean over 25 nm is the value there.
    assert np.interp(660.0, sunlight.wavelengths_nm(), sunlight.AM15G_W_M2_NM) == pytest.approx(1.399, rel=0.01)
    theta = np.linspace(0.0, np.pi / 2, 20_001)
    for half_angle in (5.0, 20.0, 60.0):
        on_axis = sunlight.intensity_w_sr(1.0, half_angle)
        m = np.log(0.5) / np.log(np.cos(np.radians(half_angle)))
        ring = on_axis * np.cos(theta) ** m * 2.0 * np.pi * np.sin(theta)
        assert np.trapezoid(ring, theta) == pytest.approx(1.0, abs=1e-4)


def test_the_contrast_of_the_study_is_that_of_the_simulated_image(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    led, band, distance_m = 0.3, 120.0, 40.0
    path.write_text(
        f'irradiance_w_m2 = {band}\n[camera]\nsensor = "dvxplorer_mini"\n'
        f'path = {{ kind = "still", at_m = [0, 0, {distance_m}] }}\nlens = {{ focal_mm = 16.0, f_number = 1.4 }}\n'
        f'[[beacon]]\nname = "a"\nprotocol = "seed11"\nfresh = true\nbit_rate = 1000\nintensity_w_sr = {led}\n'
        'diameter_m = 0.001\npath = { kind = "still", at_m = [0, 0, 0] }\n'
    )
    scene = SceneStream(load_scenario(str(path)), 0, "live")
    where = scene.world.chunk_geometry(0)
    ground = scene.world.optics.background_w_m2(scene.world.scenario.ground.reflectance, band)
    peak = float(where.flux_w_m2[0, 0] / (2.0 * np.pi * where.sigma_px[0, 0] ** 2))
    told = sunlight.contrast(led, band, distance_m, 16.0, wavelength.SIGMA_PX)
    assert told == pytest.approx(peak / ground, rel=0.1)


def test_850_and_940_nm_change_places_with_the_responsivity() -> None:
    def reach(curve: str, nm: float, *, filtered: bool) -> float:
        return wavelength.reach_m({"curve": curve, "filter": filtered, "sun_w_m2": 1000.0, "led_nm": nm}, 20.0)

    assert reach("photovoltaic", 940.0, filtered=True) > reach("photovoltaic", 850.0, filtered=True)
    assert reach("cmos", 850.0, filtered=False) > reach("cmos", 940.0, filtered=False)
