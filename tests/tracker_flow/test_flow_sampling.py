"""What is read of a network's spikes where many pixels are active."""

from __future__ import annotations

import numpy as np

from heliograph_services.tracker.flow.pyramid import FlowPyramid
from heliograph_services.tracker.flow.sampling import EVERY_MOST, SURE, Sampler
from heliograph_services.tracker.flow.settings import FlowSettings
from support.flow_scenes import FlowScene


def test_a_busy_tile_reads_a_sample_of_the_surer_spikes_and_the_others_read_all() -> None:
    sampler = Sampler(192, 48, 100.0, 5.0)
    rng = np.random.default_rng(1)
    reads = np.zeros((48, 3))
    for tick in range(400):
        # The middle tile of the second row gets 60 inputs a tick, 660 in eleven; a corner gets 8, 88 in eleven.
        x = np.concatenate([rng.integers(64, 128, 60), rng.integers(0, 64, 8)])
        y = np.concatenate([rng.integers(16, 32, 60), rng.integers(0, 16, 8)])
        wanted, left_out = sampler.choose(x, y, tick)
        if tick < 60:
            continue
        busy = wanted[16:32, 1].copy()
        assert left_out == (busy == 0).sum() == 16 - 16 // EVERY_MOST
        assert set(busy.tolist()) == {0, int(np.ceil(SURE * 5.0))}
        reads += wanted > 0
    quiet = np.ones((48, 3), np.bool_)
    quiet[16:32, 1] = False
    assert (reads[quiet] == 340).all()
    assert (abs(reads[16:32, 1] / 340 - 1 / EVERY_MOST) < 0.08).all(), "some rows have no turn"


def test_rest_is_forgotten() -> None:
    sampler = Sampler(64, 16, 100.0, 5.0)
    x, y = np.tile(np.arange(64), 16), np.repeat(np.arange(16), 64)
    assert sampler.choose(x, y, 0)[1] > 0
    sampler.skip(200)
    assert sampler.choose(x[:10], y[:10], 201)[1] == 0


def test_sampling_spares_most_spikes_of_texture_and_none_of_beacons() -> None:
    counters = {}
    for kind in ("texture", "discs"):
        scene = FlowScene(kind, 300.0, 40.0, seed=9)
        ticks = list(scene.onsets(0.3))
        for tile_inputs in (64.0, np.inf):
            flow = FlowPyramid(
                FlowSettings(tile_inputs=tile_inputs), width=scene.width, height=scene.height, tick_us=scene.tick_us
            )
            for onsets in ticks:
                flow.feed(onsets)
            counters[kind, tile_inputs] = flow.counters
    assert counters["texture", 64.0]["inputs"] == counters["texture", np.inf]["inputs"]
    assert counters["texture", 64.0]["spikes"] < 0.2 * counters["texture", np.inf]["spikes"]
    assert counters["texture", 64.0]["unread"] > 0
    assert counters["discs", 64.0]["spikes"] > 0.7 * counters["discs", np.inf]["spikes"]
