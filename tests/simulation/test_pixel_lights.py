"""Images of lights on the pixels: where events are, what adds up, what is handed over when a light goes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph_services.event_source.simulation.contract import BACKGROUND, Floats, PixelEvents
from heliograph_services.event_source.simulation.pixel.array import PixelArray
from support.pixel_scenes import Lamp, flat_view, joined, moving, numbers, run, shares, still_lamp

BACK = 0.05


def counts(events: PixelEvents, size: int = 48) -> Floats:
    return np.bincount(events.pixel, minlength=size * size).astype(np.float64)


@given(x=st.floats(20.0, 28.0), y=st.floats(20.0, 28.0), sigma=st.floats(0.5, 2.5), contrast=st.floats(3.0, 1000.0))
def test_the_centroid_of_an_on_edge_lies_within_a_tenth_of_a_pixel_of_the_light(
    x: float, y: float, sigma: float, contrast: float
) -> None:
    """At ideal thresholds, weighted by what each pixel's events say of its light: (exp(n th) - 1) about the middle."""
    view = flat_view(BACK)
    flux = contrast * BACK / shares(24.0, 24.0, sigma).max()
    lamp = still_lamp(x, y, flux, sigma=sigma, edges=[(1000.0, 1.0)])
    # The thresholds are fine: with coarse ones a spot of three pixels says less of its place than a tenth.
    law = numbers(threshold_on=0.05, tau_ref_us=0.0)
    n = counts(run(PixelArray(law, 48, 48, 1, view), view, 4000, [lamp])).reshape(48, 48)
    weight = np.expm1(0.05 * (n + 0.5)) * (n > 0)
    j, i = np.indices(n.shape)
    assert abs((weight * i).sum() / weight.sum() - x) < 0.1
    assert abs((weight * j).sum() / weight.sum() - y) < 0.1


