"""The scenes of the link's study are what their conditions say, and every run is another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from heliograph_services.cli.studies.link_scenes import CONDITIONS, PLACES, Condition, scenario
from heliograph_services.cli.studies.paths import true_paths
from heliograph_services.event_source.simulation.stream import SceneStream
from heliograph_services.event_source.simulation.world.load import load_scenario


def scene(condition: Condition, seed: int, folder: Path, *, repeats: bool = False) -> SceneStream:
    path = folder / "scene.toml"
    path.write_text(scenario(condition, seed, repeats=repeats), encoding="utf-8")
    return SceneStream(load_scenario(str(path)), seed, "live")


ALONE = [one for one in CONDITIONS if one.place not in PLACES and one.protocol == "seed11"]


@pytest.mark.parametrize("condition", ALONE, ids=lambda one: one.name)
def test_a_beacon_is_in_view_all_the_time_and_as_fast_as_it_is_said_to_be(condition: Condition, tmp_path: Path) -> None:
    paths = true_paths(scene(condition, 3, tmp_path), 3_000_000)
    assert paths.visible.all()
    speed = np.hypot(np.diff(paths.x_px), np.diff(paths.y_px))[0] * 1e3
    expected = 2.0 * condition.focal_mm / 9e-3 / condition.distance_m if condition.place == "moving" else 0.0
    assert np.quantile(speed, 0.6) == pytest.approx(expected, rel=0.02, abs=1e-3)


def test_runs_differ_in_clock_phase_and_text() -> None:
    for condition in (CONDITIONS[0], next(one for one in CONDITIONS if one.protocol == "uart")):
        texts = [scenario(condition, seed) for seed in range(4)]
        assert len(set(texts)) == 4
        assert texts[0] == scenario(condition, 0)


@pytest.mark.parametrize("place", sorted(PLACES))
@pytest.mark.parametrize("repeats", [False, True])
def test_in_built_in_scenes_all_beacons_send_the_paper_s_frame(place: str, repeats: bool, tmp_path: Path) -> None:
    condition = next(one for one in CONDITIONS if one.place == place)
    beacons = scene(condition, 0, tmp_path, repeats=repeats).world.beacons
    assert len(beacons) >= 4
    assert {(one.protocol, one.bit_rate, one.fresh) for one in beacons} == {("seed11", condition.bit_rate, not repeats)}
    if repeats:
        assert len({one.payload for one in beacons}) == len(beacons)
