"""What a camera is to the rest of the source: a sensor, and windows of its events on an absolute grid."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from heliograph.camera import Intrinsics
from heliograph.errors import Refusals
from heliograph.events import EventBatch
from heliograph.messages import Message
from heliograph.streams import Image


@dataclass(frozen=True, slots=True)
class Window:
    """What a camera saw in [t0_us, t1_us).

    Args:
        t0_us: a multiple of the configured window.
        t1_us: t0_us + the window.
        batch: its events: sorted, on the sensor; none is missing and none comes later.
        stream: the run that it belongs to; when it changes, time starts anew, else t0_us is the last window's t1_us.
        truth: what was really there, from a camera that knows it (a `heliograph.truth.Truth`).
        labels: (n,) int16, what made each event, from a camera that knows it; for files alone, never sent.
        image: a view of the scene, from a camera that has one, where one is due.
        refused: input refused since the window before, by reason.
        end: nothing follows.
    """

    t0_us: int
    t1_us: int
    batch: EventBatch
    stream: str
    truth: Message | None = None
    labels: npt.NDArray[np.int16] | None = None
    image: Image | None = None
    refused: Refusals = field(default_factory=Refusals)
    end: bool = False


class Camera(Protocol):
    """A camera, opened. A backend is a class made with (config, context) that obeys this."""

    width: int
    height: int
    stream: str  # of the first window
    intrinsics: Intrinsics | None

    def windows(self) -> Iterator[Window]:
        """Yield the windows in order of time, also those without an event.

        Raises:
            FileError: what is played turns out to be no recording after all.
        """
        ...

    def close(self) -> None:
        """Let go of files and devices; may be called twice."""
        ...
