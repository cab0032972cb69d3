"""Where the regions were: their centres and velocities at the ends of the last windows, in the order of the tracks.

A frame is published later than it ended: by what its receiver looks ahead, and by up to a second where several links
contend for a track. Its place is that of its own time; and what the tracker says of the past is compared with the past.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import Final

import numpy as np

from heliograph_services.decoder.region_state import Floats, Ints

# Twice the paper's beacons; doubled where there are more.
START_TRACKS: Final = 40


class History:
    """The last centres and velocities of all tracks.

    Args:
        rows: how many windows it holds at least.
    """

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self._n = 0
        # A list: of the few hundred times one alone is looked up, often.
        self._t_us: list[int] = []
        self._tracks = 0
        self._motion: Floats = np.empty((2 * rows, 4, START_TRACKS), np.float64)

    def clear(self) -> None:
        """Forget all."""
        self._n = 0
        self._t_us = []
        self._tracks = 0

    def record(self, t_us: int, motion: Floats) -> None:
        """Note x, y, vx, vy of all tracks, (4, n), at a time after the last one noted, or, instead of them, at it."""
        if self._n and self._t_us[self._n - 1] == t_us:
            self._n -= 1
            self._t_us.pop()
        if self._n == 2 * self._rows:
            self._n = self._rows
            del self._t_us[: self._rows]
            self._motion[: self._n, :, : self._tracks] = self._motion[self._rows :, :, : self._tracks]
        self._t_us.append(t_us)
        self._motion[self._n, :, : self._tracks] = motion
        self._n += 1

    def keep(self, kept: list[int]) -> None:
        """Keep these tracks alone, in this order."""
        if kept != list(range(self._tracks)):
            self._motion[: self._n, :, : len(kept)] = self._motion[: self._n, :, kept]
            self._tracks = len(kept)

    def append(self, t_us: Ints, trail: Floats) -> None:
        """Add a track with its trail: (4, m) at m > 0 rising times; before and behind it, its ends."""
        if self._tracks == self._motion.shape[2]:
            wider = np.empty((2 * self._rows, 4, 2 * self._tracks), np.float64)
            wider[: self._n, :, : self._tracks] = self._motion[: self._n]
            self._motion = wider
        at = np.array(self._t_us, np.int64)
        for row in range(4):
            self._motion[: self._n, row, self._tracks] = np.interp(at, t_us, trail[row])
        self._tracks += 1

    def at(self, i: int, t_us: int) -> tuple[float, float, float, float] | None:
        """Return x, y, vx, vy of track i then, interpolated; None behind the last time noted."""
        times = self._t_us
        if not times or t_us > times[-1]:
            return None
        k = bisect_left(times, t_us)
        x_px, y_px, vx_px_s, vy_px_s = self._motion[k, :, i].tolist()
        if k > 0 and times[k] != t_us:
            x0_px, y0_px, vx0_px_s, vy0_px_s = self._motion[k - 1, :, i].tolist()
            share = (times[k] - t_us) / (times[k] - times[k - 1])
            x_px += share * (x0_px - x_px)
            y_px += share * (y0_px - y_px)
            vx_px_s += share * (vx0_px_s - vx_px_s)
            vy_px_s += share * (vy0_px_s - vy_px_s)
        return x_px, y_px, vx_px_s, vy_px_s

    def all_at(self, t_us: int) -> Floats | None:
        """Return x, y, vx, vy of all tracks then, (4, n), as `at` does."""
        times = self._t_us
        if not times or t_us > times[-1]:
            return None
        k = bisect_left(times, t_us)
        motion: Floats = self._motion[k, :, : self._tracks].copy()
        if k > 0 and times[k] != t_us:
            share = (times[k] - t_us) / (times[k] - times[k - 1])
            motion += share * (self._motion[k - 1, :, : self._tracks] - motion)
        return motion
