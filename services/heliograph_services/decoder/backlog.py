"""The last raw events, for tracks that arrive later than their targets.

A track comes with its state at an instant A that has passed. From A its path is followed back to its birth and forth to
now through the kept windows, centred on its own events both ways (heliograph_services.decoder.routing); what it would
have heard is given to its receiver first. So a track that arrives late loses nothing, as far back as the backlog goes.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from heliograph.errors import Refusals
from heliograph.events import EventBatch, Flags, Times
from heliograph_services.decoder.regions import Place, Regions
from heliograph_services.decoder.routing import NEVER


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What a track would have heard, and where that leads it now."""

    t_us: Times
    on: Flags
    now: Place
    centred_us: int


@dataclass(frozen=True, slots=True)
class _Window:
    t0_us: int
    batch: EventBatch


class Backlog:
    """The raw events of the last windows, bounded by time and by number.

    Args:
        window_us: length of a window.
        limit_us: how far back it goes.
        limit_events: how many events it holds at most.
    """

    def __init__(self, window_us: int, limit_us: int, limit_events: int) -> None:
        self._window_us = window_us
        self._limit_us = limit_us
        self._limit_events = limit_events
        self._windows: deque[_Window] = deque()
        self.events = 0

    def clear(self) -> None:
        """Forget all."""
        self._windows.clear()
        self.events = 0

    def push(self, t0_us: int, batch: EventBatch) -> None:
        """Keep the window that begins at t0_us; let the oldest go."""
        self._windows.append(_Window(t0_us, batch))
        self.events += len(batch)
        oldest_us = t0_us + self._window_us - self._limit_us
        while self._windows and (self._windows[0].t0_us < oldest_us or self.events > self._limit_events):
            self.events -= len(self._windows.popleft().batch)

    def replay(
        self, regions: Regions, places: list[Place], born_us: list[int], as_of_us: int, now_us: int, refusals: Refusals
    ) -> list[Heard]:
        """Return what new tracks would have heard.

        Args:
            regions: a free set of regions of the same sensor.
            places: where the tracks are at as_of_us.
            born_us: their births; nothing before them is heard.
            as_of_us: the instant of the places; may be later than now_us.
            now_us: the end of the last kept window.
            refusals: where events off the sensor would be counted; they have been, so it is the caller's scratch.
        """
        n = len(places)
        pivot_us = min(as_of_us - (as_of_us - now_us) % self._window_us, now_us)
        start = [at.after(pivot_us - as_of_us) for at in places]
        never = [NEVER] * n
        pieces: list[list[tuple[Times, Flags]]] = [[] for _ in range(n)]

        regions.load(start, never, pivot_us)
        for window in reversed(self._windows):
            if window.t0_us >= pivot_us:
                continue
            if window.t0_us + self._window_us <= min(born_us):
                break
            regions.advance(window.t0_us - regions.now_us)
            routed = regions.route(window.batch, self._window_us, refusals)
            regions.follow(routed, -self._window_us)
            for i in range(n):
                pieces[i].append(routed.of(i))
        for piece in pieces:
            piece.reverse()

        centred = [NEVER if regions.centred_us(i) == NEVER else pivot_us for i in range(n)]
        regions.load(start, centred, pivot_us)
        for window in self._windows:
            if window.t0_us < pivot_us:
                continue
            regions.advance(window.t0_us - regions.now_us)
            routed = regions.route(window.batch, self._window_us, refusals)
            regions.follow(routed, self._window_us)
            for i in range(n):
                pieces[i].append(routed.of(i))
        regions.advance(now_us - regions.now_us)
        return [self._heard(pieces[i], born_us[i], regions, i) for i in range(n)]

    @staticmethod
    def _heard(pieces: list[tuple[Times, Flags]], born_us: int, regions: Regions, i: int) -> Heard:
        t_us = np.concatenate([np.empty(0, np.int64), *(t for t, _ in pieces)])
        on = np.concatenate([np.empty(0, np.bool_), *(o for _, o in pieces)])
        first = int(np.searchsorted(t_us, born_us))
        return Heard(t_us[first:], on[first:], regions.place(i), regions.centred_us(i))
