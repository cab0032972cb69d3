"""Measuring the bit rate of a track: events are kept until some rates are likely, and then all handed on.

The first attempt is made a quarter of a second after the first event, the next ones whenever there is half as much
again. After two seconds the older half is let go; a track that never shows a rate is asked once a second.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph_services.decoder.region_state import Depths

FIRST_US: Final = 250_000
GROWTH: Final = 1.5
# 100 bits of the slowest link, in which the words of fewest edges show 36 intervals.
LIMIT_US: Final = 2_000_000
EVENTS_LIMIT: Final = 500_000

Measure = Callable[[Times, Flags], tuple[float, ...]]
Heard = tuple[Times, Flags, Depths]


class Measuring:
    """Names the likely bit rates of one track.

    Args:
        measure: names the likely bit rates of events; None where none is to be measured.
    """

    def __init__(self, measure: Measure | None) -> None:
        self.refusals = Refusals()
        self._measure = measure
        self._kept: list[Heard] = []
        self._try_us: int | None = None

    def feed(self, t_us: Times, on: Flags, depth: Depths, until_us: int) -> tuple[tuple[float, ...], Heard] | None:
        """Take events, all of those before until_us; return likely rates and all that is kept, or None as yet."""
        if len(t_us) and sum(len(kept[0]) for kept in self._kept) < EVENTS_LIMIT:
            self._kept.append((t_us, on, depth))
        if not self._kept or self._measure is None:
            return None
        first_us = int(self._kept[0][0][0])
        if self._try_us is None:
            self._try_us = first_us + FIRST_US
        if until_us < self._try_us:
            return None
        all_t = np.concatenate([kept[0] for kept in self._kept])
        all_on, all_depth = (np.concatenate([kept[k] for kept in self._kept]) for k in (1, 2))
        rates = self._measure(all_t, all_on)
        if rates:
            self._kept, self._try_us = [], None
            return rates, (all_t, all_on, all_depth)
        self._try_us = first_us + round((until_us - first_us) * GROWTH)
        if until_us - first_us >= LIMIT_US:
            self.refusals[Refusal.NO_CLOCK] += 1
            self._try_us = until_us + LIMIT_US // 2
            late = int(np.searchsorted(all_t, until_us - LIMIT_US // 2))
            self._kept = [(all_t[late:], all_on[late:], all_depth[late:])] if late < len(all_t) else []
            if not self._kept:
                self._try_us = None
        return None
