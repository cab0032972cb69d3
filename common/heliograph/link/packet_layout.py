"""What a packet looks like on the air, bit by bit. The first on the air is at the left; 1 is lit, 0 dark (NRZ).

::

    SYNC  24 bits, 111100110011010010101000 (as they are)
    BODY  the code bits of HEADER | DATA | CRC | TAIL, punctured, interleaved, scrambled

    HEADER  AAAAAAAA  address, the sender's ID
            K         kind of the message: 0 bytes, 1 text (UTF-8)
            NNNN      number of the message, modulo 16: it tells two messages, and a repeat from a new one
            FFFFFF    which fragment of the message, from 0
            LLLLL     bytes of DATA that are used, 0 to 16: the message ends here; 31: all, and more fragments follow
    DATA    16 bytes, unused ones zero             (option `block`: 4 to 30)
    CRC     32 bits over the bytes of HEADER and DATA: CRC-32/ISO-HDLC (IEEE 802.3), most significant bit first
    TAIL    6 zeros

All numbers most significant bit first. With 16 bytes of data: 190 bits before the code, N after puncturing.

Code: K = 7, punctured (`heliograph.link.convolutional`). Interleaver: code bit i goes to place i S^-1 mod N, so the bit
on the air at place j is code bit j S mod N; S is the least number, coprime to N, of at least N / 7: what is lost in a
burst of up to six bits lies at least N / 7 code bits apart. Scrambler: place j is inverted where the maximal-length
sequence of x^9 + x^5 + 1 (ITU-T O.150, PN9), begun with nine ones, is one: no data make a long run or a square wave.

One length of packets for a link: its end is known from its sync alone; a length read off a damaged packet could lie.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import lru_cache
from math import gcd
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from heliograph.link.contract import Bits
from heliograph.link.convolutional import TAIL, mother_bits, sent_places

ADDRESSES: Final = 256
NUMBERS: Final = 16
FRAGMENTS: Final = 64
MORE: Final = 31
HEADER_BYTES: Final = 3
CRC_BYTES: Final = 4
BLOCK_DEFAULT: Final = 16
# Below four bytes a packet is all header; 31 in LLLLL means "more follow", so 30 are the most.
BLOCK_LEAST: Final = 4
BLOCK_MOST: Final = MORE - 1
# Measured (bench/study_packet.py): with a twentieth of the transitions lost, and bursts of few events, it reads what
# 3/4 does not, and is 2.07 kbit/s net at 5 kbit/s; 1/2 reads little more for a quarter of the rate.
RATE: Final = "2/3"
# Twelve ones, thirteen edges, runs of at most four; by no shift does it look like itself: of the places that overlap
# never more than four agree beyond those that differ, or the other way round. It begins lit: it may follow darkness.
SYNC: Final = 0b111100110011010010101000
SYNC_BITS: Final = 24
BURST: Final = 7

Octets = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Packet:
    """What a packet says.

    Args:
        address: of the sender, 0 to 255.
        text: the message is UTF-8 text, not bytes.
        number: of the message, 0 to 15.
        fragment: of the message, 0 to 63.
        more: further fragments follow; then the data fill the block.
        data: the bytes that are used.
    """

    address: int
    text: bool
    number: int
    fragment: int
    more: bool
    data: bytes


class Tables(NamedTuple):
    """What the kernels need of a layout.

    Args:
        sync: (SYNC_BITS,) uint8.
        mother: (N,) int64, which bit of the mother code is on the air at each place of the body.
        flip: (N,) uint8, whether it is inverted there.
        steps: bits before the code, tail included.
    """

    sync: Octets
    mother: Ints
    flip: Octets
    steps: int


class Layout:
    """The layout of a link's packets.

    Args:
        block: bytes of DATA.
        rate: of the code, a row of `heliograph.link.convolutional.PATTERNS`.

    Raises:
        ValueError: out of range.
    """

    def __init__(self, block: int = BLOCK_DEFAULT, rate: str = RATE) -> None:
        if type(block) is not int or not BLOCK_LEAST <= block <= BLOCK_MOST:
            raise ValueError(f"block must be in [{BLOCK_LEAST}, {BLOCK_MOST}] bytes, not {block!r}")
        self.block = block
        self.steps = 8 * (HEADER_BYTES + block + CRC_BYTES) + TAIL
        places = sent_places(self.steps, rate)
        self.body_bits = len(places)
        self.bits = SYNC_BITS + self.body_bits
        step = interleaver_step(self.body_bits)
        self._mother = [places[j * step % self.body_bits] for j in range(self.body_bits)]
        self._flip = scrambler(self.body_bits)

    def encode(self, packet: Packet) -> Bits:
        """Return a packet's bits on the air.

        Raises:
            ValueError: a field is out of range.
        """
        whole = self._bytes(packet)
        checked = whole + zlib.crc32(whole).to_bytes(CRC_BYTES, "big")
        mother = mother_bits([*bits_of_bytes(checked), *(0,) * TAIL])
        body = (mother[i] ^ flip for i, flip in zip(self._mother, self._flip, strict=True))
        return (*(SYNC >> (SYNC_BITS - 1 - i) & 1 for i in range(SYNC_BITS)), *body)

    def _bytes(self, packet: Packet) -> bytes:
        for name, value, end in (
            ("address", packet.address, ADDRESSES),
            ("number", packet.number, NUMBERS),
            ("fragment", packet.fragment, FRAGMENTS),
        ):
            if not 0 <= value < end:
                raise ValueError(f"{name} must be in [0, {end - 1}], not {value!r}")
        if len(packet.data) > self.block or (packet.more and len(packet.data) < self.block):
            least = self.block if packet.more else 0
            raise ValueError(f"data must have {least} to {self.block} bytes, not {len(packet.data)}")
        used = MORE if packet.more else len(packet.data)
        header = (int(packet.text) << 15) | (packet.number << 11) | (packet.fragment << 5) | used
        return bytes([packet.address]) + header.to_bytes(2, "big") + packet.data.ljust(self.block, b"\0")

    def parse(self, whole: bytes) -> Packet | None:
        """Return what HEADER, DATA and CRC say, or None where check, length or unused bytes are wrong.

        Raises:
            ValueError: they are not so many bytes.
        """
        if len(whole) != HEADER_BYTES + self.block + CRC_BYTES:
            raise ValueError(f"a packet has {HEADER_BYTES + self.block + CRC_BYTES} bytes, not {len(whole)}")
        checked, crc = whole[:-CRC_BYTES], whole[-CRC_BYTES:]
        header = int.from_bytes(checked[1:HEADER_BYTES], "big")
        used, more = header & 31, header & 31 == MORE
        if zlib.crc32(checked) != int.from_bytes(crc, "big") or (not more and used > self.block):
            return None
        data = checked[HEADER_BYTES:] if more else checked[HEADER_BYTES : HEADER_BYTES + used]
        if any(checked[HEADER_BYTES + len(data) :]):
            return None
        return Packet(checked[0], bool(header >> 15), header >> 11 & 15, header >> 5 & 63, more, data)

    def tables(self) -> Tables:
        """Return what the kernels need."""
        sync = np.array([SYNC >> (SYNC_BITS - 1 - i) & 1 for i in range(SYNC_BITS)], np.uint8)
        return Tables(sync, np.array(self._mother, np.int64), np.array(self._flip, np.uint8), self.steps)


@lru_cache(maxsize=64)
def layout_of(block: int = BLOCK_DEFAULT, rate: str = RATE) -> Layout:
    """Return the layout of these packets, made once."""
    return Layout(block, rate)


def bits_of_bytes(whole: bytes) -> list[int]:
    """Return the bits of bytes, the most significant of each first."""
    return [byte >> (7 - i) & 1 for byte in whole for i in range(8)]


def interleaver_step(n: int) -> int:
    """Return S of n places."""
    step = -(-n // BURST)
    while gcd(step, n) != 1:
        step += 1
    return step


def scrambler(n: int) -> list[int]:
    """Return n bits of PN9: b[j] = b[j-9] + b[j-5] (mod 2), after nine ones, which are the first bits themselves."""
    bits = [1] * 9
    while len(bits) < n:
        bits.append(bits[-9] ^ bits[-5])
    return bits[:n]
