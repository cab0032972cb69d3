"""Only text is a text beacon, and how long it stays one."""

from __future__ import annotations

from math import log

import numpy as np
import pytest

from heliograph.errors import Refusal
from heliograph.link.contract import LinkFrame, Text
from heliograph.link.modulations.uart import Uart
from heliograph.link.text_identity import TextIdentity
from heliograph.link.uart_follow import Decision
from support.text_light import TextLight, Watched, hear, joined, watch, watch_text

TEXT = "Thou art more lovely and more temperate:\n"


def poisson(rate_hz: float, seconds: float, seed: int) -> Watched:
    rng = np.random.default_rng(seed)
    n = int(rng.poisson(rate_hz * seconds))
    t_us = np.sort(rng.integers(0, int(seconds * 1e6), n)).astype(np.int64)
    return Watched(t_us, rng.random(n) < 0.5, int(seconds * 1e6))


@pytest.mark.parametrize("bit_rate", [504.0, 3125.0])
@pytest.mark.parametrize("rate_hz", [1e3, 1e4, 1e5])
def test_noise_is_neither_text_nor_frames(rate_hz: float, bit_rate: float) -> None:
    receiver = Uart().receiver(bit_rate)
    assert hear(receiver, poisson(rate_hz, 3.0, seed=1)) == []
    assert receiver.identity() is None


@pytest.mark.parametrize("bit_rate", [504.0, 1400.0, 3125.0])
@pytest.mark.parametrize("lamp_hz", [100, 120])
def test_a_lamp_is_no_text_beacon(lamp_hz: int, bit_rate: float) -> None:
    square = watch(TextLight(events=50), [1, 0] * (5 * lamp_hz), 2.0 * lamp_hz, seed=lamp_hz)
    assert hear(Uart().receiver(bit_rate), square) == []


@pytest.mark.parametrize("seed", range(3))
def test_random_bits_at_the_right_rate_are_no_text_beacon(seed: int) -> None:
    bits = np.random.default_rng(seed).integers(0, 2, 10_000).tolist()
    receiver = Uart().receiver(3125.0)
    assert hear(receiver, watch(TextLight(), bits, 3125.0, seed)) == []
    assert receiver.refusals[Refusal.PARITY] + receiver.refusals[Refusal.STOP_BITS] > 0


@pytest.mark.parametrize(("events", "lit"), [(3.0, 0.5), (6.0, 0.5), (20.0, 0.7)])
def test_runs_of_random_bits_are_worth_no_more_than_chance_however_weak_the_light(
    events: float, lit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    worth: list[float] = []
    take = TextIdentity.take

    def note(self: TextIdentity, decision: Decision, end_us: int) -> list[LinkFrame | Text]:
        out = take(self, decision, end_us)
        worth.append(self.worth)
        return out

    monkeypatch.setattr(TextIdentity, "take", note)
    bits = (np.random.default_rng(7).random(60_000) < lit).astype(int).tolist()
    assert hear(Uart().receiver(1000.0), watch(TextLight(events=events), bits, 1000.0, seed=7)) == []
    # Of so many decisions one in e^x may exceed x nats.
    most = np.sort(worth)[::-1]
    assert len(worth) > 500
    assert most[0] < log(len(worth)) + 4.0


@pytest.mark.parametrize("word", ["11101010101", "11101010100"], ids=["even", "paper_text"])
def test_a_cyclic_code_at_the_same_rate_is_no_text_beacon(word: str) -> None:
    code = watch(TextLight(), [int(bit) for bit in word] * 300, 1000.0, seed=1)
    assert hear(Uart().receiver(1000.0), code) == []


def test_one_character_for_ever_is_periodic() -> None:
    receiver = Uart().receiver(1000.0)
    assert hear(receiver, watch_text(TextLight(), "W" * 300, 1000.0, seed=1)) == []
    assert receiver.refusals[Refusal.PERIODIC] > 100


def test_characters_are_held_back_until_the_track_is_a_text_beacon_and_then_released_at_once() -> None:
    out = hear(Uart().receiver(1000.0), watch_text(TextLight(), TEXT, 1000.0, seed=1))
    texts = [item for item in out if isinstance(item, Text)]
    first = texts[0].text or ""
    assert TEXT.startswith(first)
    assert 10 <= len(first) <= 13
    assert all(len(item.text or "") == 1 for item in texts[1:])


def test_nine_characters_are_not_enough() -> None:
    receiver = Uart().receiver(1000.0)
    assert hear(receiver, watch_text(TextLight(lead_bits=300), TEXT[:9], 1000.0, seed=1)) == []
    assert receiver.identity() is None


def test_the_identity_has_no_payload_and_says_since_when() -> None:
    seen = watch_text(TextLight(), TEXT, 1000.0, seed=1)
    receiver = Uart().receiver(1000.0)
    out = hear(receiver, seen)
    identity = receiver.identity()
    assert identity is not None
    assert identity.payload is None
    assert identity.since_us == next(item.t_us for item in out if isinstance(item, Text))
    assert identity.frames_used == len(TEXT)
    assert identity.confidence > 0.99


def test_a_lit_led_that_idles_keeps_its_identity_and_a_dark_one_loses_it() -> None:
    seen = watch_text(TextLight(), TEXT, 1000.0, seed=1)
    lit, dark = Uart().receiver(1000.0), Uart().receiver(1000.0)
    hear(lit, seen, flush=False)
    lit.feed(np.empty(0, np.int64), np.empty(0, np.bool_), seen.until_us + 5_000_000)
    assert lit.verdict(seen.until_us + 5_000_000) == "valid"
    off_us = seen.until_us + 10_000
    hear(dark, seen, flush=False)
    dark.feed(np.full(20, off_us, np.int64), np.zeros(20, np.bool_), off_us + 5_000_000)
    assert dark.verdict(off_us + 1_000_000) == "valid"
    assert dark.verdict(off_us + 5_000_000) == "invalid"


def test_text_that_turns_into_noise_is_given_up_and_text_after_it_is_read() -> None:
    text = watch_text(TextLight(), TEXT * 2, 1000.0, seed=1)
    noise = poisson(4e3, 2.0, seed=2)
    receiver = Uart().receiver(1000.0)
    hear(receiver, text, flush=False)
    assert receiver.identity() is not None
    until_us = text.until_us + noise.until_us
    receiver.feed(noise.t_us + text.until_us, noise.on, until_us)
    assert receiver.identity() is None
    again = watch_text(TextLight(), TEXT * 2, 1000.0, seed=3, t0_us=until_us)
    assert TEXT in joined(hear(receiver, again))


def test_a_track_that_says_nothing_is_new_and_then_invalid() -> None:
    receiver = Uart().receiver(1000.0)
    receiver.feed(np.arange(0, 50_000, 1000, dtype=np.int64), np.ones(50, np.bool_), 50_000)
    assert receiver.verdict(500_000) == "new"
    assert receiver.verdict(1_000_000) == "invalid"
