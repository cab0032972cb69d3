"""Characters with a check, for fast links: 7-bit ASCII in words of a BCH code, at distances of 5 and 6.

A character m (7 bits, most significant first) is followed by the remainder of its division by
g(x) = x^8 + x^7 + x^6 + x^4 + 1, the generator of BCH(15, 7), distance 5; a parity bit more makes the number of ones
even and the distance 6::

    word15 = m | (m x^8 mod g)              7 + 8 bits
    word16 = word15 | parity of word15      15 + 1 bits

A receiver corrects one wrong bit and withholds the rest: what it lets through wrong has four bits wrong or more of 15,
five of 16. Of all words of 15 (16) bits 1/256 (1/512) are characters.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

CHARACTERS: Final = 128
GENERATOR: Final = 0b1_1101_0001
CHECK_BITS: Final = 8
# As in ASCII (ANSI X3.4): DEL is no part of a text; it fills time.
TIME_FILL: Final = 0x7F


def word15(code: int) -> int:
    """Return the 15 bits of a character.

    Raises:
        ValueError: the code lies outside [0, 127].
    """
    if not 0 <= code < CHARACTERS:
        raise ValueError(f"a character's code must be in [0, {CHARACTERS - 1}], not {code}")
    rest = code << CHECK_BITS
    for i in reversed(range(CHECK_BITS, CHECK_BITS + 7)):
        if rest >> i & 1:
            rest ^= GENERATOR << (i - CHECK_BITS)
    return code << CHECK_BITS | rest


def word16(code: int) -> int:
    """Return the 16 bits of a character; see `word15`."""
    word = word15(code)
    return word << 1 | word.bit_count() & 1


def code_of(character: str, at: int = 0) -> int:
    """Return the code of a character that can be sent.

    Raises:
        ValueError: it is DEL, or none of 7-bit ASCII; the text names it and its place.
    """
    if ord(character) >= TIME_FILL:
        raise ValueError(f"a text must be 7-bit ASCII without DEL (time fill), not {character!r} (character {at})")
    return ord(character)


@cache
def nearest(bits: int) -> npt.NDArray[np.int16]:
    """Return (2**bits,) int16: 256 d + character of the word at a distance d of at most 1; -1 where there is none.

    Args:
        bits: 15 or 16.
    """
    table = np.full(1 << bits, -1, np.int16)
    for code in range(CHARACTERS):
        word = word15(code) if bits == 15 else word16(code)
        table[word] = code
        for i in range(bits):
            table[word ^ (1 << i)] = 256 + code
    return table
