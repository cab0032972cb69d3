"""Lights that go on and off at random, slowly against the bit clock, are no text beacons (`RunWorth`)."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from heliograph.link.modulations.uart import Uart
from heliograph.link.text_identity import WORTH_NEEDED, RunWorth
from heliograph.link.uart_layout import CHARACTERS, character_bits, word_table
from support.text_light import TextLight, Watched, hear, watch

# What a lamp of 12 ms on and 12 ms off on average was read as at 1000 bit/s, before a sensor of 199 us a scan.
FROM_A_LAMP = (
    "\x00`\x1f;\x01\x01\x07\x01\x0e\x01\x07\x00\x1f\x07\x00\x1f\x00\x07\rO\x01\x1f_`\x01\x07\r\x1f\x01?\x07",
    "\x01\x07\x0b\x01\x07\x01\x01\x1f=\x1f\x1f\x0f\x03\x00\x01\x07\r\x071\x00a",
    "\x1f\x07>\x1f\x07xa\x00\x01\x1f\x1f\x00\x1f7\r\x1f\x00\x00;\x00\x00\x0e\x1fE?\x1c\x1f/\x01t\x0e\x00\x00?\x01?~\x01`\x1f",
)


def worth_of(text: str, *, after_idle: bool) -> list[float]:
    """Return the worth of the run after each of its characters."""
    run, worth = RunWorth(), []
    for i, character in enumerate(text):
        run.add(ord(character), after_idle=after_idle or i == 0)
        worth.append(run.value)
    return worth


@pytest.mark.parametrize("text", FROM_A_LAMP)
def test_what_a_slow_lamp_was_read_as_is_worth_too_little(text: str) -> None:
    assert max(worth_of(text, after_idle=False)) < WORTH_NEEDED
    assert max(worth_of(text, after_idle=True)) < 1.0


def test_a_run_is_never_worth_more_than_among_random_bits_and_busy_text_hardly_less() -> None:
    text = "Thou art more lovely and more temperate:"
    worth = worth_of(text, after_idle=False)
    most = [math.log(8.0) + i * math.log(16.0) for i in range(len(text))]
    assert all(a <= b + 1e-9 for a, b in zip(worth, most, strict=True))
    assert worth[-1] > 0.85 * most[-1]
    assert worth[11] > WORTH_NEEDED


@pytest.mark.parametrize("flip", [0.02, 0.05, 0.08, 0.15, 0.3, 0.5])
def test_a_chain_of_bits_reaches_a_worth_as_seldom_as_it_must(flip: float) -> None:
    """Ville: after start bits for nothing, the chance that a run ever reaches e^w is at most e^-w; here w = ln 500.

    Three good characters after idle time were worth 512, and come with the chance .21^3 = 1 / 108 where bits flip with
    the chance .08.
    """
    good = {int(word): code for code, word in enumerate(word_table())}
    rng = np.random.default_rng(round(1000 * flip))
    runs, reached = 6_000, 0
    for _ in range(runs):
        run = RunWorth()
        for _ in range(20):
            bits = np.bitwise_xor.accumulate(np.concatenate([[0], rng.random(10) < flip]).astype(np.int64))
            code = good.get(int("".join(map(str, bits.tolist())), 2))
            if code is None:
                break
            run.add(code, after_idle=True)
            if run.value >= math.log(500.0):
                reached += 1
                break
    assert reached <= runs / 500 + 4 * math.sqrt(runs / 500)


def test_the_steps_of_a_character_are_those_of_its_bits() -> None:
    for code in range(CHARACTERS):
        run = RunWorth()
        run.add(code, after_idle=False)
        bits = character_bits(code)
        n = np.zeros((2, 2))
        for a, b in pairwise(bits):
            n[a, b] += 1
        share = n / np.maximum(n.sum(1, keepdims=True), 1)
        surprise = -float((n * np.log(np.where(n > 0, share, 1.0))).sum())
        assert run.value == pytest.approx(min(math.log(16.0), surprise - 6 * math.log(2.0)))


def test_a_lamp_that_goes_on_and_off_at_random_is_no_text_beacon() -> None:
    """15 s of it, 12 bits on and 12 off on average, in quarters of a bit."""
    rng = np.random.default_rng(12)
    quarters = np.repeat(np.arange(1_300) % 2, rng.geometric(0.25 / 12, 1_300))[:60_000]
    receiver = Uart().receiver(1000.0)
    assert hear(receiver, watch(TextLight(events=20), quarters.tolist(), 4000.0, seed=12)) == []
    assert receiver.identity() is None


def test_an_offset_costs_what_makes_it_unlikelier_than_anywhere_in_reach() -> None:
    worth = []
    for offset in (0.0, 2.3, 3.0, -6.0):
        run = RunWorth()
        run.add(ord("U"), after_idle=False, offset=offset)
        worth.append(run.most)
    free = math.log(16.0)
    anywhere = math.log(13.0 / 1.5 / math.sqrt(2.0 * math.pi))
    assert worth == pytest.approx([free, free, free + anywhere - 2.0, free + anywhere - 8.0])


def test_after_idle_time_offsets_cost_nothing_and_characters_are_worth_little() -> None:
    run = RunWorth()
    for code in (ord("U"), ord("%")):
        run.add(code, after_idle=True, offset=5.0)
    assert run.most == pytest.approx(math.log(4.0))


@pytest.mark.parametrize("hz", [100, 120])
@pytest.mark.parametrize("rate_hz", [2_000, 5_000])
def test_the_flicker_of_the_mains_is_no_text(hz: int, rate_hz: int) -> None:
    """It had been: sgN_1 over and over, five characters to a turn of the phase."""
    rng = np.random.default_rng(12)
    at = rng.uniform(0.0, 8.0, 20 * rate_hz)
    slope = np.cos(2 * np.pi * hz * at)
    kept = rng.random(len(at)) < np.abs(slope)
    order = np.argsort(at[kept])
    t_us = (at[kept][order] * 1e6).astype(np.int64)
    receiver = Uart().receiver(504.0)
    assert hear(receiver, Watched(t_us, slope[kept][order] > 0, 8_000_000)) == []
    assert receiver.identity() is None


def test_random_bits_at_another_rate_are_no_text() -> None:
    """Bits of 1.3 bits, and a tail: half of what is looked for in them looks like a character, and none is on time."""
    rng = np.random.default_rng(11)
    levels = rng.integers(0, 2, 31_000)
    edges = np.flatnonzero(np.diff(levels))
    count = rng.poisson(15, len(edges))
    t = np.repeat(edges * 130.0, count) + rng.exponential(30.0, int(count.sum()))
    on = np.repeat(levels[edges + 1] > 0, count)
    order = np.argsort(t, kind="stable")
    receiver = Uart().receiver(10_000.0)
    assert hear(receiver, Watched(t[order].astype(np.int64), on[order], 4_000_000)) == []
