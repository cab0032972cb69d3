"""Which data were sent? Viterbi's decision of the convolutional code (`heliograph.link.convolutional`) on soft bits.

With l[i] = ln P(bit i is 0) / P(it is 1), l = 0 where it was not sent, the data are those u that maximise

    M(u) = sum_i (1 - 2 c_i(u)) l[i]

over the trellis of 64 states s[t] = (u[t-1] .. u[t-6]), u[t-1] most significant. Of equal metrics the path from the
lower state wins, so that the decision is the same everywhere.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.convolutional import POLYNOMIALS, STATES, TAIL

Floats = npt.NDArray[np.float64]
Octets = npt.NDArray[np.uint8]


def _signs() -> Floats:
    """Return (64, 2, 2): 1 - 2 c of branch A and B, by the state before and the bit."""
    signs = np.empty((STATES, 2, 2))
    for state in range(STATES):
        for bit in range(2):
            register = (bit << TAIL) | state
            for branch, polynomial in enumerate(POLYNOMIALS):
                signs[state, bit, branch] = 1.0 - 2.0 * ((register & polynomial).bit_count() & 1)
    return signs


SIGNS: Final = _signs()


@numba.njit(nogil=True)
def viterbi(soft: Floats, signs: Floats, data: Octets) -> float:
    """Decide the data; the encoder began and ended in state zero.

    Args:
        soft: (2 steps,) l, in the order of the mother code.
        signs: SIGNS.
        data: (steps,) out: the bits, tail included.

    Returns:
        The metric M of the decision.
    """
    steps = len(data)
    half = STATES // 2
    came = np.empty((steps, STATES), np.uint8)
    metric, after = np.full(STATES, -np.inf), np.empty(STATES)
    metric[0] = 0.0
    for t in range(steps):
        a, b = soft[2 * t], soft[2 * t + 1]
        for state in range(STATES):
            # s[t+1] holds the bit and the five newest of s[t]: it came from 2 (s mod 32), or from that and one.
            bit = state >> (TAIL - 1)
            even = 2 * (state & (half - 1))
            from_even = metric[even] + signs[even, bit, 0] * a + signs[even, bit, 1] * b
            from_odd = metric[even + 1] + signs[even + 1, bit, 0] * a + signs[even + 1, bit, 1] * b
            came[t, state] = from_odd > from_even
            after[state] = max(from_even, from_odd)
        metric, after = after, metric
    state = 0
    for t in range(steps - 1, -1, -1):
        data[t] = state >> (TAIL - 1)
        state = 2 * (state & (half - 1)) + came[t, state]
    return float(metric[0])


@numba.njit(nogil=True)
def encode_into(data: Octets, mother: Octets) -> None:
    """Set mother (2 steps,) to the code bits of the data (steps,), tail included."""
    register = 0
    for t in range(len(data)):
        register = (int(data[t]) << TAIL) | (register >> 1)
        for branch in range(2):
            masked = register & POLYNOMIALS[branch]
            parity = 0
            while masked:
                parity ^= masked & 1
                masked >>= 1
            mother[2 * t + branch] = parity