@pytest.mark.parametrize("place", [(20.0, 20.0), (20.5, 20.25), (21.3, 19.7), (20.7, 20.49)])
def test_the_plain_centroid_of_events_with_mismatch_is_as_near_over_many_edges(place: tuple[float, float]) -> None:
    view = flat_view(BACK)
    edges = [(500.0 * k, float(k % 2)) for k in range(1, 39)]
    off = []
    for seed in range(20):
        lamp = still_lamp(*place, 40 * BACK / shares(24.0, 24.0, 1.5).max(), sigma=1.5, edges=edges)
        law = numbers(threshold_sd=0.03, tau_ref_us=0.5)
        events = run(PixelArray(law, 48, 48, seed, view), view, 20_000, [lamp])
        pixel = events.pixel[events.on]
        off.append((np.mean(pixel % 48) - place[0], np.mean(pixel // 48) - place[1]))
    assert np.abs(np.mean(off, axis=0)).max() < 0.1
    assert np.abs(off).max() < 0.3


def test_lights_in_one_pixel_add_up() -> None:
    view = flat_view(BACK)
    share = shares(20.0, 20.0, 0.7)[20, 20]
    two = [
        still_lamp(20.0, 20.0, BACK / share, edges=[(1000.0, 1.0)]),
        still_lamp(20.0, 20.0, 2 * BACK / share, level0=1.0),
    ]
    events = run(PixelArray(numbers(threshold_on=0.01, tau_ref_us=0.0), 48, 48, 1, view), view, 4000, two)
    # From 3 to 4 times the background: not from 1 to 2.
    assert (events.pixel == 20 * 48 + 20).sum() == math.floor(math.log(4 / 3) / 0.01)
    assert set(events.cause) == {0}


def test_lights_that_were_always_lit_make_no_events_until_they_change() -> None:
    view = flat_view(BACK)
    lamps = [still_lamp(20.0, 20.0, 5.0, level0=1.0), still_lamp(21.0, 20.0, 5.0, level0=1.0, edges=[(9000.0, 0.0)])]
    events = run(PixelArray(numbers(tau_ref_us=1.0), 48, 48, 1, view), view, 20_000, lamps)
    assert len(events) > 20
    assert events.t_us.min() > 9000.0
    assert set(events.cause) == {1}


def test_a_stream_that_begins_later_finds_the_lights_as_they_are_by_then() -> None:
    view = flat_view(BACK)
    lamp = still_lamp(20.0, 20.0, 5.0, edges=[(41_000.0, 1.0), (47_000.0, 0.0)])
    events = run(PixelArray(numbers(tau_ref_us=1.0), 48, 48, 1, view), view, 60_000, [lamp], t0_us=44_000)
    assert not events.on.any()
    assert events.t_us.min() > 47_000.0


def test_a_pixel_that_a_light_has_left_goes_on_as_if_it_had_stayed_under_watch() -> None:
    """A view that moves after the light has gone gives the same events, whether a dark light is still there or not."""
    first = flat_view(BACK)
    ramps = moving(first, lambda t: first + np.float32(0.3 * min(t, 100_000) / 20_000))
    gone = Lamp(
        lambda t: np.full_like(t, 20.0), lambda t: np.full_like(t, 20.0),
        flux=lambda t: np.where(t <= 30_000, 5.0, 0.0), edges=[(1000.0, 1.0), (3000.0, 0.0)],
    )  # fmt: skip
    law = numbers(threshold_sd=0.03, tau_ref_us=20.0)
    results = [
        run(PixelArray(law, 48, 48, 1, first), ramps, 120_000, [lamp], 4000)
        for lamp in (gone, still_lamp(20.0, 20.0, 5.0, edges=[(1000.0, 1.0), (3000.0, 0.0)]))
    ]
    for one, other in zip((results[0].t_us, results[0].pixel), (results[1].t_us, results[1].pixel), strict=True):
        assert np.array_equal(one, other)
    of_spot = results[0].pixel == 20 * 48 + 20
    assert (results[0].cause[of_spot & (results[0].t_us < 10_000)] == 0).all()
    assert (results[0].cause[of_spot & (results[0].t_us > 60_000)] == BACKGROUND).all()


def test_a_light_that_is_hidden_takes_its_light_with_it() -> None:
    view = flat_view(BACK)
    hidden = Lamp(
        lambda t: np.full_like(t, 20.0), lambda t: np.full_like(t, 20.0),
        flux=lambda t: np.where((t >= 5000) & (t < 12_000), 0.0, 3.0), level0=1.0,
    )  # fmt: skip
    events = run(PixelArray(numbers(tau_ref_us=0.5), 48, 48, 1, view), view, 20_000, [hidden])
    mine = events.pixel == 20 * 48 + 20
    steps = math.floor(math.log1p(3.0 * shares(20.0, 20.0, 0.7)[20, 20] / BACK) / 0.2)
    assert (~events.on[mine]).sum() == steps
    assert abs(int(events.on[mine].sum()) - steps) <= 1
    assert events.t_us[mine][~events.on[mine]].max() < 5100.0
    assert events.t_us[mine][events.on[mine]].min() > 11_000.0


@pytest.mark.parametrize("speed", [100.0, 1000.0, 11_000.0])
def test_a_moving_lit_light_leaves_as_many_off_events_as_on_events_and_sweeps_its_path(speed: float) -> None:
    """Each pixel of the path is lit and left: what rises falls, but for less than a threshold."""
    view = flat_view(BACK, 300, 24)
    until = int(260 / speed * 1e6)
    path = Lamp(lambda t: 20.0 + speed * 1e-6 * t, lambda t: np.full_like(t, 12.0), flux=lambda t: np.full_like(t, 2.0),
                level0=1.0)  # fmt: skip
    events = run(PixelArray(numbers(tau_ref_us=0.05, tau_min_us=1.0), 300, 24, 1, view), view, until, [path])
    steps = math.floor(math.log1p(2.0 * shares(12.0, 12.0, 0.7)[12, 12] / BACK) / 0.2)
    for x in range(40, 260, 20):
        mine = events.pixel == 12 * 300 + x
        on, off = int(events.on[mine].sum()), int((~events.on[mine]).sum())
        assert abs(on - steps) <= 1
        assert on - 1 <= off <= on
        middle = (x - 20.0) / speed * 1e6
        assert events.t_us[mine][events.on[mine]].max() <= middle + 1e6 / speed
        assert events.t_us[mine][~events.on[mine]].min() >= middle - 1e6 / speed


@pytest.mark.parametrize("speed", [0.0, 11_000.0])
def test_a_large_image_covers_what_it_must(speed: float) -> None:
    """FWHM 42 px: 16 mm at half a metre."""
    view = flat_view(BACK, 200, 200)
    lamp = Lamp(
        lambda t: 100.0 + speed * 1e-6 * t, lambda t: np.full_like(t, 100.0), sigma=42 / 2.355,
        flux=lambda t: np.full_like(t, 100.0), edges=[(1000.0, 1.0), (2000.0, 0.0)],
    )  # fmt: skip
    events = run(PixelArray(numbers(tau_ref_us=0.1), 200, 200, 1, view), view, 4000, [lamp])
    seen = counts(events, 200).reshape(200, 200)
    size = np.log1p(100.0 * shares(100.0 + speed * 1.0e-3, 100.0, 42 / 2.355, 200, 200) / BACK)
    assert (seen[size > 0.41] > 0).all()
    assert (seen[size < 0.1] == 0).all() or speed > 0
    if speed == 0.0:
        assert np.abs(seen - 2 * np.floor(size / 0.2))[size > 0.2].max() <= 1


def test_a_light_may_jump_leave_the_sensor_and_come_back() -> None:
    view = flat_view(BACK)
    lamp = Lamp(
        lambda t: np.select([t < 4000, t < 9000, t < 14_000], [10.0, 500.0, -300.0], 30.0),
        lambda t: np.full_like(t, 20.0), flux=lambda t: np.full_like(t, 3.0), level0=1.0,
    )  # fmt: skip
    events = run(PixelArray(numbers(tau_ref_us=0.5), 48, 48, 1, view), view, 40_000, [lamp])
    steps = math.floor(math.log1p(3.0 * shares(10.0, 20.0, 0.7)[20, 10] / BACK) / 0.2)
    left, come = events.pixel == 20 * 48 + 10, events.pixel == 20 * 48 + 30
    assert (~events.on[left & (events.t_us < 6000)]).sum() == steps
    assert events.on[come & (events.t_us > 13_000)].sum() >= steps - 1
    assert not ((events.t_us > 15_000) & left).any()
    assert joined([events]).t_us.max() < 20_000


def test_a_light_far_below_its_surroundings_claims_nothing_and_makes_nothing() -> None:
    view = flat_view(100.0)
    lamp = still_lamp(20.0, 20.0, 0.5, edges=[(100.0 * k, float(k % 2)) for k in range(1, 100)])
    pixels = PixelArray(numbers(), 48, 48, 1, view)
    assert len(run(pixels, view, 20_000, [lamp])) == 0
