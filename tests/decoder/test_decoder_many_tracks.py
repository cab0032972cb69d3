"""What is done for many tracks at once is what would be done for each alone."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusals
from heliograph.events import EventBatch
from heliograph.messages import Tracks
from heliograph_services.decoder.centring import share
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.region_state import NEVER, RANK, REACH, SHARED, X, Y, gate_px, shown_px
from heliograph_services.decoder.regions import Doubt, Place, Regions, column
from heliograph_services.decoder.telling import SILENCE_US, telling_of

WIDTH, HEIGHT = 61, 45
Floats = npt.NDArray[np.float64]


def states_of(rng: np.random.Generator, n: int, width: int = WIDTH, height: int = HEIGHT) -> Floats:
    sure = Doubt(*rng.uniform(0.1, 2.0, 3))
    spots = rng.uniform((-5, -5, 0.5), (width + 5, height + 5, 9.0), (n, 3)).tolist()
    places = [Place(x_px, y_px, 0.0, 0.0, reach_px) for x_px, y_px, reach_px in spots]
    return np.stack([column(at, 3.0, sure) for at in places], axis=1)


def owner(states: Floats, x: int, y: int) -> int:
    """Return who hears a pixel, by the definition: a region that is read within its own radius, else the innermost."""
    best: tuple[int, float, int] | None = None
    for i in range(states.shape[1]):
        away = math.hypot(x - states[X, i], y - states[Y, i])
        inner = away / states[REACH, i]
        if away <= shown_px(states, i):
            key = (0 if states[RANK, i] and inner <= 1.0 else 1, inner, i)
            best = key if best is None else min(best, key)
    return -1 if best is None else best[2]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 90))
def test_a_square_that_is_painted_late_shows_what_the_whole_image_would(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    made = Regions(WIDTH, HEIGHT, 128, 1_000, 80.0, self_centring=False)
    for _ in range(3):
        states = states_of(rng, n)
        made.load(states, np.full(n, NEVER), made.now_us)
        made.rank(rng.random(n) < 0.3)
        for _ in range(2):
            # Some places only: what nobody has looked at stays as it is.
            x, y = rng.integers(0, WIDTH, 12).astype(np.uint16), rng.integers(0, HEIGHT, 12).astype(np.uint16)
            batch = EventBatch(np.full(12, made.now_us, np.int64), x, y, np.ones(12, np.bool_))
            now = made.states()
            # Looked up where they are in the middle of the window, which is a microsecond long.
            routed = made.follow(batch, 1, Refusals())
            heard = [int(routed.starts[i + 1] - routed.starts[i]) for i in range(n)]
            found = [owner(now, int(px), int(py)) for px, py in zip(x, y, strict=True)]
            assert heard == [found.count(i) for i in range(n)]


@pytest.mark.parametrize("seed", range(5))
def test_regions_share_as_each_pair_does_however_many_there_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 150
    states = states_of(rng, n, 640, 480)
    states[REACH] *= 3.0
    states[RANK] = rng.random(n) < 0.5
    centred_us = np.where(rng.random(n) < 0.4, 1_000_000, NEVER)
    expected = np.zeros(n)
    for i in range(n):
        for k in range(n):
            away = math.hypot(states[X, i] - states[X, k], states[Y, i] - states[Y, k])
            near = away < min(states[REACH, i] + states[REACH, k], gate_px(states, i) + gate_px(states, k))
            if i != k and near and centred_us[k] > 0 and states[RANK, k] >= states[RANK, i]:
                expected[i] = 1.0
    share(states, centred_us, n, 1_000_000)
    assert expected.any()
    assert (states[SHARED] == expected).all()


def message(rng: np.random.Generator, n: int) -> Tracks:
    wide = [rng.normal(0.0, 10.0 ** rng.uniform(-2, 6), n).tolist() for _ in range(6)]
    variances = [(10.0 ** rng.uniform(-3, 9, n)).tolist() for _ in range(5)]
    times = rng.integers(-3_000_000, 3_000_000, (2, n)).tolist()
    return Tracks(
        camera="cam0", as_of_us=100_000, period_us=100_000, track=[f"t{i}" for i in range(n)],
        born_us=times[0], seen_us=times[1], x_px=wide[0], y_px=wide[1], vx_px_s=wide[2], vy_px_s=wide[3],
        x_var_px2=variances[0], x_vx_cov_px2_s=wide[4], vx_var_px2_s2=variances[1],
        y_var_px2=variances[2], y_vy_cov_px2_s=wide[5], vy_var_px2_s2=variances[3],
        radius_px=variances[4], size_px=variances[4], polarity=[0.0] * n, status=["new"] * n,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(10))
def test_what_is_told_of_a_track_makes_a_sound_region_within_its_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    config = DecoderConfig(max_tracks=20)
    told, left_out = telling_of(message(rng, 40), {f"t{i}" for i in range(0, 40, 4)}, config)
    # All that is followed, and the first twenty of the others.
    assert left_out == 10
    assert told.names == [f"t{i}" for i in range(40) if i % 4 == 0 or i < 27]
    assert (told.places[REACH] <= config.region_max_px).all()
    assert ((told.unseen_us >= 0) & (told.unseen_us <= SILENCE_US)).all()
    assert (told.born_us <= 100_000).all()
    for row in range(len(told.names)):
        state = told.column(row)
        assert np.isfinite(state).all()
        assert told.doubt.xv[row] ** 2 <= told.doubt.xx[row] * told.doubt.vv[row] * (1 + 1e-12)
