"""DBSCAN on a pixel grid, exact.

With w(p) the events of an active pixel p in the window, eps the radius and B(p) the active pixels q, |q - p| <= eps::

    p is core         if   sum over q in B(p) of w(q) >= min_events
    p, q core share a cluster if q in B(p), transitively
    p not core takes the lowest-numbered cluster of a core pixel in B(p), or none (label -1)

Clusters are numbered by their first core pixel in the order of the input. These are scikit-learn's labels for
``DBSCAN(eps, min_samples=min_events).fit(pixels, sample_weight=w)``, and for the raw events when pixels come in the
order of their first event (Ester et al. 1996; the paper, "Clustering").

The grid holds, for each pixel, its place in the input plus one (0: silent), with a rim as wide as eps, so that a
neighbour is one addition away. The grid is cleared pixel by pixel: a window costs what is active in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.jit import kernel

Ints = npt.NDArray[np.int32]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Active:
    """n distinct active pixels of a window, in the order of their first entry.

    Args:
        x_px: (n,) int32, onset pixels.
        y_px: (n,) int32.
        on: (n,) int32, events that became brighter.
        off: (n,) int32, events that became darker.
        moments: (2, n) float64, sums over the pixel's events of their tick, and of its square.
    """

    x_px: Ints
    y_px: Ints
    on: Ints
    off: Ints
    moments: Floats

    def __len__(self) -> int:
        return len(self.x_px)


@kernel
def _distinct(
    x_px: npt.NDArray[Any],
    y_px: npt.NDArray[Any],
    on: npt.NDArray[Any],
    off: npt.NDArray[Any],
    tick: npt.NDArray[Any],
    grid: Ints,
    stride: int,
    pad: int,
    out: Ints,
    moments: Floats,
) -> int:
    """Write the distinct pixels with events to out (4, n): x, y, on, off; and their moments (2, n); return how many."""
    n = 0
    for i in range(len(x_px)):
        a = np.int32(on[i])
        b = np.int32(off[i])
        if a + b == 0:
            continue
        cell = (np.int64(y_px[i]) + pad) * stride + np.int64(x_px[i]) + pad
        j = grid[cell] - 1
        if j < 0:
            j = n
            n += 1
            grid[cell] = n
            out[0, j] = x_px[i]
            out[1, j] = y_px[i]
            out[2, j] = 0
            out[3, j] = 0
            moments[0, j] = 0.0
            moments[1, j] = 0.0
        out[2, j] += a
        out[3, j] += b
        k = float(tick[i])
        moments[0, j] += (a + b) * k
        moments[1, j] += (a + b) * k * k
    for j in range(n):
        grid[(np.int64(out[1, j]) + pad) * stride + np.int64(out[0, j]) + pad] = 0
    return n


@kernel
def _label(
    cells: npt.NDArray[np.int64],
    weight: Ints,
    grid: Ints,
    disc: npt.NDArray[np.int64],
    min_events: int,
    labels: Ints,
    core: npt.NDArray[np.bool_],
    stack: Ints,
) -> int:
    """Fill labels, return the number of clusters; core and stack are scratch of the input's length."""
    n = len(cells)
    for i in range(n):
        grid[cells[i]] = i + 1
        labels[i] = -1
    for i in range(n):
        total = np.int64(0)
        for k in range(len(disc)):
            j = grid[cells[i] + disc[k]]
            if j > 0:
                total += weight[j - 1]
        core[i] = total >= min_events
    count = 0
    for i in range(n):
        if labels[i] >= 0 or not core[i]:
            continue
        labels[i] = count
        stack[0] = i
        depth = 1
        while depth > 0:
            depth -= 1
            p = stack[depth]
            if not core[p]:
                continue
            for k in range(len(disc)):
                j = grid[cells[p] + disc[k]] - 1
                if j >= 0 and labels[j] < 0:
                    labels[j] = count
                    stack[depth] = j
                    depth += 1
        count += 1
    for i in range(n):
        grid[cells[i]] = 0
    return count


class Clusterer:
    """DBSCAN for windows of one sensor; keeps the grid between windows.

    Args:
        width: columns, onset pixels.
        height: rows.
        eps_px: radius, onset pixels; a neighbour at exactly this distance counts.
        min_events: events within the radius that make a pixel core, its own included.
    """

    def __init__(self, width: int, height: int, eps_px: float, min_events: int) -> None:
        self._pad = math.floor(eps_px)
        self._stride = width + 2 * self._pad
        # Zeros are mapped by the system only where they are touched: a wide sensor costs nothing until it is active.
        self._grid = np.zeros(self._stride * (height + 2 * self._pad), np.int32)
        self._min_events = min_events
        reach = range(-self._pad, self._pad + 1)
        # Compared as scikit-learn does, by the root: for eps = sqrt(2) the squares would round the other way.
        self._disc = np.array(
            [dy * self._stride + dx for dy in reach for dx in reach if math.sqrt(dx * dx + dy * dy) <= eps_px],
            np.int64,
        )

    def distinct(
        self,
        x_px: npt.NDArray[Any],
        y_px: npt.NDArray[Any],
        on: npt.NDArray[Any],
        off: npt.NDArray[Any],
        tick: npt.NDArray[Any],
    ) -> Active:
        """Return the pixels with events, counts of repeated entries added; all of them must lie on the sensor."""
        out = np.empty((4, len(x_px)), np.int32)
        moments = np.empty((2, len(x_px)))
        n = _distinct(x_px, y_px, on, off, tick, self._grid, self._stride, self._pad, out, moments)
        # Rows cut short are another type to numba, for which a live tracker would wait seconds.
        return Active(out[0, :n], out[1, :n], out[2, :n], out[3, :n], np.ascontiguousarray(moments[:, :n]))

    def labels(self, active: Active) -> tuple[Ints, int]:
        """Return (n,) int32 labels, -1 for noise, and the number of clusters."""
        n = len(active)
        labels = np.empty(n, np.int32)
        cells = (active.y_px.astype(np.int64) + self._pad) * self._stride + active.x_px + self._pad
        count = _label(
            cells,
            active.on + active.off,
            self._grid,
            self._disc,
            self._min_events,
            labels,
            np.empty(n, np.bool_),
            np.empty(n, np.int32),
        )
        return labels, count
