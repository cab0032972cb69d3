"""Regions against slow references, and how well they follow their targets by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusals
from heliograph.events import EventBatch
from heliograph_services.decoder.regions import Place, Regions, mixed
from heliograph_services.decoder.routing import NEVER, OMEGA_PER_S, TRIM, trimmed_mean
from support.blinkers import Disc, Path, scene, straight

WIDTH, HEIGHT = 160, 120
STEP_US, WINDOW_US = 1_000, 5_000


def regions(places: list[Place], now_us: int = 0) -> Regions:
    made = Regions(WIDTH, HEIGHT, 32, STEP_US, 80.0)
    made.load(places, [NEVER] * len(places), now_us)
    return made


def owners(x: npt.NDArray[np.uint16], y: npt.NDArray[np.uint16], places: list[Place]) -> list[int]:
    """Return the index of the nearest region's track a pixel, -1 for none: the definition, pixel by pixel."""
    found: list[int] = []
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        near = [(np.hypot(px - at.x_px, py - at.y_px), i) for i, at in enumerate(places)]
        inside = [(d, i) for d, i in near if d <= places[i].reach_px]
        found.append(min(inside)[1] if inside else -1)
    return found


place_of = st.builds(
    Place,
    st.floats(-20, WIDTH + 20),
    st.floats(-20, HEIGHT + 20),
    st.just(0.0),
    st.just(0.0),
    st.floats(0.5, 15),
)


