"""Two beacons that touch make one cluster: it is cut along the tracks' predicted centres.

A cluster is cut if the predicted centres of several tracks lie within its reach and it is clearly larger than the
largest of them; each pixel then goes to the nearest centre. Without the cut one track would be pulled into the middle
and the other starve. The centre of a piece is biased away from the other beacon: it counts as little as one pixel of
the disc (`association`), so that two that pass each other quickly coast through, and do not bounce.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.clustering import Active, Ints
from heliograph_services.tracker.shape import Targets

Floats = npt.NDArray[np.float64]

# One beacon's swept disc is up to 1.4 times its size; two that touch are 2.
MERGED: Final = 1.5


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
    dx = targets.x_px[:, None] - centres_px[None, :, 0]
    dy = targets.y_px[:, None] - centres_px[None, :, 1]
    inside = dx * dx + dy * dy <= (targets.reach_px**2)[:, None]
    several = np.flatnonzero(inside.sum(axis=1) > 1)
    out = labels
    for c in several:
        tracks = np.flatnonzero(inside[c])
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
