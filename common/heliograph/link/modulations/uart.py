"""`uart`: text as characters of 11 bits (Wang et al. 2022; layout in `heliograph.link.uart_layout`)."""

from __future__ import annotations

from heliograph.link.contract import Bits, Receiver
from heliograph.link.text_receiver import warm
from heliograph.link.uart_clock import ClockedTextReceiver
from heliograph.link.uart_layout import text_bits

__all__ = ["Uart", "warm"]

RECEIVERS = ("default", "wang2022", "wang2022_tuned")


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
            ValueError: the name is none of `RECEIVERS`, or the bit rate is out of range.
        """
        if name == "default":
            return ClockedTextReceiver(bit_rate)
        if name in ("wang2022", "wang2022_tuned"):
            from heliograph.link.wang2022 import WangReceiver, tuned  # noqa: PLC0415 - only comparisons need its kernel

            return WangReceiver(bit_rate, None if name == "wang2022" else tuned(bit_rate))
        raise ValueError(f"receiver of uart must be one of {', '.join(RECEIVERS)}, not {name!r}")
