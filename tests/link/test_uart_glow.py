"""A lit LED that moves glows in the events; where it turns the glow goes and comes back, and its text is read on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.link.contract import edges_of
from heliograph.link.modulations.uart import Uart
from heliograph.link.step_response import SUB_BINS
from heliograph.link.uart_glow import SHAPE, correction, lit_events
from heliograph.link.uart_layout import CONTEXTS, text_bits
from heliograph.link.uart_words import slots_of
from support.text_light import TextLight, Watched, edits, hear, joined, watch_text

LETTERS = "abcdefghijklmnopqrstuvwxyz 0123456789.,;:!?ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@given(word=st.integers(0, 2047), before=st.integers(0, CONTEXTS - 1), seed=st.integers(0, 1000))
def test_lit_events_are_those_of_ones_that_follow_ones(word: int, before: int, seed: int) -> None:
    counts = np.random.default_rng(seed).poisson(0.5, (13 * SUB_BINS, 2)).astype(np.int32)
    slots = slots_of(SUB_BINS * 1.01)
    bits = [before & 1, *((word >> (10 - i)) & 1 for i in range(11))]
    at = [int(slot) for slot, old, new in zip(slots, bits, bits[1:], strict=False) if old and new]
    expected = sum(int(counts[3 + a : 3 + a + SUB_BINS].sum()) for a in at)
    assert lit_events(counts, 3, slots, word, before, SUB_BINS) == (expected, SUB_BINS * len(at))


@given(
    rate=st.floats(0.01, 3.0), n=st.integers(1, 9), share=st.floats(0.0, 4.0), f=st.floats(1.0, 10.0)
)  # fmt: skip
def test_the_glow_is_corrected_towards_what_the_last_character_showed(
    rate: float, n: int, share: float, f: float
) -> None:
    seen, sums, glow = np.ones(CONTEXTS), np.full((2, CONTEXTS, SUB_BINS), 99.0), np.empty(2)
    sums[0, 3::4], sums[1, 3::4] = rate, 2.0 * rate
    events = round(share * 3.0 * rate * n * SUB_BINS)
    correction(seen, sums, events, n * SUB_BINS, f, SHAPE, glow)
    expected = 3.0 * rate * n * SUB_BINS
    ratio = (events + SHAPE * f) / (expected + SHAPE * f)
    assert glow == pytest.approx([rate * (ratio - 1.0), 2.0 * rate * (ratio - 1.0)])


def test_without_a_lit_bit_nothing_is_corrected() -> None:
    glow = np.ones(2)
    correction(np.ones(CONTEXTS), np.ones((2, CONTEXTS, SUB_BINS)), 0, 0, 1.0, SHAPE, glow)
    assert glow.tolist() == [0.0, 0.0]
    correction(np.zeros(CONTEXTS), np.ones((2, CONTEXTS, SUB_BINS)), 9, 16, 1.0, SHAPE, glow)
    assert glow.tolist() == [0.0, 0.0]


def moving(text: str, bit_rate: float, glow: float, turn_s: float, seed: int) -> Watched:
    """Return the events of a text whose lit bits make `glow` events each, but for a turn of turn_s in its middle."""
    light = TextLight(events=12.0, tail_bits=0.15)
    edges = watch_text(light, text, bit_rate, seed)
    rng = np.random.default_rng(seed)
    levels = [*[1] * light.lead_bits, *text_bits(text), *[1] * light.lead_bits]
    ends, on = edges_of(levels, 1_000_000, 1e6 / bit_rate, level=True)
    last_us = 1_000_000 + len(levels) * 1e6 / bit_rate
    t = rng.uniform(1e6, last_us, rng.poisson(glow * len(levels)))
    # Of events at all times those stay that come while the LED is lit, by the speed at their time.
    k = np.searchsorted(ends, t) - 1
    lit = np.where(k >= 0, on[np.maximum(k, 0)], True)
    middle_us = 0.5 * (1e6 + last_us)
    kept = lit & (rng.random(len(t)) < np.minimum(np.abs(t - middle_us) / (0.5e6 * turn_s), 1.0))
    t_us = np.concatenate([edges.t_us, np.floor(t[kept]).astype(np.int64)])
    both = np.concatenate([edges.on, rng.random(int(kept.sum())) < 0.5])
    order = np.argsort(t_us, kind="stable")
    return Watched(t_us[order], both[order], max(edges.until_us, int(last_us) + 1))


def test_a_light_that_turns_is_read_through_its_turn() -> None:
    wrong = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        text = "".join(LETTERS[i] for i in rng.integers(0, len(LETTERS), 120))
        wrong += edits(text, joined(hear(Uart().receiver(504.0), moving(text, 504.0, 40.0, 0.2, seed))))
    # 4, of which 3 are at the beginning, before anything is learned; 22 where the glow is as it was on average.
    assert wrong <= 6
