"""The characters of the text beacons of Wang et al. (2022).

Each has 11 bits, first on the air at the left::

    0 DDDDDDD P 1 1      start, 7-bit ASCII (most significant bit first), parity, stop, stop

P makes the number of ones in DDDDDDD P even. Between characters the LED is idle: lit, level 1, for any time (also for
none, also for a part of a bit). The recordings published with the paper (Z. Wang et al., "Smart visual beacons with
asynchronous optical communications using event cameras", IROS 2022) are laid out so.

The *context* of a bit is the bit itself and the four before it, oldest first, as a number: the light of an LED that has
just been switched still rings in the events of the bits that follow, so what a bit looks like depends on its context.

DEL (127, all data bits lit) is time fill, as ASCII (ANSI X3.4) has it: the beacons of the recordings send one at the
end of a text. It is a frame like any other and no part of a text.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.link.contract import Bits

CHARACTER_BITS: Final = 11
DATA_BITS: Final = 7
CHARACTERS: Final = 1 << DATA_BITS
TIME_FILL: Final = 0x7F

# The step response of the far LED at 3125 bit/s rings for three to four bits; a sixth bit of context doubles what must
# be learned and reads none of the recordings better.
CONTEXT_BITS: Final = 5
CONTEXTS: Final = 1 << CONTEXT_BITS
IDLE_CONTEXT: Final = CONTEXTS - 1


def character_bits(code: int) -> Bits:
    """Return the 11 bits of a character.

    Raises:
        ValueError: the code lies outside [0, 127].
    """
    if not 0 <= code < CHARACTERS:
        raise ValueError(f"a character's code must be in [0, {CHARACTERS - 1}], not {code}")
    data = tuple((code >> i) & 1 for i in reversed(range(DATA_BITS)))
    return (0, *data, sum(data) % 2, 1, 1)


def text_bits(text: str) -> Bits:
    """Return the bits of a text, its characters one right after another.

    Raises:
        ValueError: the text is empty or holds DEL or a character beyond 7-bit ASCII; the message names it.
    """
    if not text:
        raise ValueError("a text must hold at least 1 character, not 0")
    for at, character in enumerate(text):
        if ord(character) >= TIME_FILL:
            raise ValueError(f"a text must be 7-bit ASCII without DEL (time fill), not {character!r} (character {at})")
    return tuple(bit for character in text for bit in character_bits(ord(character)))


def word_table() -> npt.NDArray[np.int64]:
    """Return (128,) int64: each character's 11 bits as a number, first on the air = most significant."""
    words = [int("".join(map(str, character_bits(code))), 2) for code in range(CHARACTERS)]
    return np.array(words, np.int64)
