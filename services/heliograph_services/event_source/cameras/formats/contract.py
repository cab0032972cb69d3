"""What a file format is to the recording camera: a size, and chunks of events as the file has them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from heliograph.errors import FileError, Refusals
from heliograph.events import EventBatch, Pixels
from heliograph.messages import SENSOR_LIMIT_PX

# Events a chunk: 13 bytes each in memory; larger ones are no faster, smaller ones cost calls.
CHUNK_EVENTS: Final = 65_536


@dataclass(frozen=True, slots=True)
class Chunk:
    """Events as they stand in the file, neither ordered nor within the sensor for sure, and what was unreadable."""

    batch: EventBatch
    refused: Refusals = field(default_factory=Refusals)


@dataclass(frozen=True, slots=True)
class Size:
    """A sensor's size in pixels; 0 x 0: not given."""

    width: int
    height: int

    def __bool__(self) -> bool:
        return self.width > 0 and self.height > 0

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


class Reader(Protocol):
    """A file that can be read, again and again. A format is a class made with (path, given size) that obeys this."""

    size: Size

    def chunks(self) -> Iterator[Chunk]:
        """Yield the file's events from its beginning, in bounded memory.

        Raises:
            FileError: nothing can be made of the file.
        """
        ...


def as_pixels(column: npt.NDArray[Any]) -> Pixels:
    """Return whole numbers as coordinates; those that no uint16 holds become one that no sensor has."""
    if column.dtype == np.uint16:
        return column
    return np.where((column < 0) | (column > 0xFFFF), 0xFFFF, column).astype(np.uint16)


def settled_size(path: Path, found: Size, given: Size) -> Size:
    """Return the sensor's size from what the file says and what the operator says.

    Raises:
        FileError: nobody says it, the two differ, or it is beyond every sensor.
    """
    if found and given and found != given:
        raise FileError(f"{path}: the file says {found}, the settings say {given}")
    size = found or given
    if not size:
        raise FileError(f"{path}: the file does not say the size of its sensor; set width and height")
    if max(size.width, size.height) > SENSOR_LIMIT_PX:
        raise FileError(f"{path}: a sensor has at most {SENSOR_LIMIT_PX} pixels a side, not {size}")
    return size
