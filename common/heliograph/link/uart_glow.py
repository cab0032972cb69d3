"""The glow of a lit LED that moves, followed from character to character.

Lit, an image that moves makes events all the time; dark, or at rest, it makes none. What the step response has learned
(`heliograph.link.step_response`) holds that glow as it was on average. Where the light turns, its glow is gone within
ten characters and back within ten more, while the response takes three hundred: lit bits then look dark, and dark ones,
between two edges, lit. So of every sub-bin in which the LED is lit the response's mean is corrected by ::

    (r - 1) m[q]       m[q]   mean events a sub-bin of polarity q in the bits that follow a lit bit, as learned
                       r      = (y / F + a) / (m n / F + a)

with y the events of the *last* character in its n such sub-bins, m the sum of m[0] and m[1], and F the overdispersion:
the mean of a Gamma law of scale 1 and shape a, given y. A character ends in two stop bits, so there is always one such
bit. A light at rest has hardly any events there (m n is small), and is left as it is.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.uart_layout import CONTEXTS

Array = npt.NDArray[np.float64]

# a: a light of steady motion is known to be one only by what it shows; two events' worth says "as before". With eight
# the first characters of a turn are lost; memory of the characters before the last one costs more than it steadies.
SHAPE: Final = 2.0


@numba.njit(cache=True, nogil=True)
def lit_events(
    counts: npt.NDArray[np.int32], start: int, slots: npt.NDArray[np.int64], word: int, before: int, sub_bins: int
) -> tuple[int, int]:
    """Return how many events lie in the lit bits of a word that follow a lit bit, and how many sub-bins those have.

    Args:
        counts: (n, 2) int32, events a sub-bin, ON and OFF.
        start: sub-bin of the word's first bit.
        slots: (bits,) int64, offsets of the bits' first sub-bins.
        word: the bits, first on the air = most significant.
        before: context of the bit before the word.
        sub_bins: a bit.
    """
    events, n = 0, 0
    bits = slots.shape[0]
    last = before & 1
    for i in range(bits):
        bit = (word >> (bits - 1 - i)) & 1
        if bit & last:
            for j in range(start + slots[i], start + slots[i] + sub_bins):
                events += counts[j, 0] + counts[j, 1]
            n += sub_bins
        last = bit
    return events, n


@numba.njit(cache=True, nogil=True)
def correction(seen: Array, sums: Array, events: int, n: int, f: float, shape: float, glow: Array) -> None:
    """Fill glow (2,): events a sub-bin by which the LED's lit sub-bins differ now from what was learned.

    Args:
        seen: (32,) bits learned, by context.
        sums: (2, 32, 16) their events.
        events: of the last character, in lit bits that follow a lit bit.
        n: number of their sub-bins.
        f: overdispersion.
        shape: a (see the module).
        glow: (2,) out.
    """
    glow[:] = 0.0
    bits = 0.0
    for c in range(3, CONTEXTS, 4):
        bits += seen[c]
        glow[0] += sums[0, c].sum()
        glow[1] += sums[1, c].sum()
    if bits == 0.0 or n == 0:
        glow[:] = 0.0
        return
    glow /= bits * sums.shape[2]
    expected = (glow[0] + glow[1]) * n
    glow *= (events / f + shape) / (expected / f + shape) - 1.0
