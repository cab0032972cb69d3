"""Cyclic frames: a word of n bits, sent again and again, read from any rotation.

`seed11`, first on the air at the left::

    1110 PPPPPP C     C = 1 when the payload has an odd number of ones  (`even`: the paper's example, 1110 100000 1)
                      C = 1 when it has an even number of ones          (`paper_text`: the paper's sentence)

The paper's sentence and its example contradict each other; both are formats of their own and never guessed, since one
flipped bit turns one into the other.

A word is an int: the first bit on the air is its most significant one. Two payloads whose words are rotations of each
other are *ambiguous*: no receiver can tell them apart. A word with a single run of ones is *periodic*: a square wave,
which a lamp can imitate.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal
from heliograph.link.contract import Bits

Parity = Literal["even", "paper_text"]
PARITIES: Final[tuple[str, ...]] = get_args(Parity)
# What a receiver does with words that any switched lamp of that frequency sends: refuse them; read them as frames, of
# which no number makes an identity; or believe them, as beacons that are known to be there.
Periodic = Literal["refused", "read", "believed"]
PERIODIC: Final[tuple[str, ...]] = get_args(Periodic)

SEED11_BITS: Final = 11
SEED11_PAYLOAD_BITS: Final = 6
SEED11_START: Final = 0b1110
SEED11_START_BITS: Final = 4

_ONES: Final = np.array([i.bit_count() for i in range(1 << 16)], np.uint8)


def bits_of(word: int, n: int) -> Bits:
    """Return the n bits of a word, first on the air first."""
    return tuple((word >> (n - 1 - i)) & 1 for i in range(n))


def word_of(bits: Sequence[int]) -> int:
    """Return the word of the bits, first on the air = most significant."""
    word = 0
    for bit in bits:
        word = (word << 1) | bit
    return word


def rotated(word: int, n: int, by: int) -> int:
    """Return the word as it reads when its first `by` bits are sent last."""
    by %= n
    return ((word << by) | (word >> (n - by))) & ((1 << n) - 1)


def rotations(word: int, n: int) -> list[int]:
    """Return the n rotations, the word itself first; a word with a shorter period repeats in the list."""
    return [rotated(word, n, by) for by in range(n)]


def cyclic_runs(word: int, n: int) -> list[int]:
    """Return the lengths of the runs of equal bits around the circle; [n] when both levels are not present."""
    bits = bits_of(word, n)
    starts = [i for i in range(n) if bits[i] != bits[i - 1]]
    if not starts:
        return [n]
    return [(after - begin) % n for begin, after in zip(starts, [*starts[1:], starts[0]], strict=True)]


def cyclic_distance(a: int, b: int, n: int) -> int:
    """Return the least Hamming distance of `a` to a rotation of `b`; of a word to itself: to its other rotations."""
    others = rotations(b, n)[1:] if a == b else rotations(b, n)
    return min((a ^ other).bit_count() for other in others)


def is_periodic(word: int, n: int) -> bool:
    """Return whether the word is a plain square wave: one run of ones and one of zeros, or that several times over."""
    turns = sum(other == word for other in rotations(word, n))
    return len(cyclic_runs(word, n)) == 2 * turns


def seed11_word(payload: int, parity: Parity = "even") -> int:
    """Return the 11 bits of a payload, ambiguous or not.

    Raises:
        ValueError: the payload lies outside [0, 63], or the parity is none of `PARITIES`.
    """
    if parity not in PARITIES:
        raise ValueError(f"parity must be one of {', '.join(PARITIES)}, not {parity!r}")
    if not 0 <= payload < 1 << SEED11_PAYLOAD_BITS:
        raise ValueError(f"payload must be in [0, 63], not {payload}")
    odd = payload.bit_count() & 1
    check = odd if parity == "even" else 1 - odd
    return (SEED11_START << 7) | (payload << 1) | check


@dataclass(frozen=True, slots=True)
class CyclicCode:
    """The words that a receiver of a cyclic code chooses from; payload = index.

    Args:
        name: of the protocol or the codebook.
        bits: n, the length of a frame, 4 to 32.
        words: the word of each payload.
        start: the bits with which each frame begins, and how many; (0, 0) where there are none.
        twins: for each ambiguous payload the others that read alike.
        periodic: payloads that are plain square waves.
        longest_run: the most equal bits in a row in an endless repetition of any word of the code.
        distance: the least Hamming distance of a word to any rotation of another, and to those of its own that differ.
    """

    name: str
    bits: int
    words: tuple[int, ...]
    start: tuple[int, int] = (0, 0)
    twins: dict[int, tuple[int, ...]] = field(default_factory=dict)
    periodic: frozenset[int] = frozenset()
    longest_run: int = 0
    distance: int = 0

    def hard_refusal(self, word: int) -> Refusal:
        """Return why a clearly read word that is none of the code's is refused."""
        start, start_bits = self.start
        if start_bits == 0:
            return Refusal.UNKNOWN_WORD
        if word >> (self.bits - start_bits) != start:
            return Refusal.NO_START_CODE
        return Refusal.PARITY


