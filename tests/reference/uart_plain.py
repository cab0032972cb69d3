"""The text receiver's likelihoods as their equations say, bit by bit and word by word."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heliograph.link.uart_layout import character_bits

Array = npt.NDArray[np.float64]


def bit_likelihood(counts: npt.NDArray[np.int32], at: int, context: int, rates: Array, f: float) -> float:
    """Return l of a bit: 1/F sum_j sum_q (y ln lambda - lambda); rates is lambda[q, context, j]."""
    total = 0.0
    for q in range(2):
        for j in range(rates.shape[2]):
            rate = rates[q, context, j]
            total += counts[at + j, q] * np.log(rate) - rate
    return total / f


def word_likelihood(
    counts: npt.NDArray[np.int32], at: int, bits: tuple[int, ...], before: int, rates: Array, f: float
) -> float:
    """Return l of a word whose bits are 16 sub-bins long."""
    context, total = before, 0.0
    for n, bit in enumerate(bits):
        context = ((context << 1) | bit) % rates.shape[1]
        total += bit_likelihood(counts, at + n * rates.shape[2], context, rates, f)
    return total


def all_characters(counts: npt.NDArray[np.int32], at: int, before: int, rates: Array, f: float) -> Array:
    """Return l of each of the 128 characters."""
    return np.array([word_likelihood(counts, at, character_bits(code), before, rates, f) for code in range(128)])


def all_words(counts: npt.NDArray[np.int32], at: int, before: int, rates: Array, f: float) -> Array:
    """Return l of each of the 2^11 words."""
    words = (tuple((word >> (10 - n)) & 1 for n in range(11)) for word in range(1 << 11))
    return np.array([word_likelihood(counts, at, word, before, rates, f) for word in words])
