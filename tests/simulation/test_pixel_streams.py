"""The stream of the pixels' events: order, repetition, cuts, and what a caller may not do."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph_services.event_source.simulation.contract import PixelEvents, View
from heliograph_services.event_source.simulation.pixel.array import PixelArray
from support.pixel_scenes import Lamp, chunk_of, flat_view, joined, moving, numbers, run, still_lamp

REAL = {
    "threshold_sd": 0.03, "leak_hz": 2.0, "shot_noise_hz": 20.0, "hot_pixels": 0.01, "hot_pixel_hz": 300.0,
    "latency_us": 60.0, "latency_off_extra_us": 20.0, "jitter_us": 15.0, "tau_ref_us": 20.0,
}  # fmt: skip
LAMPS = [
    Lamp(
        lambda t: 20.0 + 15 * np.sin(t / 9000.0), lambda t: 20.0 + 12 * np.cos(t / 7000.0), sigma=1.0,
        flux=lambda t: np.where((t > 22_000) & (t < 30_000), 0.0, 2.0),
        edges=[(333.0 + 417.0 * k, float(k % 3 > 0)) for k in range(140)],
    ),
    still_lamp(25.0, 20.0, 4.0, edges=[(1000.0 * k, float(k % 2)) for k in range(60)]),
]  # fmt: skip


def textured(size: int = 48) -> View:
    return np.asarray(np.log(0.05) + 0.2 * np.random.default_rng(3).normal(size=(size, size)), np.float32)


def scene(
    seed: int, step_us: int = 4000, lamps: list[Lamp] = LAMPS, moves: bool = True, **changes: float
) -> PixelEvents:
    first = textured()

    def view(t: int) -> View:
        return np.asarray(np.roll(first, t // 4000, axis=1), np.float32)

    law = numbers(**{**REAL, **changes})
    views = moving(first, view) if moves else first
    return run(PixelArray(law, 48, 48, seed, first), views, 60_000, lamps, step_us)


def same(one: PixelEvents, other: PixelEvents) -> bool:
    pairs = zip(dataclasses.astuple(one), dataclasses.astuple(other), strict=True)
    return all(a.tobytes() == b.tobytes() for a, b in pairs)


def test_one_seed_gives_one_stream_to_the_byte_and_another_seed_another() -> None:
    assert same(scene(5), scene(5))
    assert not same(scene(5), scene(6))


@pytest.mark.parametrize("moves", [True, False])
def test_events_come_by_time_then_pixel_each_within_its_interval(moves: bool) -> None:
    first = textured()
    pixels = PixelArray(numbers(**REAL), 48, 48, 5, first)
    chunk = chunk_of(LAMPS, 0)
    now = first
    for t in range(0, 20_000, 2000):
        then = np.roll(now, 1, axis=1) if moves else now
        events = pixels.interval(t, t + 2000, now, then, chunk)
        assert len(events) > 0
        assert events.t_us[0] >= t
        assert events.t_us[-1] < t + 2000
        order = np.lexsort((events.pixel, events.t_us))
        assert np.array_equal(order, np.arange(len(events)))
        now = then


def test_where_nothing_but_time_passes_intervals_may_end_anywhere() -> None:
    """A line cut in two gives the same v but for rounding: so the events are the same, their times to a step of 61 ps.

    Events are only compared where jitter takes no part in their order.
    """
    coarse, fine = (scene(5, step, LAMPS[1:], moves=False, jitter_us=0.0) for step in (4000, 500))
    assert len(coarse) == len(fine)
    for one, other in zip(coarse.t_us, fine.t_us, strict=True):
        assert one == pytest.approx(other, abs=1e-3)
    for pixel in np.unique(coarse.pixel):
        mine = [e.on[e.pixel == pixel] for e in (coarse, fine)]
        assert np.array_equal(*mine)


@settings(max_examples=15)
@given(cuts=st.lists(st.integers(1, 199), max_size=12, unique=True))
def test_lights_over_a_still_view_do_not_mind_any_cut(cuts: list[int]) -> None:
    view = flat_view(0.05)
    whole = run(PixelArray(numbers(), 48, 48, 1, view), view, 20_000, LAMPS, 20_000)
    pixels, chunk = PixelArray(numbers(), 48, 48, 1, view), chunk_of(LAMPS, 0)
    ends = [0, *sorted(100 * cut for cut in cuts), 20_000]
    parts = joined(
        [pixels.interval(a, b, view, view, chunk) for a, b in pairwise(ends)]
    )  # fmt: skip
    # A cut adds a place on the way of a moving image: its line of u is a little finer there.
    assert abs(len(parts) - len(whole)) <= 3 + len(whole) // 200


def test_what_latency_moves_past_an_interval_s_end_comes_in_the_next() -> None:
    view = flat_view(0.05)
    lamp = still_lamp(20.0, 20.0, 5.0, edges=[(3990.0, 1.0)])
    law = numbers(latency_us=5000.0, tau_ref_us=1.0)
    pixels, chunk = PixelArray(law, 48, 48, 1, view), chunk_of([lamp], 0)
    parts = [pixels.interval(t, t + 4000, view, view, chunk) for t in (0, 4000, 8000)]
    assert [len(part) > 0 for part in parts] == [False, False, True]
    assert parts[2].t_us.min() > 8990.0


def test_views_of_other_kinds_of_arrays_give_the_same() -> None:
    first = textured()
    other = np.asfortranarray(first)
    frozen = first.copy()
    frozen.flags.writeable = False
    law = numbers(**REAL)
    streams = [run(PixelArray(law, 48, 48, 5, view), view, 20_000, LAMPS) for view in (first, other, frozen)]
    assert same(streams[0], streams[1])
    assert same(streams[0], streams[2])


def test_a_caller_s_mistakes_are_told() -> None:
    view = flat_view(0.05)
    pixels, chunk = PixelArray(numbers(), 48, 48, 1, view), chunk_of(LAMPS, 0)
    with pytest.raises(ValueError, match="must lie in"):
        pixels.interval(0, 20_001, view, view, chunk)
    with pytest.raises(ValueError, match="begin with the view"):
        pixels.interval(0, 1000, view.copy(), view, chunk)
    pixels.interval(0, 1000, view, view, chunk)
    with pytest.raises(ValueError, match="must begin at 1000"):
        pixels.interval(2000, 3000, view, view, chunk)
    pixels.interval(1000, 20_000, view, view, chunk)
    with pytest.raises(ValueError, match="must have 2 lights"):
        pixels.interval(20_000, 21_000, view, view, chunk_of(LAMPS[:1], 20_000))
    with pytest.raises(ValueError, match="of shape"):
        PixelArray(numbers(), 48, 40, 1, view)


def test_an_hour_later_the_pixels_still_obey() -> None:
    """Drift and time are large by then; times keep their steps of 61 ps."""
    view = flat_view(0.05)
    begin = 7_200_000_000
    lamp = still_lamp(20.0, 20.0, 5.0, edges=[(begin + 1000.0, 1.0)])
    law = numbers(leak_hz=5.0, tau_ref_us=20.0)
    events = run(PixelArray(law, 48, 48, 1, view), view, begin + 200_000, [lamp], t0_us=begin)
    early = run(
        PixelArray(law, 48, 48, 1, view), view, 200_000, [dataclasses.replace(lamp, edges=[(1000.0, 1.0)])]
    )  # fmt: skip
    assert len(events) == pytest.approx(len(early), abs=2)
    assert np.allclose(np.sort(events.t_us - begin)[:100], np.sort(early.t_us)[:100], atol=0.05)
