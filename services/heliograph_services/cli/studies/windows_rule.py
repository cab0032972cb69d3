"""The paper's polarity windows before the layout of a character: what its rule makes of a text beacon.

Windows and transitions are those of `heliograph.link.paper`: P = (N_on - N_off) / (N_on + N_off) in windows on an
absolute grid; |P| >= .5 in a window of at least five events is a transition, and n = max(1, round((t_c - t_t) f)) bits
have passed since the last one. A run longer than a character's longest (nine zeros are one too many; ones may idle for
any time) ends the character. A character begins at a zero after a one; its parity and both stop bits must be right, or
else the next bit is looked at.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times
from heliograph.link.paper import MIN_EVENTS, POLARITY
from heliograph.link.uart_layout import CHARACTER_BITS, TIME_FILL, character_bits

# A start bit, seven zeros and even parity.
ZEROS_MOST: Final = 9


def read_windows(t_us: Times, on: Flags, bit_us: float, width: float = 1.0, phase: float = 0.0) -> str:
    """Return the text that the rule reads.

    Args:
        t_us: (n,) int64, of one light, sorted.
        on: (n,) bool.
        bit_us: length of a bit.
        width: of a window, in bits.
        phase: where the grid begins, in windows.
    """
    if not len(t_us):
        return ""
    window_us = width * bit_us
    number: npt.NDArray[np.int64] = np.floor(t_us / window_us - phase).astype(np.int64)
    starts = np.flatnonzero(np.concatenate([np.ones(1, np.bool_), np.diff(number) != 0]))
    events = np.diff(np.concatenate([starts, [len(number)]]))
    polarity = np.add.reduceat(np.where(on, 1, -1), starts) / events
    strong = (events >= MIN_EVENTS) & (np.abs(polarity) >= POLARITY)
    at, lit = number[starts][strong], polarity[strong] > 0
    changes = np.concatenate([np.ones(min(len(lit), 1), np.bool_), lit[1:] != lit[:-1]])
    at, lit = at[changes], lit[changes]
    bits: list[int] = []
    for a, b, was_lit in zip(at[:-1].tolist(), at[1:].tolist(), lit[:-1].tolist(), strict=True):
        n = max(1, round((b - a) * width))
        if was_lit:
            # Whatever idles longer than a character's ones says nothing more.
            bits += [1] * min(n, CHARACTER_BITS)
        else:
            bits += [0] * n if n <= ZEROS_MOST else [1, 1]
    return _characters(bits)


def _characters(bits: list[int]) -> str:
    """Return the characters of a row of bits."""
    out = []
    at = 1
    while at + CHARACTER_BITS <= len(bits):
        word = bits[at : at + CHARACTER_BITS]
        code = int("".join(map(str, word[1:8])), 2)
        if bits[at - 1] == 1 and tuple(word) == character_bits(code):
            if code != TIME_FILL:
                out.append(chr(code))
            at += CHARACTER_BITS
        else:
            at += 1
    return "".join(out)
