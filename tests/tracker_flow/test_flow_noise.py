"""Noise is measured from the stream, whatever moves in it, gated at the source or not."""

from __future__ import annotations

import pytest

from heliograph_services.tracker.flow.intake import threshold
from heliograph_services.tracker.flow.noise import NoiseMeter
from support.flow_scenes import FlowScene


@pytest.mark.parametrize("noise_hz", [0.0, 1e6, 5e6])
@pytest.mark.parametrize("gated", [False, True])
@pytest.mark.parametrize("discs", [0, 2])
def test_the_rate_of_noise_is_found_beneath_beacons(noise_hz: float, gated: bool, discs: int) -> None:
    scene = FlowScene("discs", 200.0, noise_hz=noise_hz, gated=gated, discs=discs)
    meter = NoiseMeter(scene.width, scene.height)
    for onsets in scene.onsets(0.2):
        meter.measure(onsets.x_px, onsets.y_px, onsets.on_count, onsets.off_count)
    true = noise_hz * scene.tick_us * 1e-6 / (640 * 480)
    assert meter.events == pytest.approx(true, rel=0.25, abs=0.003)


def test_a_flood_bounds_it() -> None:
    scene = FlowScene("discs", 1.0, discs=0, noise_hz=3e8)
    meter = NoiseMeter(scene.width, scene.height)
    for onsets in scene.onsets(0.05):
        meter.measure(onsets.x_px, onsets.y_px, onsets.on_count, onsets.off_count)
    assert 3 < meter.events < 12
    assert threshold(meter.events, 0.005) < 200


def test_the_threshold_is_passed_by_no_more_noise_than_asked_for() -> None:
    scipy_stats = pytest.importorskip("scipy.stats", reason="scipy is not installed")
    for noise in (1e-4, 0.01, 0.1, 0.7, 3.0):
        m = threshold(noise, 0.005)
        own = 1 - scipy_stats.poisson.pmf(0, noise)
        assert own * scipy_stats.poisson.sf(m - 2, 8 * noise) <= 0.005
        assert m == 1 or own * scipy_stats.poisson.sf(m - 3, 8 * noise) > 0.005
    assert threshold(0.7, 1.0) == 1
    assert threshold(0.0, 0.005) == 1
