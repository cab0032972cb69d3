"""Lights so weak, and a bit rate so low, that a scan tells each of their pixels once a change."""

from __future__ import annotations

import numpy as np

from heliograph_services.cli.studies import contest, distance, methods


def test_all_weak_lights_at_100_bit_s_are_followed_and_read() -> None:
    # Twelve at 100 m, 16 mm: 1.0 to 1.1 events a pixel and change, at a pace of 5 ms windows with one change at most.
    one = distance._cell("fresh", "indoors", 16.0, 100.0, 100.0, 1.5)
    run = contest.watch(distance.scene(one, 1), 1, ["ours"])
    right = (run.found["ours"].outcome == 1) & run.sent.visible
    assert np.unique(run.sent.beacon[right]).tolist() == list(range(12))
    assert right.sum() >= run.sent.visible.sum() - 1
    assert len({name for tracks in run.heard["ours"].tracks for name in tracks.track}) == 12


def test_a_still_light_before_a_camera_that_compares_images_is_followed_and_read() -> None:
    # Every pixel tells a change once, however large, and all of an image at once.
    one = methods._cell("images", 50.0, 5.0, False, 0, 3.0)
    run = contest.watch(methods.scene(one, 7), 7, ["ours"])
    right = (run.found["ours"].outcome == 1) & run.sent.visible
    assert right.sum() == run.sent.visible.sum() > 5
