"""The compiled decision is that of trying every word and every n bits."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from heliograph.link.frames import bits_of, seed11_code
from heliograph.link.likelihood import (
    AT_REST,
    BEST,
    EVIDENCE,
    FLOOR,
    LEVEL,
    MARGIN,
    OTHER,
    RESTS,
    SCORE,
    VERDICT_FIELDS,
    decide,
    plain_bits,
    slot,
)
from reference import cyclic_plain as plain

N = 6
WORDS = [bits_of(word, N) for word in (0b000011, 0b001011, 0b001111, 0b010101 ^ 0b000010)]
SLOTS = hnp.arrays(np.float64, (N + 1, 4), elements=st.floats(FLOOR, 1.0))


@settings(max_examples=60)
@given(SLOTS, st.integers(0, 8), st.sampled_from([0.5, 0.95]))
def test_a_frame_is_decided_as_by_trying_everything(slots: np.ndarray, first: int, next_one: float) -> None:
    ring = np.ones((9, 4))
    for i in range(N + 1):
        ring[(first + i) % 9] = slots[i]
    verdict = np.empty(VERDICT_FIELDS)
    decide(ring, first, np.array(WORDS, np.uint8), next_one, verdict)
    at_rest = AT_REST if (slots[:, 3] < RESTS * slots[:, 0]).any() else 0.0
    each = [plain.either_likelihood(slots, word, next_one, at_rest) for word in WORDS]
    _, score, evidence = plain.decision(slots, WORDS, next_one, OTHER, at_rest)
    assert each[int(verdict[BEST])] == pytest.approx(max(each))
    assert verdict[SCORE] == pytest.approx(score, rel=1e-5)
    assert verdict[EVIDENCE] == pytest.approx(evidence, abs=1e-5)
    top, second = sorted(each, reverse=True)[:2]
    assert verdict[MARGIN] == pytest.approx(min(np.log(top / second), -np.log(1e-7)), abs=1e-4)


@pytest.mark.parametrize("payload", [11, 19, 35, 7, 9, 42])
@pytest.mark.parametrize("moves", [True, False])
def test_a_moving_light_is_read_where_it_turns(payload: int, moves: bool) -> None:
    """Lit it makes events while it moves; at a turn it makes none, for a whole frame, and its edges alone tell."""
    code = seed11_code()
    words = np.array([bits_of(word, code.bits) for word in code.words], np.uint8)
    bits = [0, *words[payload].tolist(), 1]
    ring = np.full((code.bits + 1, 4), FLOOR)
    for i, (before, after) in enumerate(pairwise(bits)):
        lit = 2 * before + after == 3
        ring[i, 2 * before + after] = 1.0
        if before == after:
            ring[i, [0, 3]] = (LEVEL, 1.0) if lit and moves else (1.0, LEVEL)
            # Where few events come, an edge is missed once in a hundred.
            ring[i, 1:3] = 0.005
    verdict = np.empty(VERDICT_FIELDS)
    decide(ring, 0, words, 0.95, verdict)
    assert (verdict[BEST], verdict[SCORE] > 0.99) == (payload, True)


@settings(max_examples=60)
@given(SLOTS)
def test_the_plain_bits_are_the_most_likely_ones(slots: np.ndarray) -> None:
    word, share = plain_bits(slots, 0, N)
    each = [plain.word_likelihood(slots, bits_of(any_, N)) for any_ in range(1 << N)]
    # The share is exact up to the averaging over the outer bits, which both sides do alike.
    assert each[word] == pytest.approx(max(each))
    assert share == pytest.approx(max(each) / sum(each))


@given(hnp.arrays(np.float64, 4, elements=st.floats(-1e6, 1e6)))
def test_a_slot_says_neither_too_much_nor_nothing(loglikelihood: np.ndarray) -> None:
    out = np.empty(4)
    slot(loglikelihood, out)
    assert out.max() == 1.0
    assert out.min() >= FLOOR
