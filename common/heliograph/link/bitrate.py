"""First guesses of an unknown bit rate, each good to a per cent: what the receivers' own clocks (+-2.5 %) start from.

Changes. The light changes where the sum of its signed events turns (`heliograph.link.turns`). A change is timed by its
first event, with h a third of the usual swing; noise hides that event, so it is also timed by the one that completes h,
half of the usual swing, and what is more coherent counts.

Rate. An NRZ signal changes at whole numbers of bits. The intervals d_i between changes of the same polarity are k_i T +
noise, k_i = 2, 3, ..., whatever the delay of that polarity; of each change the next and the next but one are taken. The
intervals between a rise and the next fall have one common offset, those between a fall and the next rise the opposite
one. For a candidate T::

    C(T) = min( mean_i cos(2 pi d_i / T),  1.5 sqrt((|E_rf|^2 + |E_fr|^2) / 2) )        E = mean_j exp(2 pi j d_j / T)

is near 1 at the true T and at T / 2, T / 3, ...; among n random intervals the first exceeds x with the chance
exp(-n x^2), and the second tells T from 2 T where a word's intervals happen to be even. A bit is at most half of an
interval between equal changes.

The highest peak need not be the right one: a sensor that is read out in scans shows all changes on the grid of its
scans (of rate s: C near 1), and has images at k s +- 1/T; and a short word has few intervals. So several are named, and
who reads something decides; fractions of a longer bit that are no more coherent, and images, are left out. A word whose
intervals between changes are all odd shows 2 T as well as T, but with an offset of T between its polarities, as if OFF
events came half a bit of 2 T late: so where ``mean_j cos(2 pi d_j / T)`` of all neighbours is negative at 2 T and not
at T, T is named too. A periodic light (a lamp, a word with a single run of ones) has one interval alone: its T would be
a guess.
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times
from heliograph.link.turns import turns
from heliograph.units import US_PER_S

Floats = npt.NDArray[np.float64]

# Changes used at most, the newest: enough for any code, and a bound on the work (800 x 1200 turns, 10 ms).
CHANGES: Final = 400
# Fewer could not be coherent enough to be no chance (`SURPRISE`): the words of fewest edges then name 50 bit/s in .6 s.
INTERVALS_LEAST: Final = 14
# h, in swings to which half of all that S moves belongs; and whether the first event is the time.
TURNS: Final = ((1.0 / 3.0, True), (1.0 / 2.0, False))
# 50 bit/s to 20 kbit/s, and clocks that are 3 % off.
F_MIN: Final = 48.5
F_MAX: Final = 20_600.0
# Candidates lie this far apart, as a share: a tenth of a turn at the longest run of 20 bits.
RESOLUTION: Final = 0.005
# exp(-n C^2) for random intervals, times some 500 periods that are independent: one in a thousand.
SURPRISE: Final = 13.0
# Below it a rate is not worth a receiver, however many intervals there are: slow lights are a little coherent anywhere.
COHERENT: Final = 0.25
# Of the highest peak: that of a sensor's scans is 1, that of bits of 2.5 scans .5.
OF_THE_BEST: Final = 0.35
SCANNED: Final = 0.85
IMAGE: Final = 0.01  # of the rate: as far as an image may lie from where it mirrors
# Receivers cost what their bits cost.
RATES: Final = 6
# Candidates this near to a whole fraction of a longer one, as a share, are that one's.
FRACTION: Final = 0.02
BETTER: Final = 0.1
STRAIGHTER: Final = 1.0
# Intervals this near to their median, as a share, are the same: a lamp's flicker keeps 1 %, jitter adds the rest.
PERIODIC_SPREAD: Final = 0.06


def likely_bit_rates(t_us: Times, on: Flags, f_min: float = F_MIN, f_max: float = F_MAX) -> tuple[float, ...]:
    """Return the likely bit rates of one light's events, the lowest first; none where none is likely.

    Args:
        t_us: (n,) event times, not falling.
        on: (n,) polarities.
        f_min: lowest rate considered, bit/s.
        f_max: highest.

    Returns:
        At most `RATES` rates, bit/s; none when there are too few changes, none fits, or the light is periodic.

    Raises:
        ValueError: 0 < f_min < f_max does not hold.
    """
    if not 0.0 < f_min < f_max:
        raise ValueError(f"f_min and f_max must obey 0 < f_min < f_max, not {f_min}, {f_max}")
    likely: list[tuple[float, float]] = []
    for share, by_first in TURNS:
        at_us, rises = _changes(t_us, on, share, by_first=by_first)
        intervals = _alike(at_us, rises)
        if len(intervals) < INTERVALS_LEAST:
            continue
        if _periodic(intervals):
            return ()
        likely = max(likely, _coherent(at_us, rises, US_PER_S / f_max, US_PER_S / f_min))
    return tuple(sorted(US_PER_S / bit_us for _, bit_us in likely))


def _changes(t_us: Times, on: Flags, share: float, *, by_first: bool) -> tuple[Floats, Flags]:
    """Return the times of the light's changes, at most `CHANGES`, and whether they are rises; they alternate."""
    at, swing = turns(on, share, by_first=by_first, balanced=True)
    return t_us[at[-CHANGES:]].astype(np.float64), swing[-CHANGES:] > 0.0


