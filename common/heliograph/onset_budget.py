"""What of the onsets crosses the link when all of them do not fit: lights first, what is near, edges, tile by tile.

A message may cost what has been saved for it: each of length T adds ``.95 R T / 8 - OVERHEAD_BYTES`` bytes to the
credit, of which those of `CREDIT_US` are kept at most; each takes from it what its columns really took, and may
overdraw it. So over any second the link carries at most R and little more. How many entries fit follows from what an
entry has cost lately.

If n entries do not fit, tiles of 32x32 pixels are left out whole, since a cut target has a wrong centre and a cut front
a wrong motion. Tiles are taken in the order of a hash until the next one does not fit::

    lights  (`OnsetColumns.light`, `onset_dipoles`) by hash(tile, message): what is left out comes with the next ones
    near    (`onset_dipoles`) in the room that is left, by hash(tile, half second): what came and went would blink
    edges   in the room that is left, by hash(tile, half second): a front can be followed for a while

Everything depends on the stream alone, and never on how its events were cut into batches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.onset_dipoles import Marks
from heliograph.onsets import OnsetColumns
from heliograph.streams import OVERHEAD_BYTES
from heliograph.units import US_PER_S

Flags = npt.NDArray[np.bool_]

# What quiet ticks leave may be used by the next ones so long: a second's worst is then a twentieth above the plan.
CREDIT_US: Final = 50_000
# A share of the rate that is not planned with, for just that.
RESERVE: Final = 0.05
TILE_SHIFT: Final = 5
EPOCH_US: Final = 500_000
# What an entry costs before there is an experience, and how fast that is learned; messages of few entries teach little.
FIRST_COST: Final = 1.5
LEARNING: Final = 0.25
TEACHING_ENTRIES: Final = 64


@dataclass(frozen=True, slots=True)
class Kept:
    """Which entries cross, and how many lights and edges do not."""

    keep: Flags
    lights_thinned: int
    edges_thinned: int


class OnsetBudget:
    """Decides for one message after another, and learns what each cost.

    Args:
        bit_rate: R, of the link; 0: everything crosses.
        message_us: T, the length of a message.
    """

    def __init__(self, bit_rate: float, message_us: int) -> None:
        self._income = bit_rate * (1 - RESERVE) / 8 * message_us / US_PER_S - OVERHEAD_BYTES
        self._most = max(1.0, CREDIT_US / message_us) * self._income
        self._limited = bit_rate > 0
        self._credit = 0.0
        self._cost = FIRST_COST
        self._message_us = message_us

    @property
    def limited(self) -> bool:
        """Whether there is a limit at all."""
        return self._limited

    def reset(self) -> None:
        """Forget everything: a new stream begins."""
        self._credit, self._cost = 0.0, FIRST_COST

    def choose(self, columns: OnsetColumns, t0_us: int, marks: Marks | None = None) -> Kept:
        """Return what of a message crosses.

        Args:
            columns: of the message.
            t0_us: its begin.
            marks: of the dipoles among them; None: nobody has looked.
        """
        n = len(columns.tick)
        if not self._limited:
            return Kept(np.ones(n, np.bool_), 0, 0)
        self._credit = min(self._credit + self._income, self._most)
        room = max(0, int(self._credit / self._cost))
        if n <= room:
            return Kept(np.ones(n, np.bool_), 0, 0)
        tile = (columns.y_px.astype(np.int64) >> TILE_SHIFT << 16) | (columns.x_px >> TILE_SHIFT)
        light = columns.light if marks is None else columns.light | marks.dipole
        keep = np.zeros(n, np.bool_)
        keep[light] = _whole_tiles(tile[light], t0_us // self._message_us, room)
        room -= int(np.count_nonzero(keep))
        thinned = int(np.count_nonzero(light & ~keep))
        if thinned == 0:
            left = ~light
            if marks is not None:
                near = marks.near & left
                keep[near] = _whole_tiles(tile[near], t0_us // EPOCH_US, room)
                room -= int(np.count_nonzero(keep & near))
                left &= ~near
            keep[left] = _whole_tiles(tile[left], t0_us // EPOCH_US, room)
        return Kept(keep, thinned, n - thinned - int(np.count_nonzero(keep)))

    def spent(self, entries: int, size: int) -> None:
        """Take what the message of the last choice took.

        Args:
            entries: that crossed.
            size: bytes of their columns.
        """
        self._credit -= size
        if entries >= TEACHING_ENTRIES:
            self._cost += LEARNING * (size / entries - self._cost)


def _whole_tiles(tile: npt.NDArray[Any], turn: int, room: int) -> Flags:
    """Return which entries lie in the first tiles, by hash(tile, turn), that fit into the room together."""
    if len(tile) <= room:
        return np.ones(len(tile), np.bool_)
    tiles, place, entries = np.unique(tile, return_inverse=True, return_counts=True)
    order = np.argsort(_hash(tiles, turn), kind="stable")
    chosen = np.zeros(len(tiles), np.bool_)
    chosen[order] = np.cumsum(entries[order]) <= room
    kept: Flags = chosen[place]
    return kept


def _hash(tiles: npt.NDArray[Any], turn: int) -> npt.NDArray[np.uint64]:
    """Return 64 bits of each tile and the turn, mixed as splitmix64 does (Steele et al. 2014)."""
    word = tiles.astype(np.uint64) + np.uint64((turn * 0x9E37_79B9_7F4A_7C15) & (2**64 - 1))
    for shift, factor in ((30, 0xBF58_476D_1CE4_E5B9), (27, 0x94D0_49BB_1331_11EB)):
        word = (word ^ (word >> np.uint64(shift))) * np.uint64(factor)
    return word ^ (word >> np.uint64(31))
