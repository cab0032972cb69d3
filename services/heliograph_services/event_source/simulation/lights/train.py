"""Trains of edges: drives whose edges can be worked out for any stretch of time without what came before.

An edge's time and level are a function of its number alone, so a stretch [t0, t1) holds the same edges however time
is cut. Asking costs some 20 us of numpy a call, and a light is asked every 20 ms: so edges are made for a *block* of
time at once and handed out in slices. Blocks lie on an absolute grid; they change the cost and nothing else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph_services.event_source.simulation.contract import CHUNK_US, Floats, SentFrame

# 2048 edges are 32 kB a light; a beacon of 2 kbit/s is asked afresh once a second, one of 100 kbit/s in every chunk.
BLOCK_EDGES: Final = 2_048
# No block beyond 4 s, however slow the light: a picture of an hour ahead serves nobody.
BLOCK_CHUNKS_LIMIT: Final = 200
# Whoever asks for the truth of the last window lags behind whoever makes the next chunk by less than this.
BLOCKS_KEPT: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    level0: float
    edge_us: Floats
    edge_level: Floats


class Train(ABC):
    """A drive (`contract.Drive`) that works out its edges block by block.

    Args:
        edges_hz: about how many edges it has a second; for the size of the blocks alone.
        stagger: of several lights' blocks, so that they do not all fall due in the same chunk.
    """

    def __init__(self, edges_hz: float, stagger: int = 0) -> None:
        chunks = int(BLOCK_EDGES / max(edges_hz * CHUNK_US * 1e-6, 1e-9))
        chunks = min(max(chunks, 1), BLOCK_CHUNKS_LIMIT)
        self._block_us = float(chunks * CHUNK_US)
        self._shift_us = float(stagger % chunks * CHUNK_US)
        self._blocks: dict[int, _Block] = {}

    @abstractmethod
    def edges(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and new levels of the changes in [t0_us, t1_us), worked out afresh."""

    @abstractmethod
    def level_before(self, t_us: float) -> float:
        """Return the level just before t_us, worked out afresh."""

    def changes(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and new levels of the changes in [t0_us, t1_us) (`contract.Drive`)."""
        first = self._number(t0_us)
        if t1_us <= self._begin_us(first + 1):
            return _slice(self._block(first), t0_us, t1_us)
        if t1_us > self._begin_us(first + 2):
            return self.edges(t0_us, t1_us)
        parts = [_slice(self._block(number), t0_us, t1_us) for number in (first, first + 1)]
        return np.concatenate([t for t, _ in parts]), np.concatenate([level for _, level in parts])

    def level(self, t_us: float) -> float:
        """Return the level just before t_us (`contract.Drive`)."""
        block = self._block(self._number(t_us))
        i = int(np.searchsorted(block.edge_us, t_us))
        return float(block.edge_level[i - 1]) if i else block.level0

    def frames_ended(self, t0_us: float, t1_us: float) -> list[SentFrame]:  # noqa: ARG002 - a beacon's is its own
        """Return no frames: only beacons send any."""
        return []

    def _number(self, t_us: float) -> int:
        return int((t_us - self._shift_us) // self._block_us)

    def _begin_us(self, number: int) -> float:
        return number * self._block_us + self._shift_us

    def _block(self, number: int) -> _Block:
        block = self._blocks.get(number)
        if block is None:
            while len(self._blocks) >= BLOCKS_KEPT:
                del self._blocks[min(self._blocks)]
            begin_us = self._begin_us(number)
            block = _Block(self.level_before(begin_us), *self.edges(begin_us, self._begin_us(number + 1)))
            self._blocks[number] = block
        return block


class Periodic(Train):
    """The same edges in every period, without end.

    Args:
        period_us: length of a period.
        offset_us: (n,) the edges' times in it, rising, in [0, period_us); n may be 0.
        level: (n,) the level from each on.
        steady: the level where n is 0.
        phase_us: begin of one of the periods.
        stagger: of its blocks.
    """

    def __init__(
        self, period_us: float, offset_us: Floats, level: Floats, steady: float, phase_us: float, stagger: int
    ) -> None:
        super().__init__(len(offset_us) * 1e6 / period_us, stagger)
        self._period_us = period_us
        self._offset_us = offset_us
        self._level = level
        self._steady = steady
        self._phase_us = phase_us

    def edges(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and new levels of the changes in [t0_us, t1_us)."""
        first = (t0_us - self._phase_us) // self._period_us - 1
        last = (t1_us - self._phase_us) // self._period_us + 1
        periods = np.arange(first, last + 1, dtype=np.float64)
        t_us = (self._phase_us + periods[:, None] * self._period_us + self._offset_us[None, :]).ravel()
        inside = (t_us >= t0_us) & (t_us < t1_us)
        return t_us[inside], np.tile(self._level, len(periods))[inside]

    def level_before(self, t_us: float) -> float:
        """Return the level just before t_us."""
        if not len(self._offset_us):
            return self._steady
        # Two periods back there is an edge for certain, wherever rounding puts the first.
        return float(self.edges(t_us - 2.0 * self._period_us, t_us)[1][-1])


def _slice(block: _Block, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
    i, j = (int(k) for k in np.searchsorted(block.edge_us, (t0_us, t1_us)))
    return block.edge_us[i:j], block.edge_level[i:j]