@settings(max_examples=40)
@given(st.lists(st.lists(place_of, max_size=6), min_size=1, max_size=3), st.integers(0, 2**32 - 1))
def test_each_event_goes_to_the_nearest_region_that_holds_it(layouts: list[list[Place]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 400
    made = regions([])
    for k, places in enumerate(layouts):  # one after another: what was painted before must be gone
        made.load(places, [NEVER] * len(places), k * WINDOW_US)
        batch = EventBatch(
            np.sort(rng.integers(made.now_us, made.now_us + WINDOW_US, n, dtype=np.int64)),
            rng.integers(0, WIDTH, n, dtype=np.uint16),
            rng.integers(0, HEIGHT, n, dtype=np.uint16),
            rng.random(n) < 0.5,
        )
        routed = made.route(batch, WINDOW_US, Refusals())
        expected = owners(batch.x_px, batch.y_px, places)
        assert routed.outside == expected.count(-1)
        for i in range(len(places)):
            mine = [j for j, owner in enumerate(expected) if owner == i]
            t_us, on = routed.of(i)
            assert t_us.tolist() == batch.t_us[mine].tolist()
            assert on.tolist() == batch.on[mine].tolist()


def test_a_region_moves_within_a_window() -> None:
    # 2000 px/s: 10 px in a window, twice the reach.
    made = regions([Place(50.0, 60.0, 2_000.0, 0.0, 3.0)])
    t_us = np.arange(0, WINDOW_US, 100, dtype=np.int64)
    x_px = np.round(50.0 + 2e-3 * t_us).astype(np.uint16)
    batch = EventBatch(t_us, x_px, np.full(len(t_us), 60, np.uint16), np.ones(len(t_us), np.bool_))
    assert made.route(batch, WINDOW_US, Refusals()).outside == 0


@given(
    st.lists(st.floats(-9, 9, width=32), min_size=1, max_size=200),
)
def test_the_trimmed_mean_is_that_of_the_sorted_values(values: list[float]) -> None:
    array = np.array(values, np.float32)
    # Each value counts as the middle of its quarter pixel; a fractional count is cut from both ends.
    binned = np.sort((np.floor(array * 4) + 0.5) / 4)
    cut = TRIM * len(binned)
    weight = np.clip(
        np.minimum(np.arange(1, len(binned) + 1), len(binned) - cut) - np.maximum(np.arange(len(binned)), cut), 0, 1
    )
    expected = float(np.sum(binned * weight) / np.sum(weight))
    assert trimmed_mean(array, 9.0, np.zeros(200, np.int64)) == pytest.approx(expected, abs=1e-9)


def column(x_px: int, rows: int, t0_us: int, times: int) -> EventBatch:
    """Return events of `rows` pixels in one column, each firing `times` times."""
    n = rows * times
    y_px = np.repeat(np.arange(60 - rows // 2, 60 - rows // 2 + rows, dtype=np.uint16), times)
    return EventBatch(np.arange(n, dtype=np.int64) + t0_us, np.full(n, x_px, np.uint16), y_px, np.ones(n, np.bool_))


@pytest.mark.parametrize("times", [2, 50])
def test_a_correction_follows_the_filters_equation_and_a_pixel_counts_twice_at_most(times: int) -> None:
    made = regions([Place(50.0, 60.0, 0.0, 0.0, 8.0)])
    made.follow(made.route(column(52, 5, 0, times), WINDOW_US, Refusals()), WINDOW_US)
    # The residual of 2 px falls into the bin whose middle is 2.125 px; 10 events count of however many.
    theta, correction = np.exp(-OMEGA_PER_S * 5e-3), 10 / 16 * 2.125
    at = made.place(0)
    assert at.x_px == pytest.approx(50 + (1 - theta**2) * correction)
    assert at.vx_px_s == pytest.approx((1 - theta) ** 2 * correction / 5e-3)
    assert made.centred_us(0) == WINDOW_US


def follow(
    path: Path, start: Place, end_us: int, noise_hz: float = 0.0, hot: tuple[int, int] | None = None, seed: int = 1
) -> tuple[float, float, float]:
    """Let one region follow a blinking disc without a tracker.

    Returns:
        The share of the disc's events that it heard, its rms error and its largest error after the first 100 ms, in px.
    """
    disc = Disc(5, path)
    clean = scene([disc], 0, end_us, WIDTH * 8, HEIGHT * 8, 0.0, seed)
    batch = scene([disc], 0, end_us, WIDTH * 8, HEIGHT * 8, noise_hz, seed)
    if hot is not None:
        extra = np.arange(0, end_us, 500, dtype=np.int64)
        merged_t = np.concatenate([batch.t_us, extra])
        order = np.argsort(merged_t, kind="stable")
        batch = EventBatch(
            merged_t[order],
            np.concatenate([batch.x_px, np.full(len(extra), hot[0], np.uint16)])[order],
            np.concatenate([batch.y_px, np.full(len(extra), hot[1], np.uint16)])[order],
            np.concatenate([batch.on, np.ones(len(extra), np.bool_)])[order],
        )
    made = Regions(WIDTH * 8, HEIGHT * 8, 4, STEP_US, 80.0)
    made.load([start], [NEVER], 0)
    heard = 0
    errors: list[float] = []
    for t0_us in range(0, end_us, WINDOW_US):
        first, behind = np.searchsorted(batch.t_us, [t0_us, t0_us + WINDOW_US])
        routed = made.route(batch.part(int(first), int(behind)), WINDOW_US, Refusals())
        heard += len(routed.t_us)
        made.follow(routed, WINDOW_US)
        x, y = path(np.array([made.now_us / 1e6]))
        errors.append(float(np.hypot(made.place(0).x_px - x[0], made.place(0).y_px - y[0])))
    late = np.array(errors[20:])
    return heard / len(clean), float(np.sqrt(np.mean(late**2))), float(late.max())


def test_five_per_cent_of_velocity_error_at_400_px_s_cost_no_event_in_two_seconds() -> None:
    start = Place(100.0, 300.0, 380.0, 0.0, 7.0)
    share, rms_px, worst_px = follow(straight(100, 300, 400, 0), start, 2_000_000)
    assert share > 0.999
    assert rms_px < 0.4
    assert worst_px < 1.5


@pytest.mark.parametrize("noise_hz", [0.0, 1e6])
def test_a_region_without_a_tracker_follows_a_curve_of_1000_px_s2_for_two_seconds(noise_hz: float) -> None:
    def curve(s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        # A circle of 160 px at 2.5 rad/s: 400 px/s, 1000 px/s2.
        return 600 + 160 * np.cos(2.5 * s), 450 + 160 * np.sin(2.5 * s)

    share, rms_px, worst_px = follow(curve, Place(760.0, 450.0, 0.0, 400.0, 7.0), 2_000_000, noise_hz)
    assert share > 0.995
    assert rms_px < 2.0
    assert worst_px < 3.5


def test_a_hot_pixel_in_the_region_does_not_hold_it_back() -> None:
    start = Place(300.0, 300.0, 20.0, 0.0, 7.0)
    _, _, worst_px = follow(straight(300, 300, 20, 0), start, 1_500_000, hot=(306, 303))
    assert worst_px < 1.5


def test_noise_alone_does_not_carry_a_region_away() -> None:
    dark = Disc(5, straight(0, 0, 0, 0), lit_us=(0, 0))
    batch = scene([dark], 0, 1_000_000, WIDTH, HEIGHT, 6e4, 3)
    made = regions([Place(80.0, 60.0, 0.0, 0.0, 7.0)])
    for t0_us in range(0, 1_000_000, WINDOW_US):
        first, behind = np.searchsorted(batch.t_us, [t0_us, t0_us + WINDOW_US])
        made.follow(made.route(batch.part(int(first), int(behind)), WINDOW_US, Refusals()), WINDOW_US)
    assert made.place(0).away_px(Place(80.0, 60.0, 0.0, 0.0, 7.0)) < 1.0


def test_what_is_told_counts_little_where_a_region_is_centred_and_all_where_it_is_blind() -> None:
    own = Place(50.0, 60.0, 100.0, 0.0, 7.0)
    told = Place(54.0, 60.0, 120.0, 0.0, 8.0)
    centred = mixed(own, 1_000_000, told, 1_000_000, read=False)
    assert centred.x_px == pytest.approx(50.2)
    assert centred.vx_px_s == pytest.approx(101.0)
    assert mixed(own, 950_000, told, 1_000_000, read=False).x_px == pytest.approx(52.0)
    assert mixed(own, NEVER, told, 1_000_000, read=False).x_px == pytest.approx(54.0)
    assert centred.reach_px == 8.0


def test_a_region_jumps_to_where_it_is_told_unless_it_reads_where_it_is() -> None:
    own = Place(50.0, 60.0, 0.0, 0.0, 7.0)
    far = replace(own, x_px=90.0)
    assert mixed(own, 1_000_000, far, 1_000_000, read=False).x_px == 90.0
    assert mixed(own, 1_000_000, far, 1_000_000, read=True).x_px == pytest.approx(52.0)


def test_one_pixel_is_never_re_centred() -> None:
    made = Regions(1, 1, 4, STEP_US, 80.0)
    made.load([Place(0.0, 0.0, 0.0, 0.0, 2.0)], [NEVER], 0)
    n = 500
    batch = EventBatch(
        np.arange(n, dtype=np.int64), np.zeros(n, np.uint16), np.zeros(n, np.uint16), np.ones(n, np.bool_)
    )
    routed = made.route(batch, WINDOW_US, Refusals())
    assert len(routed.of(0)[0]) == n
    made.follow(routed, WINDOW_US)
    assert made.place(0) == Place(0.0, 0.0, 0.0, 0.0, 2.0)
