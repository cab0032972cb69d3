"""A pixel's laws, each against its formula."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from heliograph.errors import ConfigError
from heliograph_services.event_source.simulation.contract import (
    HOT_PIXEL,
    LEAK,
    SHOT_NOISE,
    Floats,
    PixelEvents,
    View,
)
from heliograph_services.event_source.simulation.pixel.array import PixelArray
from support.pixel_scenes import flat_view, numbers, run, shares, still_lamp

BACK = 0.05
# What is said of times holds to 2^-14 us, in which they leave, and the resolution of the view's float32.
NEAR_US = 2e-3


def of_pixel(events: PixelEvents, x: int, y: int, width: int = 48) -> tuple[Floats, list[bool]]:
    mine = events.pixel == y * width + x
    return events.t_us[mine], list(events.on[mine])


def background(value: float = BACK) -> float:
    """Return the irradiance that a view of float32 stands for."""
    return math.exp(float(np.float32(math.log(value))))


def step_times(begin: float, size: float, threshold: float, tau: float) -> list[float]:
    """Return when the events of a step come: the k-th after tau ln(D / (D - k th))."""
    return [begin + tau * math.log(size / (size - k * threshold)) for k in range(1, math.floor(size / threshold) + 1)]


@pytest.mark.parametrize("flux", [0.5, 3.0, 100.0])
@pytest.mark.parametrize("threshold", [0.1, 0.23, 0.5])
def test_a_step_gives_floor_of_size_by_threshold_events_at_the_stated_times(flux: float, threshold: float) -> None:
    view = flat_view(BACK)
    lamp = still_lamp(20.3, 21.1, flux, edges=[(1234.5, 1.0), (15_000.0, 0.0)])
    law = numbers(threshold_on=threshold, threshold_off=threshold, tau_min_us=5.0, tau_ref_us=20.0)
    events = run(PixelArray(law, 48, 48, 1, view), view, 40_000, [lamp])
    seen = 0
    for (y, x), share in np.ndenumerate(shares(20.3, 21.1, 0.7)):
        bright, dark = background() + flux * share, background()
        size = math.log(bright / dark)
        if flux * share < 0.011 * dark or abs(size / threshold - round(size / threshold)) < 1e-4:
            continue
        on = step_times(1234.5, size, threshold, max(5.0, 20.0 / bright))
        # What the lit spot has reached by 15 ms it falls from; each step down ends on the grid of the references.
        left = size - len(on) * threshold
        off = [
            15_000.0 + max(5.0, 20.0 / dark) * math.log(size / (size - left - k * threshold))
            for k in range(1, math.floor((size - left) / threshold + 1e-9) + 1)
            if size - left - k * threshold > 1e-9
        ]
        t_us, polarity = of_pixel(events, x, y)
        assert polarity[: len(on)] == [True] * len(on)
        assert np.allclose(t_us[: len(on)], on, atol=NEAR_US, rtol=0)
        reached = [t for t in off if t < 39_000.0]
        assert np.allclose(t_us[len(on) : len(on) + len(reached)], reached, atol=NEAR_US, rtol=0)
        assert not any(polarity[len(on) :])
        seen += len(t_us)
    assert seen > 8


def test_at_equal_contrast_twice_the_light_halves_all_times_down_to_the_least_tau() -> None:
    """Predicted: tau = 100 us W/m2 / I, so tau is 40, 20, 10 us at 2.5, 5, 10 W/m2, then stays at 10."""
    firsts = []
    for brightness in (0.5, 1.0, 2.0, 4.0, 8.0):
        view = flat_view(brightness)
        lamp = still_lamp(20.0, 20.0, 4.0 * brightness / shares(20.0, 20.0, 0.7)[20, 20], edges=[(1000.0, 1.0)])
        t_us, _ = of_pixel(run(PixelArray(numbers(), 48, 48, 1, view), view, 4000, [lamp]), 20, 20)
        firsts.append(t_us - 1000.0)
    assert all(len(first) == math.floor(math.log(5.0) / 0.2) for first in firsts)
    assert np.allclose(firsts[0], 2 * firsts[1], rtol=1e-4)
    assert np.allclose(firsts[1], 2 * firsts[2], rtol=1e-4)
    assert np.allclose(firsts[2], firsts[3], rtol=1e-4)
    assert np.allclose(firsts[2], firsts[4], rtol=1e-4)


def test_thresholds_are_recovered_from_a_slow_ramp_with_the_stated_mean_and_deviation() -> None:
    first = flat_view(BACK, 64, 64)
    pixels = PixelArray(numbers(threshold_sd=0.03, threshold_off=0.3, tau_ref_us=0.0), 64, 64, 7, first)

    # ln I rises by 2 in 2 s, and falls again.
    def view(t: int) -> View:
        return first if t == 0 else first + np.float32(min(t, 4_000_000 - t) * 1e-6)

    events = run(pixels, view, 4_000_000, step_us=5000)
    for on, mean, begin in ((True, 0.2, 0), (False, 0.3, 2_000_000)):
        measured = np.full(64 * 64, np.nan)
        half = (events.on == on) & (events.t_us >= begin)
        for pixel in range(64 * 64):
            t_us = events.t_us[half & (events.pixel == pixel)]
            measured[pixel] = np.diff(t_us).mean() * 1e-6
        stated = pixels.thresholds()[0 if on else 1].reshape(-1)
        assert np.allclose(measured, stated, atol=2e-5)
        assert measured.mean() == pytest.approx(mean, abs=4 * 0.03 / 64)
        assert measured.std() == pytest.approx(0.03, rel=4 / math.sqrt(2 * 64 * 64))
        assert stats.kstest((measured - mean) / 0.03, "norm").pvalue > 0.001


def test_no_threshold_is_below_a_tenth_of_the_mean() -> None:
    on, off = PixelArray(numbers(threshold_sd=0.2), 48, 48, 7, flat_view(1.0)).thresholds()
    assert on.min() == pytest.approx(0.02)
    assert off.min() == pytest.approx(0.02)
    assert (on == on.min()).mean() == pytest.approx(stats.norm.cdf(-0.9), abs=0.04)


@pytest.mark.parametrize("rate_hz", [0.1, 5.0])
def test_shot_noise_comes_at_the_stated_rate_in_exponential_intervals_of_even_polarity(rate_hz: float) -> None:
    view = flat_view(BACK, 64, 64)
    seconds = 30 if rate_hz < 1 else 10
    events = run(PixelArray(numbers(shot_noise_hz=rate_hz), 64, 64, 3, view), view, seconds * 1_000_000, step_us=5000)
    assert (events.cause == SHOT_NOISE).all()
    expected = rate_hz * seconds * 64 * 64
    assert len(events) / expected == pytest.approx(1.0, abs=min(0.05, 5 / math.sqrt(expected)))
    assert events.on.mean() == pytest.approx(0.5, abs=5 / math.sqrt(expected))
    counts = np.bincount(events.pixel, minlength=64 * 64)
    assert stats.chi2.sf((counts - counts.mean()) ** 2 @ np.full(64 * 64, 1 / counts.mean()), 64 * 64 - 1) > 0.001
    # All pixels' intervals together, were each pixel's process complete: those of the union, and of single pixels.
    assert stats.kstest(np.diff(events.t_us), "expon", args=(0, 1e6 / (rate_hz * 64 * 64))).pvalue > 0.01
    if rate_hz > 1:
        for pixel in (0, 1777, 4095):
            mine = events.t_us[events.pixel == pixel]
            assert stats.kstest(np.diff(mine), "expon", args=(0, 1e6 / rate_hz)).pvalue > 0.01


def test_shot_noise_does_not_touch_the_reference() -> None:
    view = flat_view(BACK)
    lamp = still_lamp(20.0, 20.0, edges=[(1000.0, 1.0)])
    quiet = run(PixelArray(numbers(), 48, 48, 1, view), view, 20_000, [lamp])
    noisy = run(PixelArray(numbers(shot_noise_hz=1000.0), 48, 48, 1, view), view, 20_000, [lamp])
    of_light = noisy.cause == 0
    assert np.array_equal(noisy.t_us[of_light], quiet.t_us)
    assert (~of_light).sum() > 10_000


def test_hot_pixels_are_few_fixed_and_restless() -> None:
    view = flat_view(BACK, 200, 200)
    law = numbers(hot_pixels=0.01, hot_pixel_hz=1000.0)
    events = run(PixelArray(law, 200, 200, 5, view), view, 200_000)
    assert (events.cause == HOT_PIXEL).all()
    counts = np.bincount(events.pixel, minlength=40_000)
    assert (counts > 0).sum() == pytest.approx(400, abs=100)
    assert counts[counts > 0].mean() == pytest.approx(200, rel=0.02)
    other = run(PixelArray(law, 200, 200, 6, view), view, 200_000)
    assert set(np.unique(other.pixel)) != set(np.unique(events.pixel))


def test_leak_makes_the_stated_rate_of_on_events_in_constant_light() -> None:
    view = flat_view(BACK, 64, 64)
    events = run(PixelArray(numbers(leak_hz=5.0, threshold_sd=0.03), 64, 64, 3, view), view, 4_000_000, step_us=5000)
    assert events.on.all()
    assert (events.cause == LEAK).all()
    assert len(events) / (5.0 * 4 * 64 * 64) == pytest.approx(1.0, abs=0.01)
    # In a pixel they come regularly: a drift, not a noise; and the pixels do not come together.
    mine = np.diff(events.t_us[events.pixel == 77])
    assert mine.std() < 1e-3 * mine.mean()
    assert stats.kstest(events.t_us % 200_000, "uniform", args=(0, 200_000)).pvalue > 0.001


@pytest.mark.parametrize("refractory_us", [15.0, 100.0, 5000.0])
def test_after_an_event_the_reference_follows_for_the_refractory_time(refractory_us: float) -> None:
    view = flat_view(BACK)
    lamp = still_lamp(20.0, 20.0, 5.0, edges=[(1000.0, 1.0)])
    law = numbers(refractory_us=refractory_us, tau_ref_us=100.0)
    t_us, _ = of_pixel(run(PixelArray(law, 48, 48, 1, view), view, 20_000, [lamp]), 20, 20)
    light = background() + 5.0 * shares(20.0, 20.0, 0.7)[20, 20]
    size, tau = math.log(light / background()), max(10.0, 100.0 / light)
    expected, gone = [], 0.0
    # v(x) = D (1 - exp(-x / tau)): an event a threshold above where v was when the pixel came alive.
    while size * math.exp(-gone / tau) > 0.2:
        expected.append(-tau * math.log(math.exp(-gone / tau) - 0.2 / size))
        gone = expected[-1] + refractory_us
    assert np.allclose(t_us - 1000.0, expected, atol=NEAR_US)
    assert (np.diff(t_us) >= refractory_us).all()


def test_a_beacon_over_bright_ground_makes_fewer_events_for_there_is_one_reference_a_pixel() -> None:
    counts = []
    for ground in (0.01, 0.1, 1.0, 10.0):
        view = flat_view(ground)
        lamp = still_lamp(20.0, 20.0, 1.0, edges=[(1000.0 * k, float(k % 2)) for k in range(1, 19)])
        t_us, _ = of_pixel(run(PixelArray(numbers(tau_ref_us=0.0), 48, 48, 1, view), view, 20_000, [lamp]), 20, 20)
        counts.append(len(t_us))
    sizes = [math.log1p(shares(20.0, 20.0, 0.7)[20, 20] / ground) for ground in (0.01, 0.1, 1.0, 10.0)]
    # Up, and down again as far as a threshold reaches: between floor - 1 and floor.
    assert all(18 * (size // 0.2 - 1) <= count <= 18 * (size // 0.2) for size, count in zip(sizes, counts, strict=True))
    assert counts[0] > counts[1] > counts[2] > counts[3] == 0


def test_latency_its_excess_for_off_and_jitter_are_three_numbers() -> None:
    view = flat_view(BACK)
    lamp = still_lamp(24.0, 24.0, 500.0, sigma=12.0, edges=[(1000.0, 1.0), (10_000.0, 0.0)])
    plain = run(PixelArray(numbers(), 48, 48, 1, view), view, 60_000, [lamp])
    late = numbers(latency_us=80.0, latency_off_extra_us=30.0)
    events = run(PixelArray(late, 48, 48, 1, view), view, 60_000, [lamp])
    by_pixel, late_by_pixel = (np.lexsort((e.t_us, e.pixel)) for e in (plain, events))
    delay = events.t_us[late_by_pixel] - plain.t_us[by_pixel]
    assert np.allclose(delay, np.where(plain.on[by_pixel], 80.0, 110.0), atol=1e-3)

    shaken = run(PixelArray(numbers(latency_us=80.0, jitter_us=10.0), 48, 48, 1, view), view, 60_000, [lamp])
    # The first event of each pixel: later ones may be held back by those before them.
    first = [np.unique(e.pixel, return_index=True)[1] for e in (plain, shaken)]
    delay = shaken.t_us[first[1]] - plain.t_us[first[0]]
    n = len(delay)
    assert n > 1000
    assert delay.mean() == pytest.approx(80.0, abs=5 * 10 / math.sqrt(n) + 1.0)
    assert delay.std() == pytest.approx(10.0, rel=5 / math.sqrt(2 * n) + 0.02)


@given(seed=st.integers(0, 2**64 - 1), jitter_us=st.sampled_from([1.0, 20.0, 300.0]))
def test_no_event_leaves_before_its_crossing_and_those_of_a_pixel_keep_their_order(seed: int, jitter_us: float) -> None:
    view = flat_view(BACK, 16, 16)
    lamp = still_lamp(8.0, 8.0, 20.0, edges=[(1000.0, 1.0), (5000.0, 0.0), (9000.0, 1.0)])
    plain = run(PixelArray(numbers(), 16, 16, seed, view), view, 40_000, [lamp])
    shaken = run(PixelArray(numbers(jitter_us=jitter_us), 16, 16, seed, view), view, 40_000, [lamp])
    assert len(plain) == len(shaken)
    one, other = (np.lexsort((e.t_us, e.pixel)) for e in (plain, shaken))
    assert np.array_equal(plain.on[one], shaken.on[other])
    assert (shaken.t_us[other] >= plain.t_us[one]).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [("threshold_on", 0.0), ("tau_min_us", 0.0), ("jitter_us", -1.0), ("hot_pixels", 1.1), ("leak_hz", math.nan)],
)
def test_a_number_out_of_its_range_is_refused_by_its_name(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"pixel\.{name} must be in \[.*\], not"):
        PixelArray(numbers(**{name: value}), 4, 4, 0, flat_view(1.0, 4, 4))
