"""Centre, size and roundness of targets."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from heliograph_services.tracker import shape
from heliograph_services.tracker.clustering import Active
from heliograph_services.tracker.config import Shape
from heliograph_services.tracker.shape import ShapeFilter, Targets

RULES: tuple[Shape, ...] = ("distinct", "paper")
Mask = npt.NDArray[np.bool_]


def target_of(mask: Mask, rule: Shape = "distinct", pool_px: int = 1, on: int = 1, off: int = 0) -> Targets:
    y, x = np.nonzero(mask)
    n = len(x)
    counts = np.full(n, on, np.int32), np.full(n, off, np.int32)
    active = Active(x.astype(np.int32), y.astype(np.int32), *counts, np.zeros((2, n)))
    return shape.measure(active, np.zeros(n, np.int32), np.zeros(1, np.bool_), pool_px, ShapeFilter(4, 2000, 0.5, rule))


def disc(radius_px: float, x_px: float = 30.0, y_px: float = 30.0) -> Mask:
    y, x = np.mgrid[0:64, 0:64]
    return np.asarray((x - x_px) ** 2 + (y - y_px) ** 2 <= radius_px**2)


@pytest.mark.parametrize("radius_px", np.arange(1.5, 15, 0.7))
@pytest.mark.parametrize("offset_px", [0.0, 0.3, 0.5])
def test_discs_score_as_round_in_both_measures(radius_px: float, offset_px: float) -> None:
    mask = disc(radius_px, 30 + offset_px, 30)
    assert 0.85 <= target_of(mask).roundness[0] <= 1.01
    assert 0.6 <= target_of(mask, "paper").roundness[0] <= 0.95


@pytest.mark.parametrize("width", [1, 2, 3])
def test_streaks_are_not_round_in_either_measure(width: int) -> None:
    mask = np.zeros((64, 64), np.bool_)
    mask[10 : 10 + width, 10 : 10 + 6 * width] = True
    for rule in RULES:
        found = target_of(mask, rule)
        assert found.roundness[0] < 0.5
        assert found.verdict[0] == shape.NOT_ROUND


def in_ticks(mask: Mask, ticks: list[int], *, is_fine: bool = True) -> Targets:
    """Return the target whose pixels fire once each, in these of a window's five ticks in turn."""
    y, x = np.nonzero(mask)
    t = np.resize(np.array(ticks, np.float64), len(x))
    once, never = np.ones(len(x), np.int32), np.zeros(len(x), np.int32)
    active = Active(x.astype(np.int32), y.astype(np.int32), once, never, np.stack([t, t**2]))
    labels = np.zeros(len(x), np.int32)
    rule = ShapeFilter(4, 2000, 0.5, "distinct")
    return shape.measure(active, labels, np.zeros(1, np.bool_), 1, rule, 5, 1e-3, is_fine=is_fine)


@pytest.mark.parametrize("ticks", [[0], [4], [1, 2], [2, 2, 2, 3]])
def test_a_disc_whose_pixels_fire_once_but_at_once_is_a_switched_light(ticks: list[int]) -> None:
    assert in_ticks(disc(2.6), ticks).switched.tolist() == [True]


def test_what_takes_the_whole_window_or_is_no_disc_or_tiny_is_no_switched_light() -> None:
    streak = np.zeros((64, 64), np.bool_)
    streak[10:12, 10:16] = True
    two_by_two = np.zeros((64, 64), np.bool_)
    two_by_two[10:12, 10:12] = True
    assert in_ticks(disc(2.6), [0, 1, 2, 3, 4]).switched.tolist() == [False]
    assert in_ticks(streak, [2]).switched.tolist() == [False]
    assert in_ticks(two_by_two, [2]).switched.tolist() == [False]


@pytest.mark.parametrize("radius_px", [1.2, 1.3, 1.45, 1.6])
def test_small_discs_less_round_by_their_place_on_the_pixels_are_switched_lights_if_of_one_tick(
    radius_px: float,
) -> None:
    for x_px, y_px in [(30.2, 30.4), (30.5, 30.0), (30.25, 30.25), (30.0, 30.0), (30.4, 30.5)]:
        mask = disc(radius_px, x_px, y_px)
        if mask.sum() >= shape.ONE_TICK_PIXELS:
            assert in_ticks(mask, [2]).switched.tolist() == [True]
    five = np.zeros((64, 64), np.bool_)
    five[10:12, 10:12] = five[12, 10] = True
    assert in_ticks(five, [2]).switched.tolist() == [True]
    assert in_ticks(five, [2, 3]).switched.tolist() == [False]


def test_two_or_three_pixels_that_all_went_both_ways_are_a_light_and_one_or_quiet_ones_are_too_few() -> None:
    for shape_px in ((1, 2), (2, 1), (1, 3)):
        mask = np.zeros((64, 64), np.bool_)
        mask[10 : 10 + shape_px[0], 10 : 10 + shape_px[1]] = True
        assert target_of(mask, on=1, off=1).verdict.tolist() == [shape.ROUND]
        assert target_of(mask, on=2, off=0).verdict.tolist() == [shape.TOO_FEW]
        assert target_of(mask, "paper", on=1, off=1).verdict.tolist() == [shape.TOO_FEW]
    one = np.zeros((64, 64), np.bool_)
    one[10, 10] = True
    assert target_of(one, on=2, off=2).verdict.tolist() == [shape.TOO_FEW]


def test_in_images_and_slow_scans_only_a_disc_of_nine_pixels_is_a_switched_light() -> None:
    crown = disc(2.6) & ~disc(1.5)
    assert in_ticks(disc(1.5), [2], is_fine=False).switched.tolist() == [True]
    assert in_ticks(disc(1.2), [2], is_fine=False).switched.tolist() == [False]
    assert in_ticks(crown, [2], is_fine=False).switched.tolist() == [False]


