"""The kernels agree with their equations."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.link.step_response import CHANGE_AT, SUB_BINS, StepResponse, cold_rates
from heliograph.link.sub_bins import LEAD_BINS, QUIET_BINS, SubBins
from heliograph.link.uart_layout import CONTEXTS, IDLE_CONTEXT, character_bits
from heliograph.link.uart_lock import LOCK_BINS, lock
from heliograph.link.uart_paths import IDLE, explain
from heliograph.link.uart_words import any_word, near, skip_idle, slots_of
from reference import uart_plain
from support.text_light import TextLight, watch_text


def plain_rates(response: StepResponse) -> uart_plain.Array:
    """Return lambda[q, context, j] of a response's tables."""
    return np.exp(response.log_rate * response.f).transpose(0, 2, 1)


@pytest.mark.parametrize("seed", range(4))
def test_the_best_character_its_runner_up_and_the_free_word_are_those_of_all_words(seed: int) -> None:
    rng = np.random.default_rng(seed)
    response = StepResponse(20.0)
    counts = rng.poisson(0.7, (13 * SUB_BINS, 2)).astype(np.int32)
    before = int(rng.integers(CONTEXTS))
    _, code, likelihood, second, free, word, _ = near(counts, 8, 0, slots_of(SUB_BINS), before, response.tables)
    characters = uart_plain.all_characters(counts, 8, before, plain_rates(response), response.f)
    words = uart_plain.all_words(counts, 8, before, plain_rates(response), response.f)
    assert code == characters.argmax()
    assert likelihood == pytest.approx(characters.max(), abs=1e-9)
    assert second == pytest.approx(np.sort(characters)[-2], abs=1e-9)
    assert free == pytest.approx(words.max(), abs=1e-9)
    assert words[word] == pytest.approx(words.max(), abs=1e-9)
    together = words.max() + np.log(np.exp(words - words.max()).sum())
    assert any_word(counts, 8, slots_of(SUB_BINS), before, response.tables) == pytest.approx(together, abs=1e-9)


def ideal(bits: list[int]) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    """Return counts of bits that follow idle time, ten events at each change of level."""
    counts = np.zeros((len(bits) * SUB_BINS, 2), np.int32)
    for n, (old, new) in enumerate(zip([1, *bits], bits, strict=False)):
        if old != new:
            counts[n * SUB_BINS + CHANGE_AT + 1, 1 - new] = 10
    return counts


def test_a_stretch_is_explained_by_its_characters_and_the_idle_time_between_them() -> None:
    bits = [*character_bits(ord("a")), *[1] * 7, *character_bits(ord("Z")), *character_bits(ord("5")), 1, 1]
    response = StepResponse(10.0)
    path = np.empty((len(bits) * SUB_BINS, 2), np.int64)
    steps = explain(ideal(bits), 0, len(path), slots_of(SUB_BINS), IDLE_CONTEXT, response.tables, path)
    found = [(int(at), chr(code)) for at, code in path[:steps] if code >= 0]
    assert [character for _, character in found] == ["a", "Z", "5"]
    assert [round(at / SUB_BINS) for at, _ in found] == [0, 18, 29]
    between = path[:steps][(path[:steps, 0] >= 11 * SUB_BINS + 3) & (path[:steps, 0] < 18 * SUB_BINS - 3)]
    assert len(between)
    assert np.all(between[:, 1] == IDLE)


@pytest.mark.parametrize("noise", [0.05, 0.3, 2.0])
@pytest.mark.parametrize("text", ["", "aZ", "Ow"])
def test_the_way_through_a_stretch_is_that_of_trying_every_character_everywhere(text: str, noise: float) -> None:
    bits = [1, 1, *(bit for character in text for bit in (*character_bits(ord(character)), 1)), *[1] * 14]
    rng = np.random.default_rng(int(100 * noise) + len(text))
    counts = (ideal(bits) + rng.poisson(noise, (len(bits) * SUB_BINS, 2))).astype(np.int32)
    response = StepResponse(10.0)
    path = np.empty((len(counts), 2), np.int64)
    steps = explain(counts, 0, len(counts), slots_of(SUB_BINS), IDLE_CONTEXT, response.tables, path)
    assert [(int(at), int(code)) for at, code in path[:steps]] == uart_plain.explained(
        counts, len(counts), IDLE_CONTEXT, response
    )


