"""The front end of `heliograph.link.wang2022`: a leaky sum of signed events, its strong samples, bits in their middles.

At each event, with p = +1 (brighter) or -1 (darker), step C and time constant tau::

    S <- S exp(-(t - t_before) / tau) + C p
    S > upper: a strong sample 1         S < lower: a strong sample 0         else: no sample

A character begins at t_0, a strong 0 after a strong 1 (or the first sample of all: an idle LED is lit) while armed.
Bit k (of start, seven data, parity, first stop bit) is looked at in its middle, m_k = t_0 + (k + middle) T: what most
strong samples within window T of m_k are, and where they are none or even, the last strong sample up to m_k. After the
last of them the receiver is armed again, in the first stop bit. The second stop bit is not read.

Nothing depends on how the input is cut: a bit is decided when no more events can lie in its window.
"""

from __future__ import annotations

from math import exp
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times

BITS: Final = 10  # start, data, parity, first stop bit
# State. Floats: the sum, the time of its last event, t_0, and the time up to which falls are no start.
SUM, SINCE, START, ARMED = range(4)
FLOATS: Final = 4
# Ints: the last strong sample (-1: none yet), the bit that is read (-1: idle), strong samples of its window (ones less
# zeros), the last strong sample up to its middle, and the bits so far.
LEVEL, BIT, VOTE, HELD, WORD = range(5)
INTS: Final = 5


def new_state() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return the state before the first event: (4,) float64 and (5,) int64."""
    floats = np.zeros(FLOATS, np.float64)
    floats[ARMED] = -np.inf
    return floats, np.array([-1, -1, 0, -1, 0], np.int64)


@numba.njit(cache=True, nogil=True)
def read(
    t_us: Times, on: Flags, until_us: float, setting: npt.NDArray[np.float64], floats: npt.NDArray[np.float64],
    ints: npt.NDArray[np.int64], starts: npt.NDArray[np.float64], words: npt.NDArray[np.int64],
) -> tuple[int, int]:  # fmt: skip
    """Take events; return how many were taken and how many words were read.

    Args:
        t_us: (n,) int64, not falling.
        on: (n,) bool.
        until_us: there are no more events before it.
        setting: tau_us, step, upper, lower, middle, window (bits), T (us).
        floats: state, changed.
        ints: state, changed.
        starts: takes t_0 of each word read; with room for one more the reading goes on.
        words: takes its ten bits, the start bit first.
    """
    tau_us, step, upper, lower = setting[0], setting[1], setting[2], setting[3]
    middle, window, t_bit = setting[4], setting[5], setting[6]
    made = 0
    for i in range(len(t_us) + 1):
        t = np.float64(t_us[i]) if i < len(t_us) else until_us
        while ints[BIT] >= 0 and t >= floats[START] + (ints[BIT] + middle + window) * t_bit:
            if made == len(starts):
                return i, made
            vote = ints[VOTE]
            bit = ints[HELD] if vote == 0 else (1 if vote > 0 else 0)
            ints[WORD] = 2 * ints[WORD] + bit
            ints[VOTE] = 0
            ints[HELD] = ints[LEVEL]
            ints[BIT] += 1
            if ints[BIT] == BITS:
                starts[made], words[made] = floats[START], ints[WORD]
                made += 1
                floats[ARMED] = floats[START] + (BITS - 1 + middle) * t_bit
                ints[BIT] = -1
        if i == len(t_us):
            break
        sign = 1 if on[i] else -1
        if ints[LEVEL] == -1 and floats[SUM] == 0.0:
            floats[SINCE] = t
        floats[SUM] = floats[SUM] * exp(-(t - floats[SINCE]) / tau_us) + step * sign
        floats[SINCE] = t
        if lower <= floats[SUM] <= upper:
            continue
        sample = 1 if floats[SUM] > upper else 0
        if ints[BIT] < 0 and sample == 0 and ints[LEVEL] != 0 and t >= floats[ARMED]:
            floats[START] = t
            ints[BIT], ints[VOTE], ints[HELD], ints[WORD] = 0, 0, 0, 0
        ints[LEVEL] = sample
        if ints[BIT] >= 0:
            at = floats[START] + (ints[BIT] + middle) * t_bit
            if t <= at:
                ints[HELD] = sample
            if abs(t - at) < window * t_bit:
                ints[VOTE] += 2 * sample - 1
    return len(t_us), made
