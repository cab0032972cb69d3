"""`packet`: messages, text or bytes, in packets with address, check and error correction.

On the air: `heliograph.link.packet_layout`; messages in packets: `heliograph.link.packet_messages`. The payload that
identifications tell is the address.
"""

from __future__ import annotations

from heliograph.link.contract import Bits, Receiver
from heliograph.link.packet_layout import ADDRESSES, BLOCK_DEFAULT, RATE, layout_of
from heliograph.link.packet_messages import packets_of


class Packet:
    """Data beacons; obeys `heliograph.link.contract.Modulation`.

    Args:
        block: bytes of data a packet, 4 to 30.
        rate: of the code, "1/2", "2/3", "3/4" or "5/6".

    Raises:
        ValueError: another block or rate.
    """

    name = "packet"

    def __init__(self, block: int = BLOCK_DEFAULT, rate: str = RATE) -> None:
        self.layout = layout_of(block, rate)

    @property
    def frame_bits(self) -> int:
        """Bits of a packet."""
        return self.layout.bits

    def encode(self, payload: int | str | bytes) -> Bits:
        """Return the bits of one message: an address's empty one, or a text or bytes of address 0.

        Raises:
            ValueError: there is no such address, or the message is too long.
        """
        if isinstance(payload, (str, bytes)):
            return self.message(payload)
        if not 0 <= payload < ADDRESSES:
            raise ValueError(f"payload of packet must be in [0, {ADDRESSES - 1}], not {payload!r}")
        return self.message(b"", address=payload)

    def message(self, data: str | bytes, address: int = 0, number: int = 0) -> Bits:
        """Return the bits of one message, its packets one right after another.

        Raises:
            ValueError: there is no such address, or it is too long.
        """
        packets = packets_of(data, address, number, self.layout.block)
        return tuple(bit for packet in packets for bit in self.layout.encode(packet))

    def messages(self, text: str, address: int = 0) -> list[tuple[int, Bits]]:
        """Return the packets of a text, a message a line, as frames: the address and the bits of each.

        Raises:
            ValueError: it says nothing, there is no such address, or a line is too long.
        """
        lines = [line for line in text.split("\n") if line]
        if not lines:
            raise ValueError("text of packet must have a line that is not empty")
        packets = [
            packet
            for number, line in enumerate(lines)
            for packet in packets_of(line, address, number, self.layout.block)
        ]
        return [(address, self.layout.encode(packet)) for packet in packets]

    def receiver(self, bit_rate: float, name: str = "default") -> Receiver:
        """Return a receiver of one track.

        Raises:
            ValueError: another name than "default", or the bit rate is out of range.
        """
        if name != "default":
            raise ValueError(f"receiver of packet must be default, not {name!r}")
        from heliograph.link.packet_receiver import PacketReceiver  # noqa: PLC0415 - numba, only where it receives

        return PacketReceiver(self.layout, bit_rate)