@pytest.mark.parametrize("place", [0.0, 40.0, 170.5])
def test_after_junk_a_character_at_another_place_than_the_ones_before_costs_more(place: float) -> None:
    bits = [0, 1, 0, 0, 1, 0, 1, 0, 0, 1, 0, *character_bits(ord("k")), 1, 1, 1, 1]
    counts = (ideal(bits) + np.random.default_rng(3).poisson(0.3, (len(bits) * SUB_BINS, 2))).astype(np.int32)
    response = StepResponse(10.0)
    path = np.empty((len(counts), 2), np.int64)
    steps = explain(counts, 0, len(counts), slots_of(SUB_BINS), IDLE_CONTEXT, response.tables, path, place)
    assert [(int(at), int(code)) for at, code in path[:steps]] == uart_plain.explained(
        counts, len(counts), IDLE_CONTEXT, response, place
    )


def test_idle_time_is_skipped_up_to_the_start_bit() -> None:
    counts = ideal([*[1] * 9, 0, 0, 1, 1])
    at = skip_idle(counts, 0, 10 * SUB_BINS, StepResponse(10.0).tables)
    assert 8 * SUB_BINS < at <= 9 * SUB_BINS + 1


def test_learning_reproduces_the_means_of_what_was_seen() -> None:
    response = StepResponse(10.0)
    counts = ideal([*character_bits(ord("e"))])
    word = int("".join(map(str, character_bits(ord("e")))), 2)
    for _ in range(3000):
        response.learn(counts, 0, slots_of(SUB_BINS), word, IDLE_CONTEXT)
    response.refresh()
    rates = plain_rates(response)
    assert rates[1, 0b11110].sum() == pytest.approx(10.0, rel=0.05)
    assert rates[0, 0b11110].sum() < 0.5


def test_the_cold_response_sheds_a_changes_events_over_the_bits_that_follow() -> None:
    rates = cold_rates(100.0)
    first, second = rates[0, 0b00001].sum(), rates[0, 0b00011].sum()
    left = np.exp(CHANGE_AT / SUB_BINS - 1)  # of what a change sheds, after the bit that it is in
    assert first == pytest.approx(100 * (1 - left), rel=0.01)
    assert second == pytest.approx(100 * left * (1 - np.exp(-1)), rel=0.01)
    assert rates[1, 0b00001, CHANGE_AT:].sum() == 0.0  # before the change, it is dark for at least four bits
    assert rates[1, 0b00001, :CHANGE_AT].sum() < 100 * np.exp(-4)


def test_a_cold_start_finds_text_and_its_clock_but_none_in_noise() -> None:
    seen = watch_text(TextLight(clock=0.01), "But thy eternal summer shall not fade", 1000.0, seed=1)
    bins = SubBins(1000.0 / SUB_BINS)
    assert bins.add(seen.t_us, seen.on) > 0
    found = lock(bins.counts, LEAD_BINS, LOCK_BINS)
    assert found is not None
    assert found.bit_bins == pytest.approx(SUB_BINS * 1.01, rel=0.002)
    rng = np.random.default_rng(1)
    assert lock(rng.poisson(1.0, (LOCK_BINS, 2)).astype(np.int32), 0, LOCK_BINS) is None


def test_light_that_turns_too_seldom_for_eight_characters_is_not_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> int:
        raise AssertionError("it was explained")

    monkeypatch.setattr("heliograph.link.uart_lock.explain", never)
    slow = np.zeros((LOCK_BINS, 2), np.int32)
    for k in range(15):
        slow[k * 180 : k * 180 + 90, k % 2] = 2
    slow[::40, 0] += 1
    assert lock(slow, 0, LOCK_BINS) is None
    slow[15 * 180 : 15 * 180 + 90, 1] = 2
    with pytest.raises(AssertionError, match="explained"):
        lock(slow, 0, LOCK_BINS)


def test_silence_is_cut_out_and_time_is_kept() -> None:
    bins = SubBins(10.0)
    t_us = np.array([1_000, 1_005, 1_015, 9_000_000_000_000, 9_000_000_000_021], np.int64)
    assert bins.add(t_us, np.array([True, False, True, True, False])) == 5
    first = LEAD_BINS
    again = LEAD_BINS + 1 + QUIET_BINS
    assert bins.counts[first].tolist() == [1, 1]
    assert bins.counts[first + 1].tolist() == [1, 0]
    assert bins.counts[again].tolist() == [1, 0]
    assert bins.counts[again + 2].tolist() == [0, 1]
    assert bins.time_us(first + 1) == 1_010
    assert bins.time_us(again + 1) == 9_000_000_000_010
    assert bins.known(9_000_000_000_025) == again + 2
    assert bins.known(1 << 62) == again + 2 + QUIET_BINS
