"""Bit clock: found by a periodogram, then tracked by a PI loop.

Acquisition. The light's edges lie on b_0 + m T, T unknown within +-5.5 %. Time is cut into blocks of 16 nominal bits
and sub-bins of a sixteenth of a bit, with counts c_p[i] of polarity p. A block's sums, taken about its centre, barely
change with f, so nine of them serve all offsets, and a window's periodogram costs a few operations a block::

    S_p(b, f) = sum_i in b c_p[i] exp(-2 pi j f (i / 16 - centre_b))      f in bits a nominal bit, 1 +- 0.055
    R_p(f)    = sum_b exp(-2 pi j f centre_b) S_p(b, nearest of nine f)
    z(f)      = sum_p |R_p(f)|^2 / sum_i (c_p[i] - mean c_p)^2            noise: exp(-z) (1 + z)

Each polarity counts by its own power: a falling LED's edge may trail over more than a bit, in many events without a
phase, beside which sharp rises must not drown.

Windows of 64 bits, and of 256 where 64 do not suffice (jitter, noise). Few clocks are more than 2.5 % off, so a rate
beyond counts with RARE nats less: noise finds hardly more clocks than in the narrow span alone, and good clocks are
found as soon. f is the peak, refined by a parabola. A word of n bits that repeats has lines 1 / n from its bit rate,
nearly as high where its edges lie close together; so peaks nearly as high as the highest are told too, and who looks
for frames chooses (`heliograph.link.beginning`). NRZ bits have a spectral null at the bit rate, so what a *lit* LED
does while it moves does not disturb; the edges alone stand out. The phases of R_on and R_off give the delay of each
polarity; the bit grid goes midway between them.

Tracking. After a slot with a transition of polarity p, whose events n[k] lie at offsets x_k from the boundary and are
the transition's own with probability q_p[k] (learned, `heliograph.link.response`)::

    e = sum_k (n[k] - B_p[k]) q_p[k] x_k / sum_k (n[k] - B_p[k]) q_p[k] - mu_p        B: background, learned
    b <- b + T + alpha e        T <- T + alpha^2 / 4 e        damping 1; mu_on = -mu_off: half the polarities' delay
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

# Sub-bins a bit. 8 blur the step response of slow LEDs into one or two bins, 32 starve each bin of events to learn by.
SUB: Final = 16
# Bits of a block, also between two attempts: the longest a lock can come late.
BLOCK_BITS: Final = 16
# Blocks of the short window: 64 bits resolve 1.6 %, so the whole +-5.5 % is seven cells; half of it hardly holds a word
# of 20 bits twice. And of the long one: four times the certainty, a quarter of a second at 1 kbit/s.
SHORT_BLOCKS: Final = 4
LONG_BLOCKS: Final = 16
# Searched offset: crystals keep 0.01 %, RC oscillators of cheap beacons 1 to 5 %; at the edge a peak has two sides.
SPAN: Final = 0.055
# Beyond this a clock is rarer than within, by so many nats: there are half as many resolved offsets again as within.
COMMON: Final = 0.025
RARE: Final = 2.0
# The price rises over so much, a fraction of what a short window resolves: at a step, peaks would be drawn to its edge.
RAMP: Final = 0.005
# Offsets at which a block is summed: at the edge of a block the nearest of nine is wrong by at most 0.055 turns.
BLOCK_OFFSETS: Final = 9
# Offsets a window is searched at, per block: a quarter of the resolution.
STEPS_PER_BLOCK: Final = 7
# Two lines within one and a half of the resolution may cancel where they overlap, so many steps wide.
DIP: Final = 6
# Peaks told at most: the highest, and a line of the word's on either side.
PEAKS: Final = 3
# Of the highest, from here on another may be the bit rate: two edges of a polarity, 2 bits of 20 apart, leave .90.
AS_HIGH: Final = 0.7
# Numbers of a block: for each offset the real and imaginary sums of OFF and ON; then the power of both.
POWER: Final = 4 * BLOCK_OFFSETS
SUMS: Final = POWER + 2
# exp(-z) (1 + z) times the independent offsets and as many between them, those beyond COMMON by exp(-RARE): 5e-4 * 10
# and 8e-5 * 33, a wrong lock in noise once in 200 and in 380 attempts. It costs no more than time.
THRESHOLD_SHORT: Final = 10.0
THRESHOLD_LONG: Final = 12.0
# Loop gain at lock and in the long run: the first pulls .1 bit of error in within one frame of seed11, the second
# averages jitter over some 20 transitions and still follows a drift of 100 ppm within .01 bit.
GAIN_START: Final = 0.15
GAIN_END: Final = 0.04
GAIN_SLOTS: Final = 32
# A clock outside this is no clock of the nominal rate.
CLOCK_LIMIT: Final = 0.065


def _turned() -> Floats:
    """Return (cells, BLOCK_OFFSETS, 2) the real and imaginary part of each cell's turn about the block's centre."""
    from_centre = (np.arange(BLOCK_BITS * SUB) + 0.5) / SUB - 0.5 * BLOCK_BITS
    f = 1.0 + SPAN * np.linspace(-1.0, 1.0, BLOCK_OFFSETS)
    angle = -2.0 * math.pi * np.outer(from_centre, f)
    return np.stack([np.cos(angle), np.sin(angle)], axis=2)


_TURNED: Final = _turned()


@numba.njit(cache=True, nogil=True)
def block(t: Floats, on: npt.NDArray[np.bool_], sums: Floats) -> None:
    """Sum one block.

    Args:
        t: (n,) event times in nominal bits from the block's beginning, in [0, BLOCK_BITS).
        on: (n,) polarities.
        sums: (SUMS,) out.
    """
    cells = BLOCK_BITS * SUB
    counts = np.zeros((2, cells))
    for i in range(len(t)):
        counts[1 if on[i] else 0, max(0, min(int(t[i] * SUB), cells - 1))] += 1.0
    sums[:] = 0.0
    for p in range(2):
        sums[POWER + p] = -(counts[p].sum() ** 2) / cells
    for cell in range(cells):
        off, lit = counts[0, cell], counts[1, cell]
        if off + lit == 0.0:
            continue
        sums[POWER] += off * off
        sums[POWER + 1] += lit * lit
        for o in range(BLOCK_OFFSETS):
            re, im = _TURNED[cell, o, 0], _TURNED[cell, o, 1]
            sums[4 * o] += off * re
            sums[4 * o + 1] += off * im
            sums[4 * o + 2] += lit * re
            sums[4 * o + 3] += lit * im


@numba.njit(cache=True, nogil=True)
def peak(sums: Floats) -> tuple[float, float]:
    """Return the bit rate, in bits a nominal bit, that the window of these blocks shows, and its z (less RARE).

    Args:
        sums: (blocks, SUMS), oldest first.
    """
    z = _spectrum(sums)
    best = int(np.argmax(z))
    return _refined(z, best) if z[best] > 0.0 else (1.0, 0.0)


@numba.njit(cache=True, nogil=True)
def peaks(sums: Floats, threshold: float, found: Floats) -> int:
    """Find the bit rates that the window of these blocks may show.

    Args:
        sums: (blocks, SUMS), oldest first.
        threshold: z of the highest; where it is below, it alone is told.
        found: (PEAKS, 2) out: rate and z as of `peak`, the highest first.

    Returns:
        How many there are, at least 1.
    """
    z = _spectrum(sums)
    top = z.max()
    n = 0
    while n < len(found):
        best = int(np.argmax(z))
        if n > 0 and (z[best] < AS_HIGH * top or z[best] < threshold):
            break
        found[n, 0], found[n, 1] = _refined(z, best) if z[best] > 0.0 else (1.0, 0.0)
        n += 1
        if top < threshold:
            break
        # This peak is done with, down to either foot.
        left, right = best, best
        while left > 0 and z[left - 1] <= z[left]:
            left -= 1
        while right < len(z) - 1 and z[right + 1] <= z[right]:
            right += 1
        z[left : right + 1] = 0.0
    return n


@numba.njit(cache=True, nogil=True)
def lobes(sums: Floats, share: float) -> Floats:
    """Return (n,) the bit rates with a share of the greatest z, a quarter of the resolution apart, and those in a dip.

    Args:
        sums: (blocks, SUMS), oldest first.
        share: 0 to 1.
    """
    z = _spectrum(sums)
    steps = len(z)
    least = share * z.max()
    out = np.empty(steps)
    n, last = 0, -steps
    for s in range(steps):
        if z[s] < least:
            continue
        for between in range(last + 1 if s - last <= DIP else s, s + 1):
            out[n] = _rate(between, steps)
            n += 1
        last = s
    return out[:n]


@numba.njit(cache=True, nogil=True)
def _rate(step: float, steps: int) -> float:
    return 1.0 + SPAN * (2.0 * step / (steps - 1) - 1.0)


@numba.njit(cache=True, nogil=True)
def _refined(z: Floats, at: int) -> tuple[float, float]:
    """Return the rate and the height of a peak, by a parabola through it and its neighbours."""
    steps = len(z)
    if 0 < at < steps - 1:
        bend = z[at - 1] - 2.0 * z[at] + z[at + 1]
        slope = z[at - 1] - z[at + 1]
        if bend < 0.0 and abs(slope) <= -bend:
            return _rate(at + 0.5 * slope / bend, steps), z[at] - 0.125 * slope * slope / bend
    return _rate(float(at), steps), z[at]


@numba.njit(cache=True, nogil=True)
def _spectrum(sums: Floats) -> Floats:
    """Return z of a window at offsets from -SPAN to SPAN, in equal steps, less RARE beyond COMMON."""
    blocks = sums.shape[0]
    off, lit = 0.0, 0.0
    for b in range(blocks):
        off += sums[b, POWER]
        lit += sums[b, POWER + 1]
    steps = STEPS_PER_BLOCK * blocks + 1
    z = np.zeros(steps)
    if off <= 0.0 and lit <= 0.0:
        return z
    for s in range(steps):
        offset = 2.0 * s / (steps - 1) - 1.0
        nearest_offset = round((offset + 1.0) * 0.5 * (BLOCK_OFFSETS - 1))
        z[s] = _coherence(sums, 1.0 + SPAN * offset, nearest_offset, off, lit)
        beyond = min(max(abs(offset) * SPAN - COMMON, 0.0) / RAMP, 1.0)
        z[s] = max(z[s] - beyond * RARE, 0.0)
    return z


@numba.njit(cache=True, nogil=True)
def _coherence(sums: Floats, f: float, nearest: int, off: float, lit: float) -> float:
    """Return z at f; off and lit are the powers, one of them above 0."""
    off_re, off_im, on_re, on_im = 0.0, 0.0, 0.0, 0.0
    for b in range(sums.shape[0]):
        angle = -2.0 * math.pi * f * (b + 0.5) * BLOCK_BITS
        re, im = math.cos(angle), math.sin(angle)
        s = sums[b, 4 * nearest : 4 * nearest + 4]
        off_re += s[0] * re - s[1] * im
        off_im += s[0] * im + s[1] * re
        on_re += s[2] * re - s[3] * im
        on_im += s[2] * im + s[3] * re
    z = (off_re**2 + off_im**2) / off if off > 0.0 else 0.0
    return z + (on_re**2 + on_im**2) / lit if lit > 0.0 else z


@numba.njit(cache=True, nogil=True)
def grid(t: Floats, on: npt.NDArray[np.bool_], f: float, until: float, found: Floats, folded: Floats) -> None:
    """Lay the bit grid through a window's events, and fold them on it.

    Args:
        t: (n,) event times in nominal bits, n > 0.
        on: (n,) polarities.
        f: bits a nominal bit.
        until: end of the window.
        found: (4,) out: the boundary before the first event, the period (nominal bits), half the delay ON - OFF (bits),
            and the slots folded.
        folded: (2, SUB) out: events a slot, by polarity (OFF, ON) and sub-bin; the boundary is at SUB / 2.
    """
    off_re, off_im, on_re, on_im = 0.0, 0.0, 0.0, 0.0
    for i in range(len(t)):
        angle = 2.0 * math.pi * f * t[i]
        if on[i]:
            on_re += math.cos(angle)
            on_im += math.sin(angle)
        else:
            off_re += math.cos(angle)
            off_im += math.sin(angle)
    phase_off = math.atan2(off_im, off_re) / (2.0 * math.pi)
    phase_on = math.atan2(on_im, on_re) / (2.0 * math.pi)
    apart = phase_on - phase_off
    apart -= round(apart)
    weight_off, weight_on = math.hypot(off_re, off_im), math.hypot(on_re, on_im)
    # With one polarity all but absent its phase means nothing.
    half = 0.5 * apart if min(weight_off, weight_on) > 0.2 * max(weight_off, weight_on) else 0.0
    middle = phase_off + half if weight_off >= weight_on else phase_on - half
    period = 1.0 / f
    found[0] = (middle + math.floor(t[0] * f - middle)) * period
    found[1] = period
    found[2] = half
    folded[:] = 0.0
    for i in range(len(t)):
        slot = (t[i] - found[0]) * f + 0.5
        k = min(int((slot - math.floor(slot)) * SUB), SUB - 1)
        folded[1 if on[i] else 0, k] += 1.0
    found[3] = max((until - t[0]) * f, 8.0)
    folded /= found[3]
