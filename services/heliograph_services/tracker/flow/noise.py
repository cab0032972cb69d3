"""How much of a stream is noise, measured from the stream itself.

Noise falls like rain: N events a pixel and stream tick, Poisson of mean lambda. What moves or blinks comes in groups.
So only 3 x 3 pixels are counted that hold nothing (`empty`), or something in the middle alone::

    open stream    lambda = ln(1 + alone / empty)          exact for noise, whatever else there is in groups
    gated stream   lambda^2 / 2 exp(-9 lambda) = two       two: the share of middles alone with exactly two events

The source's gate ("active") drops single events and keeps pairs; a stream in which single events stand alone less
often than pairs is gated, and what is empty in it says nothing. Of the two roots it is the smaller; beyond 2/9 there is
none, and it is that. In an open stream lambda never exceeds -ln(share of pixels without events), which also answers
where nothing is empty. All counts are smoothed over ticks.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.jit import kernel

# A measured tick's weight in the means, of 5 ms: noise changes with the light, in seconds. A shorter one sees less and
# weighs less, so the means are over the same time.
SMOOTHING: Final = 0.05
SMOOTHED_US: Final = 5_000
# Of the stream's ticks, every fourth is enough once there is a mean: measuring costs as much as pooling three scales.
EVERY: Final = 4
EACH_AT_FIRST: Final = 20
# Sixteen times a stamp stays within int32.
STAMPS: Final = 2**26
# Fewer empty 3 x 3 than this say nothing of how many stand alone.
EMPTY_LEAST: Final = 16.0
# Where pairs that stand alone are most frequent; more noise makes fewer of them again.
PAIRS_LIMIT: Final = 2 / 9
# The iteration gains a digit in two rounds at 5 Mev/s on VGA, and ends at the limit where it does not converge.
ROUNDS: Final = 16


@kernel
def _survey(x: Any, y: Any, on: Any, off: Any, near: Any, stamp: int) -> Any:
    """Return the pixels that stand alone with one event, with two, with any; and those in reach of any event.

    near holds, with a margin of one, 16 stamp + the number of entries in reach of a pixel; older stamps count as none.
    """
    reached = 0
    height = near.shape[0] - 2
    width = near.shape[1] - 2
    none = np.int32(stamp << 4)
    for i in range(len(x)):
        cy = np.int64(y[i])
        cx = np.int64(x[i])
        for qy in range(cy, cy + 3):
            for qx in range(cx, cx + 3):
                now = near[qy, qx]
                if now < none:
                    now = none
                    reached += 0 < qy <= height and 0 < qx <= width
                near[qy, qx] = now + 1
    one = 0
    two = 0
    alone = 0
    single = none + 1
    for i in range(len(x)):
        if near[np.int64(y[i]) + 1, np.int64(x[i]) + 1] == single:
            count = np.int64(on[i]) + np.int64(off[i])
            alone += 1
            one += count == 1
            two += count == 2
    return one, two, alone, reached


class NoiseMeter:
    """Measures one stream.

    Args:
        width: columns, the stream's pixels.
        height: rows.
        tick_us: length of the stream's ticks.

    Attributes:
        events: lambda, events a pixel and stream tick.
        ticks: how many were measured.
    """

    def __init__(self, width: int, height: int, tick_us: int = SMOOTHED_US) -> None:
        self.events = 0.0
        self._weight = SMOOTHING * min(1.0, tick_us / SMOOTHED_US)
        self._pixels = width * height
        self._near = np.zeros((height + 2, width + 2), np.int32)
        self._mean = np.zeros(5)  # alone with one event, with two, with any; empty 3 x 3; pixels without events
        self.ticks = 0

    def measure(self, x: npt.NDArray[Any], y: npt.NDArray[Any], on: npt.NDArray[Any], off: npt.NDArray[Any]) -> None:
        """Take a tick's entries: (n,) distinct pixels and their events."""
        stamp = self.ticks % STAMPS + 1
        if stamp == 1:
            self._near[:] = 0
        one, two, alone, reached = _survey(x, y, on, off, self._near, stamp)
        self.ticks += 1
        now = np.array([one, two, alone, self._pixels - reached, self._pixels - len(x)], np.float64)
        # The plain mean of what there is so far at first.
        self._mean += (now - self._mean) * max(self._weight, 1 / self.ticks)
        one_, two_, alone_, void, empty = self._mean.tolist()
        if two_ > one_:
            self.events = _of_pairs(two_ / self._pixels)
            return
        self.events = float(-np.log(max(empty, 0.5) / self._pixels))
        if void >= EMPTY_LEAST:
            self.events = min(self.events, float(np.log1p(alone_ / void)))


def is_due(tick: int, measured: int) -> bool:
    """Return whether a stream's tick of this number is measured."""
    return measured < EACH_AT_FIRST or tick % EVERY == 0


def _of_pairs(two: float) -> float:
    """Return the smaller lambda of which so many pixels have two events and eight empty neighbours."""
    rate = 0.0
    for _ in range(ROUNDS):
        rate = min(PAIRS_LIMIT, float(np.sqrt(2 * two * np.exp(9 * rate))))
    return rate
