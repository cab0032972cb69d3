"""A first guess of an unknown bit rate, good to a few per cent: what the receiver's own clock (+-2.5 %) starts from.

An NRZ signal changes at whole numbers of bits. Bursts of one polarity are reduced to their first event (the better
clock than a majority); the intervals d_i between successive changes are then k_i T + noise, k_i = 1, 2, 3, ... For a
candidate T::

    C(T) = mean_i cos(2 pi d_i / T)

is near 1 at the true T and at T / 2, T / 3, ...: the longest T with C within a tenth of the best is taken. All changes
of one polarity share their delay, so intervals between equal changes (ON to ON, OFF to OFF) are used: they do not
depend on the delays of the two polarities, nor on the tail of the slower one.

A periodic light (a lamp, a word with a single run of ones) has one interval alone. Its T would be a guess: refused.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times
from heliograph.units import US_PER_S

Floats = npt.NDArray[np.float64]

# Changes used at most: enough for any code, and a bound on the work (200 x 2000 cosines, 10 ms).
CHANGES: Final = 400
CHANGES_LEAST: Final = 24
# Candidates lie this far apart, as a share: a tenth of a turn at the longest run of 10 bits.
RESOLUTION: Final = 0.005
COHERENT: Final = 0.5
# Intervals this near to their median, as a share, are the same: a lamp's flicker keeps 1 %, jitter adds the rest.
PERIODIC_SPREAD: Final = 0.06


def estimate_bit_rate(t_us: Times, on: Flags, f_min: float = 50.0, f_max: float = 20_000.0) -> float | None:
    """Return the likely bit rate of one light's events, or None.

    Args:
        t_us: (n,) event times, not falling.
        on: (n,) polarities.
        f_min: lowest rate considered, bit/s.
        f_max: highest.

    Returns:
        Bits a second; None when there are too few changes, none fits, or the light is periodic.

    Raises:
        ValueError: 0 < f_min < f_max does not hold.
    """
    if not 0.0 < f_min < f_max:
        raise ValueError(f"f_min and f_max must obey 0 < f_min < f_max, not {f_min}, {f_max}")
    intervals = _intervals(t_us, on, US_PER_S / f_max)
    if len(intervals) < CHANGES_LEAST or _periodic(intervals):
        return None
    return _longest_coherent(intervals, US_PER_S / f_max, US_PER_S / f_min)


def _intervals(t_us: Times, on: Flags, least_us: float) -> Floats:
    """Return the intervals between successive changes of the same polarity."""
    if len(t_us) < 3:
        return np.empty(0)
    first = np.flatnonzero(np.concatenate([np.ones(1, np.bool_), on[1:] != on[:-1]]))
    size = np.diff(np.concatenate([first, [len(on)]]))
    # Lone events between bursts are noise, or motion: a burst counts when it has a third of the usual size, which is
    # that of the burst to which half of all *events* belong, however many lone ones there are.
    largest = np.sort(size)[::-1]
    usual = float(largest[np.searchsorted(np.cumsum(largest), 0.5 * len(on))])
    strong = first[size >= max(1.0, usual / 3.0)]
    polarity = on[strong]
    change = np.concatenate([np.ones(1, np.bool_), polarity[1:] != polarity[:-1]])
    starts, polarity = t_us[strong][change][:CHANGES], polarity[change][:CHANGES]
    rises, falls = starts[polarity], starts[~polarity]
    both = np.concatenate([np.diff(rises), np.diff(falls)]).astype(np.float64)
    return both[both > least_us]


def _periodic(intervals: Floats) -> bool:
    """Return whether nearly all intervals are the same."""
    middle = float(np.median(intervals))
    return float(np.mean(np.abs(intervals - middle) < PERIODIC_SPREAD * middle)) > 0.9


def _longest_coherent(intervals: Floats, shortest_us: float, longest_us: float) -> float | None:
    # A bit is no longer than half the shortest interval between equal changes.
    top_us = min(longest_us, 0.6 * float(np.percentile(intervals, 5)))
    if top_us <= shortest_us:
        return None
    count = int(np.log(top_us / shortest_us) / RESOLUTION) + 2
    periods = np.geomspace(shortest_us, top_us, count)
    coherence = np.array([np.cos(2.0 * np.pi * intervals / period).mean() for period in periods])
    best = float(coherence.max())
    if best < COHERENT:
        return None
    good = np.flatnonzero(coherence >= best - 0.1)
    # The longest group of neighbours that fit, and in it the best.
    last = int(good[-1])
    begin = last
    while begin > 0 and coherence[begin - 1] >= best - 0.1:
        begin -= 1
    chosen = begin + int(np.argmax(coherence[begin : last + 1]))
    return float(US_PER_S / _refined(intervals, float(periods[chosen])))


def _refined(intervals: Floats, period_us: float) -> float:
    """Return the period by least squares through d_i = k_i T."""
    k = np.round(intervals / period_us)
    use = (k > 0) & (np.abs(intervals - k * period_us) < 0.25 * period_us)
    if not use.any():
        return period_us
    return float((k[use] * intervals[use]).sum() / (k[use] ** 2).sum())
