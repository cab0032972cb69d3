"""The last raw events, for tracks that arrive later than their targets.

A track comes with its state at an instant A that has passed. From A its path is followed back to its birth and forth to
now through the kept beats, centred on its own events both ways (heliograph_services.decoder.centring; backwards in
mirrored time, t -> -t, where all that is known of filters holds). What it would have heard is given to its receiver
first. So a track that arrives late loses nothing, as far back as the backlog goes; and a region that has lost its
target catches up with it from A. Of a beat with many events those near the regions alone are looked at
(heliograph_services.decoder.tiles).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.errors import Refusals
from heliograph.events import EventBatch, Flags, Times
from heliograph_services.decoder.region_state import CORE, NEVER, P_XV, US_PER_S, VX, VY, Depths, Floats, Ints, X, Y
from heliograph_services.decoder.regions import Regions, Routed
from heliograph_services.decoder.tiles import Tiles

_MIRROR: Final = np.array([[1.0], [1.0], [-1.0], [-1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What a track would have heard (`Routed.of`), and along which trail.

    That is x, y, vx, vy, (4, m), at m rising times up to now.
    """

    t_us: Times
    on: Flags
    depth: Depths
    trail_us: Ints
    trail: Floats


@dataclass(frozen=True, slots=True)
class _Beat:
    t0_us: int
    events: int
    tiles: Tiles


@dataclass(frozen=True, slots=True)
class _Passed:
    pieces: list[Routed]
    trail: list[tuple[int, Floats]]


class Backlog:
    """The raw events of the last beats, bounded by time and by number.

    Args:
        size: the sensor's width and height, px.
        beat_us: length of a beat.
        limit_us: how far back it goes.
        limit_events: how many events it holds at most.
    """

    def __init__(self, size: tuple[int, int], beat_us: int, limit_us: int, limit_events: int) -> None:
        self._size = size
        self._beat_us = beat_us
        self._limit_us = limit_us
        self._limit_events = limit_events
        self._beats: deque[_Beat] = deque()
        self.events = 0

    def clear(self) -> None:
        """Forget all."""
        self._beats.clear()
        self.events = 0

    def push(self, t0_us: int, windows: list[EventBatch]) -> None:
        """Keep the windows of the beat that begins at t0_us; let the oldest go."""
        events = sum(map(len, windows))
        self._beats.append(_Beat(t0_us, events, Tiles(windows, *self._size)))
        self.events += events
        oldest_us = t0_us + self._beat_us - self._limit_us
        while self._beats and (self._beats[0].t0_us < oldest_us or self.events > self._limit_events):
            self.events -= self._beats.popleft().events

    def replay(self, regions: Regions, states: Floats, born_us: list[int], as_of_us: int, now_us: int) -> list[Heard]:
        """Return what new tracks would have heard; `regions` then holds them as of now.

        Args:
            regions: a free set of regions of the same sensor.
            states: (ROWS, k), what the tracks are at as_of_us.
            born_us: their births; nothing before them is heard.
            as_of_us: the instant of the states; may be later than now_us.
            now_us: the end of the last kept beat.
        """
        n = states.shape[1]
        pivot_us, start = self._pivot(states, as_of_us, now_us)
        earlier = [beat for beat in self._beats if min(born_us) - self._beat_us < beat.t0_us < pivot_us]
        regions.load(_mirrored(start), np.full(n, NEVER), -pivot_us)
        before = self._pass(regions, earlier[::-1], back=True)
        # Centred on the way back is centred at the pivot: the forward pass begins there.
        centred = np.where(regions.centred_us() == NEVER, NEVER, pivot_us)
        start[CORE] = regions.states()[CORE]
        after = self._forth(regions, start, centred, pivot_us, now_us)

        back = [(-t_us, motion * _MIRROR) for t_us, motion in reversed(before.trail)]
        trail = [*back, (pivot_us, start[[X, Y, VX, VY]]), *after.trail]
        times = np.array([t_us for t_us, _ in trail], np.int64)
        motions = np.array([motion for _, motion in trail])
        heard: list[Heard] = []
        for i in range(n):
            pieces = [_unmirrored(routed.of(i)) for routed in reversed(before.pieces)]
            t_us, on, depth = _joined(pieces + [routed.of(i) for routed in after.pieces], born_us[i])
            heard.append(Heard(t_us, on, depth, times, motions[:, :, i].T.copy()))
        return heard

    def catch_up(self, regions: Regions, states: Floats, as_of_us: int, now_us: int) -> None:
        """Follow states of the past to now: `regions` then holds them; arguments as for `replay`."""
        pivot_us, start = self._pivot(states, as_of_us, now_us)
        self._forth(regions, start, np.full(states.shape[1], NEVER), pivot_us, now_us)

    def _pivot(self, states: Floats, as_of_us: int, now_us: int) -> tuple[int, Floats]:
        """Return the beginning of a beat at or before as_of_us, and the states carried there."""
        pivot_us = min(as_of_us - (as_of_us - now_us) % self._beat_us, now_us)
        start = states.copy()
        start[[X, Y]] += start[[VX, VY]] * ((pivot_us - as_of_us) / US_PER_S)
        return pivot_us, start

    def _forth(self, regions: Regions, start: Floats, centred_us: Ints, pivot_us: int, now_us: int) -> _Passed:
        regions.load(start, centred_us, pivot_us)
        passed = self._pass(regions, [beat for beat in self._beats if beat.t0_us >= pivot_us])
        regions.advance(now_us - regions.now_us)
        return passed

    def _pass(self, regions: Regions, beats: list[_Beat], *, back: bool = False) -> _Passed:
        """Follow all regions through the beats; back in mirrored time."""
        passed = _Passed([], [])
        ignored = Refusals()  # counted when they came
        for beat in beats:
            t0_us = -(beat.t0_us + self._beat_us) if back else beat.t0_us
            regions.advance(t0_us - regions.now_us)
            batch, elsewhere = beat.tiles.near(*regions.ears(self._beat_us))
            batch = _back(batch) if back else batch
            passed.pieces.append(regions.follow(batch, self._beat_us, ignored, elsewhere))
            regions.measure()
            passed.trail.append((regions.now_us, regions.motion()))
        return passed


def _back(batch: EventBatch) -> EventBatch:
    """Return events in mirrored time."""
    return EventBatch(-batch.t_us[::-1], batch.x_px[::-1].copy(), batch.y_px[::-1].copy(), batch.on[::-1].copy())


def _mirrored(states: Floats) -> Floats:
    mirrored = states.copy()
    mirrored[[VX, VY, P_XV]] *= -1.0
    return mirrored


def _unmirrored(heard: tuple[Times, Flags, Depths]) -> tuple[Times, Flags, Depths]:
    return -heard[0][::-1], heard[1][::-1], heard[2][::-1]


def _joined(pieces: list[tuple[Times, Flags, Depths]], from_us: int) -> tuple[Times, Flags, Depths]:
    t_us = np.concatenate([np.empty(0, np.int64), *(one[0] for one in pieces)])
    on = np.concatenate([np.empty(0, np.bool_), *(one[1] for one in pieces)])
    depth = np.concatenate([np.empty(0, np.uint8), *(one[2] for one in pieces)])
    first = int(np.searchsorted(t_us, from_us))
    return t_us[first:], on[first:], depth[first:]
