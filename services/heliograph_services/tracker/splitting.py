"""Two beacons that touch make one cluster: it is cut along the tracks' predicted centres.

A cluster is cut if the predicted centres of several tracks lie within its reach and it is clearly larger than the
largest of them; each pixel then goes to the nearest centre. Without the cut one track would be pulled into the middle
and the other starve. The centre of a piece is biased away from the other beacon: it counts as little as one pixel of
the disc (`association`), so that two that pass each other quickly coast through, and do not bounce.

A beacon on a moving edge makes one cluster with it, long before and after it lies free. What blinks there is told from
what is crossed (`shape.BOTH_SHARE`): the pixels that went both ways are clustered among themselves and cut out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.clustering import Active, Ints
from heliograph_services.tracker.jit import kernel
from heliograph_services.tracker.shape import NOT_ROUND, TOO_MANY, Targets

Floats = npt.NDArray[np.float64]

# One beacon's swept disc is up to 1.4 times its size; two that touch are 2.
MERGED: Final = 1.5
# Where more of a cluster blinks, it is the light itself, and the rest is its rim.
CARVED_SHARE: Final = 0.7


def carve(
    active: Active, labels: Ints, targets: Targets, cluster: Callable[[Active], tuple[Ints, int]], min_pixels: int
) -> tuple[Ints, int] | None:
    """Cut what blinks out of the clusters that have not the shape of a light; return labels and how many, or None.

    Args:
        active: the window's n pixels.
        labels: (n,) int32.
        targets: of these labels.
        cluster: the clustering.
        min_pixels: what is smaller stays where it is.
    """
    crossed = (targets.verdict == NOT_ROUND) | (targets.verdict == TOO_MANY)
    crossed &= (targets.both >= min_pixels) & (targets.both < CARVED_SHARE * targets.pixels)
    if not crossed.any():
        return None
    blinking = np.flatnonzero((labels >= 0) & crossed[labels] & (active.on > 0) & (active.off > 0))
    inner, count = cluster(
        Active(
            active.x_px[blinking],
            active.y_px[blinking],
            active.on[blinking],
            active.off[blinking],
            active.moments[:, blinking],
        )
    )
    large = np.bincount(inner[inner >= 0], minlength=count) >= min_pixels
    if not large.any():
        return None
    place = np.cumsum(large) - 1 + len(targets)
    cut = np.flatnonzero((inner >= 0) & large[inner])
    out = labels.copy()
    out[blinking[cut]] = place[inner[cut]]
    return out, len(targets) + int(large.sum())


@kernel
def _shared(x_px: Floats, y_px: Floats, reach_px: Floats, at_x_px: Floats, at_y_px: Floats) -> npt.NDArray[np.bool_]:
    """Return (k,) bool: the targets that reach to more than one of the centres."""
    out = np.zeros(len(x_px), np.bool_)
    for c in range(len(x_px)):
        reach2 = reach_px[c] * reach_px[c]
        inside = 0
        for i in range(len(at_x_px)):
            dx = x_px[c] - at_x_px[i]
            dy = y_px[c] - at_y_px[i]
            if dx * dx + dy * dy <= reach2:
                inside += 1
                if inside > 1:
                    out[c] = True
                    break
    return out


def split(
    active: Active, labels: Ints, targets: Targets, centres_px: Floats, size_px: Floats, pool_px: int
) -> tuple[Ints, npt.NDArray[np.bool_]] | None:
    """Return new labels, and for each of them whether it is a piece, if a cluster had to be cut.

    Args:
        active: the window's n pixels.
        labels: (n,) int32.
        targets: of these labels, k of them.
        centres_px: (m, 2) float64, predicted centres of the tracks, sensor pixels.
        size_px: (m,) float64, their sizes, sensor pixels.
        pool_px: side of an onset pixel.
    """
    count = len(targets)
    pieces: list[int] = []
    if count == 0 or len(centres_px) < 2:
        return None
    places = (targets.x_px, targets.y_px, targets.reach_px, centres_px[:, 0], centres_px[:, 1])
    # One layout of arrays, one compilation.
    several = np.flatnonzero(_shared(*(np.ascontiguousarray(each) for each in places)))
    out = labels
    for c in several:
        dx, dy = targets.x_px[c] - centres_px[:, 0], targets.y_px[c] - centres_px[:, 1]
        tracks = np.flatnonzero(dx * dx + dy * dy <= targets.reach_px[c] ** 2)
        if targets.pixels[c] * pool_px**2 < MERGED * size_px[tracks].max():
            continue
        if out is labels:
            out = labels.copy()
        pixels = np.flatnonzero(labels == c)
        middle = (pool_px - 1) / 2
        away_x = active.x_px[pixels, None] * pool_px + middle - centres_px[None, tracks, 0]
        away_y = active.y_px[pixels, None] * pool_px + middle - centres_px[None, tracks, 1]
        nearest = np.argmin(away_x**2 + away_y**2, axis=1)
        # Parts without a pixel get no label: labels stay dense.
        parts = np.unique(nearest)
        pieces.append(int(c))
        for part in parts[1:]:
            out[pixels[nearest == part]] = count
            pieces.append(count)
            count += 1
    if not pieces:
        return None
    piece = np.zeros(count, np.bool_)
    piece[pieces] = True
    return out, piece
