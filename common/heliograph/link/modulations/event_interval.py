"""`event_interval`: the time between events carries the data (event interval modulation, arXiv 2510.14245).

The published scheme has M intervals tau_1 < ... < tau_M, each worth log2 M bits (28 kbit/s at 10 m, indoors); unit,
mapping and framing are ours. The unit is u = 1 / bit_rate (10 us at 100,000 bit/s, the fastest). A gap lies between two
rising edges; the LED is lit for its first unit::

    gap of G + s units   (G - 1 + s dark)      a symbol s, 0 to 7: three bits, Gray coded: s = gray(b2 b1 b0)
    gap of G + 8 units                         start, of a character; a last one ends a text
    character = start, then 15 bits in five symbols, most significant first

    symbol       0   1   2   3   4   5   6   7
    bits        000 001 011 010 110 111 101 100        neighbours differ in one bit

The 15 bits are the character and its check (`heliograph.link.checked_characters`): a gap that is read as its neighbour
costs one bit, which is corrected. The guard G (`guard`, default 3, at least 2) leaves a pixel time to become ready.
Mean gap of a symbol: G + 3.5 units. With G = 3 a character has 43.5 units on average: at u = 10 us 34.5 kbit/s of coded
bits, 16.1 kbit/s of text.
"""

from __future__ import annotations

from typing import Final

from heliograph.link.checked_characters import code_of, word15
from heliograph.link.contract import Bits, Receiver
from heliograph.link.options import whole

SYMBOLS: Final = 8
SYMBOL_BITS: Final = 3
WORD_BITS: Final = 15
WORD_SYMBOLS: Final = WORD_BITS // SYMBOL_BITS
GUARD: Final = 3


def gray(bits: int) -> int:
    """Return the symbol of three bits: the number whose Gray code they are."""
    return bits ^ (bits >> 1) ^ (bits >> 2)


def bits_of_symbol(symbol: int) -> int:
    """Return the three bits of a symbol: its Gray code."""
    return symbol ^ (symbol >> 1)


def symbols_of(code: int) -> tuple[int, ...]:
    """Return the five symbols of a character."""
    word = word15(code)
    return tuple(gray(word >> SYMBOL_BITS * i & 7) for i in reversed(range(WORD_SYMBOLS)))


class EventInterval:
    """Text by intervals; obeys `heliograph.link.contract.Modulation`.

    Args:
        guard: the shortest gap, in units.

    Raises:
        ValueError: the option is out of its range.
    """

    name = "event_interval"

    def __init__(self, guard: int | str = GUARD) -> None:
        self._guard = whole("guard of event_interval", guard, 2, 16)
        self.frame_bits = (WORD_SYMBOLS + 1) * (self._guard + SYMBOLS)  # the longest

    def encode(self, payload: str) -> Bits:
        """Return the bits of a text, one a unit, without the start that ends it (the next text's, or any rise).

        Raises:
            ValueError: the text is empty or not 7-bit ASCII.
        """
        if not payload:
            raise ValueError("a text must hold at least 1 character, not 0")
        bits: list[int] = []
        for at, character in enumerate(payload):
            for symbol in (SYMBOLS, *symbols_of(code_of(character, at))):
                bits += [1] + [0] * (self._guard - 1 + symbol)
        return tuple(bits)

    def receiver(self, bit_rate: float, name: str = "default") -> Receiver:
        """Return a receiver of one track.

        Raises:
            ValueError: another name than "default", or the bit rate is out of range.
        """
        if name != "default":
            raise ValueError(f"receiver of event_interval must be default, not {name!r}")
        from heliograph.link.interval_words import IntervalReceiver  # noqa: PLC0415 - numba, only where it receives

        return IntervalReceiver(bit_rate, self._guard)
