"""`uart`: text as characters of 11 bits (Wang et al. 2022; layout in `heliograph.link.uart_layout`)."""

from __future__ import annotations

from heliograph.link.contract import Bits, Receiver
from heliograph.link.text_receiver import TextReceiver, warm
from heliograph.link.uart_layout import text_bits

__all__ = ["Uart", "warm"]


class Uart:
    """Text beacons; obeys `heliograph.link.contract.Modulation`. It has no options."""

    name = "uart"

    def encode(self, payload: str) -> Bits:
        """Return the bits of a text; the LED is lit before and after it.

        Raises:
            ValueError: the text is empty or not 7-bit ASCII.
        """
        return text_bits(payload)

    def receiver(self, bit_rate: float, name: str = "default") -> Receiver:
        """Return a receiver of one track.

        Raises:
            ValueError: the bit rate is out of range, or uart has no such receiver.
        """
        if name != "default":
            raise ValueError(f"receiver of uart must be default, not {name!r}")
        return TextReceiver(bit_rate)
