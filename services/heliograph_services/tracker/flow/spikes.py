"""What a network that runs takes and gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.flow.network import DELAY_LIMIT

Ints = npt.NDArray[np.int32]

# A tick and the ten before it.
TICKS: Final = DELAY_LIMIT + 1
# Buffers of spikes grow when they are full.
SPIKES_AT_FIRST: Final = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Spikes:
    """The n spikes of one tick: views of the runtime's buffers, overwritten by its next tick.

    Args:
        x: (n,) int32, column.
        y: (n,) int32, row.
        k: (n,) int32, neuron.
        s: (n,) potential, float32, or int32 where weights are whole.
    """

    x: Ints
    y: Ints
    k: Ints
    s: npt.NDArray[Any]

    def __len__(self) -> int:
        return len(self.x)

    def copy(self) -> Spikes:
        """Return the same spikes, to keep."""
        return Spikes(self.x.copy(), self.y.copy(), self.k.copy(), self.s.copy())

    def within(self, wanted: npt.NDArray[np.uint8] | None) -> Spikes:
        """Return those that are asked for; see `Runtime.step`."""
        if wanted is None:
            return self
        least = wanted[self.y, self.x >> 6]
        mine = (least != 0) & (self.s >= least)
        return Spikes(self.x[mine], self.y[mine], self.k[mine], self.s[mine])


class Runtime(Protocol):
    """A network that runs."""

    def step(self, x: npt.NDArray[Any], y: npt.NDArray[Any], wanted: npt.NDArray[np.uint8] | None = None) -> Spikes:
        """Take the next tick's distinct active pixels, all on the image; return its spikes, for use until the next.

        Args:
            x: (n,) columns.
            y: (n,) rows.
            wanted: (rows, words of 64 columns) the least potential of the spikes that are asked for there, 0 where none
                is; all are asked for if None.
        """
        ...

    def skip(self, ticks: int) -> list[Spikes]:
        """Pass so many ticks without input; return the spikes of the first that can have any."""
        ...


NO_PIXELS: Final = np.empty(0, np.int64)
NO_SPIKES: Final = Spikes(np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.int32))
