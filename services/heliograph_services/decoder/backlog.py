"""The last raw events, for tracks that arrive later than their targets.

A track comes with its state at an instant A that has passed. From A its path is followed back to its birth and forth to
now through the kept windows, centred on its own events both ways (heliograph_services.decoder.routing); what it would
have heard is given to its receiver first. So a track that arrives late loses nothing, as far back as the backlog goes.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from heliograph.errors import Refusals
from heliograph.events import EventBatch, Flags, Times
from heliograph_services.decoder.regions import Place, Regions, Routed
from heliograph_services.decoder.routing import NEVER, Floats


@dataclass(frozen=True, slots=True, eq=False)
class Trail:
    """Where a track was before it was known: centres (px) at rising times, one a window."""

    t_us: Times
    x_px: Floats
    y_px: Floats

    def at(self, t_us: int, otherwise: Place) -> Place:
        """Return the place at t_us, interpolated; behind the trail's end, what is otherwise known."""
        if not len(self.t_us) or t_us > int(self.t_us[-1]):
            return otherwise
        x_px = float(np.interp(t_us, self.t_us, self.x_px))
        y_px = float(np.interp(t_us, self.t_us, self.y_px))
        return replace(otherwise, x_px=x_px, y_px=y_px)


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What a track would have heard, along which trail, and where that leads it now."""

    t_us: Times
    on: Flags
    trail: Trail
    now: Place
    centred_us: int


@dataclass(frozen=True, slots=True)
class _Window:
    t0_us: int
    batch: EventBatch


@dataclass(frozen=True, slots=True)
class _Passed:
    pieces: list[Routed]
    trail: list[tuple[int, Floats]]


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
        never = [NEVER] * n
        pivot_us = min(as_of_us - (as_of_us - now_us) % self._window_us, now_us)
        start = [at.after(pivot_us - as_of_us) for at in places]
        earlier = [w for w in self._windows if min(born_us) - self._window_us < w.t0_us < pivot_us]
        later = [w for w in self._windows if w.t0_us >= pivot_us]

        regions.load(start, never, pivot_us)
        before = self._pass(regions, earlier[::-1], -self._window_us, refusals)
        before.pieces.reverse()
        before.trail.reverse()

        centred = [NEVER if regions.centred_us(i) == NEVER else pivot_us for i in range(n)]
        regions.load(start, centred, pivot_us)
        after = self._pass(regions, later, self._window_us, refusals)
        regions.advance(now_us - regions.now_us)

        trail = [*before.trail, (pivot_us, np.array([[at.x_px, at.y_px] for at in start]).T), *after.trail]
        times = np.array([t_us for t_us, _ in trail], np.int64)
        centres = np.array([xy for _, xy in trail])
        heard: list[Heard] = []
        for i in range(n):
            t_us, on = _joined([routed.of(i) for routed in (*before.pieces, *after.pieces)], born_us[i])
            path = Trail(times, centres[:, 0, i].copy(), centres[:, 1, i].copy())
            heard.append(Heard(t_us, on, path, regions.place(i), regions.centred_us(i)))
        return heard

    @staticmethod
    def _pass(regions: Regions, windows: list[_Window], window_us: int, refusals: Refusals) -> _Passed:
        """Follow all regions through the windows, forth or (window_us negative) back."""
        passed = _Passed([], [])
        for window in windows:
            regions.advance(window.t0_us - regions.now_us)
            routed = regions.route(window.batch, abs(window_us), refusals)
            regions.follow(routed, window_us)
            passed.pieces.append(routed)
            passed.trail.append((regions.now_us, regions.centres()))
        return passed


def _joined(pieces: list[tuple[Times, Flags]], from_us: int) -> tuple[Times, Flags]:
    t_us = np.concatenate([np.empty(0, np.int64), *(t for t, _ in pieces)])
    on = np.concatenate([np.empty(0, np.bool_), *(o for _, o in pieces)])
    first = int(np.searchsorted(t_us, from_us))
    return t_us[first:], on[first:]
