"""`ook_fast`: text at 3 to 60 kbit/s; wrong characters are withheld, and nobody is a text."""

from __future__ import annotations

import json
from difflib import SequenceMatcher
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph.link.checked_characters import CHARACTERS, nearest
from heliograph.link.modulations import MODULATIONS, modulation
from heliograph.link.modulations.ook_fast import COSET, WORD_BITS
from heliograph_services.cli.studies.asynchronous import AsyncPixels
from heliograph_services.cli.studies.strangers import SENTENCE, nobody, others, sent
from support.async_lights import read

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "ook_fast.json").read_text())
KIND = modulation("ook_fast")
TEXT = SENTENCE * 4
LIGHT = AsyncPixels(pixels=50, jitter_us=4.0, refractory_us=2.0, noise_hz=2e3, delay_off_us=2.0)


def longest_common(sent_text: str, text: str) -> int:
    return SequenceMatcher(None, sent_text, text, autojunk=False).find_longest_match().size


@pytest.mark.parametrize("vector", VECTORS["words"], ids=lambda v: repr(v["character"]))
def test_a_character_is_sent_as_worked_out_by_hand(vector: dict[str, Any]) -> None:
    assert "".join(map(str, KIND.encode(vector["character"]))) == vector["on_air"]
    plain = int(vector["on_air"], 2) ^ int(VECTORS["coset"], 2)
    assert f"{plain:016b}" == f"{ord(vector['character']):07b}{vector['check']}{vector['parity']}"
    assert nearest(16)[plain] == ord(vector["character"])


def test_every_character_has_four_edges_and_no_text_a_longer_run_than_14() -> None:
    words = ["".join(map(str, KIND.encode(chr(code)))) for code in range(CHARACTERS - 1)]
    assert min(sum(a != b for a, b in pairwise(word)) for word in words) >= 4
    runs = [max(len(run) for run in (a + b).replace("01", "0 1").replace("10", "1 0").split())
            for a, b in product(words, words)]  # fmt: skip
    assert max(runs) <= 14


def test_bits_across_two_characters_are_no_character_but_by_chance_half_way() -> None:
    words = np.array([int("".join(map(str, KIND.encode(chr(code)))), 2) for code in range(CHARACTERS - 1)])
    pairs = ((words[:, None] << WORD_BITS) | words[None, :]).ravel()
    for shift in range(1, WORD_BITS):
        across = (pairs >> (WORD_BITS - shift)) & 0xFFFF
        entry = nearest(16)[across ^ COSET]
        share = float(((entry >= 0) & (entry < 256)).mean())
        assert share == 0.0 or (shift == 8 and share < 1.2 / 512)


@pytest.mark.parametrize("bit_rate", [3_000.0, 10_000.0, 30_000.0, 60_000.0])
@pytest.mark.parametrize("ppm", [-5_000.0, 100.0])
def test_a_text_is_read_from_its_beginning(bit_rate: float, ppm: float) -> None:
    bits = (*KIND.encode(TEXT), *(0,) * 40)
    got = read(KIND.receiver(bit_rate), *sent(bits, bit_rate, LIGHT, 1, ppm=ppm))
    assert TEXT.endswith(got.text)
    assert len(got.text) >= len(TEXT) - 4  # the paths of the first bits have not met yet
    assert got.identity is not None
    assert got.identity.payload is None


def test_a_text_is_read_from_a_cold_start_within_it() -> None:
    t_us, on = sent(KIND.encode(TEXT), 60_000.0, LIGHT, 2)
    late = t_us > 20_000
    got = read(KIND.receiver(60_000.0), t_us[late], on[late])
    assert longest_common(TEXT, got.text) >= 140


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(1, 70_000), max_size=20))
def test_any_split_of_the_stream_gives_the_same_text(cuts: list[int]) -> None:
    light = AsyncPixels(pixels=9, jitter_us=5.0, refractory_us=10.0, noise_hz=2e4, loss=0.2, delay_off_us=3.0)
    t_us, on = sent(KIND.encode(TEXT), 60_000.0, light, 3)
    assert read(KIND.receiver(60_000.0), t_us, on, cuts) == read(KIND.receiver(60_000.0), t_us, on)


def test_wrong_characters_are_withheld_where_edges_are_dropped() -> None:
    text = SENTENCE * 20
    light = AsyncPixels(pixels=50, jitter_us=3.0, dropped_edges=0.02)
    receiver = KIND.receiver(60_000.0)
    got = read(receiver, *sent(KIND.encode(text), 60_000.0, light, 4))
    # By time: character i ends with the bit 16 (i + 1).
    places = [round((frame.t_us - 100) * 0.06 / WORD_BITS) - 1 for frame in got.frames]
    right = sum(ord(text[i]) == frame.payload for i, frame in zip(places, got.frames, strict=True))
    print(f"{len(text)} sent, {len(got.text)} told, {len(got.text) - right} of them wrong, {dict(receiver.refusals)}")
    assert len(got.text) == len(got.frames)
    assert right == len(got.frames)
    assert receiver.refusals[Refusal.UNKNOWN_WORD] > 0
    assert right > 0.6 * len(text)


