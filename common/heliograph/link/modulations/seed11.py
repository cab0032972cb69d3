"""`seed11`: the paper's frame, 1110 PPPPPP C, repeated (`heliograph.link.frames` has the layout).

Of 64 payloads 16 are ambiguous under rotation (8 pairs) and cannot be sent; 4 of the other 48 are square waves, which a
lamp can imitate: they can be sent, and are believed where the site expects them (`periodic`).
"""

from __future__ import annotations

from typing import cast

from heliograph.link.contract import Bits, Receiver
from heliograph.link.frames import PARITIES, PERIODIC, Parity, Periodic, bits_of, seed11_code

RECEIVERS = ("default", "paper", "paper_tuned", "binning", "binning_tuned")


class Seed11:
    """The paper's modulation.

    Args:
        parity: "even" (the paper's example) or "paper_text" (its sentence).
        periodic: what the default receiver does with payloads that a lamp can imitate: "refused" (as PERIODIC), "read"
            (as frames that never make an identity) or "believed". The paper's receiver reads them always.

    Raises:
        ValueError: another parity, another word for `periodic`.
    """

    name = "seed11"

    def __init__(self, parity: str = "even", periodic: str = "refused") -> None:
        if parity not in PARITIES:
            raise ValueError(f"parity must be one of {', '.join(PARITIES)}, not {parity!r}")
        if periodic not in PERIODIC:
            raise ValueError(f"periodic must be one of {', '.join(PERIODIC)}, not {periodic!r}")
        self.code = seed11_code(cast("Parity", parity))
        self._parity = parity
        self._periodic = cast("Periodic", periodic)

    def encode(self, payload: int) -> Bits:
        """Return the 11 bits of a payload.

        Raises:
            ValueError: it is none of 0 to 63, or ambiguous; the text names the twin.
        """
        if not 0 <= payload < len(self.code.words):
            raise ValueError(f"payload must be in [0, {len(self.code.words) - 1}], not {payload!r}")
        twins = self.code.twins.get(payload)
        if twins:
            raise ValueError(
                f"payload {payload} cannot be sent: with parity {self._parity} it reads like {twins[0]} under rotation"
            )
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
        if name == "default":
            from heliograph.link.cyclic import CyclicReceiver  # noqa: PLC0415 - numba, only where something is received

            return CyclicReceiver(self.code, bit_rate, self._periodic)
        if name in ("paper", "paper_tuned"):
            from heliograph.link.paper import PUBLISHED, TUNED, PaperReceiver  # noqa: PLC0415 - for symmetry

            return PaperReceiver(self.code, bit_rate, PUBLISHED if name == "paper" else TUNED)
        if name in ("binning", "binning_tuned"):
            from heliograph.link.binning import TUNED_EVENTS, BinningReceiver  # noqa: PLC0415 - for symmetry

            return BinningReceiver(self.code, bit_rate, 1 if name == "binning" else TUNED_EVENTS)
        raise ValueError(f"receiver of seed11 must be one of {', '.join(RECEIVERS)}, not {name!r}")
