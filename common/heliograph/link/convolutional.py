"""The convolutional code of our data link: K = 7, rate 1/2 punctured (its decision: `heliograph.link.viterbi`).

Encoder, the pair 171, 133 (octal) that CCSDS 131.0-B, IEEE 802.11 and DVB-S use: u[t] is the newest bit, zeros before::

    A[t] = u[t] + u[t-1] + u[t-2] + u[t-3] + u[t-6]      (mod 2)       171 = 1111001b, newest bit first
    B[t] = u[t] + u[t-2] + u[t-3] + u[t-5] + u[t-6]                    133 = 1011011b
    mother code: A[0] B[0] A[1] B[1] ...        TAIL zeros follow the data, so that the encoder ends in state zero

Puncturing, the patterns of DVB-S (ETSI EN 300 421): of each period only the ones are sent, A before B::

    1/2  A 1    B 1          2/3  A 10   B 11          3/4  A 101  B 110        5/6  A 10101  B 11010
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

CONSTRAINT: Final = 7
TAIL: Final = CONSTRAINT - 1
STATES: Final = 1 << TAIL
POLYNOMIALS: Final = (0o171, 0o133)
# Which of A and B are sent in each step of a period.
PATTERNS: Final[dict[str, tuple[tuple[int, ...], tuple[int, ...]]]] = {
    "1/2": ((1,), (1,)),
    "2/3": ((1, 0), (1, 1)),
    "3/4": ((1, 0, 1), (1, 1, 0)),
    "5/6": ((1, 0, 1, 0, 1), (1, 1, 0, 1, 0)),
}


def mother_bits(data: Sequence[int]) -> list[int]:
    """Return A[0] B[0] A[1] B[1] ... of the data; the tail is the caller's."""
    register = 0
    out: list[int] = []
    for bit in data:
        register = (bit << TAIL) | (register >> 1)
        out += [(register & polynomial).bit_count() & 1 for polynomial in POLYNOMIALS]
    return out


def sent_places(steps: int, rate: str) -> list[int]:
    """Return which bits of the mother code are sent, of so many steps, in their order.

    Raises:
        ValueError: no pattern has this rate.
    """
    if rate not in PATTERNS:
        raise ValueError(f"rate must be one of {', '.join(PATTERNS)}, not {rate!r}")
    pattern = PATTERNS[rate]
    period = len(pattern[0])
    return [2 * t + branch for t in range(steps) for branch in range(2) if pattern[branch][t % period]]
