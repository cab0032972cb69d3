"""Events of a camera: one struct of arrays, checked where it enters.

An event is (t, x, y, polarity) of one pixel. `t` is int64 microseconds on the camera's clock; `on` is True where the
pixel became brighter. y grows downwards, pixel (0, 0) is the upper left one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Times = npt.NDArray[np.int64]
Pixels = npt.NDArray[np.uint16]
Flags = npt.NDArray[np.bool_]

_COLUMNS: Final = tuple(
    (name, np.dtype(kind))
    for name, kind in (("t_us", np.int64), ("x_px", np.uint16), ("y_px", np.uint16), ("on", np.bool_))
)


@dataclass(frozen=True, slots=True, eq=False)
class EventBatch:
    """n events of one camera, sorted by time; n may be 0.

    Args:
        t_us: (n,) int64, camera clock, not falling.
        x_px: (n,) uint16, column.
        y_px: (n,) uint16, row.
        on: (n,) bool, True where brighter.

    Raises:
        ValueError: lengths differ. Order and range are the business of `checked`, since they cost a pass.
        TypeError: an array has another dtype.
    """

    t_us: Times
    x_px: Pixels
    y_px: Pixels
    on: Flags

    def __post_init__(self) -> None:
        shape = (len(self.t_us),)
        for name, dtype in _COLUMNS:
            array = getattr(self, name)
            if array.dtype != dtype:
                raise TypeError(f"{name} must be {dtype.name}, not {array.dtype.name}")
            if array.shape != shape:
                raise ValueError(f"{name} must have the shape {shape} of t_us, not {array.shape}")

    def __len__(self) -> int:
        return len(self.t_us)

    @classmethod
    def empty(cls) -> EventBatch:
        """Return a batch of no events."""
        return cls(np.empty(0, np.int64), np.empty(0, np.uint16), np.empty(0, np.uint16), np.empty(0, np.bool_))

    def part(self, start: int, stop: int) -> EventBatch:
        """Return the events [start, stop) as views."""
        return EventBatch(self.t_us[start:stop], self.x_px[start:stop], self.y_px[start:stop], self.on[start:stop])


def checked(batch: EventBatch, width: int, height: int) -> EventBatch:
    """Return the batch after one pass over it.

    Raises:
        ValueError: time falls, or a pixel lies outside width x height; the text names the first such event.
    """
    if len(batch) == 0:
        return batch
    falls = batch.t_us[1:] < batch.t_us[:-1]
    if falls.any():
        i = int(falls.argmax())
        raise ValueError(f"time runs backwards at event {i + 1}: {batch.t_us[i + 1]} us after {batch.t_us[i]} us")
    if batch.x_px.max() >= width or batch.y_px.max() >= height:
        i = int(np.argmax((batch.x_px >= width) | (batch.y_px >= height)))
        raise ValueError(f"event {i} at ({batch.x_px[i]}, {batch.y_px[i]}) lies outside {width}x{height}")
    return batch


def concatenate(batches: list[EventBatch]) -> EventBatch:
    """Return the events of all batches, one after another; the caller vouches for the order."""
    if not batches:
        return EventBatch.empty()
    if len(batches) == 1:
        return batches[0]
    return EventBatch(
        np.concatenate([b.t_us for b in batches]),
        np.concatenate([b.x_px for b in batches]),
        np.concatenate([b.y_px for b in batches]),
        np.concatenate([b.on for b in batches]),
    )
