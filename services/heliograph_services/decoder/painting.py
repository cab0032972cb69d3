"""The kernels that paint the lookup image: which region hears a pixel.

One uint16 a pixel (0 = nobody, i + 1 = track i)::

    label(p) = 1 + argmin_i |p - c_i| / r_i    over the tracks with |p - c_i| <= s_i      (equal: the lowest i)

r is the region's own radius, s >= r what it listens to for now; within r a region that is being read goes
before those that are not, so that a track of the clutter cannot take a beacon's events. It is repainted at the first
step with events in which a region has moved or grown by a pixel since.

To repaint is to note where the regions are (a *drawing*: a row each of x, y, s, r and rank, a column a region) and
which squares of TILE_PX they touch, before or now. Such a square is stale, and all its pixels are UNPAINTED; it is
painted from the drawing when an event falls on it. So a region that hears nothing is never painted, and what is read of
the image is the same as if all had been.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph_services.decoder.region_state import (
    RANK,
    REACH,
    TOGETHER,
    Floats,
    Labels,
    X,
    Y,
    neighbours,
    part,
    shown_px,
)

Stale = npt.NDArray[np.uint8]

# Repaint as soon as a centre has moved so far; the regions' margin is more than that.
REPAINT_PX: Final = 1.0
# A region of 12 px to each side touches 16 of them, and half of what is painted is its own.
TILE_SHIFT: Final = 3
TILE_PX: Final = 1 << TILE_SHIFT
# More than any label.
UNPAINTED: Final = 65_535
# Rows of a drawing.
AT_X: Final = 0
AT_Y: Final = 1
SHOWN: Final = 2  # s, px
OWN: Final = 3  # r, px
FIRST: Final = 4  # 1 where it goes before others
DRAWN_ROWS: Final = 5


@part
def span(centre: float, reach: float, side: int) -> tuple[int, int]:
    """Return the first and behind the last pixel of a row or column that a disc can touch, within the sensor."""
    low = min(max(math.ceil(centre - reach), 0.0), float(side))
    high = min(max(math.floor(centre + reach) + 1.0, 0.0), float(side))
    return int(low), int(high)


@part
def goes_before(drawn: Floats, i: int, inner: float, k: int, x: int, y: int) -> bool:
    """Return whether region i hears a pixel rather than region k; `inner` is its (|p - c_i| / r_i)^2."""
    ox, oy, own = x - drawn[AT_X, k], y - drawn[AT_Y, k], drawn[OWN, k]
    other = (ox * ox + oy * oy) / (own * own)
    if drawn[FIRST, i] > drawn[FIRST, k] and inner <= 1.0:
        return True
    if drawn[FIRST, k] > drawn[FIRST, i] and other <= 1.0:
        return False
    return bool(inner < other)


@part
def _touch(labels: Labels, stale: Stale, drawn: Floats, n: int) -> None:
    """Mark the squares that n regions touch."""
    height, width = labels.shape
    for i in range(n):
        x0, x1 = span(drawn[AT_X, i], drawn[SHOWN, i], width)
        y0, y1 = span(drawn[AT_Y, i], drawn[SHOWN, i], height)
        if x0 >= x1 or y0 >= y1:
            continue
        for y in range(y0 >> TILE_SHIFT, ((y1 - 1) >> TILE_SHIFT) + 1):
            for x in range(x0 >> TILE_SHIFT, ((x1 - 1) >> TILE_SHIFT) + 1):
                if not stale[y, x]:
                    stale[y, x] = 1
                    top, left = y << TILE_SHIFT, x << TILE_SHIFT
                    labels[top : top + TILE_PX, left : left + TILE_PX] = UNPAINTED


@part
def draw(labels: Labels, stale: Stale, drawn: Floats, n_drawn: int, state: Floats, n: int) -> None:
    """Draw n regions instead of the n_drawn ones, and mark what is to be painted anew."""
    _touch(labels, stale, drawn, n_drawn)
    for i in range(n):
        drawn[AT_X, i] = state[X, i]
        drawn[AT_Y, i] = state[Y, i]
        drawn[SHOWN, i] = shown_px(state, i)
        drawn[OWN, i] = state[REACH, i]
        drawn[FIRST, i] = state[RANK, i]
    _touch(labels, stale, drawn, n)


@part
def paint(labels: Labels, stale: Stale, drawn: Floats, n: int, x_tile: int, y_tile: int) -> None:
    """Paint a square from the drawing of n regions."""
    height, width = labels.shape
    left, top = x_tile << TILE_SHIFT, y_tile << TILE_SHIFT
    right, bottom = min(left + TILE_PX, width), min(top + TILE_PX, height)
    stale[y_tile, x_tile] = 0
    for y in range(top, bottom):
        for x in range(left, right):
            labels[y, x] = 0
    half = 0.5 * TILE_PX
    x_middle, y_middle = left + half - 0.5, top + half - 0.5
    at_x, at_y, shown = drawn[AT_X], drawn[AT_Y], drawn[SHOWN]
    for first in range(0, n, TOGETHER):
        behind = min(first + TOGETHER, n)
        # A pixel's middle is within half a square of the square's.
        if not neighbours(at_x[first:behind], at_y[first:behind], shown[first:behind], x_middle, y_middle, half):
            continue
        for i in range(first, behind):
            x0, x1 = span(at_x[i], shown[i], width)
            y0, y1 = span(at_y[i], shown[i], height)
            limit, own = shown[i] * shown[i], drawn[OWN, i] * drawn[OWN, i]
            for y in range(max(y0, top), min(y1, bottom)):
                dy = y - at_y[i]
                for x in range(max(x0, left), min(x1, right)):
                    dx = x - at_x[i]
                    away2 = dx * dx + dy * dy
                    if away2 > limit:
                        continue
                    if labels[y, x] != 0 and not goes_before(drawn, i, away2 / own, labels[y, x] - 1, x, y):
                        continue
                    labels[y, x] = i + 1


@part
def moved(drawn: Floats, n_drawn: int, state: Floats, n: int) -> bool:
    """Return whether a region has moved or grown by a pixel since it was drawn."""
    if n != n_drawn:
        return True
    for i in range(n):
        if max(abs(state[X, i] - drawn[AT_X, i]), abs(state[Y, i] - drawn[AT_Y, i])) >= REPAINT_PX:
            return True
        if abs(shown_px(state, i) - drawn[SHOWN, i]) >= REPAINT_PX:
            return True
    return False