def _alike(at_us: Floats, rises: Flags) -> Floats:
    """Return the intervals between successive changes of the same polarity."""
    return np.concatenate([np.diff(at_us[rises]), np.diff(at_us[~rises])])


def _periodic(intervals: Floats) -> bool:
    """Return whether nearly all intervals are the same."""
    middle = float(np.median(intervals))
    return float(np.mean(np.abs(intervals - middle) < PERIODIC_SPREAD * middle)) > 0.9


@numba.njit(cache=True, nogil=True)
def _coherence(at_us: Floats, first_rises: bool, bits_us: Floats, coherence: Floats, straight: Floats) -> None:
    """Fill coherence with C of each bit length, straight with the neighbours' mean cosine; at_us alternate."""
    n = len(at_us)
    for k in range(len(bits_us)):
        turn = 2.0 * math.pi / bits_us[k]
        alike = 0.0
        sums = np.zeros(4)
        # Products of the last interval, of the last two, and of the two before the last: the changes' own phases.
        re1 = im1 = re2 = im2 = older_re = older_im = 0.0
        for i in range(1, n):
            angle = turn * (at_us[i] - at_us[i - 1])
            re, im = math.cos(angle), math.sin(angle)
            side = 2 if (i & 1) == first_rises else 0
            sums[side] += re
            sums[side + 1] += im
            two_re, two_im = re * re1 - im * im1, re * im1 + im * re1
            if i > 1:
                alike += two_re
            if i > 3:
                alike += two_re * older_re - two_im * older_im
            re1, im1 = re, im
            older_re, older_im, re2, im2 = re2, im2, two_re, two_im
        half = 0.5 * (n - 1)
        apart = (sums[0] ** 2 + sums[1] ** 2 + sums[2] ** 2 + sums[3] ** 2) / (2.0 * half * half)
        coherence[k] = min(alike / (2 * n - 6), 1.5 * math.sqrt(apart))
        straight[k] = (sums[0] + sums[2]) / (n - 1)


def _coherent(at_us: Floats, rises: Flags, shortest_us: float, longest_us: float) -> list[tuple[float, float]]:
    """Return (C, bit) of at most `RATES` bits whose C stands out, the greatest C first."""
    intervals = _alike(at_us, rises)
    # Half of the median interval is a bit or more; noise and jitter add a tenth.
    top_us = min(longest_us, 0.55 * float(np.median(intervals)))
    if top_us <= shortest_us:
        return []
    bits_us = np.geomspace(shortest_us, top_us, int(math.log(top_us / shortest_us) / RESOLUTION) + 2)
    coherence, straight = np.empty(len(bits_us)), np.empty(len(bits_us))
    _coherence(at_us, bool(rises[0]), bits_us, coherence, straight)
    around = np.concatenate([[-1.0], coherence, [-1.0]])
    peaks = np.flatnonzero((coherence >= around[:-2]) & (coherence > around[2:]))
    least = max(COHERENT, math.sqrt(SURPRISE / len(intervals)), OF_THE_BEST * float(coherence.max()))
    found: list[tuple[float, float, float]] = []
    for peak in peaks[coherence[peaks] >= least][::-1]:
        bit_us, c, s = _refined(intervals, float(bits_us[peak])), float(coherence[peak]), float(straight[peak])
        longer = [one for one in found if _is_fraction(one[2] / bit_us)]
        if all(c >= one[0] + BETTER or s >= one[1] + STRAIGHTER for one in longer):
            found.append((c, s, bit_us))
    return sorted(_without_images([(c, bit_us) for c, _, bit_us in found]), reverse=True)[:RATES]


def _is_fraction(ratio: float) -> bool:
    return abs(ratio - round(ratio)) < FRACTION * ratio


def _without_images(found: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Leave out the rates that mirror a lower one at a multiple of a scan's rate; found is (C, bit).

    A scan's grid holds all changes, so nothing is more coherent than it.
    """
    for scan_c, scan in [(c, US_PER_S / bit_us) for c, bit_us in found if c > SCANNED]:
        kept: list[tuple[float, float]] = []
        offsets: list[float] = []
        for c, bit_us in sorted(found, key=lambda one: -one[1]):
            rate = US_PER_S / bit_us
            offset = abs(rate - scan * round(rate / scan))
            if rate == scan or c > scan_c:
                # What mirrors the scan itself is a multiple, and has been judged as a fraction of its bit.
                kept.append((c, bit_us))
            elif not any(abs(offset - other) < IMAGE * rate for other in offsets):
                kept.append((c, bit_us))
                offsets.append(offset)
        found = kept
    return found


def _refined(intervals: Floats, bit_us: float) -> float:
    """Return the bit by least squares through d_i = k_i T."""
    k = np.round(intervals / bit_us)
    use = (k > 0) & (np.abs(intervals - k * bit_us) < 0.25 * bit_us)
    if not use.any():
        return bit_us
    return float((k[use] * intervals[use]).sum() / (k[use] ** 2).sum())


def warm() -> None:
    """Compile, or load from the cache, the kernels of this module."""
    _changes(np.arange(2), np.array([True, False]), 0.5, by_first=True)
    _coherence(np.arange(5.0), True, np.ones(1), np.empty(1), np.empty(1))
