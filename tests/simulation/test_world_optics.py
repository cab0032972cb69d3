"""Projection and link budget: figures of the guide, worked by hand, and laws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from heliograph_services.event_source.simulation.world.optics import (
    FWHM_PER_SIGMA,
    Optics,
    contrast,
    lobe,
    peak_share,
)
from heliograph_services.event_source.simulation.world.projection import Projection, rotations
from heliograph_services.event_source.simulation.world.spec import Lens

WIDE = Optics(Lens(focal_mm=3.6, f_number=2.0), 9.0)
LONG = Optics(Lens(focal_mm=16.0, f_number=1.4), 9.0)
CAMERA = Projection(400.0, 640, 480)


def one(value: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array([value], np.float64)


def posed(
    yaw: float = 0.0, pitch: float = -90.0, roll: float = 0.0
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return rotations(np.radians([[yaw, pitch, roll]]))


def pixel(point: tuple[float, float, float], place: tuple[float, float, float], **angles: float) -> tuple[float, float]:
    x, y, _ = CAMERA.pixels(np.array([place]), posed(**angles), np.array([point]))
    return float(x[0]), float(y[0])


@pytest.mark.parametrize(
    ("optics", "distance_m", "fwhm_px", "within"),
    [
        (WIDE, 0.5, 9.6, 0.05),
        (WIDE, 5, 1.9, 0.05),
        (WIDE, 16, 1.7, 0.05),
        (LONG, 0.5, 42, 0.5),
        (LONG, 5, 4.5, 0.05),
        (LONG, 16, 2.1, 0.05),
    ],
)
def test_the_image_of_a_cluster_of_20_mm_has_the_published_width(
    optics: Optics, distance_m: float, fwhm_px: float, within: float
) -> None:
    sigma = optics.sigma_px(one(0.02), one(distance_m))[0]
    assert sigma * FWHM_PER_SIGMA == pytest.approx(fwhm_px, abs=within)


def test_the_flux_is_the_formula_worked_by_hand() -> None:
    # .4 W/sr at 5 m: .016 W/m2 on an aperture of 1.8 mm (2.545e-6 m2), .9 of it over (9 um)2.
    assert WIDE.flux_w_m2(one(0.4), one(5.0), one(5.0))[0] == pytest.approx(0.016 * 2.5447e-6 * 0.9 / 8.1e-11, rel=1e-4)


def test_the_background_is_the_formula_worked_by_hand() -> None:
    assert WIDE.background_w_m2(0.25, 100.0) == pytest.approx(0.25 * 100 * 0.9 / 16)
    assert WIDE.background_w_m2(0.25, 2.0) == pytest.approx(0.028, abs=2e-4)


def step_ratio(distance_m: float, diameter_m: float) -> float:
    """Light over background in the middle pixel."""
    flux = WIDE.flux_w_m2(one(0.4), one(distance_m), one(distance_m))[0]
    sigma = float(WIDE.sigma_px(one(diameter_m), one(distance_m))[0])
    return math.expm1(contrast(flux, sigma, WIDE.background_w_m2(0.25, 100.0)))


def test_twice_as_far_a_spot_is_four_times_fainter_against_the_ground() -> None:
    for distance_m in (5.0, 10.0, 20.0):
        assert step_ratio(distance_m, 0.002) / step_ratio(2 * distance_m, 0.002) == pytest.approx(4.0, rel=0.01)


def test_a_disc_that_covers_the_pixel_is_as_bright_from_twice_as_far() -> None:
    assert step_ratio(1.0, 1.0) / step_ratio(2.0, 1.0) == pytest.approx(1.0, rel=0.01)
    # In between: from 3 m a panel of 20 cm is a disc of 27 px still, from 100 m nearly a point.
    ratios = [step_ratio(d, 0.2) / step_ratio(2 * d, 0.2) for d in (1.0, 10.0, 30.0, 100.0)]
    assert ratios == sorted(ratios)
    assert 1.0 < ratios[0] < 1.1 < 3.5 < ratios[-1] < 4.0


def test_along_a_ray_off_the_axis_light_falls_with_the_square_of_the_distance_too() -> None:
    near, far = (WIDE.flux_w_m2(one(0.4), one(d), one(0.8 * d))[0] for d in (5.0, 10.0))
    assert near / far == pytest.approx(4.0)


def test_even_ground_and_even_light_keep_their_ratio_over_the_field() -> None:
    # A shining disc that lies on the ground covers fewer pixels in the corner, each as bright: flux / area is constant.
    depth = 5.0
    for cosine in (1.0, 0.9, 0.75):
        flux = WIDE.flux_w_m2(one(cosine), one(depth / cosine), one(depth))[0]  # Lambert: I falls with the cosine
        assert flux == pytest.approx(WIDE.flux_w_m2(one(1.0), one(depth), one(depth))[0])


def test_defocus_is_the_blur_disc_of_a_thin_lens() -> None:
    sharp, soft = (Optics(Lens(focal_mm=16.0, f_number=1.4, focus_m=focus), 9.0) for focus in (5.0, 10.0))
    at_5 = one(5.0)
    assert sharp.sigma_px(one(1e-6), at_5)[0] == pytest.approx(0.7, rel=1e-6)
    blur_m = (0.016 / 1.4) * 0.016 * 5.0 / (5.0 * (10.0 - 0.016))
    assert soft.sigma_px(one(1e-6), at_5)[0] == pytest.approx(math.hypot(0.7, blur_m / 9e-6 / 4))


def test_the_share_of_the_middle_pixel_is_the_integral_of_the_gaussian() -> None:
    n = 2000
    u = (np.arange(n) + 0.5) / n - 0.5
    for sigma in (0.3, 0.7, 2.0):
        density = np.exp(-(u**2) / (2 * sigma**2)) / (sigma * np.sqrt(2 * np.pi))
        assert peak_share(sigma) == pytest.approx(float(density.mean()) ** 2, rel=1e-6)


def test_a_lobe_is_half_at_its_half_angle_and_dark_behind() -> None:
    cosines = np.cos(np.radians([0.0, 30.0, 60.0, 91.0, 180.0]))
    np.testing.assert_allclose(lobe(cosines, np.full(5, 30.0))[[0, 1]], [1.0, 0.5])
    np.testing.assert_allclose(lobe(cosines, np.full(5, 60.0)), [1, np.cos(np.pi / 6), 0.5, 0, 0], atol=1e-12)
    np.testing.assert_array_equal(lobe(cosines, np.full(5, np.nan)), 1.0)


def test_a_nadir_camera_has_north_up_and_east_to_the_right() -> None:
    assert pixel((1.0, 0.0, 0.0), (0.0, 0.0, 5.0)) == pytest.approx((319.5 + 80, 239.5))
    assert pixel((0.0, 1.0, 0.0), (0.0, 0.0, 5.0)) == pytest.approx((319.5, 239.5 - 80))


def test_yaw_turns_clockwise_seen_from_above() -> None:
    # Up in the image is east now.
    assert pixel((1.0, 0.0, 0.0), (0.0, 0.0, 5.0), yaw=90.0) == pytest.approx((319.5, 239.5 - 80))


def test_pitch_lifts_the_axis() -> None:
    assert pixel((0.0, 10.0, 2.0), (0.0, 0.0, 2.0), pitch=0.0) == pytest.approx((319.5, 239.5))
    assert pixel((1.0, 10.0, 2.0), (0.0, 0.0, 2.0), pitch=0.0) == pytest.approx((319.5 + 40, 239.5))
    assert pixel((0.0, 10.0, 1.0), (0.0, 0.0, 2.0), pitch=0.0)[1] == pytest.approx(239.5 + 40)


def test_roll_turns_the_camera_clockwise_and_the_image_the_other_way() -> None:
    assert pixel((1.0, 0.0, 0.0), (0.0, 0.0, 5.0), roll=90.0) == pytest.approx((319.5, 239.5 - 80))
    x, y = pixel((1.0, 10.0, 2.0), (0.0, 0.0, 2.0), pitch=0.0, roll=90.0)
    assert (x, y) == pytest.approx((319.5, 239.5 - 40))


def test_rotations_are_rotations() -> None:
    r = rotations(np.random.default_rng(1).uniform(-3, 3, (50, 3)))
    np.testing.assert_allclose(r @ r.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(r), 1.0)


def test_the_homography_is_the_projection_of_the_plane() -> None:
    rng = np.random.default_rng(2)
    rotation = posed(yaw=35.0, pitch=-60.0, roll=8.0)
    position = np.array([[1.0, -2.0, 7.0]])
    for z_m in (0.0, 1.8):
        points = np.column_stack([rng.uniform(-2, 2, 20) + 3, rng.uniform(-2, 2, 20) + 2, np.full(20, z_m)])
        x, y, depth = CAMERA.pixels(position, rotation, points)
        plane = np.column_stack([points[:, :2], np.ones(20)])
        image = plane @ CAMERA.plane_homography(position[0], rotation[0], z_m).T
        np.testing.assert_allclose(image[:, :2] / image[:, 2:], np.column_stack([x, y]), atol=1e-9)
        np.testing.assert_allclose(image[:, 2], depth, atol=1e-9)


def test_the_bearing_of_a_camera_file_with_these_intrinsics_points_at_the_light() -> None:
    rotation = posed(yaw=35.0, pitch=-60.0, roll=8.0)
    position, point = np.array([[1.0, -2.0, 7.0]]), np.array([[4.0, 1.0, 0.5]])
    x, y, _ = CAMERA.pixels(position, rotation, point)
    ray = rotation[0] @ (point - position)[0]
    np.testing.assert_allclose(
        CAMERA.intrinsics.bearing(float(x[0]), float(y[0])), ray / np.linalg.norm(ray), atol=1e-12
    )
