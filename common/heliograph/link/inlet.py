"""The door of a receiver: events come in order of time, or are refused and counted."""

from __future__ import annotations

import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times


class Inlet:
    """Keeps the order that `heliograph.link.contract.Receiver.feed` promises.

    Args:
        refusals: where what comes too late is counted.
    """

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self.until_us: int | None = None

    def take(self, t_us: Times, on: Flags, until_us: int) -> tuple[Times, Flags]:
        """Return the events that are not before an earlier until_us; none where until_us itself falls."""
        if self.until_us is not None and until_us < self.until_us:
            self._refusals[Refusal.TIME_BACKWARDS] += 1
            return t_us[:0], on[:0]
        if len(t_us) and self.until_us is not None and t_us[0] < self.until_us:
            self._refusals[Refusal.TIME_BACKWARDS] += 1
            start = int(np.searchsorted(t_us, self.until_us))
            t_us, on = t_us[start:], on[start:]
        self.until_us = until_us
        return t_us, on
