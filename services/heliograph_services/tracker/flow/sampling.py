"""Which spikes of a network are read in a tick: all where little moves, a sample of the surer ones where much does.

Ground in view fires a network everywhere, and thousands of samples tell no more of its motion than hundreds. With the
image in tiles of 64 x 16 pixels, and n the inputs of a tile within a neuron's longest delay (a running sum that
forgets 1/11 a tick)::

    m = min(ceil(n / limit), EVERY_MOST)
    m <= 1    all spikes are read
    m > 1     those of a potential of at least SURE v_th, in the rows with (row + turn_t) mod m = 0

turn_t jumps about, since rows taken in order would run along with some fronts. Every input enters the network; without
memory an output is not less exact because another is not computed. So a beacon on dark ground is read whole, whatever
goes on elsewhere, and the work of a tile is bounded. Weak spikes in texture are where two fronts meet: without them the
errors at 640 and 1000 px/s fell, too.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.flow.spikes import TICKS
from heliograph_services.tracker.jit import kernel

Wanted = npt.NDArray[np.uint8]

# With 6 ticks that answer, every row still has its turn.
EVERY_MOST: Final = 4
# 8 of 25 inputs in time, where the paper's threshold is 5; 9 and more lose slow, weak texture.
SURE: Final = 1.6
WORD_BITS: Final = 6
ROW_BITS: Final = 4
# Multiplying by the golden section's share of 2^32 scatters ticks; its upper bits are used (Knuth).
_SCATTER: Final = 2_654_435_761


@kernel
def _choose(x: Any, y: Any, tick: int, limit: float, sure: int, load: Any, wanted: Any) -> int:
    """Update load (tile rows, words) by this tick's inputs, fill wanted (rows, words); return how many are left out."""
    for row in range(load.shape[0]):
        for word in range(load.shape[1]):
            load[row, word] *= 1.0 - 1.0 / TICKS
    for i in range(len(x)):
        load[y[i] >> ROW_BITS, x[i] >> WORD_BITS] += 1.0
    turn = (((tick & 0xFFFFFF) * _SCATTER) & 0xFFFFFFFF) >> 16
    left_out = 0
    for row in range(wanted.shape[0]):
        for word in range(wanted.shape[1]):
            every = min(EVERY_MOST, int(np.ceil(load[row >> ROW_BITS, word] / limit)))
            if every <= 1:
                wanted[row, word] = 1
            elif (row + turn) % every == 0:
                wanted[row, word] = sure
            else:
                wanted[row, word] = 0
                left_out += 1
    return left_out


class Sampler:
    """Chooses for one network.

    Args:
        width: columns.
        height: rows.
        limit: see the module.
        v_th: the network's threshold.
    """

    def __init__(self, width: int, height: int, limit: float, v_th: float) -> None:
        words = -(-width // (1 << WORD_BITS))
        self._load = np.zeros((-(-height // (1 << ROW_BITS)), words))
        self._wanted = np.ones((height, words), np.uint8)
        self._limit = limit
        self._sure = min(255, int(np.ceil(SURE * v_th)))

    def choose(self, x: npt.NDArray[Any], y: npt.NDArray[Any], tick: int) -> tuple[Wanted, int]:
        """Take the inputs of the next tick.

        Args:
            x: (n,) columns.
            y: (n,) rows.
            tick: its number.

        Returns:
            (rows, words of 64 columns) the least potential that is read, 0 where none is, for use until the next tick;
            and the number of the latter.
        """
        left_out = _choose(x, y, tick, self._limit, self._sure, self._load, self._wanted)
        return self._wanted, left_out

    def skip(self, ticks: int) -> None:
        """Pass so many ticks without input."""
        self._load *= (1 - 1 / TICKS) ** ticks
