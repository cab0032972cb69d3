"""Which onsets belong to a small light that shines and moves.

Such a light brightens the pixels before it and darkens those behind it, a few pixels apart and in the same tick: a
*dipole*. An edge that passes shows one polarity over many pixels. So with the sums over the 5x5 pixels around an entry,
in its own tick::

    dipole      sum(on_count) >= 2  and  sum(off_count) >= 2;  and every entry within 3 px of such a one
    near        an entry around which, within 16 to 24 px, there was a dipole in the last memory_us

A light that is switched off shows none, and comes back with one polarity, some way off: near. Under texture that moves
at 200 px/s a twelfth of the entries are dipoles, and nine of ten targets of LEDs of 2 px radius (construction site).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.onsets import OnsetColumns

Flags = npt.NDArray[np.bool_]

LEAST: Final = 2
REACH: Final = 2
SPREAD: Final = 3
CELL_SHIFT: Final = 3
CELLS: Final = 2
NEVER: Final = -(2**62)


@dataclass(frozen=True, slots=True)
class Marks:
    """Of n entries, which are dipoles and which lie near one; see the module."""

    dipole: Flags
    near: Flags


class Dipoles:
    """Marks the onsets of one stream.

    Args:
        width: of the sensor, onset pixels.
        height: of the sensor, onset pixels.
        memory_us: see the module.
    """

    def __init__(self, width: int, height: int, memory_us: int = 250_000) -> None:
        self._counts = np.zeros((2, height + 2 * SPREAD, width + 2 * SPREAD), np.int32)
        # When a dipole last reached each pixel, and each cell.
        self._reached_us = np.full((height + 2 * SPREAD, width + 2 * SPREAD), NEVER, np.int64)
        self._last_us = np.full(((height >> CELL_SHIFT) + 1, (width >> CELL_SHIFT) + 1), NEVER, np.int64)
        self._memory_us = memory_us

    def reset(self) -> None:
        """Forget everything: a new stream begins."""
        self._reached_us[:] = NEVER
        self._last_us[:] = NEVER

    def mark(self, columns: OnsetColumns, t0_us: int, tick_us: int) -> Marks:
        """Return the marks of a message's entries.

        Args:
            columns: of the message.
            t0_us: its begin.
            tick_us: length of a tick.
        """
        n = len(columns.tick)
        marks = Marks(np.zeros(n, np.bool_), np.zeros(n, np.bool_))
        at_us = t0_us + columns.tick.astype(np.int64) * tick_us
        _mark(
            at_us, columns.x_px, columns.y_px, columns.on_count, columns.off_count,
            self._counts, self._reached_us, self._last_us, self._memory_us, marks.dipole, marks.near,
        )  # fmt: skip
        return marks


def warm() -> None:
    """Compile the kernel, or take it from the cache."""
    counts, places = np.ones(1, np.uint8), np.zeros(1, np.uint16)
    Dipoles(8, 8).mark(OnsetColumns(places, places, places, counts, counts, np.zeros(1, np.bool_), 0, 0, 0), 0, 1_000)


@numba.njit(cache=True, nogil=True)
def _mark(
    at_us: Any, x: Any, y: Any, on: Any, off: Any, counts: Any, reached_us: Any, last_us: Any, memory_us: int,
    dipole: Any, near: Any,
) -> None:  # fmt: skip
    start = 0
    while start < len(at_us):
        now_us = at_us[start]
        stop = start
        while stop < len(at_us) and at_us[stop] == now_us:
            counts[0, y[stop] + SPREAD, x[stop] + SPREAD] = on[stop]
            counts[1, y[stop] + SPREAD, x[stop] + SPREAD] = off[stop]
            stop += 1
        for i in range(start, stop):
            row, column = int(y[i]) + SPREAD, int(x[i]) + SPREAD
            brighter = 0
            darker = 0
            for r in range(row - REACH, row + REACH + 1):
                for c in range(column - REACH, column + REACH + 1):
                    brighter += counts[0, r, c]
                    darker += counts[1, r, c]
            if brighter < LEAST or darker < LEAST:
                continue
            reached_us[row - SPREAD : row + SPREAD + 1, column - SPREAD : column + SPREAD + 1] = now_us
            row, column = int(y[i]) >> CELL_SHIFT, int(x[i]) >> CELL_SHIFT
            last_us[max(0, row - CELLS) : row + CELLS + 1, max(0, column - CELLS) : column + CELLS + 1] = now_us
        for i in range(start, stop):
            dipole[i] = reached_us[y[i] + SPREAD, x[i] + SPREAD] == now_us
            near[i] = last_us[y[i] >> CELL_SHIFT, x[i] >> CELL_SHIFT] >= now_us - memory_us
            counts[0, y[i] + SPREAD, x[i] + SPREAD] = 0
            counts[1, y[i] + SPREAD, x[i] + SPREAD] = 0
        start = stop
