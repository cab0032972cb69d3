"""The convolutional code: encoder and decision against scikit-commpy, and where it must not err."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.link.convolutional import PATTERNS, TAIL, mother_bits, sent_places
from heliograph.link.viterbi import SIGNS, encode_into, viterbi

DATA = st.lists(st.integers(0, 1), min_size=1, max_size=80)


def decided(soft: np.ndarray[tuple[int], np.dtype[np.float64]]) -> list[int]:
    data = np.empty(len(soft) // 2, np.uint8)
    viterbi(soft, SIGNS, data)
    return data.tolist()


@given(DATA)
def test_the_kernel_encodes_as_the_plain_encoder(data: list[int]) -> None:
    mother = np.empty(2 * len(data), np.uint8)
    encode_into(np.array(data, np.uint8), mother)
    assert mother.tolist() == mother_bits(data)


@given(DATA, st.sampled_from(sorted(PATTERNS)))
def test_clean_bits_are_decided_at_every_rate(data: list[int], rate: str) -> None:
    whole = [*data, *(0,) * TAIL]
    soft = np.zeros(2 * len(whole))
    for place in sent_places(len(whole), rate):
        soft[place] = 1.0 - 2.0 * mother_bits(whole)[place]
    assert decided(soft) == whole


@given(st.integers(0, 2**32 - 1))
def test_four_errors_among_the_bits_of_a_constraint_length_are_corrected_at_rate_half(seed: int) -> None:
    # The free distance of the mother code is 10: four wrong bits never suffice.
    rng = np.random.default_rng(seed)
    data = [*rng.integers(0, 2, 40).tolist(), *(0,) * TAIL]
    soft = 1.0 - 2.0 * np.array(mother_bits(data), np.float64)
    first = int(rng.integers(0, len(soft) - 14))
    soft[first + rng.choice(14, 4, replace=False)] *= -1.0
    assert decided(soft) == data


def test_it_decides_as_well_as_the_viterbi_decoder_of_others() -> None:
    others = pytest.importorskip("commpy.channelcoding", reason="the oracle scikit-commpy is not installed")
    # Theirs have the newest bit last: 171 and 133 reversed.
    trellis = others.Trellis(np.array([TAIL]), np.array([[0o117, 0o155]]))
    rng = np.random.default_rng(3)
    for _ in range(6):
        data = rng.integers(0, 2, 40)
        theirs = others.conv_encode(data, trellis, "term")
        whole = [*data.tolist(), *(0,) * TAIL]
        assert theirs.tolist() == mother_bits(whole)
        # One bit in ten is wrong. Their decision may end in any state, ours only in the one that was sent.
        soft = 1.0 - 2.0 * theirs + rng.normal(0.0, 0.8, len(theirs))
        assert (soft * (1.0 - 2.0 * theirs) < 0.0).any()
        their_data = others.viterbi_decode(-soft, trellis, tb_depth=len(whole), decoding_type="unquantized")
        ours = decided(soft)
        if not their_data[-TAIL:].any():
            assert ours == their_data[: len(whole)].astype(int).tolist()
        signs = 1.0 - 2.0 * np.array(mother_bits(ours))
        assert viterbi(soft, SIGNS, np.empty(len(whole), np.uint8)) == pytest.approx(float(signs @ soft))
        assert ours == whole
