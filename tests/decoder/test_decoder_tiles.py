"""Of a window's events, those near some places: none too few, in their order, and the others counted."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.events import EventBatch
from heliograph_services.decoder.tiles import FEW_EVENTS, TILE_PX, WHOLE_LOOKS, Floats, Tiles

WIDTH, HEIGHT = 320, 240


def _events(n: int, seed: int, width: int = WIDTH, height: int = HEIGHT) -> EventBatch:
    rng = np.random.default_rng(seed)
    return EventBatch(
        np.sort(rng.integers(0, 5_000, n)),
        rng.integers(0, width, n).astype(np.uint16),
        rng.integers(0, height, n).astype(np.uint16),
        rng.random(n) < 0.5,
    )


def _near(batch: EventBatch, x_px: Floats, y_px: Floats, reach_px: Floats) -> tuple[EventBatch, int]:
    tiles = Tiles([batch], WIDTH, HEIGHT)
    for _ in range(WHOLE_LOOKS):
        near, elsewhere = tiles.near(x_px, y_px, reach_px)
        assert near is batch
        assert elsewhere == 0
    return tiles.near(x_px, y_px, reach_px)


@pytest.mark.parametrize("seed", range(5))
def test_every_event_within_reach_is_returned_in_order_and_far_ones_are_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    batch = _events(20_000, seed)
    x_px, y_px = rng.uniform(-400, 700, 6), rng.uniform(-400, 600, 6)
    reach_px = rng.uniform(1, 50, 6)
    near, elsewhere = _near(batch, x_px, y_px, reach_px)
    dx = np.abs(batch.x_px[:, None] - x_px)
    dy = np.abs(batch.y_px[:, None] - y_px)
    must = ((dx <= reach_px) & (dy <= reach_px)).any(axis=1)
    may = ((dx <= reach_px + TILE_PX) & (dy <= reach_px + TILE_PX)).any(axis=1)
    rows = set(zip(*(column.tolist() for column in (near.t_us, near.x_px, near.y_px, near.on)), strict=True))
    each = list(zip(*(column.tolist() for column in (batch.t_us, batch.x_px, batch.y_px, batch.on)), strict=True))
    assert {each[k] for k in np.flatnonzero(must)} <= rows <= {each[k] for k in np.flatnonzero(may)}
    assert np.all(np.diff(near.t_us) >= 0)
    assert len(near) + elsewhere == len(batch)


def test_a_place_that_is_absurdly_far_off_gets_nothing() -> None:
    batch = _events(20_000, 1)
    near, elsewhere = _near(
        batch, np.array([16_384.0, -16_384.0]), np.array([-16_384.0, 50.0]), np.array([300.0, 300.0])
    )
    assert (len(near), elsewhere) == (0, len(batch))


def test_events_off_the_sensor_are_neither_near_nor_elsewhere() -> None:
    batch = _events(20_000, 2, width=2 * WIDTH)
    near, elsewhere = _near(batch, np.array([WIDTH - 1.0]), np.array([50.0]), np.array([40.0]))
    assert len(near)
    assert np.all(near.x_px < WIDTH)
    assert len(near) + elsewhere == np.count_nonzero(batch.x_px < WIDTH)


def test_few_events_are_all_returned() -> None:
    batch = _events(FEW_EVENTS, 3)
    near, elsewhere = _near(batch, np.array([10.0]), np.array([10.0]), np.array([5.0]))
    assert near is batch
    assert elsewhere == 0
