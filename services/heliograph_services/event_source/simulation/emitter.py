"""What a simulated LED does: its light at any time, its edges, and the frames that it sends.

A beacon repeats one *round*: its frames one after another (a text has a frame for every character), then `gap_bits` of
the last level. It has always done so; `start_us` is where one of the rounds begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
import numpy.typing as npt

from heliograph.errors import ConfigError
from heliograph.events import Flags
from heliograph.link.contract import Bits, edges_of
from heliograph.link.modulations import modulation
from heliograph.units import bit_us
from heliograph_services.event_source.simulation.scenario import BeaconSpec

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SentFrame:
    """A frame on the air, its bits from t0_us to t1_us."""

    t0_us: float
    t1_us: float
    payload: int


class Emitter:
    """The LED of one beacon.

    Args:
        frames: payload and bits of the frames of a round, in the order in which they are sent.
        bit_us: length of a bit.
        gap_bits: bits of the last level after them.
        start_us: begin of one of the rounds.
    """

    def __init__(self, frames: list[tuple[int, Bits]], bit_us: float, gap_bits: int = 0, start_us: float = 0.0) -> None:
        bits = [bit for _, frame in frames for bit in frame]
        bits += bits[-1:] * gap_bits
        self._levels = np.array(bits, np.bool_)
        self._bit_us = bit_us
        self._start_us = start_us
        self._round_us = len(bits) * bit_us
        self._edge_us, self._edge_on = edges_of(bits, 0.0, bit_us, level=bool(bits[-1]))
        self._payloads = [payload for payload, _ in frames]
        ends = list(accumulate(len(frame) for _, frame in frames))
        self._end_us = np.array(ends, np.float64) * bit_us
        self._begin_us = np.array([0, *ends[:-1]], np.float64) * bit_us

    def lit(self, t_us: Floats) -> Flags:
        """Return (n,) bool, the LED's state at the times."""
        bit = np.floor((t_us - self._start_us) / self._bit_us).astype(np.int64)
        return self._levels[bit % len(self._levels)]

    def edges(self, t0_us: float, t1_us: float) -> tuple[Floats, Flags]:
        """Return times (float64 us) and new states of the changes in [t0_us, t1_us)."""
        t_us, which = self._repeated(self._edge_us, t0_us, t1_us)
        return t_us, self._edge_on[which]

    def frames_ended(self, t0_us: float, t1_us: float) -> list[SentFrame]:
        """Return the frames whose last bit ended in [t0_us, t1_us), in order of time."""
        ended, which = self._repeated(self._end_us, t0_us, t1_us)
        lengths = (self._end_us - self._begin_us)[which]
        return [
            SentFrame(float(end - length), float(end), self._payloads[i])
            for end, length, i in zip(ended, lengths, which, strict=True)
        ]

    def _repeated(self, offsets_us: Floats, t0_us: float, t1_us: float) -> tuple[Floats, npt.NDArray[np.int64]]:
        """Return the times in [t0_us, t1_us) at which a round's offsets come round, and the index of each."""
        first = int(np.floor((t0_us - self._start_us) / self._round_us)) - 1
        last = int(np.floor((t1_us - self._start_us) / self._round_us)) + 1
        rounds = np.arange(first, last + 1, dtype=np.float64)
        t_us = self._start_us + (rounds[:, None] * self._round_us + offsets_us[None, :]).ravel()
        which = np.tile(np.arange(len(offsets_us)), len(rounds))
        inside = (t_us >= t0_us) & (t_us < t1_us)
        return t_us[inside], which[inside]


def emitter_of(spec: BeaconSpec) -> Emitter:
    """Return the LED of a scenario's beacon.

    Raises:
        ConfigError: its protocol does not exist, or cannot send what it is to send.
    """
    try:
        kind: Any = modulation(spec.protocol, **spec.options)
        if spec.text is not None:
            frames = [(ord(character), kind.encode(character)) for character in spec.text]
        else:
            frames = [(int(spec.payload or 0), kind.encode(spec.payload))]
        if not sum(len(bits) for _, bits in frames):
            raise ValueError("nothing to send")
        return Emitter(frames, bit_us(spec.bit_rate), spec.gap_bits, float(spec.start_us))
    except (ValueError, TypeError) as error:
        raise ConfigError(f"beacon {spec.name}: {error}") from None
