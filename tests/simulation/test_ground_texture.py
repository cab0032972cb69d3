"""The ground's textures: what the scenario says of them, no seam, coarser levels that are the mean of finer ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Literal

import numpy as np
import pytest

from heliograph_services.event_source.simulation.ground.texture import SIZE, TILE_GRAINS, Texture
from heliograph_services.event_source.simulation.ground.texture import make_texture as make
from heliograph_services.event_source.simulation.world.spec import Ground

Kind = Literal["asphalt", "site", "boards"]
make_texture: Callable[[Ground, int], Texture] = cache(make)
KINDS: tuple[Kind, ...] = ("asphalt", "site", "boards")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("reflectance", "contrast"), [(0.25, 1.5), (0.1, 3.0)])
def test_mean_and_contrast_are_those_of_the_scenario(kind: Kind, reflectance: float, contrast: float) -> None:
    rho = make_texture(Ground(texture=kind, reflectance=reflectance, contrast=contrast), 1).levels[0]
    assert rho.mean(dtype=np.float64) == pytest.approx(reflectance, rel=1e-3)
    # One standard deviation up and down; what is clipped at three takes a little.
    assert math.exp(2.0 * float(np.log(rho).std())) == pytest.approx(contrast, rel=0.02)
    assert rho.max() <= 1.0
    assert rho.min() > 0.0


def test_a_ground_that_would_reflect_more_than_all_light_stays_below_and_keeps_its_mean() -> None:
    rho = make_texture(Ground(texture="asphalt", reflectance=0.7, contrast=4.0), 1).levels[0]
    assert rho.max() <= 1.0
    assert rho.mean(dtype=np.float64) == pytest.approx(0.7, rel=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_a_tile_has_no_seam(kind: Kind) -> None:
    logs = np.log(make_texture(Ground(texture=kind), 1).levels[2])  # 4 texels, so that the grain's own steps are small
    inside = max(np.abs(np.diff(logs, axis=0)).mean(axis=1).max(), np.abs(np.diff(logs, axis=1)).mean(axis=0).max())
    assert np.abs(logs[0] - logs[-1]).mean() <= inside
    assert np.abs(logs[:, 0] - logs[:, -1]).mean() <= inside


@pytest.mark.parametrize("kind", KINDS)
def test_levels_halve_and_keep_the_mean_while_contrast_falls(kind: Kind) -> None:
    levels = make_texture(Ground(texture=kind), 1).levels
    assert [len(level) for level in levels] == [SIZE >> k for k in range(len(levels))]
    means = [float(level.mean(dtype=np.float64)) for level in levels]
    assert means == pytest.approx([means[0]] * len(means), rel=1e-5)
    deviations = [float(np.log(level).std()) for level in levels]
    assert deviations == sorted(deviations, reverse=True)
    assert deviations[-1] < 0.2 * deviations[0]


def test_one_seed_gives_one_ground_and_another_seed_another() -> None:
    first, again, other = (make(Ground(texture="asphalt"), seed).levels[0] for seed in (1, 1, 2))
    assert (first == again).all()
    assert abs(float(np.corrcoef(first.ravel()[::97], other.ravel()[::97])[0, 1])) < 0.1


def test_a_tile_covers_its_grains_whatever_they_measure() -> None:
    fine, coarse = (make_texture(Ground(texture="boards", grain_m=grain_m), 1) for grain_m in (0.1, 7.0))
    assert (fine.tile_m, coarse.tile_m) == (TILE_GRAINS * 0.1, TILE_GRAINS * 7.0)
    assert (fine.levels[0] == coarse.levels[0]).all()


def test_the_largest_patches_are_a_grain_wide() -> None:
    """Soil a quarter of a grain apart is alike, two grains apart it is not."""
    logs = np.log(make_texture(Ground(texture="site", grain_m=1.0), 1).levels[3])
    logs -= logs.mean()
    texels = len(logs) / TILE_GRAINS

    def alike(grains: float) -> float:
        return float((logs * np.roll(logs, round(grains * texels), axis=1)).mean() / logs.var())

    assert alike(0.25) > 0.4
    assert abs(alike(2.5)) < 0.1


def test_what_is_packed_is_the_logarithm_with_a_border() -> None:
    texture = make_texture(Ground(texture="boards"), 1)
    packed, bases = texture.packed(3.0, 0.01)
    side = SIZE // 4 + 1
    level = packed[bases[2] : bases[2] + side * side].reshape(side, side)
    assert level[:-1, :-1] == pytest.approx(np.log(3.0 * texture.levels[2] + 0.01), rel=1e-5)
    assert (level[-1, :-1] == level[0, :-1]).all()
    assert (level[:, -1] == level[:, 0]).all()
