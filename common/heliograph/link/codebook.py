"""Codebooks whose words are known apart from any rotation of each other.

A book is JSON: ``{"name", "bits", "distance", "max_run", "seed", "words": ["0101...", ...]}``; a beacon's ID is the
index of its word, so a stored book is never regenerated or reordered under the same name. Books of others are read too:
a plain JSON list of words, each a list of bits or a string of bits, and the sequence files of UVDAR
(ctu-mrs/uvdar_core, config/): a word a line, its bits apart by commas::

    0,0,1,0,0,1,0,1,0,1,1,1

A word of others may turn into itself under a rotation (0,0,1,0,1,1 twice over): its ID is told, though not where it
begins.

The search is greedy: words of even weight are tried in the order of their value, XORed with a mask drawn from the seed
(seed 0: none), and kept when their distance over all rotations is at least d. Lexicographic order packs better than
chance (20 bits, d 4: 522 words against 203 in random order), since it makes the book nearly linear; words of even
weight differ by at least two bits from the outset.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np

from heliograph.errors import ConfigError, FileError
from heliograph.link.frames import CyclicCode, cyclic_code, cyclic_runs, least_distance, rotations

STORED: Final[tuple[str, ...]] = ("code18d4", "code20d4")

# Files of one word a line.
LINES: Final = (".txt", ".csv")
# The receiver tries every word at every frame: 4096 words of 24 bits cost 0.2 ms a frame, one core at 5 kbit/s.
WORDS_LIMIT: Final = 4096
# A book file of 4096 words of 32 bits, written as lists of bits with spaces, has 400 kB.
FILE_LIMIT_BYTES: Final = 2_000_000
# The search keeps a table of all 2**n words.
SEARCH_BITS_LIMIT: Final = 24


@dataclass(frozen=True, slots=True)
class Codebook:
    """A book of rotation-unique words; payload = index.

    Args:
        name: stored name, or the file's stem.
        bits: n, length of a word.
        distance: least Hamming distance over all rotations, to others and to itself.
        max_run: longest run of equal bits around the circle.
        seed: of the search that made it; None for a book of others.
        words: first bit on the air = most significant.
    """

    name: str
    bits: int
    distance: int
    max_run: int
    seed: int | None
    words: tuple[int, ...]

    def to_json(self) -> str:
        """Return the book as a file's text, one word a line."""
        head = {"name": self.name, "bits": self.bits, "distance": self.distance, "max_run": self.max_run}
        lines = ",\n".join(f'  "{word:0{self.bits}b}"' for word in self.words)
        seed = "" if self.seed is None else f', "seed": {self.seed}'
        return f'{json.dumps(head)[:-1]}{seed}, "words": [\n{lines}\n]}}\n'

    def code(self) -> CyclicCode:
        """Return what a receiver needs."""
        return cyclic_code(self.name, self.bits, self.words)


@cache
def load(name: str) -> Codebook:
    """Return a stored book by its name, or the book of a file.

    Raises:
        ValueError: no stored book has the name.
        FileError: the file is missing, no book, or its words are not unique under rotation.
    """
    if name in STORED:
        return _parsed(name, (files(__package__) / "codebooks" / f"{name}.json").read_text("utf-8"), name)
    if not name.endswith((".json", *LINES)):
        raise ValueError(f"codebook must be one of {', '.join(STORED)} or a path to a .json or .txt file, not {name!r}")
    path = Path(name)
    try:
        if path.stat().st_size > FILE_LIMIT_BYTES:
            raise FileError(f"codebook {name} is larger than {FILE_LIMIT_BYTES} bytes")
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"codebook {name} cannot be read: {error}") from None
    return _parsed(path.stem, text, name)


def _parsed(name: str, text: str, where: str) -> Codebook:
    try:
        content = _lines(text) if where.endswith(LINES) else json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileError(f"codebook {where} is not JSON: {error}") from None
    listed = content.get("words", content.get("sequences")) if isinstance(content, dict) else content
    if not isinstance(listed, list) or not 1 <= len(listed) <= WORDS_LIMIT:
        raise FileError(f"codebook {where} must list 1 to {WORDS_LIMIT} words")
    seed = content.get("seed") if isinstance(content, dict) else None
    bits = {_length(word) for word in listed}
    n = bits.pop()
    if bits or not 4 <= n <= 32:
        raise FileError(f"codebook {where}: all words must have the same length, 4 to 32 bits")
    words = tuple(_word(word, i, where) for i, word in enumerate(listed))
    distance = least_distance(words, n, symmetric=True)
    if distance < 1:
        raise FileError(f"codebook {where}: two words, or rotations of them, are the same")
    if not all(0 < word < (1 << n) - 1 for word in words):
        raise FileError(f"codebook {where}: a word must hold both a 0 and a 1")
    runs = max(max(cyclic_runs(word, n)) for word in words)
    return Codebook(name, n, distance, runs, seed if isinstance(seed, int) else None, words)


def _lines(text: str) -> list[str]:
    """Return the words of a file that has one a line."""
    return ["".join(line.replace(",", " ").split()) for line in text.splitlines() if line.strip()]


def _length(word: Any) -> int:
    return len(word) if isinstance(word, str | list) else 0


def _word(word: Any, index: int, where: str) -> int:
    text = (
        word
        if isinstance(word, str)
        else "".join("1" if b in (1, True) else "0" if b in (0, False) else "?" for b in word)
    )
    if set(text) - {"0", "1"}:
        raise FileError(f"codebook {where}: word {index} has a bit that is neither 0 nor 1")
    return int(text, 2)


def generate(bits: int, distance: int, max_run: int = 5, seed: int = 0, name: str = "") -> Codebook:
    """Return a book found by the greedy search; the same arguments give the same book.

    Raises:
        ConfigError: an argument is out of its range, or no word obeys them all.
    """
    for what, value, low, high in (
        ("bits", bits, 4, SEARCH_BITS_LIMIT),
        ("distance", distance, 1, 8),
        ("max-run", max_run, 1, bits),
        ("seed", seed, 0, 2**32 - 1),
    ):
        if not low <= value <= high:
            raise ConfigError(f"{what} must be in [{low}, {high}], not {value}")
    mask = 0 if seed == 0 else int(np.random.default_rng(seed).integers(1 << bits))
    ball = _ball(bits, distance - 1)
    taken = np.zeros(1 << bits, np.bool_)
    words: list[int] = []
    step = 2 if distance > 1 else 1
    for value in range(1 << bits):
        word = value ^ mask
        if taken[word] or (step == 2 and word.bit_count() & 1):
            continue
        turned = rotations(word, bits)
        apart = min((word ^ other).bit_count() for other in turned[1:]) >= distance
        if not apart or max(cyclic_runs(word, bits)) > max_run:
            taken[turned] = True
            continue
        words.append(word)
        for other in turned:
            taken[ball ^ other] = True
        if len(words) == WORDS_LIMIT:
            break
    if not words:
        raise ConfigError(
            f"no word of {bits} bits has distance {distance} to its rotations and runs of at most {max_run}"
        )
    found = least_distance(words, bits)
    runs = max(max(cyclic_runs(word, bits)) for word in words)
    return Codebook(name or f"code{bits}d{distance}", bits, found, runs, seed, tuple(words))


def _ball(n: int, radius: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return all error patterns of at most `radius` flipped bits."""
    patterns = [sum(1 << i for i in places) for k in range(radius + 1) for places in combinations(range(n), k)]
    return np.array(patterns, np.int64)
