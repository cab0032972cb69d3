"""Places where an invalid track ended that had never been valid: no births there for a while.

A lamp is born, judged invalid by the decoder, ended; without a pause it would be born again in the next window. The
pause doubles each time a track is judged invalid at the same place, up to a limit, and is forgotten after as long a
limit of peace. Tracks that pass the place are not touched.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

# As many lamps as a street has; the oldest place is forgotten first.
PLACES_LIMIT: Final = 256


class Quarantine:
    """The places, in the order in which they were closed last.

    Args:
        first_us: the first pause.
        limit_us: the longest.
    """

    def __init__(self, first_us: int, limit_us: int) -> None:
        self._first_us = first_us
        self._limit_us = limit_us
        # Rows: x, y, radius, pixels.
        self._place: Floats = np.empty((0, 3), np.float64)
        # Rows: closed until, length of that pause; microseconds.
        self._until: npt.NDArray[np.int64] = np.empty((0, 2), np.int64)

    def __len__(self) -> int:
        return len(self._place)

    def close(self, x_px: float, y_px: float, radius_px: float, at_us: int) -> None:
        """Close a disc for births; twice as long as before, if it has been closed before."""
        if self._first_us == 0:
            return
        d2 = (self._place[:, 0] - x_px) ** 2 + (self._place[:, 1] - y_px) ** 2
        known = d2 <= np.maximum(self._place[:, 2], radius_px) ** 2
        pause = self._first_us
        if known.any():
            pause = min(self._limit_us, 2 * int(self._until[known, 1].max()))
        keep = np.flatnonzero(~known)[-(PLACES_LIMIT - 1) :]
        self._place = np.concatenate([self._place[keep], [[x_px, y_px, radius_px]]])
        self._until = np.concatenate([self._until[keep], np.array([[at_us + pause, pause]], np.int64)])

    def closed(self, at_us: int) -> Floats:
        """Return (k, 3) float64, x, y, radius of the discs that are closed at this time; forget the old."""
        remembered = self._until[:, 0] + self._limit_us > at_us
        if not remembered.all():
            self._place, self._until = self._place[remembered], self._until[remembered]
        return self._place[self._until[:, 0] > at_us]
