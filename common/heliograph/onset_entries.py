"""What an onset counter is made for, and the entries that it gives; `heliograph.onsets` says what they mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Gate = Literal["open", "active"]


@dataclass(frozen=True, slots=True)
class OnsetSettings:
    """What an onset counter is made for; the ranges are checked by the service's configuration.

    Args:
        width: of the sensor, pixels.
        height: of the sensor, pixels.
        tick_us: length of a tick.
        pool_px: side of the square of sensor pixels that becomes one entry.
        gate: "open" or "active", see `heliograph.onsets`.
        min_events: the least that the active gate asks for.
        noise_hz: entries of noise a second that may pass the active gate; 0: it asks for min_events, always.
        memory_us: see `heliograph.onsets`.
    """

    width: int
    height: int
    tick_us: int
    pool_px: int = 1
    gate: Gate = "active"
    min_events: int = 2
    noise_hz: float = 2_000.0
    memory_us: int = 250_000


@dataclass(frozen=True, slots=True, eq=False)
class OnsetColumns:
    """The entries of some ticks, in the order (tick, y, x); columns as in `heliograph.streams.Onsets`.

    `light` says which lie at a blinking light (none with the gate open). `gated` counts entries that the gate dropped,
    `flooded` ticks that were emptied, `off_sensor` events that were ignored because they lie outside the sensor.
    """

    tick: npt.NDArray[np.uint16]
    x_px: npt.NDArray[np.uint16]
    y_px: npt.NDArray[np.uint16]
    on_count: npt.NDArray[np.uint8]
    off_count: npt.NDArray[np.uint8]
    light: npt.NDArray[np.bool_]
    gated: int
    flooded: int
    off_sensor: int

    def later(self, ticks: int) -> OnsetColumns:
        """Return the same, so many ticks later."""
        return self if ticks == 0 else replace(self, tick=(self.tick + ticks).astype(np.uint16))


def joined(parts: Sequence[OnsetColumns]) -> OnsetColumns:
    """Return the entries of all parts, whose ticks follow one another; none of no parts."""
    if len(parts) == 1:
        return parts[0]

    def column(name: str, kind: type[np.generic]) -> npt.NDArray[Any]:
        return np.concatenate([np.empty(0, kind), *(getattr(part, name) for part in parts)])

    return OnsetColumns(
        column("tick", np.uint16),
        column("x_px", np.uint16),
        column("y_px", np.uint16),
        column("on_count", np.uint8),
        column("off_count", np.uint8),
        column("light", np.bool_),
        gated=sum(part.gated for part in parts),
        flooded=sum(part.flooded for part in parts),
        off_sensor=sum(part.off_sensor for part in parts),
    )
