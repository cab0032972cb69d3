"""A beacon's LED: the frames that it sends, as edges of light.

The bits come from the link's own encoders (`heliograph.link.modulations`). A beacon repeats *rounds*: the frames of a
round one right after another (a text has one for every character), then `gap_bits` of the last level. With `fresh` a
round is one frame, its payload drawn for each round anew. A round has n bits, bit k (from minus infinity) begins at::

    t_k = start_us + k T,   T = 1e6 / bit_rate / (1 + ppm 1e-6)        level(k) = round[k // n][k mod n]

and where level(k) differs from level(k - 1) the LED switches at ``t_k + jitter z_k``, z_k normal, cut at JITTER_LIMIT
bits on both sides so that edges never change places. The frames are told at the clock's times, without the jitter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from heliograph.events import Flags
from heliograph.link.contract import Bits
from heliograph.units import bit_us
from heliograph_services.event_source.simulation.contract import Floats, Ints, SentFrame
from heliograph_services.event_source.simulation.lights.draws import Use, even, normal
from heliograph_services.event_source.simulation.lights.train import Train

# Two edges a bit apart that are each late or early by so much of it keep a tenth of a bit between them. Real timers
# err by microseconds; a jitter that comes near this limit has destroyed the bits anyway.
JITTER_LIMIT: Final = 0.45


@dataclass(frozen=True, slots=True, eq=False)
class Rounds:
    """What may be sent in a round: one row, or several to be drawn from; all of the same length.

    Args:
        bits: (rows, n) bool.
        begin: (rows, frames) int64, the bit with which a frame begins.
        end: (rows, frames) int64, the bit after its last, rising.
        payload: (rows, frames) int64.
    """

    bits: Flags
    begin: Ints
    end: Ints
    payload: Ints

    @classmethod
    def repeated(cls, frames: Sequence[tuple[int, Bits]], gap_bits: int = 0) -> Self:
        """Return the rounds of a beacon that always sends the same frames (payload, bits), in this order.

        Raises:
            ValueError: there is no bit to send.
        """
        bits = [bit for _, frame in frames for bit in frame]
        if not bits:
            raise ValueError("nothing to send")
        end = np.cumsum([len(frame) for _, frame in frames])
        begin = end - [len(frame) for _, frame in frames]
        payload = [payload for payload, _ in frames]
        row = bits + bits[-1:] * gap_bits
        return cls(np.array([row], np.bool_), begin[None, :], end[None, :], np.array([payload], np.int64))

    @classmethod
    def drawn(cls, frames: Sequence[tuple[int, Bits]], gap_bits: int = 0) -> Self:
        """Return the rounds of a beacon that draws one of the frames for each.

        A frame shorter than the longest is followed by its last level, so that any round's time can be told.

        Raises:
            ValueError: there is no frame, or one without a bit.
        """
        if not frames or not all(bits for _, bits in frames):
            raise ValueError("nothing to send")
        n = max(len(bits) for _, bits in frames) + gap_bits
        rows = [(*bits, *bits[-1:] * (n - len(bits))) for _, bits in frames]
        end = np.array([[len(bits)] for _, bits in frames], np.int64)
        payload = np.array([[payload] for payload, _ in frames], np.int64)
        return cls(np.array(rows, np.bool_), np.zeros_like(end), end, payload)


class BeaconDrive(Train):
    """The LED of a beacon (`contract.Drive`).

    Args:
        rounds: what it sends.
        bit_rate: nominal bits a second.
        start_us: when a round begins; before, it sends the same.
        clock_ppm: its clock runs so much too fast.
        jitter_us: standard deviation of an edge's time.
        seed: of the simulation.
        index: of the beacon, so that each has random numbers of its own.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(
        self,
        rounds: Rounds,
        bit_rate: float,
        *,
        start_us: float = 0.0,
        clock_ppm: float = 0.0,
        jitter_us: float = 0.0,
        seed: int = 0,
        index: int = 0,
    ) -> None:
        super().__init__(bit_rate, index)
        self._rounds = rounds
        self._rows, self._n = rounds.bits.shape
        self._bit_us = bit_us(bit_rate) / (1.0 + clock_ppm * 1e-6)
        self._start_us = start_us
        self._jitter_us = jitter_us
        self._seed = seed
        self._index = index

    def edges(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and new levels of the changes in [t0_us, t1_us)."""
        k = self._bits_about(t0_us, t1_us)
        lit = self._lit(k)
        changed = np.flatnonzero(lit[1:] != lit[:-1]) + 1
        t_us = self._times(k[changed])
        inside = (t_us >= t0_us) & (t_us < t1_us)
        return t_us[inside], lit[changed][inside].astype(np.float64)

    def level_before(self, t_us: float) -> float:
        """Return the level just before t_us."""
        k = self._bits_about(t_us, t_us)
        # A bit's level holds from the (jittered) time of its beginning on, whether or not that is an edge.
        return float(self._lit(k)[np.flatnonzero(self._times(k) < t_us)[-1]])

    def frames_ended(self, t0_us: float, t1_us: float) -> list[SentFrame]:
        """Return the frames whose last bit ended in [t0_us, t1_us), in order of time."""
        round_us = self._n * self._bit_us
        first = int((t0_us - self._start_us) // round_us) - 1
        m = np.arange(first, int((t1_us - self._start_us) // round_us) + 2, dtype=np.int64)
        row = self._row(m)
        end_us = self._start_us + (m[:, None] * self._n + self._rounds.end[row]) * self._bit_us
        begin_us = self._start_us + (m[:, None] * self._n + self._rounds.begin[row]) * self._bit_us
        ended = (end_us >= t0_us) & (end_us < t1_us)
        columns = (begin_us[ended].tolist(), end_us[ended].tolist(), self._rounds.payload[row][ended].tolist())
        return [SentFrame(*frame) for frame in zip(*columns, strict=True)]

    def _bits_about(self, t0_us: float, t1_us: float) -> Ints:
        """Return the numbers of all bits that may begin in [t0_us, t1_us), two or more before them and one after."""
        first = int((t0_us - self._start_us) // self._bit_us) - 2
        return np.arange(first, int((t1_us - self._start_us) // self._bit_us) + 3, dtype=np.int64)

    def _times(self, k: Ints) -> Floats:
        t_us = self._start_us + k.astype(np.float64) * self._bit_us
        if self._jitter_us > 0.0:
            late_us = self._jitter_us * normal(self._seed, self._index, Use.JITTER, k)
            limit_us = JITTER_LIMIT * self._bit_us
            t_us = t_us + np.clip(late_us, -limit_us, limit_us)
        return t_us

    def _lit(self, k: Ints) -> Flags:
        m = k // self._n
        row = self._row(np.arange(m[0], m[-1] + 1, dtype=np.int64))
        lit: Flags = self._rounds.bits[row[m - m[0]], k % self._n]
        return lit

    def _row(self, m: Ints) -> Ints:
        if self._rows == 1:
            return np.zeros_like(m)
        row: Ints = (even(self._seed, self._index, Use.PAYLOAD, m) * self._rows).astype(np.int64)
        return row
