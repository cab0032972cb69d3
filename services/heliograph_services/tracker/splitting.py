"""Two beacons that touch make one cluster: it is cut along the tracks' predicted centres.

A cluster is cut if the predicted centres of several tracks lie within its reach and it is clearly larger than the
largest of them; each pixel then goes to the nearest centre. Without the cut one track would be pulled into the middle
and the other starve. The centre of a piece is biased away from the other beacon: it counts as little as one pixel of
the disc (`association`).

Two that pass each other quickly go on without any target until they have parted, as long as both were seen by
themselves in the last `PASS_S`: the bias of pieces is much larger than what they do unforeseen in that time, and a fast
track, which is believed to turn at any moment, follows it. Quick is a relative speed v, with their radii R::

    v PASS_S > R_1 + R_2

A beacon on a moving edge makes one cluster with it, long before and after it lies free. What blinks there is told from
what is crossed (`shape.BOTH_SHARE`): the pixels that went both ways are clustered among themselves and cut out. At 50
bit/s a window has one flip at most, and hardly a pixel goes both ways; but a light that is switched, or shines and
moves, passes several thresholds in a pixel, and a texture one (`shape.DENSE`). Where a cluster is so much larger than
what fired more than once in it that no track of that size would take it, the latter is cut out if it fired both ways:
a small light that shines and moves is a dipole (`shape.DIPOLE_SHARE`). What is left of the cluster is nobody's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.association import GROWTH
from heliograph_services.tracker.clustering import Active, Ints
from heliograph_services.tracker.jit import kernel
from heliograph_services.tracker.shape import DIPOLE_SHARE, NOT_ROUND, TOO_FEW, TOO_MANY, Targets

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# One beacon's swept disc is up to 1.4 times its size; two that touch are 2.
MERGED: Final = 1.5
# Where more of a cluster blinks, it is the light itself, and the rest is its rim.
CARVED_SHARE: Final = 0.7
# Going straight on for so long, or round its circle, a light is expected where it is within a pixel or two; 33,000
# px/s2 that nobody foresaw make more of half of it.
PASS_S: Final = 0.05
# One beacon's swept disc again, unless its track was young: more than this is two, cut or not.
LARGER: Final = 1.2


def carve(
    active: Active, labels: Ints, targets: Targets, cluster: Callable[[Active], tuple[Ints, int]], min_pixels: int
) -> tuple[Ints, int, Flags] | None:
    """Cut lights out of the clusters that they make with edges; return None where there are none.

    Args:
        active: the window's n pixels.
        labels: (n,) int32.
        targets: k of these labels.
        cluster: the clustering.
        min_pixels: what is smaller stays where it is.

    Returns:
        (n,) int32 labels; how many, m; (m,) bool, those that are the surroundings of a light that fired more than once.
    """
    inside, both, often = labels >= 0, (active.on > 0) & (active.off > 0), active.on + active.off > 1
    dense = np.bincount(labels[inside & often], minlength=len(targets))
    wide = (targets.verdict != TOO_FEW) & (dense >= min_pixels) & (GROWTH * dense < targets.pixels)
    crossed = ((targets.verdict == NOT_ROUND) | (targets.verdict == TOO_MANY)) & ~wide
    crossed &= (targets.both >= min_pixels) & (targets.both < CARVED_SHARE * targets.pixels)
    if not crossed.any() and not wide.any():
        return None
    taken = np.flatnonzero(inside & ((both & crossed[labels]) | (often & wide[labels])))
    part = Active(active.x_px[taken], active.y_px[taken], active.on[taken], active.off[taken], active.moments[:, taken])
    inner, count = cluster(part)
    member = inner >= 0
    on, off, by_wide = (
        np.bincount(inner[member], each[member], count) for each in (part.on, part.off, wide[labels[taken]])
    )
    # A strong edge fires more than once too, but one way.
    dipole = np.minimum(on, off) >= DIPOLE_SHARE * (on + off)
    large = (np.bincount(inner[member], minlength=count) >= min_pixels) & (dipole | (by_wide == 0))
    if not large.any():
        return None
    place = np.cumsum(large) - 1 + len(targets)
    cut = np.flatnonzero(member & large[inner])
    out, total = labels.copy(), len(targets) + int(large.sum())
    out[taken[cut]] = place[inner[cut]]
    around = np.zeros(total, np.bool_)
    around[labels[taken[cut]]] = wide[labels[taken[cut]]]
    return out, total, around


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


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """What is known of m tracks before their targets are.

    Args:
        state: (m, 4) float64, predicted, see `kalman`.
        radius_px: (m,) float64.
        size_px: (m,) float64, sensor pixels.
        fresh: (m,) bool: seen on its own in the last `PASS_S`.
    """

    state: Floats
    radius_px: Floats
    size_px: Floats
    fresh: Flags


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """Where tracks share clusters.

    Args:
        labels: (n,) int32, of the window's pixels.
        piece: (k,) bool, for each label whether it is shared: cut out of a cluster, or a cluster not cut.
        held: (k,) bool: of tracks that pass, and of no others.
        passing: (m,) bool: the tracks that pass, and go on without a target.
    """

    labels: Ints
    piece: Flags
    held: Flags
    passing: Flags


def split(active: Active, labels: Ints, targets: Targets, tracks: Followed, pool_px: int) -> Cut | None:
    """Cut the clusters that several tracks share; return None where none do.

    Args:
        active: the window's n pixels.
        labels: (n,) int32.
        targets: of these labels.
        tracks: m of them.
        pool_px: side of an onset pixel.
    """
    if len(targets) == 0 or len(tracks.state) < 2:
        return None
    centres_px = tracks.state[:, :2]
    places = (targets.x_px, targets.y_px, targets.reach_px, centres_px[:, 0], centres_px[:, 1])
    # One layout of arrays, one compilation.
    several = np.flatnonzero(_shared(*(np.ascontiguousarray(each) for each in places)))
    out, count = labels.copy(), len(targets)
    pieces: list[int] = []
    held: list[int] = []
    passing = np.zeros(len(centres_px), np.bool_)
    for c in several:
        dx, dy = targets.x_px[c] - centres_px[:, 0], targets.y_px[c] - centres_px[:, 1]
        inside = np.flatnonzero(dx * dx + dy * dy <= targets.reach_px[c] ** 2)
        by = _passing(tracks, inside)
        passing[inside] |= by
        if targets.pixels[c] * pool_px**2 < MERGED * tracks.size_px[inside].max():
            if by.any() or targets.pixels[c] * pool_px**2 > LARGER * tracks.size_px[inside].max():
                pieces.append(int(c))
            if by.all():
                held.append(int(c))
            continue
        pixels = np.flatnonzero(labels == c)
        middle = (pool_px - 1) / 2
        away_x = active.x_px[pixels, None] * pool_px + middle - centres_px[None, inside, 0]
        away_y = active.y_px[pixels, None] * pool_px + middle - centres_px[None, inside, 1]
        nearest = np.argmin(away_x**2 + away_y**2, axis=1)
        # Parts without a pixel get no label: labels stay dense.
        for i, part in enumerate(np.unique(nearest)):
            label = int(c) if i == 0 else count
            count += i > 0
            out[pixels[nearest == part]] = label
            pieces.append(label)
            if by[part]:
                held.append(label)
    if not pieces:
        return None
    piece, mine = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    piece[pieces] = True
    mine[held] = True
    return Cut(out, piece, mine, passing)


def _passing(tracks: Followed, inside: npt.NDArray[np.int64]) -> Flags:
    """Return (k,) bool: which of the k tracks in a cluster pass another one of them; see the module."""
    v, radius = tracks.state[inside, 2:], tracks.radius_px[inside]
    apart = np.hypot(v[:, None, 0] - v[None, :, 0], v[:, None, 1] - v[None, :, 1])
    quick = apart * PASS_S > radius[:, None] + radius[None, :]
    return np.asarray(quick.any(axis=1) & tracks.fresh[inside])
