"""A camera of one pixel: there is nothing to cluster, and nowhere to go."""

from __future__ import annotations

import numpy as np

from heliograph.messages import StatusWord
from heliograph_services.tracker.tracks import Numbers, Snapshot
from heliograph_services.tracker.windows import Window


class OnePixelFollower:
    """A camera of one pixel (a photodiode, a recording without places) is one track, from its first moment on."""

    def __init__(self, t0_us: int, numbers: Numbers) -> None:
        self._number = numbers.take()
        self._born_us = t0_us
        self._seen_us = t0_us
        self._polarity = 0.0
        self._status: StatusWord = "new"

    def step(self, window: Window) -> bool:
        """Take note of the window's polarity; nothing is ever born."""
        on, off = int(window.on.sum(dtype=np.int64)), int(window.off.sum(dtype=np.int64))
        if on + off:
            self._polarity = round((on - off) / (on + off), 3)
            self._seen_us = window.end_us
        return False

    def judge(self, words: dict[int, StatusWord], tokens: dict[int, str | None], at_us: int) -> bool:
        """Take the decoder's word; it is passed on, and ends nothing. Whoever is read here, it is this track."""
        del tokens, at_us
        self._status = words.get(self._number, self._status)
        return False

    def expire(self, at_us: int) -> None:
        """Nothing ends: there is nowhere else to look."""

    def snapshot(self, at_us: int) -> Snapshot:
        """Return the one track, at (0, 0)."""
        del at_us
        return Snapshot(
            number=[self._number],
            born_us=[self._born_us],
            seen_us=[self._seen_us],
            x_px=[0.0],
            y_px=[0.0],
            vx_px_s=[0.0],
            vy_px_s=[0.0],
            # Uniform over the pixel.
            x_var_px2=[round(1 / 12, 3)],
            x_vx_cov_px2_s=[0.0],
            vx_var_px2_s2=[0.0],
            y_var_px2=[round(1 / 12, 3)],
            y_vy_cov_px2_s=[0.0],
            vy_var_px2_s2=[0.0],
            radius_px=[0.5],
            size_px=[1.0],
            polarity=[self._polarity],
            status=[self._status],
        )
