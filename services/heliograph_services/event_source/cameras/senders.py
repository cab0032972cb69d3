"""Waits for those who drive a simulated light from outside: the only part of a simulation that needs a clock."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from typing import Final

from heliograph.errors import Refusals
from heliograph_services.event_source.simulation.contract import Drive
from heliograph_services.event_source.simulation.lights.recorded import StreamedDrive

_LOG = logging.getLogger(__name__)
# A light that is driven from outside is waited for so long; then it holds its level until its sender speaks again.
PATIENCE_S: Final = 1.0
_POLL_S: Final = 0.001


class Senders:
    """The streams of edges of a scene.

    Args:
        patience_s: how long a silent one is waited for.
    """

    def __init__(self, patience_s: float = PATIENCE_S) -> None:
        self._patience_s = patience_s
        self._streamed: list[StreamedDrive] = []
        self._silent: set[int] = set()
        self._told = Refusals()

    def follow(self, drives: Sequence[Drive]) -> None:
        """Take the streams among a scene's drives."""
        self._streamed += [drive for drive in drives if isinstance(drive, StreamedDrive)]

    def wait(self, until_us: int) -> None:
        """Read until every stream is known up to a time, or is silent for too long."""
        for number, drive in enumerate(self._streamed):
            if self._is_known(drive, until_us, 0.0 if number in self._silent else self._patience_s):
                self._silent.discard(number)
            elif number not in self._silent:
                _LOG.warning("who drives light %d from outside is silent; the light holds its level", number)
                self._silent.add(number)

    def refused(self) -> Refusals:
        """Return what was refused since the last call."""
        total = Refusals()
        for drive in self._streamed:
            total.update(drive.refusals)
        news, self._told = total - self._told, total
        return news

    def close(self) -> None:
        """Let go of the streams; may be called twice."""
        for drive in self._streamed:
            drive.close()

    def _is_known(self, drive: StreamedDrive, until_us: int, patience_s: float) -> bool:
        since_s = time.monotonic()
        while True:
            while drive.poll():
                since_s = time.monotonic()
            if drive.known_until_us >= until_us:
                return True
            if time.monotonic() - since_s >= patience_s:
                return False
            time.sleep(_POLL_S)
