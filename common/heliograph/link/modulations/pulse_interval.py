"""`pulse_interval`: an ID in the gaps between pulses, as active markers of the Prophesee kind send it.

The unit is p = 1 / bit_rate (200 us at their 5000 bit/s). A gap lies between two *rising* edges; the LED is lit for the
first p of each::

    gap of 2 p   lit dark             a data bit 0
    gap of 3 p   lit dark dark        a data bit 1
    gap of 4 p   lit dark dark dark   start
    word         start, then 8 to 32 data bits, least significant first; words follow one right after another

Neither the published detector nor ours looks at the falling edges, so another pulse width reads the same.
Source: parameters `num_bits`, `base_period_us`, `tolerance` of the modulated light detector of the Metavision SDK.
"""

from __future__ import annotations

from typing import Final

from heliograph.link.contract import Bits, Receiver
from heliograph.link.options import whole

BITS_LEAST: Final = 8
BITS_MOST: Final = 32
GAP_0: Final = 2
GAP_1: Final = 3
GAP_START: Final = 4
# Gaps of 3 and 4 p meet at 1/7: 3 * 8/7 = 4 * 6/7.
TOLERANCE_MOST_PERCENT: Final = 14


def gap_bits(gap: int) -> Bits:
    """Return the bits, one a unit, of a gap."""
    return (1, *(0,) * (gap - 1))


class PulseInterval:
    """Modulation of active markers; obeys `heliograph.link.contract.Modulation`.

    Args:
        bits: data bits of a word, 8 to 32.
        tolerance_percent: how far a gap may be off, of its own length (published: 10).

    Raises:
        ValueError: an option is out of its range.
    """

    name = "pulse_interval"

    def __init__(self, bits: int | str = BITS_LEAST, tolerance_percent: int | str = 10) -> None:
        self._bits = whole("bits of pulse_interval", bits, BITS_LEAST, BITS_MOST)
        percent = whole("tolerance_percent of pulse_interval", tolerance_percent, 1, TOLERANCE_MOST_PERCENT)
        self._tolerance = percent / 100.0
        self.frame_bits = GAP_START + GAP_1 * self._bits  # the longest

    def encode(self, payload: int) -> Bits:
        """Return the bits of a word, first on the air first.

        Raises:
            ValueError: the payload does not fit the data bits.
        """
        most = (1 << self._bits) - 1
        if not 0 <= payload <= most:
            raise ValueError(f"payload of pulse_interval must be in [0, {most}] ({self._bits} bits), not {payload!r}")
        word = gap_bits(GAP_START)
        for i in range(self._bits):
            word += gap_bits(GAP_1 if payload >> i & 1 else GAP_0)
        return word

    def receiver(self, bit_rate: float, name: str = "default") -> Receiver:
        """Return a receiver of one track.

        Raises:
            ValueError: another name than "default", or the bit rate is out of range.
        """
        if name != "default":
            raise ValueError(f"receiver of pulse_interval must be default, not {name!r}")
        from heliograph.link.pulse_words import PulseReceiver  # noqa: PLC0415 - numba, only where something is received

        return PulseReceiver(bit_rate, self._bits, self._tolerance)
