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

# A tick's weight in the means: noise changes with the light, in seconds; ticks are milliseconds.
SMOOTHING: Final = 0.05
# Fewer empty 3 x 3 than this say nothing of how many stand alone.
EMPTY_LEAST: Final = 16.0
# Where pairs that stand alone are most frequent; more noise makes fewer of them again.
PAIRS_LIMIT: Final = 2 / 9
# The iteration gains a digit in two rounds at 5 Mev/s on VGA, and ends at the limit where it does not converge.
ROUNDS: Final = 16


@kernel
def _survey(x: Any, y: Any, on: Any, off: Any, near: Any, seen: Any, stamp: int) -> Any:
    """Return the pixels that stand alone with one event, with two, with any; and those in reach of any event.

    near and seen hold, with a margin of one, the stamped number of events' pixels in reach of each pixel.
    """
    reached = 0
    height = near.shape[0] - 2
    width = near.shape[1] - 2
    for i in range(len(x)):
        for qy in range(y[i], y[i] + 3):
            for qx in range(x[i], x[i] + 3):
                if seen[qy, qx] != stamp:
                    seen[qy, qx] = stamp
                    near[qy, qx] = 0
                    reached += 0 < qy <= height and 0 < qx <= width
                near[qy, qx] += 1
    one = 0
    two = 0
    alone = 0
    for i in range(len(x)):
        if near[y[i] + 1, x[i] + 1] == 1:
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

    Attributes:
        events: lambda, events a pixel and stream tick.
    """

    def __init__(self, width: int, height: int) -> None:
        self.events = 0.0
        self._pixels = width * height
        self._near = np.zeros((height + 2, width + 2), np.uint8)
        self._seen = np.full((height + 2, width + 2), -1, np.int64)
        self._mean = np.zeros(5)  # alone with one event, with two, with any; empty 3 x 3; pixels without events
        self._ticks = 0

    def measure(self, x: npt.NDArray[Any], y: npt.NDArray[Any], on: npt.NDArray[Any], off: npt.NDArray[Any]) -> None:
        """Take a tick's entries: (n,) distinct pixels and their events."""
        one, two, alone, reached = _survey(
            x.astype(np.int64), y.astype(np.int64), on, off, self._near, self._seen, self._ticks
        )
        self._ticks += 1
        now = np.array([one, two, alone, self._pixels - reached, self._pixels - len(x)], np.float64)
        # The plain mean of what there is so far at first.
        self._mean += (now - self._mean) * max(SMOOTHING, 1 / self._ticks)
        one_, two_, alone_, void, empty = self._mean.tolist()
        if two_ > one_:
            self.events = _of_pairs(two_ / self._pixels)
            return
        self.events = float(-np.log(max(empty, 0.5) / self._pixels))
        if void >= EMPTY_LEAST:
            self.events = min(self.events, float(np.log1p(alone_ / void)))


def _of_pairs(two: float) -> float:
    """Return the smaller lambda of which so many pixels have two events and eight empty neighbours."""
    rate = 0.0
    for _ in range(ROUNDS):
        rate = min(PAIRS_LIMIT, float(np.sqrt(2 * two * np.exp(9 * rate))))
    return rate