def cyclic_code(name: str, n: int, words: Sequence[int], start: tuple[int, int] = (0, 0)) -> CyclicCode:
    """Return the code of these words, with what follows from them.

    Ambiguous words are allowed and named in `twins`; `distance` is that of the words without a twin.

    Raises:
        ValueError: n lies outside [4, 32], there are no words, or one has more than n bits or is given twice.
    """
    if not 4 <= n <= 32:
        raise ValueError(f"a cyclic word must have 4 to 32 bits, not {n}")
    if not words:
        raise ValueError("a cyclic code needs at least one word, not 0")
    if len(set(words)) != len(words):
        raise ValueError("a word of the code is given twice")
    if not all(0 <= word < 1 << n for word in words):
        raise ValueError(f"a word of the code has more than {n} bits")
    same: dict[int, list[int]] = defaultdict(list)
    for payload, word in enumerate(words):
        same[min(rotations(word, n))].append(payload)
    twins = {p: tuple(q for q in group if q != p) for group in same.values() if len(group) > 1 for p in group}
    safe = [word for payload, word in enumerate(words) if payload not in twins]
    return CyclicCode(
        name=name,
        bits=n,
        words=tuple(words),
        start=start,
        twins=twins,
        periodic=frozenset(p for p, word in enumerate(words) if is_periodic(word, n)),
        longest_run=max(max(cyclic_runs(word, n)) for word in words),
        distance=least_distance(safe, n, symmetric=True) if safe else 0,
    )


def least_distance(words: Sequence[int], n: int, *, symmetric: bool = False) -> int:
    """Return the least distance of a word to any rotation of another word, and to its own other rotations.

    Args:
        words: of n bits.
        n: length of a word.
        symmetric: leave out the rotations that turn a word into itself: wherever it is said to begin, it is that word.
    """
    array = np.array(words, np.uint32)
    least = n
    for by in range(n):
        turned = ((array << np.uint32(by)) | (array >> np.uint32(n - by))) & np.uint32((1 << n) - 1)
        distance = popcount(array[:, None] ^ turned[None, :])
        if by == 0:
            np.fill_diagonal(distance, n)
        elif symmetric:
            itself = np.diagonal(distance) == 0
            distance[itself, itself] = n
        least = min(least, int(distance.min()))
    return least


def popcount(values: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint8]:
    """Return the number of ones of each value (numpy has its own only from version 2 on)."""
    ones: npt.NDArray[np.uint8] = _ONES[values & np.uint32(0xFFFF)] + _ONES[values >> np.uint32(16)]
    return ones


def seed11_code(parity: Parity = "even") -> CyclicCode:
    """Return all 64 words of `seed11`; the 16 ambiguous ones are in `twins`."""
    words = [seed11_word(payload, parity) for payload in range(1 << SEED11_PAYLOAD_BITS)]
    return cyclic_code("seed11", SEED11_BITS, words, (SEED11_START, SEED11_START_BITS))
