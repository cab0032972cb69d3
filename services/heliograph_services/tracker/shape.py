"""From clusters to targets: centre, size, polarity and roundness.

Over the N distinct pixels of a cluster, with variances var_x, var_y (a pixel's own extent adds 1/12 each) and b the
barycentre, d the farthest pixel::

    distinct   N / (2 pi (var_x + var_y + 1/6))     1 for a disc: R^2 / 2 = var_x + var_y, N = pi R^2
    paper      N / (pi (|b - d| + 1/2)^2)           the paper's N_e / (pi |b - d|^2), "Clustering"; paper-notes 8

Discs of radius 1.5 px and more score .86 to 1 (distinct) or .66 to .89 (paper), streaks .16 to .45. A target is
refused as a *birth* if N lies outside {N_min; N_max} or it is less round than r; a track may still use it.
Polarity is P = (n_on - n_off) / (n_on + n_off).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.clustering import Active, Ints
from heliograph_services.tracker.config import Shape
from heliograph_services.tracker.jit import kernel

Floats = npt.NDArray[np.float64]

# The share of a target's pixels that its radius covers (heliograph.messages.Tracks).
COVERED: Final = 0.9

ROUND: Final = 0
TOO_FEW: Final = 1
TOO_MANY: Final = 2
NOT_ROUND: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """k targets of a window, in the order of their clusters.

    Args:
        x_px: (k,) float64, centre, sensor pixels.
        y_px: (k,) float64.
        pixels: (k,) int32, distinct onset pixels.
        radius_px: (k,) float64, covers nine tenths of the pixels; half a pixel for a single one. Sensor pixels.
        reach_px: (k,) float64, covers all of them.
        on: (k,) int32, events that became brighter.
        off: (k,) int32.
        both: (k,) int32, pixels that became brighter and darker within the window.
        roundness: (k,) float64.
        verdict: (k,) uint8: ROUND, TOO_FEW, TOO_MANY or NOT_ROUND.
        piece: (k,) bool: cut out of a larger cluster (`splitting`).
    """

    x_px: Floats
    y_px: Floats
    pixels: Ints
    radius_px: Floats
    reach_px: Floats
    on: Ints
    off: Ints
    both: Ints
    roundness: Floats
    verdict: npt.NDArray[np.uint8]
    piece: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.x_px)


@dataclass(frozen=True, slots=True)
class ShapeFilter:
    """What may become a track: {N_min; N_max} onset pixels, and the least roundness by one of the two measures."""

    min_pixels: int
    max_pixels: int
    min_roundness: float
    shape: Shape


@kernel
def _members(labels: Ints, count: int, first: Ints, member: Ints) -> None:
    """Sort the pixels by cluster: those of cluster c are member[first[c]:first[c + 1]], in the order of the input."""
    for i in range(len(labels)):
        if labels[i] >= 0:
            first[labels[i] + 1] += 1
    for c in range(count):
        first[c + 1] += first[c]
    cursor = first[:count].copy()
    for i in range(len(labels)):
        c = labels[i]
        if c >= 0:
            member[cursor[c]] = i
            cursor[c] += 1


@kernel
def _measure(
    x_px: Ints, y_px: Ints, on: Ints, off: Ints, first: Ints, member: Ints, covered: float, out: Floats, events: Ints
) -> None:
    """Fill out (5, k): x, y, var_x + var_y, covering radius and reach of the centres; events (3, k): on, off, both."""
    for c in range(out.shape[1]):
        start, stop = first[c], first[c + 1]
        n = stop - start
        sx = 0.0
        sy = 0.0
        for m in range(start, stop):
            i = member[m]
            sx += x_px[i]
            sy += y_px[i]
            events[0, c] += on[i]
            events[1, c] += off[i]
            if on[i] > 0 and off[i] > 0:
                events[2, c] += 1
        x = sx / n
        y = sy / n
        d2 = np.empty(n, np.float64)
        total = 0.0
        for m in range(n):
            i = member[start + m]
            d2[m] = (x_px[i] - x) ** 2 + (y_px[i] - y) ** 2
            total += d2[m]
        d2.sort()
        out[0, c] = x
        out[1, c] = y
        out[2, c] = total / n
        out[3, c] = np.sqrt(d2[max(0, int(np.ceil(covered * n)) - 1)])
        out[4, c] = np.sqrt(d2[n - 1])


def measure(active: Active, labels: Ints, piece: npt.NDArray[np.bool_], pool_px: int, rule: ShapeFilter) -> Targets:
    """Return the targets of labelled pixels.

    Args:
        active: the window's n pixels.
        labels: (n,) int32, below k; -1 for noise. Every label below k occurs.
        piece: (k,) bool, see `Targets`.
        pool_px: side of an onset pixel in sensor pixels.
        rule: what may become a track.
    """
    count = len(piece)
    first = np.zeros(count + 1, np.int32)
    member = np.empty(len(active), np.int32)
    out = np.zeros((5, count), np.float64)
    events = np.zeros((3, count), np.int32)
    _members(labels, count, first, member)
    _measure(active.x_px, active.y_px, active.on, active.off, first, member, COVERED, out, events)
    pixels = np.diff(first)
    if rule.shape == "distinct":
        roundness = pixels / (2 * np.pi * (out[2] + 1 / 6))
    else:
        roundness = pixels / (np.pi * (out[4] + 0.5) ** 2)
    verdict = np.where(roundness < rule.min_roundness, NOT_ROUND, ROUND).astype(np.uint8)
    verdict[pixels > rule.max_pixels] = TOO_MANY
    verdict[pixels < rule.min_pixels] = TOO_FEW
    middle = (pool_px - 1) / 2
    return Targets(
        x_px=out[0] * pool_px + middle,
        y_px=out[1] * pool_px + middle,
        pixels=pixels,
        radius_px=(out[3] + 0.5) * pool_px,
        reach_px=(out[4] + 0.5) * pool_px,
        on=events[0],
        off=events[1],
        both=events[2],
        roundness=roundness,
        verdict=verdict,
        piece=piece,
    )
