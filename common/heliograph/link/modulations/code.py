"""`code`: words of a rotation-unique codebook, repeated; the payload is the index in the book.

The first bit on the air is a word's first; there is no start code: the rotation itself tells where the word begins.
Stored: code18d4 (169 IDs of 18 bits) and code20d4 (522 of 20), distance 4 over all rotations, runs of at most 5.
"""

from __future__ import annotations

from typing import cast

from heliograph.link.codebook import load
from heliograph.link.contract import Bits, Receiver
from heliograph.link.frames import PERIODIC, Periodic, bits_of

RECEIVERS = ("default", "binning", "binning_tuned")


class Code:
    """A codebook's modulation.

    Args:
        codebook: a stored name, or the path of a book, .json or .txt (`heliograph.link.codebook`).
        periodic: what the default receiver does with words that are plain square waves, if the book has such:
            "refused", "read" (as frames that never make an identity) or "believed".

    Raises:
        ValueError: no such book, another word for `periodic`.
        FileError: the file is no book.
    """

    name = "code"

    def __init__(self, codebook: str = "code20d4", periodic: str = "refused") -> None:
        if periodic not in PERIODIC:
            raise ValueError(f"periodic must be one of {', '.join(PERIODIC)}, not {periodic!r}")
        self.code = load(codebook).code()
        self._periodic = cast("Periodic", periodic)

    def encode(self, payload: int) -> Bits:
        """Return the word of a payload.

        Raises:
            ValueError: the book has no such index.
        """
        if not 0 <= payload < len(self.code.words):
            raise ValueError(f"payload of {self.code.name} must be in [0, {len(self.code.words) - 1}], not {payload!r}")
        return bits_of(self.code.words[payload], self.code.bits)

    def advice(self, payload: int) -> str | None:
        """Return why a payload that can be sent had better not be, or None."""
        if payload in self.code.periodic:
            return f"payload {payload} is a plain square wave, which a lamp can imitate"
        return None

    def receiver(self, bit_rate: float, name: str = "default") -> Receiver:
        """Return a receiver of one track.

        Raises:
            ValueError: the name is none of `RECEIVERS`, or the bit rate is out of range.
        """
        if name in ("binning", "binning_tuned"):
            from heliograph.link.binning import TUNED_EVENTS, BinningReceiver  # noqa: PLC0415 - for symmetry

            return BinningReceiver(self.code, bit_rate, 1 if name == "binning" else TUNED_EVENTS)
        if name != "default":
            raise ValueError(f"receiver of code must be one of {', '.join(RECEIVERS)}, not {name!r}")
        from heliograph.link.cyclic import CyclicReceiver  # noqa: PLC0415 - numba, only where something is received

        return CyclicReceiver(self.code, bit_rate, self._periodic)
