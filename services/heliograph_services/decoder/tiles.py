"""The events of a beat near some places, without a look at all the others.

The sensor is cut into squares of `TILE_PX`; a beat's events are sorted by square once, when they are asked for again
and again. 10 Mev/s of noise are 50,000 events in 5 ms, and a tracker that follows noise has 66 tracks a second
replayed, each through dozens of windows: a place costs the events of a dozen squares of 1,200.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch, concatenate
from heliograph_services.decoder.region_state import kernel

Order = npt.NDArray[np.int32]
Floats = npt.NDArray[np.float64]

# A region's ear is three of them wide: no more than half of what is looked at lies outside it.
TILE_PX: Final = 16
# Fewer than that are looked at faster than they are sorted.
FEW_EVENTS: Final = 2_000
# Sorting takes as long as a few looks at all: a tracker that says all its births at once does not come that often.
WHOLE_LOOKS: Final = 4


class Tiles:
    """A beat's events, (m,), by square.

    Args:
        windows: its events, window by window; put together when they are asked for.
        width: of the sensor, px.
        height: of the sensor, px.
    """

    def __init__(self, windows: list[EventBatch], width: int, height: int) -> None:
        self._windows = windows
        self._size = (width, height)
        self._index: tuple[Order, Order] | None = None
        self._looks = 0

    def near(self, x_px: Floats, y_px: Floats, reach_px: Floats) -> tuple[EventBatch, int]:
        """Return the events near places, at least all that lie within (n,) reach_px, and how many others there are.

        Those off the sensor are in neither, except where all are returned: FEW_EVENTS, or the first WHOLE_LOOKS times.
        """
        if len(self._windows) != 1:
            self._windows = [concatenate(self._windows)]
        batch = self._windows[0]
        self._looks += 1
        if len(batch) <= FEW_EVENTS or self._looks <= WHOLE_LOOKS:
            return batch, 0
        if self._index is None:
            self._index = _sorted(batch.x_px, batch.y_px, *self._size)
        order, starts = self._index
        which = _near(order, starts, *self._size, x_px, y_px, reach_px)
        picked = EventBatch(
            batch.t_us.take(which), batch.x_px.take(which), batch.y_px.take(which), batch.on.take(which)
        )
        return picked, int(starts[-1]) - len(which)


@kernel
def _sorted(x_px: npt.NDArray[np.uint16], y_px: npt.NDArray[np.uint16], width: int, height: int) -> tuple[Order, Order]:
    """Return the numbers of the events on the sensor by square, rising in each, and where each square's begin."""
    across, down = (width - 1) // TILE_PX + 1, (height - 1) // TILE_PX + 1
    starts = np.zeros(across * down + 1, np.int32)
    for j in range(len(x_px)):
        if x_px[j] < width and y_px[j] < height:
            starts[(y_px[j] // TILE_PX) * across + x_px[j] // TILE_PX + 1] += 1
    for k in range(across * down):
        starts[k + 1] += starts[k]
    order = np.empty(starts[-1], np.int32)
    at = starts[:-1].copy()
    for j in range(len(x_px)):
        if x_px[j] < width and y_px[j] < height:
            k = (y_px[j] // TILE_PX) * across + x_px[j] // TILE_PX
            order[at[k]] = j
            at[k] += 1
    return order, starts


@kernel
def _near(order: Order, starts: Order, width: int, height: int, x_px: Floats, y_px: Floats, reach_px: Floats) -> Order:
    """Return the numbers, rising, of the events in the squares that discs touch the bounds of."""
    across, down = (width - 1) // TILE_PX + 1, (height - 1) // TILE_PX + 1
    wanted = np.zeros(across * down, np.bool_)
    for i in range(len(x_px)):
        if not (-reach_px[i] < x_px[i] < width + reach_px[i] and -reach_px[i] < y_px[i] < height + reach_px[i]):
            continue  # beyond the sensor there is nothing, and what is far beyond must not overflow
        x0 = int(min(max(x_px[i] - reach_px[i], 0.0), width - 1.0)) // TILE_PX
        y0 = int(min(max(y_px[i] - reach_px[i], 0.0), height - 1.0)) // TILE_PX
        x1 = int(min(max(x_px[i] + reach_px[i], 0.0), width - 1.0)) // TILE_PX
        y1 = int(min(max(y_px[i] + reach_px[i], 0.0), height - 1.0)) // TILE_PX
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                wanted[y * across + x] = True
    n = 0
    for k in range(across * down):
        if wanted[k]:
            n += starts[k + 1] - starts[k]
    which = np.empty(n, np.int32)
    n = 0
    for k in range(across * down):
        if wanted[k]:
            for j in range(starts[k], starts[k + 1]):
                which[n] = order[j]
                n += 1
    which.sort()
    return which
