"""What moves a track between its sightings, besides its own filter: the interface that the follower calls.

`Motion` answers two questions at places and times: how fast does the thing move that is seen here (`velocities`), and
how fast do the surroundings move (`carried`). `NoMotion` knows neither.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from heliograph.messages import Message
from heliograph.streams import Onsets

Floats = npt.NDArray[np.float64]


class Motion(Protocol):
    """A source of velocities other than the tracks' own filters."""

    def feed(self, onsets: Onsets) -> None:
        """Take the stream's next onsets, before the windows that they complete are followed."""
        ...

    def velocities(self, x_px: Floats, y_px: Floats, radius_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return how fast what is seen at n places moves, known from what came before t_us.

        Returns:
            (n, 2) float64 px/s, (n,) float64 variance of each axis, (px/s)^2; inf where unknown.
        """
        ...

    def carried(self, x_px: Floats, y_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return how fast the surroundings of n places move: (n, 2) float64 px/s, (n,) float64 confidence, 0 to 1."""
        ...

    def take(self) -> list[Message]:
        """Return the records to publish that were made since the last call."""
        ...


class NoMotion:
    """Knows nothing; the filters are alone."""

    def feed(self, onsets: Onsets) -> None:
        """Take no note."""

    def velocities(self, x_px: Floats, y_px: Floats, radius_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return zeros of unknown variance."""
        del y_px, radius_px, t_us
        return np.zeros((len(x_px), 2)), np.full(len(x_px), np.inf)

    def carried(self, x_px: Floats, y_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return zeros of no confidence."""
        del y_px, t_us
        return np.zeros((len(x_px), 2)), np.zeros(len(x_px))

    def take(self) -> list[Message]:
        """Return nothing."""
        return []
