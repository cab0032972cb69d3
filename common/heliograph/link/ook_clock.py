"""The clock of fast on-off keying: two ways to see it, for sharp edges and for smeared ones.

Sharp. The periodogram of the events (`heliograph.link.clock`): a line at the bit rate, whose amplitude an event jitter
of s bits leaves ``exp(-2 pi^2 s^2)`` of: .17 at .3, .0008 at .6.

Smeared. Of the signed density d(t) = ON - OFF the part about half of the bit rate is kept, and squared::

    y = d * w,   W(f) = exp(-((f - 1/2) / W)^2 / 2),   Q(f) = sum y^2 exp(-2 pi j f t),   f in 1 +- .025

Alternating bits swing there, and their square has a line at the bit rate; jitter leaves ``exp(-pi^2 s^2)`` of it: .41
at .3, .029 at .6, .0018 at .8. What is nearer to 0 or 1 than to 1/2 holds no clock, only noise. (Timing from the
square of a filtered signal: Oerder and Meyr 1988; the filter about half the rate: Franks and Bubrouski 1974.) The line
is measured against what lies around it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags
from heliograph.link import clock

Floats = npt.NDArray[np.float64]

# Sub-bins a bit: y ends at .8, its square at 1.6 of the bit rate.
SUB: Final = 8
# Of .1, .15, .2 and .35 the widest loses least where edges are sharp, the narrowest where they are smeared; in between.
WIDTH: Final = 0.15
SPAN: Final = clock.SPAN
# The line's surroundings, beyond the span that is searched.
AROUND: Final = 0.15
# In noise exp(-z) times the cells searched, 53 of 1024 bits: one window in 20,000.
THRESHOLD: Final = 14.0
# Points a cell about the peak, and cells on either side.
FINE: Final = 4


def sharp(t: Floats, on: Flags, blocks: int) -> tuple[float, float]:
    """Return bits a nominal bit and z of the periodogram of a window.

    Args:
        t: (n,) times in nominal bits from the window's beginning, not falling.
        on: (n,) polarities.
        blocks: of `clock.BLOCK_BITS` bits, in the window.
    """
    sums = np.zeros((blocks, clock.SUMS))
    cuts = np.searchsorted(t, np.arange(blocks + 1) * float(clock.BLOCK_BITS))
    for b in range(blocks):
        own = slice(cuts[b], cuts[b + 1])
        clock.block(t[own] - b * clock.BLOCK_BITS, on[own], sums[b])
    f, z = clock.peak(sums)
    return float(f), float(z)


def smeared(t: Floats, on: Flags, bits: int) -> tuple[float, float, float]:
    """Return bits a nominal bit, z, and a boundary (nominal bits, in [0, 1)) of a window by the square of its swing.

    Args:
        t: (n,) times in nominal bits from the window's beginning, in [0, bits).
        on: (n,) polarities.
        bits: nominal bits in the window.
    """
    n = bits * SUB
    cells = np.minimum((t * SUB).astype(np.int64), n - 1)
    density = np.bincount(cells, weights=np.where(on, 1.0, -1.0), minlength=n)
    frequency = np.arange(n // 2 + 1) / bits
    swing = np.fft.irfft(np.fft.rfft(density) * np.exp(-0.5 * ((frequency - 0.5) / WIDTH) ** 2), n)
    square = swing * swing
    power = np.abs(np.fft.rfft(square)) ** 2
    apart = np.abs(frequency - 1.0)
    floor = float(power[(apart > 1.2 * SPAN) & (apart < AROUND)].mean())
    if floor <= 0.0:
        return 1.0, 0.0, 0.0
    best = int(np.argmax(np.where(apart <= SPAN, power, 0.0)))
    at = (np.arange(n) + 0.5) / SUB
    tried = (best + np.arange(-FINE, FINE + 1) / FINE) / bits
    lines = np.array([square @ np.exp(-2j * np.pi * f * at) for f in tried])
    size = np.abs(lines) ** 2
    peak = int(np.argmax(size))
    f = float(tried[peak])
    if 0 < peak < len(tried) - 1:
        bend = size[peak - 1] - 2.0 * size[peak] + size[peak + 1]
        f += 0.5 * float((size[peak - 1] - size[peak + 1]) / bend) / FINE / bits
    phase = float(np.angle(square @ np.exp(-2j * np.pi * f * at))) / (2.0 * np.pi)
    return f, float(size[peak]) / floor, float((-phase % 1.0) / f)
