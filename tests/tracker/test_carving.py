"""A lamp on a bright plate is cut out of the plate's edges; a strong edge is not."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph_services.tracker import shape
from heliograph_services.tracker.clustering import Active, Clusterer
from heliograph_services.tracker.shape import ShapeFilter
from heliograph_services.tracker.splitting import carve

MIN_PIXELS = 3


def on_a_plate(dark_half: bool) -> Active:
    """Return a window of 50 bit/s: a plate's border, one event a pixel, joined by a lamp of 3 x 3 pixels with two each.

    Args:
        dark_half: whether the lamp's trailing pixels become darker, as a lit one's do that moves; else all become
            brighter, as those of a strong edge.
    """
    y, x = (a.ravel() for a in np.mgrid[0:11, 0:11])
    border = (np.minimum(x, y) == 0) | (np.maximum(x, y) == 10) | ((y == 5) & (x < 4))
    lamp = (abs(x - 5) <= 1) & (abs(y - 5) <= 1)
    keep = border | lamp
    x, y, lamp = x[keep].astype(np.int32), y[keep].astype(np.int32), lamp[keep]
    off = np.where(lamp & (x == 4) & dark_half, 2, 0).astype(np.int32)
    on = np.where(lamp, 2, 1).astype(np.int32) * (off == 0)
    return Active(x + 20, y + 20, on.astype(np.int32), off, np.zeros((2, len(x))))


def lights_of(active: Active) -> tuple[int, list[tuple[int, int]], list[bool]]:
    """Return how many clusters there are at first, the pixels of those cut out, and who is surroundings."""
    clusterer = Clusterer(64, 64, 1.5, MIN_PIXELS)
    labels, count = clusterer.labels(active)
    targets = shape.measure(
        active, labels, np.zeros(count, np.bool_), 1, ShapeFilter(MIN_PIXELS, 2000, 0.5, "distinct")
    )
    carved = carve(active, labels, targets, clusterer.labels, MIN_PIXELS)
    if carved is None:
        return count, [], []
    out, _, around = carved
    cut = out >= count
    return count, sorted(zip(active.x_px[cut].tolist(), active.y_px[cut].tolist(), strict=True)), around.tolist()


def test_a_lamp_that_shines_and_moves_is_cut_out_of_its_plate_and_the_plate_is_nobodys() -> None:
    count, cut, around = lights_of(on_a_plate(dark_half=True))
    assert count == 1
    assert cut == [(x, y) for x in (24, 25, 26) for y in (24, 25, 26)]
    assert around == [True, False]


@pytest.mark.parametrize("times", [1, 2])
def test_what_fires_often_but_one_way_is_left_in_its_cluster(times: int) -> None:
    active = on_a_plate(dark_half=False)
    stronger = Active(active.x_px, active.y_px, active.on * times, active.off, active.moments)
    assert lights_of(stronger)[1:] == ([], [])