def swept(radius_px: float, dx_px: float, dy_px: float) -> Mask:
    """Return the pixels that a disc has covered on its way."""
    out = np.zeros((64, 64), np.bool_)
    for at in np.linspace(-0.5, 0.5, 60):
        out |= disc(radius_px, 32 + at * dx_px, 32 + at * dy_px)
    return out


@pytest.mark.parametrize("radius_px", [2.5, 3.0, 4.0, 6.0])
@pytest.mark.parametrize(("dx_px", "dy_px"), [(20.0, 0.0), (0.0, -20.0), (14.0, 14.0), (-20.0, 8.0)])
def test_a_disc_that_sweeps_and_blinks_is_a_light_and_says_roughly_how_far_it_moved(
    radius_px: float, dx_px: float, dy_px: float
) -> None:
    streak = swept(radius_px, dx_px, dy_px)
    found = target_of(streak, on=2, off=1)
    assert found.light[0]
    assert found.swept_px[0] == pytest.approx([abs(dx_px), abs(dy_px)], rel=0.4, abs=1.0)
    # What went one way only was an edge; the paper's measure knows no streaks.
    assert bool(target_of(streak).light[0]) == (target_of(streak).verdict[0] == shape.ROUND)
    if target_of(streak).verdict[0] == shape.NOT_ROUND:
        assert found.verdict[0] == shape.SWEPT


def test_a_still_disc_has_not_swept_and_thin_or_bent_streaks_are_no_lights() -> None:
    assert target_of(disc(3), on=1, off=1).swept_px[0].tolist() == [0, 0]
    ring = disc(12) & ~disc(10)
    half = ring.copy()
    half[:, 30:] = False
    line = np.zeros((64, 64), np.bool_)
    line[30:32, 10:40] = True
    for mask in (line, half, ring):
        assert not target_of(mask, on=1, off=1).light[0]


def test_a_crescent_is_not_round() -> None:
    # What a lit disc of radius 4 draws with its leading edge while it moves by 1.5 px.
    crescent = disc(4, 31.5) & ~disc(4, 30)
    assert target_of(crescent).roundness[0] < 0.5


def test_repeated_events_of_a_pixel_do_not_make_a_streak_round() -> None:
    mask = np.zeros((64, 64), np.bool_)
    mask[10, 10:18] = True
    assert target_of(mask, on=50).roundness[0] == target_of(mask, on=1).roundness[0]


def test_one_pixel_has_a_finite_score_and_a_radius_of_half_a_pixel() -> None:
    mask = np.zeros((64, 64), np.bool_)
    mask[5, 7] = True
    for rule in RULES:
        found = target_of(mask, rule)
        assert np.isfinite(found.roundness[0])
        assert (found.x_px[0], found.y_px[0], found.radius_px[0]) == (7, 5, 0.5)
        assert found.verdict[0] == shape.TOO_FEW


def test_sizes_outside_the_interval_are_refused() -> None:
    assert target_of(disc(1)).verdict[0] == shape.ROUND  # 5 pixels
    assert target_of(disc(26)).verdict[0] == shape.TOO_MANY  # 2113 pixels


@pytest.mark.parametrize("radius_px", [2.0, 4.0, 9.0])
def test_the_radius_covers_nine_tenths_of_the_pixels_and_the_reach_all(radius_px: float) -> None:
    mask = disc(radius_px)
    found = target_of(mask)
    y, x = np.nonzero(mask)
    d = np.hypot(x - found.x_px[0], y - found.y_px[0])
    assert np.mean(d <= found.radius_px[0]) >= 0.9
    assert np.mean(d <= found.radius_px[0] - 1) < 0.9
    assert d.max() == pytest.approx(found.reach_px[0] - 0.5)


def test_pooled_squares_are_given_back_in_sensor_pixels_at_their_centres() -> None:
    mask = np.zeros((64, 64), np.bool_)
    mask[2:4, 6:8] = True
    found = target_of(mask, pool_px=4)
    # Squares 6 and 7 of 4 px hold columns 24 to 31, whose centre is 27.5.
    assert (found.x_px[0], found.y_px[0]) == (27.5, 11.5)
    assert found.radius_px[0] == pytest.approx((np.sqrt(0.5) + 0.5) * 4)
    assert found.pixels[0] == 4


def pixels(x_px: list[int], y_px: list[int], on: list[int], off: list[int]) -> Active:
    """Return active pixels without moments."""
    x, y, brighter, darker = (np.array(column, np.int32) for column in (x_px, y_px, on, off))
    return Active(x, y, brighter, darker, np.zeros((2, len(x))))


def test_targets_keep_the_order_of_their_clusters_and_count_both_polarities() -> None:
    active = pixels([1, 9, 2, 8], [1, 9, 1, 9], [3, 0, 1, 0], [0, 2, 0, 7])
    labels = np.array([1, 0, 1, 0], np.int32)
    found = shape.measure(active, labels, np.zeros(2, np.bool_), 1, ShapeFilter(1, 9, 0.1, "distinct"))
    assert found.x_px.tolist() == [(9 * 2 + 8 * 7) / 9, (1 * 3 + 2) / 4]
    assert found.on.tolist() == [0, 4]
    assert found.off.tolist() == [9, 0]


def test_noise_belongs_to_no_target() -> None:
    active = pixels([1, 40], [1, 40], [1, 1], [0, 0])
    found = shape.measure(
        active, np.array([0, -1], np.int32), np.zeros(1, np.bool_), 1, ShapeFilter(1, 9, 0.1, "distinct")
    )
    assert found.pixels.tolist() == [1]
    assert found.x_px.tolist() == [1.0]
