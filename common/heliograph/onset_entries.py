"""What an onset counter is made for, and the entries that it gives; `heliograph.onsets` says what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
