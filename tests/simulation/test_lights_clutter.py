"""Clutter obeys the statistics that it names, and any time can be asked without what came before."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from heliograph.errors import ConfigError
from heliograph_services.event_source.simulation.contract import Drive
from heliograph_services.event_source.simulation.lights import drive_of
from heliograph_services.event_source.simulation.lights.clutter import LAMP_STEP, LAMP_STEP_LEAST
from heliograph_services.event_source.simulation.world.spec import (
    Bits,
    ClutterSpec,
    Glint,
    Lamp,
    Pwm,
    Signal,
    Steady,
    Still,
    Telegraph,
)

SIGNALS: dict[str, Signal] = {
    "bits": Bits(bit_rate=3_000.0),
    "slow bits": Bits(bit_rate=1.0),
    "telegraph": Telegraph(mean_on_s=0.003, mean_off_s=0.008),
    "slow telegraph": Telegraph(mean_on_s=30.0, mean_off_s=50.0),
    "pwm": Pwm(frequency_hz=1_234.5, duty=0.3),
    "fast pwm": Pwm(frequency_hz=50_000.0),
    "lamp": Lamp(frequency_hz=100.0, depth=0.5),
    "glint": Glint(rate_hz=40.0),
    "steady": Steady(),
}


def clutter(signal: Signal, seed: int = 0, index: int = 3) -> Drive:
    return drive_of(ClutterSpec(name="c", path=Still(at_m=(0.0, 0.0, 0.0)), signal=signal), seed, index)


@pytest.mark.parametrize("name", SIGNALS)
@given(st.lists(st.floats(0.0, 300_000.0), min_size=1, max_size=5))
@settings(max_examples=10, deadline=None)
def test_changes_and_levels_do_not_depend_on_how_time_is_cut(name: str, cuts: list[float]) -> None:
    signal = SIGNALS[name]
    bounds = [0.0, *sorted(cuts), 300_000.0]
    t_us, level = clutter(signal).changes(0.0, 300_000.0)
    parts = clutter(signal)
    asked = [parts.changes(a, b) for a, b in pairwise(bounds)]
    assert np.array_equal(np.concatenate([t for t, _ in asked]), t_us)
    assert np.array_equal(np.concatenate([lit for _, lit in asked]), level)
    assert (np.diff(t_us) >= 0).all()
    for cut in cuts:
        before = np.flatnonzero(t_us < cut)
        wanted = level[before[-1]] if len(before) else clutter(signal).level(0.0)
        assert clutter(signal).level(cut) == wanted
    assert clutter(signal).frames_ended(0.0, 300_000.0) == []


@pytest.mark.parametrize("name", ["bits", "telegraph", "pwm", "lamp", "glint"])
def test_lights_of_one_kind_are_out_of_step_and_repeat_with_their_seed(name: str) -> None:
    signal = SIGNALS[name]
    first = [clutter(signal, seed, index).changes(0.0, 1e6)[0][:3] for seed, index in ((1, 1), (1, 2), (2, 1), (1, 1))]
    assert np.array_equal(first[0], first[3])
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(first[0], first[2])


def test_random_bits_lie_on_their_clock_and_are_fair() -> None:
    t_us, _ = clutter(Bits(bit_rate=5_000.0)).changes(0.0, 1e7)
    steps = (t_us - t_us[0]) / 200.0
    assert np.abs(steps - np.rint(steps)).max() < 1e-6
    # Half of 50,000 bits differ from the one before.
    assert abs(len(t_us) - 25_000) < 5 * np.sqrt(12_500)
    runs = np.rint(np.diff(t_us) / 200.0)
    assert stats.chisquare([(runs == k).sum() for k in range(1, 8)], [len(runs) * 0.5**k for k in range(1, 8)],
                           sum_check=False).pvalue > 1e-3  # fmt: skip


@pytest.mark.parametrize(
    ("signal", "on_us", "off_us"),
    [
        (Telegraph(mean_on_s=0.003, mean_off_s=0.008), 3_000.0, 8_000.0),
        (Telegraph(mean_on_s=0.5, mean_off_s=0.001), 500_000.0, 1_000.0),
        (Glint(rate_hz=20.0, mean_us=1_500.0), 1_500.0, 50_000.0),
    ],
)
def test_telegraphs_and_glints_last_exponential_times_of_the_means_asked_for(
    signal: Signal, on_us: float, off_us: float
) -> None:
    t_us, level = clutter(signal, seed=8).changes(0.0, 2_000 * (on_us + off_us))
    assert (np.diff(level) != 0).all()
    lasted = np.diff(t_us)
    for lit, mean_us in ((1.0, on_us), (0.0, off_us)):
        times = lasted[level[:-1] == lit]
        assert len(times) > 1_800
        assert stats.kstest(times, "expon", args=(0.0, mean_us)).pvalue > 0.01
    # Without memory: how long one state lasts says nothing of the next.
    assert abs(stats.spearmanr(lasted[:-1], lasted[1:]).statistic) < 0.85
    on, off = lasted[level[:-1] == 1.0], lasted[level[:-1] == 0.0]
    n = min(len(on), len(off))
    assert abs(stats.spearmanr(on[:n], off[:n]).statistic) < 5 / np.sqrt(n)


def test_pwm_is_lit_for_its_share_of_each_period() -> None:
    t_us, level = clutter(Pwm(frequency_hz=240.0, duty=0.2)).changes(0.0, 1e6)
    on, off = t_us[level == 1.0], t_us[level == 0.0]
    assert np.diff(on) == pytest.approx(1e6 / 240.0)
    assert (off[off > on[0]][:200] - on[:200]) == pytest.approx(0.2 * 1e6 / 240.0)


@pytest.mark.parametrize("depth", [0.02, 0.3, 0.5, 1.0])
def test_a_lamp_is_its_sine_in_small_steps(depth: float) -> None:
    t_us, level = clutter(Lamp(frequency_hz=100.0, depth=depth)).changes(0.0, 100_000.0)
    before, after = level[:-1], level[1:]
    largest = np.maximum(LAMP_STEP * np.minimum(before, after), LAMP_STEP_LEAST)
    assert (np.abs(after - before) <= largest * (1 + 1e-9)).all()
    assert level.max() == 1.0
    assert level.min() == pytest.approx((1 - depth) / (1 + depth), abs=1e-12)
    # Where the stair is highest the sine has its top.
    period = t_us[: np.searchsorted(t_us, t_us[0] + 10_000.0)]
    peak_us = t_us[np.argmax(level)] + np.diff(t_us)[np.argmax(level)] / 2
    assert len(period) >= 2
    sine = (1 + depth * np.cos(2 * np.pi * (t_us - peak_us) / 10_000.0)) / (1 + depth)
    # At a step the sine is in the middle of it.
    assert np.abs(sine[1:] - (before + after) / 2).max() < 1e-6


def test_a_lamp_without_depth_and_a_steady_light_never_change() -> None:
    for signal in (Lamp(depth=0.0), Steady()):
        assert len(clutter(signal).changes(0.0, 1e9)[0]) == 0
        assert clutter(signal).level(5e5) == 1.0


@pytest.mark.parametrize(
    "signal", [Telegraph(mean_on_s=1e-9, mean_off_s=1.0), Glint(rate_hz=1.0, mean_us=1e-3)], ids=["telegraph", "glint"]
)
def test_a_light_faster_than_anything_is_refused_in_one_line(signal: Signal) -> None:
    with pytest.raises(ConfigError, match=r"^clutter c: 1/mean on \+ 1/mean off must be at most 200000 Hz, not"):
        clutter(signal)


def test_a_day_away_costs_no_more_than_now() -> None:
    for signal in SIGNALS.values():
        t_us, _ = clutter(signal).changes(86_400e6, 86_400e6 + 20_000.0)
        assert len(t_us) < 3_000
