"""Which onsets belong to a small light that shines and moves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from heliograph.onset_budget import OnsetBudget
from heliograph.onset_dipoles import CELL_SHIFT, CELLS, LEAST, Dipoles
from heliograph.onsets import OnsetColumns

WIDTH, HEIGHT, TICK_US = 96, 64, 5_000
Counts = npt.NDArray[np.uint8]


def entries(*ticks: tuple[Counts, Counts]) -> OnsetColumns:
    """Return the entries of ticks, each two images of counts: brighter, darker."""
    on, off = (np.stack([tick[k] for tick in ticks]) for k in range(2))
    tick, y_px, x_px = np.nonzero((on > 0) | (off > 0))
    at = (tick, y_px, x_px)
    n, x, y = (part.astype(np.uint16) for part in (tick, x_px, y_px))
    return OnsetColumns(n, x, y, on[at], off[at], np.zeros(len(n), np.bool_), 0, 0, 0)


def image(*pixels: tuple[int, int]) -> Counts:
    counts = np.zeros((HEIGHT, WIDTH), np.uint8)
    for x, y in pixels:
        counts[y, x] = 1
    return counts


# A disc of 2 px radius that goes to the right, and an edge that does.
LEADS, TRAILS = image((42, 30), (42, 31), (42, 32)), image((40, 30), (40, 31), (40, 32))
EDGE = image(*((70, y) for y in range(10, 50)))
NOTHING = image()


def test_scipys_filters_find_the_same_dipoles() -> None:
    rng = np.random.default_rng(0)
    ticks = []
    for _ in range(4):
        on, off = ((rng.random((HEIGHT, WIDTH)) < 0.05).astype(np.uint8) for _ in range(2))
        ticks.append((on, off))
    given = entries(*ticks)
    found = Dipoles(WIDTH, HEIGHT).mark(given, 0, TICK_US)
    for k, (on, off) in enumerate(ticks):
        window = np.ones((5, 5))
        sums = [ndimage.convolve(part.astype(int), window, mode="constant") for part in (on, off)]
        active = (on > 0) | (off > 0)
        centre = active & (sums[0] >= LEAST) & (sums[1] >= LEAST)
        expected = active & ndimage.binary_dilation(centre, np.ones((7, 7), np.bool_))
        assert 0 < np.count_nonzero(expected) < np.count_nonzero(active)
        np.testing.assert_array_equal(found.dipole[given.tick == k], expected[active])


def test_a_small_light_that_moves_is_a_dipole_and_an_edge_is_not() -> None:
    given = entries((LEADS + EDGE, TRAILS))
    found = Dipoles(WIDTH, HEIGHT).mark(given, 0, TICK_US)
    np.testing.assert_array_equal(found.dipole, given.x_px < 60)


def test_what_comes_near_where_a_dipole_was_is_near_it_until_forgotten() -> None:
    marker = Dipoles(WIDTH, HEIGHT, memory_us=250_000)
    marker.mark(entries((LEADS, TRAILS)), 0, TICK_US)
    burst = entries((image((50, 31), (51, 31), (40 + ((CELLS + 1) << CELL_SHIFT), 31)), NOTHING))
    np.testing.assert_array_equal(marker.mark(burst, 250_000, TICK_US).near, [True, True, False])
    assert not marker.mark(burst, 255_000, TICK_US).near.any()


def test_how_ticks_are_cut_into_messages_changes_no_mark() -> None:
    rng = np.random.default_rng(1)
    ticks = [
        ((rng.random((HEIGHT, WIDTH)) < 0.01).astype(np.uint8), (rng.random((HEIGHT, WIDTH)) < 0.01).astype(np.uint8))
        for _ in range(6)
    ]
    whole = Dipoles(WIDTH, HEIGHT, memory_us=10_000).mark(entries(*ticks), 0, TICK_US)
    marker = Dipoles(WIDTH, HEIGHT, memory_us=10_000)
    parts = [marker.mark(entries(tick), k * TICK_US, TICK_US) for k, tick in enumerate(ticks)]
    np.testing.assert_array_equal(whole.dipole, np.concatenate([part.dipole for part in parts]))
    np.testing.assert_array_equal(whole.near, np.concatenate([part.near for part in parts]))


def test_where_not_everything_fits_dipoles_cross_first_then_what_is_near_them() -> None:
    texture = (np.random.default_rng(2).random((HEIGHT, WIDTH)) < 0.5).astype(np.uint8)
    texture[:, :64] = 0
    burst = image((48, 31), (49, 31), (48, 32), (49, 32))
    given = entries((texture + LEADS, TRAILS), (texture + burst, NOTHING))
    marks = Dipoles(WIDTH, HEIGHT).mark(given, 0, TICK_US)
    kept = OnsetBudget(5e5, 10_000).choose(given, 0, marks)
    assert kept.edges_thinned > 0
    assert kept.lights_thinned == 0
    assert kept.keep[marks.dipole].all()
    lit = (given.tick == 1) & (given.x_px >= 48) & (given.x_px <= 49) & (given.y_px >= 31) & (given.y_px <= 32)
    assert kept.keep[lit].all()
