"""`event_interval`: the gaps say the text; a lost rise costs one character."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph.link.contract import edges_of
from heliograph.link.interval_soft import SURE, IntervalLikelihood
from heliograph.link.modulations import MODULATIONS, modulation
from heliograph.link.modulations.event_interval import bits_of_symbol, gray, symbols_of
from heliograph_services.cli.studies.asynchronous import AsyncPixels
from heliograph_services.cli.studies.strangers import SENTENCE, nobody, others, sent
from support.async_lights import read

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "event_interval.json").read_text())
KIND = modulation("event_interval")
FASTEST = 100_000.0
TEXT = SENTENCE * 4
END = (1,)
LIGHT = AsyncPixels(pixels=50, jitter_us=4.0, refractory_us=5.0, noise_hz=2e3)


@pytest.mark.parametrize("vector", VECTORS["words"], ids=lambda v: repr(v["character"]))
def test_a_character_is_sent_as_worked_out_by_hand(vector: dict[str, Any]) -> None:
    kind = modulation("event_interval", guard=vector["guard"])
    assert "".join(map(str, kind.encode(vector["character"]))) == vector["on_air"]
    assert vector["on_air"] == "".join("1" + "0" * (gap - 1) for gap in vector["gaps"])


def test_symbols_are_gray_coded() -> None:
    assert {f"{bits:03b}": gray(bits) for bits in range(8)} == VECTORS["gray"]
    assert all(bits_of_symbol(gray(bits)) == bits for bits in range(8))
    assert all((bits_of_symbol(a) ^ bits_of_symbol(b)).bit_count() == 1 for a, b in pairwise(range(8)))


@pytest.mark.parametrize("bit_rate", [5_000.0, 30_000.0, FASTEST])
@pytest.mark.parametrize("ppm", [-10_000.0, 100.0])
def test_a_text_is_read_whole(bit_rate: float, ppm: float) -> None:
    light = AsyncPixels(pixels=50, jitter_us=min(4.0, 1e5 / bit_rate), refractory_us=5.0, noise_hz=100.0)
    got = read(KIND.receiver(bit_rate), *sent((*KIND.encode(TEXT), *END), bit_rate, light, 1, ppm=ppm))
    assert TEXT.endswith(got.text)
    assert len(got.text) >= len(TEXT) - 2  # the detector learns the size of a rise
    assert got.identity is not None
    assert got.identity.payload is None


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(1, 100_000), max_size=20))
def test_any_split_of_the_stream_gives_the_same_text(cuts: list[int]) -> None:
    light = AsyncPixels(pixels=20, jitter_us=5.0, refractory_us=20.0, noise_hz=5e3, loss=0.1, dropped_edges=0.01)
    t_us, on = sent((*KIND.encode(TEXT), *END), FASTEST, light, 2)
    assert read(KIND.receiver(FASTEST), t_us, on, cuts) == read(KIND.receiver(FASTEST), t_us, on)


def test_what_is_told_is_right_where_rises_are_dropped_and_made_up() -> None:
    text = SENTENCE * 20
    light = AsyncPixels(pixels=50, jitter_us=4.0, refractory_us=5.0, dropped_edges=0.02, noise_hz=1e4)
    bits = (*KIND.encode(text), *END)
    receiver = KIND.receiver(FASTEST)
    got = read(receiver, *sent(bits, FASTEST, light, 3))
    at_us, levels = edges_of(bits, 100.0, 10.0)
    ends_us = at_us[levels][6::6]  # each character's last gap ends with the rise of the next one's start
    places = [int(np.argmin(np.abs(ends_us - frame.t_us))) for frame in got.frames]
    right = sum(ord(text[i]) == frame.payload for i, frame in zip(places, got.frames, strict=True))
    print(f"{len(text)} sent, {len(got.frames)} told, {len(got.frames) - right} wrong, {dict(receiver.refusals)}")
    assert len(got.frames) - right <= 0.001 * len(text)
    assert right > 0.8 * len(text)


def test_a_gap_in_its_neighbours_place_withholds_the_character() -> None:
    gaps = [gap for character in TEXT for gap in (11, *_gaps(character))]
    gaps[6 * 40 + 3] += 1
    rises_us = np.cumsum([7, *gaps, 11]) * 10
    receiver = KIND.receiver(FASTEST)
    got = read(receiver, rises_us.astype(np.int64), np.ones(len(rises_us), np.bool_))
    assert got.text == TEXT[:40] + TEXT[41:]
    assert receiver.refusals == {Refusal.UNKNOWN_WORD: 1}


def test_a_gap_nearer_to_its_neighbour_by_a_hair_is_corrected() -> None:
    likelihood = IntervalLikelihood()
    rng = np.random.default_rng(4)
    for character in TEXT:
        likelihood.take([symbol + 0.2 * rng.standard_normal() for symbol in symbols_of(ord(character))])
    choice = likelihood.take(
        [symbol + off for symbol, off in zip(symbols_of(ord("k")), (0.1, 0, 0.55, 0, 0), strict=True)]
    )
    assert choice.code == ord("k")
    assert not choice.exact
    assert choice.margin > SURE


def test_a_light_that_is_a_text_beacon_no_more_says_nothing_more() -> None:
    rng = np.random.default_rng(5)
    told = 0
    for _ in range(20):
        # Gaps of the alphabet at random, with a start before every five: nothing but the words tells them from text.
        gaps = [gap for _ in range(200) for gap in (11, *rng.integers(3, 11, 5).tolist())]
        rises_us = np.cumsum([7, *(gap for character in TEXT for gap in (11, *_gaps(character))), *gaps, 11]) * 10
        times = (rises_us + rng.normal(0.0, 0.5, len(rises_us))).astype(np.int64)
        got = read(KIND.receiver(FASTEST), times, np.ones(len(times), np.bool_))
        assert got.text.startswith(TEXT)
        assert got.identity is None
        told += len(got.text) - len(TEXT)
    # One in 256 such words is a character's, and some ten pass before the identity is dropped.
    assert told <= 4


def test_what_is_likelier_no_character_than_one_is_refused_by_name() -> None:
    likelihood = IntervalLikelihood()
    text = [[float(symbol) for symbol in symbols_of(ord(character))] for character in TEXT]
    margins = [likelihood.take(gaps).margin for gaps in text]
    assert min(margins[5:]) > SURE
    for at, off in ((0, 1.0), (2, -1.0), (4, 2.5)):
        gaps = list(text[0])
        gaps[at] = (gaps[at] + off) % 8.0
        assert likelihood.take(gaps).margin < SURE
    choice = likelihood.take([0.0, 5.0, 2.0, 7.0, 1.0])
    assert choice.none
    assert choice.margin < 0.0


def test_a_rise_told_late_after_a_short_gap_is_learned() -> None:
    likelihood = IntervalLikelihood()
    rng = np.random.default_rng(3)
    late = np.array([0.3, 0.2, 0.1, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    margins = []
    for _ in range(4):
        for character in TEXT:
            symbols = (8, *symbols_of(ord(character)))
            gaps = [n + late[n] - late[b] + 0.1 * rng.standard_normal() for b, n in pairwise(symbols)]
            choice = likelihood.take(gaps)
            assert choice.code == ord(character)
            margins.append(choice.margin)
    assert np.mean(margins[-200:]) > np.mean(margins[20:100])


def _gaps(character: str) -> list[int]:
    bits = "".join(map(str, KIND.encode(character)))
    return [len(run) + 1 for run in bits.split("1")[2:]]


def test_a_pause_between_texts_costs_next_to_nothing() -> None:
    bits = (*KIND.encode(TEXT), 1, *(0,) * 500, *KIND.encode(TEXT), *END)
    receiver = KIND.receiver(FASTEST)
    got = read(receiver, *sent(bits, FASTEST, LIGHT, 4))
    # The detector learns the size of a rise twice; of noisy characters one in a hundred is withheld.
    assert len(got.text) >= 2 * len(TEXT) - 8
    assert sum(receiver.refusals.values()) <= 6


@pytest.mark.parametrize("bit_rate", [5_000.0, FASTEST])
def test_noise_lamps_and_blinkers_of_random_bits_say_nothing(bit_rate: float) -> None:
    for label, t_us, on in nobody(bit_rate, 30_000 / bit_rate, int(bit_rate)):
        got = read(KIND.receiver(bit_rate), t_us, on, window_us=50_000)
        assert (got.identity, got.text) == (None, ""), label


def test_no_light_of_another_protocol_says_anything() -> None:
    for label, t_us, on in others("event_interval", MODULATIONS, 5_000.0, 0.5, 0):
        got = read(KIND.receiver(5_000.0), t_us, on, window_us=50_000)
        assert (got.identity, got.text) == (None, ""), label


def test_a_character_repeated_for_ever_is_no_text_and_memory_is_bounded() -> None:
    receiver = KIND.receiver(FASTEST)
    got = read(receiver, *sent((*KIND.encode("ab" * 400), *END), FASTEST, LIGHT, 7))
    assert (got.identity, got.text) == (None, "")
    assert receiver.refusals[Refusal.PERIODIC] > 0


def test_the_quality_tells_clock_and_jitter() -> None:
    receiver = KIND.receiver(FASTEST)
    t_us, on = sent((*KIND.encode(TEXT), *END), FASTEST, AsyncPixels(pixels=50, jitter_us=2.0), 8, ppm=3_000.0)
    read(receiver, t_us, on)
    quality = receiver.quality(int(t_us[-1]))
    assert quality.clock_ppm == pytest.approx(3_000.0, abs=2_000.0)
    assert quality.jitter_us is not None
    assert quality.jitter_us < 2.0


@pytest.mark.parametrize("guard", [1, 17, "x"])
def test_a_guard_out_of_range_is_refused_by_name(guard: Any) -> None:
    with pytest.raises(ValueError, match=r"guard of event_interval must be in \[2, 16\]"):
        modulation("event_interval", guard=guard)


def test_what_cannot_be_sent_or_received_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        KIND.encode("")
    with pytest.raises(ValueError, match="DEL"):
        KIND.encode("\x7f")
    with pytest.raises(ValueError, match="'paper'"):
        KIND.receiver(FASTEST, "paper")