def test_bits_smeared_over_their_neighbours_are_read() -> None:
    # .6 bit of jitter: the events themselves show no clock.
    bits = (*KIND.encode(SENTENCE * 20), *(0,) * 40)
    light = AsyncPixels(pixels=100, jitter_us=10.0, refractory_us=2.0)
    got = read(KIND.receiver(60_000.0), *sent(bits, 60_000.0, light, 9))
    assert longest_common(SENTENCE * 20, got.text) >= 0.9 * len(SENTENCE * 20)


@pytest.mark.parametrize("jitter_us", [1.0, 5.0])
def test_pixels_that_are_blind_for_longer_than_a_bit_are_read(jitter_us: float) -> None:
    bits = (*KIND.encode(TEXT), *(0,) * 40)
    light = AsyncPixels(pixels=50, jitter_us=jitter_us, refractory_us=20.0)
    got = read(KIND.receiver(60_000.0), *sent(bits, 60_000.0, light, 1))
    assert TEXT.endswith(got.text)
    assert len(got.text) >= len(TEXT) - 4


def test_an_idle_light_is_no_refusal_and_the_next_text_follows() -> None:
    bits = (*KIND.encode(TEXT), *(1,) * 400, *KIND.encode(TEXT), *(0,) * 40)
    receiver = KIND.receiver(60_000.0)
    got = read(receiver, *sent(bits, 60_000.0, LIGHT, 5))
    assert longest_common(TEXT, got.text) >= len(TEXT) - 4
    assert len(got.text) >= 2 * len(TEXT) - 8
    assert sum(receiver.refusals.values()) <= 4


def test_a_text_after_seconds_of_silence_is_read() -> None:
    t_us, on = sent(KIND.encode(TEXT), 60_000.0, LIGHT, 6)
    twice = np.concatenate([t_us, t_us + 5_000_017])
    got = read(KIND.receiver(60_000.0), twice, np.concatenate([on, on]))
    assert len(got.text) >= 2 * len(TEXT) - 8 - 16


@pytest.mark.parametrize("bit_rate", [5_000.0, 60_000.0])
def test_noise_lamps_and_blinkers_of_random_bits_say_nothing(bit_rate: float) -> None:
    for label, t_us, on in nobody(bit_rate, 30_000 / bit_rate, int(bit_rate)):
        got = read(KIND.receiver(bit_rate), t_us, on, window_us=50_000)
        assert (got.identity, got.text) == (None, ""), label


def test_no_light_of_another_protocol_says_anything() -> None:
    for label, t_us, on in others("ook_fast", MODULATIONS, 5_000.0, 0.5, 0):
        got = read(KIND.receiver(5_000.0), t_us, on, window_us=50_000)
        assert (got.identity, got.text) == (None, ""), label


def test_a_character_repeated_for_ever_is_no_text() -> None:
    got = read(KIND.receiver(60_000.0), *sent(KIND.encode("aab" * 300), 60_000.0, LIGHT, 7))
    assert (got.identity, got.text) == (None, "")


def test_the_quality_tells_clock_and_events() -> None:
    receiver = KIND.receiver(60_000.0)
    t_us, on = sent(KIND.encode(TEXT), 60_000.0, LIGHT, 8, ppm=2_000.0)
    read(receiver, t_us, on)
    receiver = KIND.receiver(60_000.0)
    receiver.feed(t_us, on, int(t_us[-1]))
    quality = receiver.quality(int(t_us[-1]))
    assert quality.clock_ppm == pytest.approx(2_000.0, abs=200.0)
    assert quality.events_per_transition == pytest.approx(50.0, rel=0.3)
    assert quality.mar_estimate == pytest.approx(1.0, abs=0.05)


def test_a_glare_and_times_that_run_backwards_are_survived() -> None:
    receiver = KIND.receiver(60_000.0)
    t_us = np.full(1_500_000, 1000, np.int64)
    receiver.feed(t_us, np.ones(len(t_us), np.bool_), 1_001)
    receiver.feed(t_us[:1], np.ones(1, np.bool_), 2_000)
    assert receiver.refusals[Refusal.NO_CLOCK] == 1
    assert receiver.refusals[Refusal.TIME_BACKWARDS] == 1
    assert receiver.feed(np.empty(0, np.int64), np.empty(0, np.bool_), 1 << 50) == []
    assert receiver.verdict(1 << 50) == "invalid"


def test_what_cannot_be_sent_or_received_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        KIND.encode("")
    with pytest.raises(ValueError, match="DEL"):
        KIND.encode("a\x7f")
    with pytest.raises(ValueError, match="'paper'"):
        KIND.receiver(60_000.0, "paper")
    with pytest.raises(ValueError, match="bit rate"):
        KIND.receiver(0.0)
