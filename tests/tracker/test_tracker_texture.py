"""What blinks becomes a track; what an edge crosses does not."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.core import Context
from heliograph.messages import Tracks
from heliograph_services.cli.bench_corpus import BEACONS, HEIGHT, WIDTH, make_corpus, place_px
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.core import CameraInfo, SourceCore
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import TrackerCore
from support.onset_scenes import Disc, Scene, line


def followed(confirm_blinks: int) -> tuple[int, Tracks]:
    """Return how many tracks a second of moving fragments and five beacons makes, and the last of them."""
    # As from a radio: by the millisecond fragments are a fifth of that.
    source = SourceCore(EventSourceConfig(tick_us=5_000), CameraInfo(WIDTH, HEIGHT))
    tracker = TrackerCore(TrackerConfig(confirm_blinks=confirm_blinks), Context("tracker", "0", lockstep=False))
    last = None
    for window in make_corpus(1e6, 1.0, 5, "fragments").windows:
        for message in source.feed(window):
            for tracks in tracker.feed(message):
                assert isinstance(tracks, Tracks)
                last = tracks
    assert last is not None
    return tracker.counters["tracks_born"], last


def test_fragments_of_moving_edges_are_no_births_and_beacons_before_them_are() -> None:
    without, _ = followed(0)
    born, last = followed(2)
    assert without > 200
    assert born < without / 10
    for i in range(len(BEACONS)):
        x_px, y_px = place_px(i, np.array([last.as_of_us], np.float64))
        away_px = np.hypot(np.array(last.x_px) - x_px, np.array(last.y_px) - y_px)
        assert away_px.min() < 3.0


@pytest.mark.parametrize("bit_rate", [50.0, 100.0, 200.0, 1000.0, 5000.0])
@pytest.mark.parametrize("speed_px_s", [0.0, 150.0])
def test_beacons_of_all_rates_are_born_within_half_a_second(bit_rate: float, speed_px_s: float) -> None:
    scene = Scene((Disc(line(60, 60, speed_px_s), 3.0, bit_rate),), step_us=100, seed=3)
    tracker = TrackerCore(TrackerConfig(), Context("tracker", "0", lockstep=False))
    for onsets in scene.onsets(0.5):
        tracker.feed(onsets)
    assert tracker.counters["tracks_born"] == 1
