"""Lights that go on and off at random, slowly against the bit clock, are no text beacons (`RunWorth`)."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from heliograph.link.modulations.uart import Uart
from heliograph.link.text_identity import WORTH_NEEDED, RunWorth
from heliograph.link.uart_layout import CHARACTERS, character_bits, word_table
from support.text_light import TextLight, hear, watch

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
        run.add(code, after_idle=True)
        bits = character_bits(code)
        n = np.zeros((2, 2))
        for a, b in pairwise(bits):
            n[a, b] += 1
        share = n / np.maximum(n.sum(1, keepdims=True), 1)
        surprise = -float((n * np.log(np.where(n > 0, share, 1.0))).sum())
        assert run.value == pytest.approx(min(math.log(8.0), surprise - 7 * math.log(2.0)))


def test_a_lamp_that_goes_on_and_off_at_random_is_no_text_beacon() -> None:
    """15 s of it, 12 bits on and 12 off on average, in quarters of a bit."""
    rng = np.random.default_rng(12)
    quarters = np.repeat(np.arange(1_300) % 2, rng.geometric(0.25 / 12, 1_300))[:60_000]
    receiver = Uart().receiver(1000.0)
    assert hear(receiver, watch(TextLight(events=20), quarters.tolist(), 4000.0, seed=12)) == []
    assert receiver.identity() is None
