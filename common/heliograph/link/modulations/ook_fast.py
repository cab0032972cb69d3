"""`ook_fast`: text by on-off keying for asynchronous sensors, to 60 kbit/s and beyond.

The events of such a sensor tell when the LED toggles; a digital phase-locked loop gives the bits (toggle demodulation
with a PLL: arXiv 2510.14266, 60 kbit/s at 200 m). The published work ends at the bits; what they say is ours. Bits are
levels, lit = 1, first on the air at the left::

    character = MMMMMMM CCCCCCCC P  xor  0000 0001 0000 0101

M a 7-bit ASCII character, most significant bit first, C and P the check of `heliograph.link.checked_characters`;
characters follow one right after another, and any level may be held between texts. The constant makes the words a
coset of the code, chosen among all 512 so that

- every character has at least 4 edges, and no run is longer than 14 bits, for the clock;
- no 16 bits across two characters are a character, but for the chance share of 1/512 half-way between them: so the
  words themselves tell where they begin, and no bits are spent on it.
"""

from __future__ import annotations

from typing import Final

from heliograph.link.checked_characters import code_of, word16
from heliograph.link.contract import Bits, Receiver
from heliograph.link.frames import bits_of

WORD_BITS: Final = 16
COSET: Final = 0x0105


class OokFast:
    """Fast text; obeys `heliograph.link.contract.Modulation`. It has no options."""

    name = "ook_fast"
    frame_bits = WORD_BITS

    def encode(self, payload: str) -> Bits:
        """Return the bits of a text.

        Raises:
            ValueError: the text is empty or not 7-bit ASCII.
        """
        if not payload:
            raise ValueError("a text must hold at least 1 character, not 0")
        codes = [code_of(character, at) for at, character in enumerate(payload)]
        return tuple(bit for code in codes for bit in bits_of(word16(code) ^ COSET, WORD_BITS))

    def receiver(self, bit_rate: float, name: str = "default") -> Receiver:
        """Return a receiver of one track.

        Raises:
            ValueError: another name than "default", or the bit rate is out of range.
        """
        if name != "default":
            raise ValueError(f"receiver of ook_fast must be default, not {name!r}")
        from heliograph.link.ook_receiver import OokReceiver  # noqa: PLC0415 - numba, only where something is received

        return OokReceiver(bit_rate)
