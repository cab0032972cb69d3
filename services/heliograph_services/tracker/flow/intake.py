"""From onset entries to a network's input: pool, gate the noise, keep onsets only.

Per network tick and pooled pixel, with c the events that its entries counted and c9 those of the 3 x 3 around it::

    active   c >= 1 and c9 >= m;  m the least with  P(N(lambda) >= 1) P(N(8 lambda) >= m - 1) <= noise_share
    input    active, and not active in the `silence` ticks before

N is Poisson's: at most that share of pixels and ticks passes by noise alone, and an edge, which is a line, passes with
one event a pixel. lambda, the noise a pixel and tick, is measured (`noise`).

Arrival is the time of the first entry of the input's tick, in network ticks: finer than the tick where the stream's
ticks are finer.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.flow.network import REACH
from heliograph_services.tracker.jit import kernel

# Beyond it a scale is blind; floating-point sums of the series would not end.
EVENTS_LIMIT: Final = 2_000
# Long before any tick that an age is asked of.
NEVER: Final = -1e9


@kernel
def _collect(
    x: Any, y: Any, on: Any, off: Any, column: Any, row: Any, part: float, counts: Any, cells: Any, first: Any, n: int
) -> int:
    """Add the entries of one stream tick to the counts; list new cells with their time in the tick; return how many."""
    for i in range(len(x)):
        cell = row[y[i]] + column[x[i]]
        before = counts[cell]
        if before == 0:
            cells[n] = cell
            first[n] = part
            n += 1
        counts[cell] = before + np.int32(on[i]) + np.int32(off[i])
    return n


@kernel
def _around(counts: Any, cell: int, stride: int) -> Any:
    """Return the events of the 3 x 3 around a cell."""
    above = cell - stride
    below = cell + stride
    total = counts[above - 1] + counts[above] + counts[above + 1]
    total += counts[cell - 1] + counts[cell] + counts[cell + 1]
    return total + counts[below - 1] + counts[below] + counts[below + 1]


@kernel
def _release(
    cells: Any, first: Any, n: int, tick: int, at_least: int, silence: int, counts: Any, stride: int, active_at: Any,
    arrival: Any, out: Any,
) -> int:  # fmt: skip
    """Write the inputs of this tick to out (2, n) and their arrival, clear the counts; return how many."""
    kept = 0
    for i in range(n):
        cell = cells[i]
        # Its own events are of the 3 x 3.
        if counts[cell] < at_least and _around(counts, cell, stride) < at_least:
            continue
        if tick - active_at[cell] > silence:
            out[0, kept] = cell % stride - REACH
            out[1, kept] = cell // stride - REACH
            kept += 1
            arrival[cell] = tick + first[i]
        active_at[cell] = tick
    for i in range(n):
        counts[cells[i]] = 0
    return kept


class Intake:
    """Collects the entries of one network tick after another.

    Args:
        width: columns of the network.
        height: rows.
        factor: the stream's pixels to one of the network's, along a side.
        silence: see the module.
        noise_share: see the module; 1 opens the gate.

    Attributes:
        arrival: (height + 4, width + 4) float64: the network tick at which each pixel's last input arrived.
    """

    def __init__(self, width: int, height: int, factor: int, silence: int, noise_share: float) -> None:
        self.arrival = np.full((height + 2 * REACH, width + 2 * REACH), NEVER)
        self._silence = silence
        self._share = noise_share
        # Cells lie in one row of memory with the margin of `arrival`, which spares them every test for the border; the
        # tables spare a division an entry.
        self._stride = width + 2 * REACH
        self._column = (np.arange(width * factor) // factor + REACH).astype(np.int32)
        self._row = ((np.arange(height * factor) // factor + REACH) * self._stride).astype(np.int32)
        self._counts = np.zeros(self.arrival.size, np.int32)
        self._active_at = np.full(self.arrival.size, -(2**40), np.int64)
        self._cells = np.empty(width * height, np.int32)
        self._first = np.empty(width * height, np.float64)
        self._n = 0

    def collect(
        self,
        x: npt.NDArray[Any],
        y: npt.NDArray[Any],
        on: npt.NDArray[Any],
        off: npt.NDArray[Any],
        part: float,
    ) -> None:
        """Take the entries of one stream tick.

        Args:
            x: (n,) columns of the stream's pixels; all on the sensor.
            y: (n,) rows.
            on: (n,) events.
            off: (n,) events.
            part: the stream tick's middle within the network tick, 0 to 1.
        """
        self._n = _collect(
            x, y, on, off, self._column, self._row, part, self._counts, self._cells, self._first, self._n
        )

    def release(self, tick: int, noise: float) -> npt.NDArray[np.int32]:
        """End this tick; return its inputs, (2, n) columns and rows.

        Args:
            tick: its number; later than the one before.
            noise: lambda, events a pixel and tick.
        """
        out = np.empty((2, self._n), np.int32)
        kept = _release(
            self._cells, self._first, self._n, tick, threshold(noise, self._share), self._silence, self._counts,
            self._stride, self._active_at, self.arrival.ravel(), out,
        )  # fmt: skip
        self._n = 0
        return out[:, :kept]

    @property
    def pending(self) -> bool:
        """Whether this tick has entries."""
        return self._n > 0


def threshold(noise: float, share: float) -> int:
    """Return m, the events in 3 x 3 pixels that noise of mean `noise` a pixel reaches in at most this share of them."""
    if share >= 1:
        return 1
    # P(N(8 lambda) >= m - 1) by the series of P(N = m); lambda is bounded, so it ends soon.
    own = -np.expm1(-noise)
    m, term, tail = 1, float(np.exp(-8 * noise)), 1.0
    while own * tail > share and m < EVENTS_LIMIT:
        tail -= term
        term *= 8 * noise / m
        m += 1
    return m
