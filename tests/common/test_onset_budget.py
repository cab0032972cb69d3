"""What of the onsets crosses a link that is too small for all of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.onset_budget import CREDIT_US, TILE_SHIFT, OnsetBudget
from heliograph.onset_columns import pack_columns
from heliograph.onsets import OnsetColumns
from heliograph.streams import OVERHEAD_BYTES

SIDE = 256
MESSAGE_US = 10_000


def columns(rng: np.random.Generator, edges: int, lights: int) -> OnsetColumns:
    """Return random entries of one tick; the lights lie in a few discs' worth of pixels at the top left."""
    place = np.sort(rng.choice(SIDE * SIDE, edges + lights, replace=False))
    light = np.zeros(len(place), np.bool_)
    light[rng.choice(len(place), lights, replace=False)] = True
    count = rng.integers(1, 5, len(place)).astype(np.uint8)
    y_px, x_px = (part.astype(np.uint16) for part in np.divmod(place, SIDE))
    return OnsetColumns(np.zeros(len(place), np.uint16), x_px, y_px, count, count, light, 0, 0, 0)


def crossed(budget: OnsetBudget, given: OnsetColumns, t0_us: int) -> tuple[np.ndarray, int]:
    kept = budget.choose(given, t0_us)
    k = kept.keep
    assert np.count_nonzero(~k) == kept.lights_thinned + kept.edges_thinned
    assert np.count_nonzero(given.light & ~k) == kept.lights_thinned
    n = np.array([np.count_nonzero(k)])
    size = len(pack_columns(n, given.x_px[k], given.y_px[k], given.on_count[k], given.off_count[k], SIDE)[1])
    budget.spent(int(n[0]), size)
    return k, size


@given(st.integers(0, 99), st.floats(5e5, 4e6), st.lists(st.integers(0, 8_000), min_size=1, max_size=6))
def test_no_second_carries_more_than_the_rate(seed: int, bit_rate: float, loads: list[int]) -> None:
    rng = np.random.default_rng(seed)
    budget = OnsetBudget(bit_rate, MESSAGE_US)
    pool = [columns(rng, load, load // 10) for load in loads]
    sizes = [crossed(budget, pool[i % len(pool)], i * MESSAGE_US)[1] + OVERHEAD_BYTES for i in range(120)]
    # The reserve covers what a quiet time has saved; what overdraws is paid for by the messages after it.
    overdrawn = max(sizes) + bit_rate / 8 * CREDIT_US / 1e6
    for start in range(20):
        assert sum(sizes[start : start + 100]) <= 0.95 * bit_rate / 8 + overdrawn


def test_what_fits_crosses_whole() -> None:
    budget = OnsetBudget(2e6, MESSAGE_US)
    assert crossed(budget, columns(np.random.default_rng(0), 200, 100), 0)[0].all()
    unlimited = OnsetBudget(0.0, MESSAGE_US)
    assert unlimited.choose(columns(np.random.default_rng(0), 60_000, 0), 0).keep.all()


def test_edges_give_way_before_lights_and_tiles_stay_whole() -> None:
    budget, given = OnsetBudget(2e6, MESSAGE_US), columns(np.random.default_rng(1), 6_000, 500)
    tile = (given.y_px >> TILE_SHIFT).astype(int) * SIDE + (given.x_px >> TILE_SHIFT)
    edge = ~given.light
    keeps = [crossed(budget, given, i * MESSAGE_US)[0] for i in range(100)]
    for keep in keeps:
        assert keep[given.light].all()
        for t in np.unique(tile[edge]):
            assert len(set(keep[edge & (tile == t)].tolist())) == 1
    assert 0.05 < np.mean(keeps[-1][edge]) < 0.6


def test_tiles_of_edges_stay_for_half_a_second_and_take_turns() -> None:
    given = columns(np.random.default_rng(2), 8_000, 0)
    budget = OnsetBudget(2e6, MESSAGE_US)
    keeps = np.array([crossed(budget, given, i * MESSAGE_US)[0] for i in range(1_000)])
    steady = np.mean(keeps[60:99] == keeps[61:100])
    assert steady > 0.9
    assert keeps.any(axis=0).mean() > 0.9


def test_lights_that_do_not_fit_come_with_the_next_messages() -> None:
    given = columns(np.random.default_rng(3), 0, 9_000)
    budget = OnsetBudget(2e6, MESSAGE_US)
    keeps = np.array([crossed(budget, given, i * MESSAGE_US)[0] for i in range(60)])
    assert not keeps.all(axis=1).any()
    assert keeps.any(axis=0).all()


@pytest.mark.parametrize("bit_rate", [0.0, 2e6])
def test_a_new_stream_begins_as_the_first(bit_rate: float) -> None:
    given = columns(np.random.default_rng(4), 9_000, 0)
    budget = OnsetBudget(bit_rate, MESSAGE_US)
    first = [crossed(budget, given, i * MESSAGE_US)[0].tolist() for i in range(5)]
    budget.reset()
    assert [crossed(budget, given, i * MESSAGE_US)[0].tolist() for i in range(5)] == first
