"""Text of beacons whose clock is off: found at the nominal rate, while good clocks are read as ever."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.link.modulations.uart import Uart
from heliograph.link.text_receiver import TextReceiver
from heliograph.link.uart_clock import ClockedTextReceiver
from support.text_light import TextLight, edits, hear, joined, watch_text

NOMINAL = 2000.0
TEXT = "The quick brown fox jumps over the lazy dog; 42 of them.\n" * 4


@pytest.mark.parametrize("percent", [-5.0, -2.0, 2.0, 5.0])
def test_text_is_read_though_the_clock_is_off(percent: float) -> None:
    seen = watch_text(TextLight(), TEXT, NOMINAL * (1.0 + 0.01 * percent), 3)
    receiver = Uart().receiver(NOMINAL)
    assert edits(TEXT, joined(hear(receiver, seen))) <= 3
    assert receiver.identity() is not None
    assert receiver.quality(int(seen.t_us[-1])).clock_ppm == pytest.approx(1e4 * percent, abs=1500.0)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 99), st.floats(-0.1, 0.1))
def test_a_good_clock_is_read_as_without_the_search(seed: int, percent: float) -> None:
    seen = watch_text(TextLight(), TEXT[:120], NOMINAL * (1.0 + 0.01 * percent), seed)
    assert hear(ClockedTextReceiver(NOMINAL), seen) == hear(TextReceiver(NOMINAL), seen)


@settings(max_examples=5, deadline=None)
@given(st.lists(st.integers(1_000_000, 1_500_000), max_size=6))
def test_nothing_depends_on_how_the_input_is_cut(cuts: list[int]) -> None:
    seen = watch_text(TextLight(), TEXT[:120], NOMINAL * 1.04, 5)
    assert hear(ClockedTextReceiver(NOMINAL), seen, sorted(cuts)) == hear(ClockedTextReceiver(NOMINAL), seen)


def test_silence_and_noise_keep_the_nominal_rate() -> None:
    rng = np.random.default_rng(1)
    receiver = ClockedTextReceiver(NOMINAL)
    t_us = np.sort(rng.integers(0, 2_000_000, 4000))
    assert receiver.feed(t_us, rng.random(4000) < 0.5, 2_000_000) == []
    assert receiver.feed(t_us[:0], np.empty(0, np.bool_), 9_000_000) == []
    assert receiver.identity() is None
    assert receiver.quality(9_000_000).bit_rate == pytest.approx(NOMINAL)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("scan_us", [198.6, 199.2, 201.0])
def test_text_is_read_at_its_own_rate_where_two_scans_are_nearly_a_bit(scan_us: float, seed: int) -> None:
    seen = watch_text(TextLight(scan_us=scan_us, tail_bits=0.01, jitter_bits=0.005), TEXT, 2500.0, seed)
    receiver = Uart().receiver(2500.0)
    assert edits(TEXT, joined(hear(receiver, seen))) <= 3
    assert receiver.quality(int(seen.t_us[-1])).clock_ppm == pytest.approx(0.0, abs=1500.0)


@pytest.mark.parametrize(("scan_us", "tail_bits"), [(199.0, 0.01), (199.2, 0.01), (199.2, 0.1)])
def test_response_and_clock_do_not_drift_together_behind_two_scans_a_bit(scan_us: float, tail_bits: float) -> None:
    # Offsets are a sawtooth of half a bit there. Held by the position alone, up to 96 of these characters were lost.
    letters = np.array(list("abcdefghijklmnopqrstuvwxyz ETAOIN"))
    text = "".join(np.random.default_rng(1).choice(letters, 1400))
    light = TextLight(events=300.0, scan_us=scan_us, tail_bits=tail_bits, jitter_bits=0.01)
    assert edits(text, joined(hear(Uart().receiver(2500.0), watch_text(light, text, 2500.0, 3)))) <= 2
