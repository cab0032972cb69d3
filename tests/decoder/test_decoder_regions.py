"""Regions against slow references, and how well they follow their targets by themselves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusals
from heliograph.events import EventBatch
from heliograph_services.decoder.centring import BINS_PER_PX, ETA, Q_MIN, R_0, TRIM, correct, share, trimmed_mean
from heliograph_services.decoder.region_state import (
    CORE,
    GATE_MARGIN_PX,
    GATE_SHARE,
    NEVER,
    SHARED,
    TURN,
    VX,
    VY,
    Q,
    X,
    Y,
    carry,
)
from heliograph_services.decoder.regions import Doubt, Place, Regions, column
from heliograph_services.decoder.routing import CORE_OF, HEART_OF
from support.blinkers import Disc, Path, scene, straight

WIDTH, HEIGHT = 160, 120
STEP_US, WINDOW_US = 1_000, 5_000


SURE = Doubt(*np.array([0.01, 0.0, 100.0]))


def load(made: Regions, places: list[Place], now_us: int = 0, sure: Doubt = SURE) -> None:
    states = [column(at, 3.0, sure)[:, None] for at in places]
    made.load(np.concatenate([np.zeros((len(column(ORIGIN, 3.0, sure)), 0)), *states], axis=1), never(places), now_us)


def never(places: list[Place]) -> npt.NDArray[np.int64]:
    return np.full(len(places), NEVER)


ORIGIN = Place(0.0, 0.0, 0.0, 0.0, 7.0)


def regions(places: list[Place], sure: Doubt = SURE) -> Regions:
    made = Regions(WIDTH, HEIGHT, 32, STEP_US, 80.0)
    load(made, places, 0, sure)
    return made


def owners(x: npt.NDArray[np.uint16], y: npt.NDArray[np.uint16], places: list[Place]) -> list[int]:
    """Return the index of the nearest region's track a pixel, -1 for none: the definition, pixel by pixel."""
    found: list[int] = []
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        near = [(np.hypot(px - at.x_px, py - at.y_px) / at.reach_px, i) for i, at in enumerate(places)]
        inside = [(d, i) for d, i in near if d <= 1.0]
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
def test_each_event_goes_to_the_region_in_which_it_is_innermost(layouts: list[list[Place]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 400
    made = Regions(WIDTH, HEIGHT, 32, WINDOW_US, 80.0, self_centring=False)
    for k, places in enumerate(layouts):  # one after another: what was painted before must be gone
        load(made, places, k * WINDOW_US)
        batch = EventBatch(
            np.sort(rng.integers(made.now_us, made.now_us + WINDOW_US, n, dtype=np.int64)),
            rng.integers(0, WIDTH, n, dtype=np.uint16),
            rng.integers(0, HEIGHT, n, dtype=np.uint16),
            rng.random(n) < 0.5,
        )
        routed = made.follow(batch, WINDOW_US, Refusals())
        expected = owners(batch.x_px, batch.y_px, places)
        assert routed.outside == expected.count(-1)
        for i in range(len(places)):
            mine = [j for j, owner in enumerate(expected) if owner == i]
            t_us, on, _ = routed.of(i)
            assert t_us.tolist() == batch.t_us[mine].tolist()
            assert on.tolist() == batch.on[mine].tolist()


def test_a_region_moves_within_a_window() -> None:
    # 2000 px/s: 10 px in a window, twice the reach.
    made = regions([Place(50.0, 60.0, 2_000.0, 0.0, 3.0)])
    t_us = np.arange(0, WINDOW_US, 100, dtype=np.int64)
    x_px = np.round(50.0 + 2e-3 * t_us).astype(np.uint16)
    batch = EventBatch(t_us, x_px, np.full(len(t_us), 60, np.uint16), np.ones(len(t_us), np.bool_))
    assert made.follow(batch, WINDOW_US, Refusals()).outside == 0


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
    half = 10 * BINS_PER_PX
    counts = np.bincount(np.floor(array * BINS_PER_PX).astype(int) + half, minlength=2 * half).astype(np.int32)
    assert trimmed_mean(counts, len(array), half) == pytest.approx(expected, abs=1e-9)


def test_prediction_and_correction_are_those_of_filterpy() -> None:
    filterpy = pytest.importorskip("filterpy.kalman")
    rng = np.random.default_rng(3)
    state = column(Place(5.0, -3.0, 40.0, 7.0, 7.0), 3.0, Doubt(*np.array([2.0, 1.5, 400.0])))[:, None]
    x_filter, y_filter = (filterpy.KalmanFilter(dim_x=2, dim_z=1) for _ in range(2))
    for one, at in ((x_filter, (5.0, 40.0)), (y_filter, (-3.0, 7.0))):
        one.x, one.P = np.array([[at[0]], [at[1]]]), np.array([[2.0, 1.5], [1.5, 400.0]])
        one.H = np.array([[1.0, 0.0]])
    for _ in range(50):
        s, variance, z = rng.uniform(1e-3, 1e-2), rng.uniform(0.05, 0.2), rng.normal(0, 0.2, 2)
        q = state[Q, 0]
        carry(state, 1, s * 1e6)
        for one in (x_filter, y_filter):
            one.F = np.array([[1.0, s], [0.0, 1.0]])
            one.Q = q * np.array([[s**3 / 3, s**2 / 2], [s**2 / 2, s]])
            one.predict()
        surprise = (z @ z) / (2 * (state[6, 0] + variance))
        correct(state, 0, z[0], z[1], variance, s)
        x_filter.update(x_filter.x[0, 0] + z[0], R=variance)
        y_filter.update(y_filter.x[0, 0] + z[1], R=variance)
        assert surprise < 12.5  # beyond it a residual is cut short
        assert state[[0, 2], 0] == pytest.approx(x_filter.x[:, 0])
        assert state[[1, 3], 0] == pytest.approx(y_filter.x[:, 0])
        assert state[[6, 7, 8], 0] == pytest.approx(x_filter.P[[0, 0, 1], [0, 1, 1]])
        assert state[Q, 0] == pytest.approx(max(q * np.exp(ETA * (min(surprise, 9.0) - 1)), Q_MIN))


def test_a_region_that_hears_nothing_for_50_ms_is_carried_round_its_circle() -> None:
    speed, radius, noise_px = 1_000.0, 80.0, 0.1
    rng = np.random.default_rng(5)
    state = column(Place(0.0, -radius, speed, 0.0, 7.0), 3.0, Doubt(*np.array([0.1, 0.0, 400.0])))[:, None]
    for step in range(1, 201):
        angle = speed / radius * step * 1e-3
        carry(state, 1, 1_000.0)
        z = radius * np.array([np.sin(angle), -np.cos(angle)]) - state[[X, Y], 0] + rng.normal(0, noise_px, 2)
        correct(state, 0, z[0], z[1], noise_px**2, 1e-3)
    assert state[TURN, 0] == pytest.approx(speed / radius, rel=0.2)
    carry(state, 1, 50_000.0)
    angle = speed / radius * 0.25
    assert np.hypot(*(radius * np.array([np.sin(angle), -np.cos(angle)]) - state[[X, Y], 0])) < 5.0
    # Straight on it would be 15 px away.
    assert state[[VX, VY], 0] == pytest.approx([speed * np.cos(angle), speed * np.sin(angle)], abs=150.0)


@pytest.mark.parametrize(
    ("apart_px", "doubt_px2", "shared"),
    [(5.0, 0.01, True), (10.0, 0.01, False), (10.0, 1.0, True), (15.0, 100.0, False)],
    ids=["gates meet", "regions overlap beyond their gates", "doubtful regions' gates meet", "regions are apart"],
)
def test_regions_share_events_where_their_gates_meet(apart_px: float, doubt_px2: float, shared: bool) -> None:
    # Reach 7 px; gates of 1.5 * 1.5 + 0.5 px and three sigmas.
    sure = Doubt(*np.array([doubt_px2, 0.0, 100.0]))
    places = [Place(60.0 + k * apart_px, 50.0, 0.0, 0.0, 7.0) for k in range(2)]
    state = np.stack([column(at, 3.0, sure) for at in places], axis=1)
    share(state, np.zeros(2, np.int64), 2, 1_000)
    assert state[SHARED].tolist() == [shared, shared]


def column_of(x_px: int, rows: int, t0_us: int, times: int) -> EventBatch:
    """Return events of `rows` pixels in one column, each firing `times` times."""
    n = rows * times
    y_px = np.repeat(np.arange(60 - rows // 2, 60 - rows // 2 + rows, dtype=np.uint16), times)
    return EventBatch(np.arange(n, dtype=np.int64) + t0_us, np.full(n, x_px, np.uint16), y_px, np.ones(n, np.bool_))


@pytest.mark.parametrize("times", [2, 50])
def test_a_correction_follows_the_filters_equation_and_a_pixel_counts_twice_at_most(times: int) -> None:
    made = regions([Place(50.0, 60.0, 0.0, 0.0, 8.0)], Doubt(*np.array([0.5, 0.0, 0.0])))
    made.follow(column_of(52, 5, 0, times), STEP_US, Refusals())
    # The residual of 2 px falls into the bin whose middle is 2.125 px; 10 events count of however many.
    core_px = made.states()[CORE, 0]
    variance = 2.0 * (min(core_px**2 / 2, 3.0**2 / 4) + 1 / 12) / 10 + R_0
    assert made.place(0).x_px == pytest.approx(50 + 0.5 / (0.5 + variance) * 2.125, rel=1e-6)
    assert made.centred_us()[0] == STEP_US


def test_one_hot_pixel_is_no_measurement() -> None:
    made = regions([Place(50.0, 60.0, 0.0, 0.0, 8.0)])
    made.follow(column_of(54, 1, 0, 900), WINDOW_US, Refusals())
    assert made.place(0).x_px == 50.0
    assert made.centred_us()[0] == NEVER


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
    load(made, [start])
    heard = 0
    errors: list[float] = []
    for t0_us in range(0, end_us, WINDOW_US):
        first, behind = np.searchsorted(batch.t_us, [t0_us, t0_us + WINDOW_US])
        routed = made.follow(batch.part(int(first), int(behind)), WINDOW_US, Refusals())
        heard += len(routed.t_us)
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
        made.follow(batch.part(int(first), int(behind)), WINDOW_US, Refusals())
        made.measure()
    assert made.place(0).away_px(Place(80.0, 60.0, 0.0, 0.0, 7.0)) < 1.0


def test_one_pixel_is_never_re_centred() -> None:
    made = Regions(1, 1, 4, STEP_US, 80.0)
    load(made, [Place(0.0, 0.0, 0.0, 0.0, 2.0)])
    n = 500
    batch = EventBatch(
        np.arange(n, dtype=np.int64), np.zeros(n, np.uint16), np.zeros(n, np.uint16), np.ones(n, np.bool_)
    )
    assert len(made.follow(batch, WINDOW_US, Refusals()).of(0)[0]) == n
    assert made.place(0) == Place(0.0, 0.0, 0.0, 0.0, 2.0)


def test_the_core_follows_the_median_distance_of_the_events_whatever_is_told_of_the_radius() -> None:
    rng = np.random.default_rng(5)
    sigma_px, n = 3.0, 20_000
    for told_px in (0.5, 12.0):
        made = Regions(WIDTH, HEIGHT, 32, STEP_US, 80.0)
        made.load(column(Place(80.0, 60.0, 0.0, 0.0, 20.0), told_px, SURE)[:, None], np.full(1, NEVER), 0)
        x, y, depth = np.empty(0), np.empty(0), np.empty(0, np.uint8)
        for k in range(4):
            t_us = np.sort(rng.integers(0, WINDOW_US, n // 4)) + k * WINDOW_US
            x, y = (np.rint(rng.normal(middle, sigma_px, n // 4)) for middle in (80, 60))
            batch = EventBatch(t_us, x.astype(np.uint16), y.astype(np.uint16), rng.random(n // 4) < 0.5)
            _, _, depth = made.follow(batch, WINDOW_US, Refusals()).of(0)
        away = np.hypot(x - 80.0, y - 60.0)
        # Of a Gaussian's distances the median is sigma sqrt(2 ln 2); but that of those within the gate counts.
        median_px = sigma_px * np.sqrt(2 * np.log(2))
        for _ in range(100):
            median_px = np.median(away[away <= GATE_SHARE * median_px + GATE_MARGIN_PX])
        expected = float(np.mean(away <= median_px + 0.5))
        assert float(np.mean(depth >= CORE_OF)) == pytest.approx(expected, abs=0.05)


def test_ground_beside_a_dark_light_does_not_draw_its_region_away() -> None:
    # What a lamp of a pixel and a stone's edge 4 px beside it make under a flying camera: 5 events a ms while it is
    # lit, for 50 ms; 1 a ms from the stone, all the time, and for the 100 ms that it is dark.
    made = Regions(WIDTH, HEIGHT, 32, STEP_US, 80.0)
    load(made, [Place(50.0, 60.0, 0.0, 0.0, 6.0)])
    for t0_us in range(0, 150_000, WINDOW_US):
        lamp_us = np.arange(t0_us, t0_us + WINDOW_US, 200, dtype=np.int64) if t0_us < 50_000 else np.empty(0, np.int64)
        stone_us = np.arange(t0_us + 100, t0_us + WINDOW_US, 1_000, dtype=np.int64)
        k, j = np.arange(len(lamp_us)), np.arange(len(stone_us))
        t_us = np.concatenate([lamp_us, stone_us])
        order = np.argsort(t_us)
        x_px = np.concatenate([49 + k % 3, np.full(len(j), 54)])[order].astype(np.uint16)
        y_px = np.concatenate([59 + k // 3 % 3, 58 + j])[order].astype(np.uint16)
        made.follow(EventBatch(t_us[order], x_px, y_px, order % 2 == 0), WINDOW_US, Refusals())
    assert made.place(0).away_px(Place(50.0, 60.0, 0.0, 0.0, 6.0)) < 1.0


def test_of_a_point_of_light_the_nine_pixels_about_it_are_the_core() -> None:
    t_us = np.arange(0, WINDOW_US, 10, dtype=np.int64)
    on_it = np.resize([True, True, True, False], len(t_us))
    x_px = np.where(on_it, 50 + np.arange(len(t_us)) % 3 - 1, 54).astype(np.uint16)
    batch = EventBatch(t_us, x_px, np.full(len(t_us), 60, np.uint16), np.ones(len(t_us), np.bool_))
    made = Regions(WIDTH, HEIGHT, 32, STEP_US, 80.0, self_centring=False)
    load(made, [Place(50.0, 60.0, 0.0, 0.0, 5.0)])
    depth = np.empty(0, np.uint8)
    for k in range(3):
        later = EventBatch(batch.t_us + k * WINDOW_US, batch.x_px, batch.y_px, batch.on)
        _, _, depth = made.follow(later, WINDOW_US, Refusals()).of(0)
    assert (depth >= CORE_OF).tolist() == on_it.tolist()


def test_the_rim_of_a_lit_target_is_outside_its_heart_and_the_middle_inside() -> None:
    # A lit disc that moves makes its events along its rim.
    made = Regions(WIDTH, HEIGHT, 32, STEP_US, 80.0, self_centring=False)
    load(made, [Place(50.0, 60.0, 0.0, 0.0, 9.0)])
    t_us = np.arange(0, WINDOW_US, 10, dtype=np.int64)
    angle = np.arange(len(t_us)) * 2.4
    middle = np.arange(len(t_us)) % 10 == 0
    x, y = (np.where(middle, at, np.rint(at + 4.0 * turn(angle))) for at, turn in ((50, np.cos), (60, np.sin)))
    batch = EventBatch(t_us, x.astype(np.uint16), y.astype(np.uint16), np.cos(angle) > 0)
    _, _, depth = made.follow(batch, WINDOW_US, Refusals()).of(0)
    assert (depth == HEART_OF).tolist() == middle.tolist()
