"""A genie of fast on-off keying: it knows each bit's boundary, and what the light looks like (for `study_fast.py`).

It takes the same counts by slot, the same contexts and the same cheapest path as the receiver
(`heliograph.link.ook_kernel`), but its slots are the true ones, its contexts are learned on the true bits of this very
run, twice over, and it is told refractory time, jitter and number of pixels: an edge j bits after another finds the
share Phi((refractory - j bit) / (sqrt(2) jitter)) of the pixels that told that one still blind. What it reads wrong is
the light's fault, or that of five bits of context: with more jitter than .8 bit an edge reaches further.
"""

from __future__ import annotations

from math import erf

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times
from heliograph.link import ook_kernel as kernel

Floats = npt.NDArray[np.float64]
Learned = tuple[Floats, Floats, Floats, Floats]


@numba.njit(nogil=True)
def _teach(bits: npt.NDArray[np.int64], counts: Floats, pixels: float, learned: Learned) -> None:
    xs = np.zeros((kernel.RING, 2))
    for k in range(len(bits)):
        xs[k % kernel.RING] = counts[k]
        if 8 < k < len(bits) - 1:
            c = 0
            for bit in bits[k - 3 : k + 2]:
                c = 2 * c + bit
            kernel.learn(k, xs, c, pixels, learned)


@numba.njit(nogil=True)
def _read(counts: Floats, pixels: float, learned: Learned) -> npt.NDArray[np.int64]:
    xs = np.zeros((kernel.RING, 2))
    cost, back = np.zeros(kernel.STATES), np.zeros((kernel.RING, kernel.STATES), np.int64)
    out = np.zeros(len(counts), np.int64)
    for k in range(len(counts) + kernel.DEPTH):
        xs[k % kernel.RING] = 0.0
        if k < len(counts):
            xs[k % kernel.RING] = counts[k]
        if k > 0:
            kernel.step(k, xs, pixels, learned, cost, back)
        if k > kernel.DEPTH + 4:
            out[k - kernel.DEPTH] = kernel.settled(k, kernel.DEPTH, cost, back) & 1
    return out


def read(
    bits: npt.NDArray[np.int64],
    t_us: Times,
    on: Flags,
    begin_us: float,
    bit_us: float,
    light: tuple[int, float, float],
) -> npt.NDArray[np.int64]:
    """Return (n,) what it reads of the bits.

    Args:
        bits: (n,) that were sent.
        t_us: (m,) events.
        on: (m,) their polarities.
        begin_us: when the first bit began.
        bit_us: length of a bit.
        light: pixels, jitter in us, refractory time in us.
    """
    pixels, jitter_us, refractory_us = light
    # Events are stamped in whole microseconds, rounded down.
    slot = np.floor((t_us + 0.5 - begin_us) / bit_us + 0.5).astype(np.int64)
    counts = np.zeros((len(bits), 2))
    inside = (slot >= 0) & (slot < len(bits))
    np.add.at(counts, (slot[inside], on[inside].astype(np.int64)), 1.0)
    n = kernel.CONTEXTS
    learned = np.zeros((n, 2)), np.ones((n, 2)), np.zeros(n), np.zeros(kernel.BLIND)
    sigma = jitter_us / bit_us
    kernel.guess(float(pixels), float(pixels), sigma, False, 0.0, learned)
    for j in range(kernel.BLIND):
        learned[3][j] = 0.5 + 0.5 * erf((refractory_us / bit_us - j - 1) / (2.0 * sigma))
    for _ in range(2):
        _teach(bits, counts, float(pixels), learned)
    return _read(counts, float(pixels), learned)
