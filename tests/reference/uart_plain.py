"""The text receiver's likelihoods as their equations say, bit by bit and word by word."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heliograph.link.step_response import StepResponse
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


IDLE, JUNK, LEAVE, NONE = -1, -2, 7.0, -1e300
Step = tuple[int, int]


def explained(
    counts: npt.NDArray[np.int32], n: int, before: int, response: StepResponse, place: float = np.nan
) -> list[Step]:
    """Return (sub-bin, code or IDLE or JUNK) of the likeliest way through n sub-bins that begins at the first one.

    All characters are tried everywhere, and every way is kept whole. Bits are 16 sub-bins long. Junk that ends more
    than 4 sub-bins off place + 176 k costs 7 more.
    """
    log_rate, rate, total, quiet = response.tables
    rows = np.array([
        sum(counts[g + j, 0] * log_rate[0, j] + counts[g + j, 1] * log_rate[1, j] for j in range(16)) - total
        for g in range(n - 15)
    ])  # fmt: skip
    words = np.array([int("".join(map(str, character_bits(code))), 2) for code in range(128)])
    # of each sub-bin: value, way, context and age of what ends there; and value and way of junk, by context
    ends: list[tuple[float, list[Step], int, int]] = [(NONE, [], 31, 0)] * (n + 1)
    ends[0] = (0.0, [], before, 0)
    junk: list[list[tuple[float, list[Step]]]] = [[(NONE, [])] * 32 for _ in range(n + 1)]
    for g in range(n + 1):
        best = max(range(32), key=lambda c: (junk[g][c][0], -c))
        leave = LEAVE + (7.0 if min((g - place) % 176.0, (place - g) % 176.0) > 4.0 else 0.0)
        if junk[g][best][0] - leave > ends[g][0]:
            ends[g] = (junk[g][best][0] - leave, junk[g][best][1], best, 0)
        value, way, context, age = ends[g]
        ones = age // 16
        lead = 31 if ones >= 4 else ((context << ones) | ((1 << ones) - 1)) & 31
        if value > junk[g][lead][0]:
            junk[g][lead] = (value, way)
        if g + 16 <= n:
            for c in range(32):
                came = max((junk[g][c >> 1 | 16], junk[g][c >> 1]), key=lambda one: one[0])
                junk[g + 16][c] = (came[0] + rows[g, c] - 1.0, [*came[1], (g, JUNK)])
        if g < n and value > NONE:
            now = 31 if ones >= 4 else ((context << (ones + 1)) | ((2 << ones) - 1)) & 31
            y, j = counts[g], age % 16
            idle = float(y[0] * log_rate[0, j, now] + y[1] * log_rate[1, j, now] - rate[j, now])
            if ones >= 4:
                idle = max(idle, float(y.sum() * quiet[0] - quiet[1]))
            if value + idle > ends[g + 1][0]:
                ends[g + 1] = (value + idle, [*way, (g, IDLE)], context, min(age + 1, 80))
        if value > NONE and g + 176 <= n:
            at = [rows[g + 16 * i, ((lead << (i + 1)) | (words >> (10 - i))) & 31] for i in range(11)]
            likelihood = np.sum(at, axis=0)
            code = int(likelihood.argmax())
            for end in range(g + 174, min(g + 178, n) + 1):
                after = value + likelihood[code] - 0.5 * ((end - g - 176) / 2.0) ** 2
                if after > ends[end][0]:
                    ends[end] = (after, [*way, (g, code)], int(words[code]) & 31, 0)
    spare = rows[n - 16].max() - 1.0
    last = max(range(n, n - 16, -1), key=lambda g: (max(one[0] for one in junk[g]) + spare * (n - g) / 16, -g))
    return max(junk[last], key=lambda one: one[0])[1]
