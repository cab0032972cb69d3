"""Cyclic codes worked on strings of 0 and 1, as slowly and plainly as they are defined."""

from __future__ import annotations

from itertools import groupby, product

import numpy as np
import numpy.typing as npt


def turns(word: str) -> list[str]:
    return [word[i:] + word[:i] for i in range(len(word))]


def distance(a: str, b: str) -> int:
    return sum(x != y for x, y in zip(a, b, strict=True))


def least_distance(words: list[str]) -> int:
    """Least Hamming distance over all rotations: between two words, and of a word to its own other rotations."""
    least = len(words[0])
    for i, word in enumerate(words):
        least = min([least, *(distance(word, own) for own in turns(word)[1:])])
        for other in words[:i]:
            least = min([least, *(distance(other, turned) for turned in turns(word))])
    return least


def longest_cyclic_run(word: str) -> int:
    """Longest run of equal bits in the endless repetition of the word."""
    return max(len(list(group)) for _, group in groupby(word * 2))


def seed11(payload: int, parity: str) -> str:
    data = f"{payload:06b}"
    odd = data.count("1") % 2
    return "1110" + data + str(odd if parity == "even" else 1 - odd)


def ambiguous_pairs(parity: str) -> list[tuple[int, int]]:
    pairs = [(p, q) for p in range(64) for q in range(p) if seed11(q, parity) in turns(seed11(p, parity))]
    return sorted((q, p) for p, q in pairs)


def word_likelihood(slots: npt.NDArray[np.float64], bits: tuple[int, ...], next_one: float = 0.5) -> float:
    """Likelihood of bits, each slot's table indexed by 2 * before + after, averaged over the outer neighbours."""
    total = 0.0
    for before, after in product((0, 1), repeat=2):
        row = [before, *bits, after]
        likelihood = 1.0
        for i, slot in enumerate(slots):
            likelihood *= float(slot[2 * row[i] + row[i + 1]])
        total += 0.5 * (next_one if after else 1.0 - next_one) * likelihood
    return total


def either_likelihood(slots: npt.NDArray[np.float64], bits: tuple[int, ...], next_one: float, at_rest: float) -> float:
    """Likelihood of bits of a light that moves, or with the chance at_rest shows lit what it shows dark."""
    resting = slots.copy()
    resting[:, 3] = resting[:, 0]
    moving = (1.0 - at_rest) * word_likelihood(slots, bits, next_one)
    return moving + at_rest * word_likelihood(resting, bits, next_one)


def decision(
    slots: npt.NDArray[np.float64], words: list[tuple[int, ...]], next_one: float, other: float, at_rest: float = 0.0
) -> tuple[int, float, float]:
    """Return the best word, its posterior and the evidence, by trying all 2**n bits."""
    n = len(words[0])
    each = [either_likelihood(slots, word, next_one, at_rest) for word in words]
    anything = sum(either_likelihood(slots, bits, next_one, at_rest) for bits in product((0, 1), repeat=n)) / 2**n
    best = int(np.argmax(each))
    code = (1.0 - other) * sum(each) / len(each)
    return (
        best,
        (1.0 - other) / len(each) * each[best] / (code + other * anything),
        float(np.log(sum(each) / len(each) / anything)),
    )
