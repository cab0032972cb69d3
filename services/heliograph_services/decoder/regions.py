"""Regions: the pixels that each track listens to, moved by prediction and by the regions' own events.

State of track i at `now_us`: centre c (px), velocity v (px/s), reach r = scale * radius + margin (px). Between windows
c += v T. What the tracker says of an instant A in the past is extrapolated to now and mixed in with the weight ::

    w = max(w0, a / (a + tau)),   a = time since the region was last centred on its own events

so that a region that follows its events well hardly heeds a late tracker, and one that has seen nothing obeys it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import EventBatch, Flags, Times
from heliograph_services.decoder import routing
from heliograph_services.decoder.routing import NEVER, PLACE_LIMIT_PX, SPEED_LIMIT_PX_S, US_PER_S

# Even a well centred region yields a twentieth to the tracker at 10 Hz: it forgets a wrong centre within 2 s.
LEAST_WEIGHT: Final = 0.05
# Half the say after 50 ms without own events: a code of 50 bit/s is silent for up to 200 ms.
TRUST_US: Final = 50_000.0


@dataclass(frozen=True, slots=True)
class Place:
    """Where a target is at one instant: centre and velocity (px, px/s), and the radius of its region (px)."""

    x_px: float
    y_px: float
    vx_px_s: float
    vy_px_s: float
    reach_px: float

    def after(self, us: int) -> Place:
        """Return the place so many microseconds later (earlier, where negative)."""
        s = us / US_PER_S
        return Place(
            _within(self.x_px + self.vx_px_s * s, PLACE_LIMIT_PX),
            _within(self.y_px + self.vy_px_s * s, PLACE_LIMIT_PX),
            self.vx_px_s,
            self.vy_px_s,
            self.reach_px,
        )

    def away_px(self, other: Place) -> float:
        """Return the distance of the two centres."""
        return float(np.hypot(self.x_px - other.x_px, self.y_px - other.y_px))


def place(x_px: float, y_px: float, vx_px_s: float, vy_px_s: float, reach_px: float) -> Place:
    """Return a place with every number brought into what a sensor can show; what is absurd ends up off the sensor."""
    return Place(
        _within(x_px, PLACE_LIMIT_PX),
        _within(y_px, PLACE_LIMIT_PX),
        _within(vx_px_s, SPEED_LIMIT_PX_S),
        _within(vy_px_s, SPEED_LIMIT_PX_S),
        reach_px,
    )


def _within(value: float, limit: float) -> float:
    # What is no number at all is off the sensor too.
    return min(value, limit) if value > -limit else -limit


@dataclass(frozen=True, slots=True)
class Routed:
    """The events of a window by track: those of track i are [starts[i], starts[i + 1]); residuals likewise."""

    starts: routing.Ints
    t_us: Times
    on: Flags
    residual_starts: routing.Ints
    dx_px: routing.Residuals
    dy_px: routing.Residuals
    outside: int

    def of(self, i: int) -> tuple[Times, Flags]:
        """Return times and polarities of the events of track i."""
        first, behind = int(self.starts[i]), int(self.starts[i + 1])
        return self.t_us[first:behind], self.on[first:behind]


class Regions:
    """All regions of a camera, in the order of its tracks.

    Args:
        width: of the sensor, px.
        height: of the sensor, px.
        capacity: the most regions there may be.
        step_us: regions move once a step within a window.
        max_reach_px: the largest reach of a region.
    """

    def __init__(self, width: int, height: int, capacity: int, step_us: int, max_reach_px: float) -> None:
        self.n = 0
        self.now_us = 0
        self.repaintings = 0
        self._pixels = width * height
        self._step_us = step_us
        self._labels = np.zeros((height, width), np.uint16)
        self._seen = np.zeros((height, width), np.uint8)
        self._painted = np.zeros((3, capacity), np.float64)
        self._n_painted = 0
        self._state = np.zeros((5, capacity), np.float64)
        self._centred_us = np.full(capacity, NEVER, np.int64)
        self._counts = np.zeros(int(2 * routing.BINS_PER_PX * (max_reach_px + 2)) + 2, np.int64)

    def load(self, places: list[Place], centred_us: list[int], now_us: int) -> None:
        """Replace all regions by these, as of now_us."""
        if self._n_painted >= 0:
            # -(n + 1) says: repaint, and n old ones are to be cleared.
            self._n_painted = -(self._n_painted + 1)
        self.n = len(places)
        self.now_us = now_us
        for i, at in enumerate(places):
            self._state[:, i] = (at.x_px, at.y_px, at.vx_px_s, at.vy_px_s, at.reach_px)
            self._centred_us[i] = centred_us[i]

    def place(self, i: int) -> Place:
        """Return where region i is at now_us."""
        return Place(*(float(value) for value in self._state[:, i]))

    def places(self) -> list[Place]:
        """Return all places at now_us."""
        return [self.place(i) for i in range(self.n)]

    def centres(self) -> routing.Floats:
        """Return a copy of all centres at now_us, (2, n) px."""
        return self._state[:2, : self.n].copy()

    def centred_us(self, i: int) -> int:
        """Return when region i was last centred on its own events."""
        return int(self._centred_us[i])

    def advance(self, us: int) -> None:
        """Move all regions by their velocities; us may be negative."""
        n = self.n
        self._state[:2, :n] += self._state[2:4, :n] * (us / US_PER_S)
        np.clip(self._state[:2, :n], -PLACE_LIMIT_PX, PLACE_LIMIT_PX, out=self._state[:2, :n])
        self.now_us += us

    def route(self, batch: EventBatch, window_us: int, refusals: Refusals) -> Routed:
        """Return the events of the window [now_us, now_us + window_us) by track; nothing moves.

        Args:
            batch: the window's events; one that lies on its end belongs to the last step.
            window_us: its length.
            refusals: counts what lies off the sensor.
        """
        m = len(batch)
        steps = max(1, -(-window_us // self._step_us))
        hit, label = np.empty(m, np.int64), np.empty(m, np.uint16)
        dx, dy = np.empty(m, np.float32), np.empty(m, np.float32)
        hits, paintings, off = routing.gather(
            batch.t_us, batch.x_px, batch.y_px, self.now_us, self._step_us, steps,
            self._labels, self._painted, self._n_painted, self._state, self.n, hit, label, dx, dy,
            self._seen,
        )  # fmt: skip
        if paintings:
            self._n_painted = self.n
            self.repaintings += paintings
        if off:
            refusals[Refusal.OFF_SENSOR] += off
        starts, t_us, on = routing.sort_by_track(batch.t_us, batch.on, self.n, hits, hit, label)
        residual_starts, dx, dy = routing.residuals_by_track(self.n, hits, label, dx, dy)
        return Routed(starts, t_us, on, residual_starts, dx, dy, m - hits - off)

    def follow(self, routed: Routed, window_us: int) -> None:
        """Move on by a window and centre each region on the events that it heard in it; back where negative."""
        if window_us > 0:
            self.advance(window_us)
        if self._pixels == 1:
            return
        covered = float(np.sum(np.square(self._state[4, : self.n]))) * np.pi
        noise_per_px = routed.outside / max(self._pixels - covered, 0.1 * self._pixels)
        routing.recentre(
            routed.residual_starts, routed.dx_px, routed.dy_px, self._state, self._centred_us, self.n,
            noise_per_px, self.now_us, window_us, self._counts,
        )  # fmt: skip
        np.clip(self._state[2:4, : self.n], -SPEED_LIMIT_PX_S, SPEED_LIMIT_PX_S, out=self._state[2:4, : self.n])


def mixed(own: Place, centred_us: int, told: Place, now_us: int, *, read: bool) -> Place:
    """Return own and told place of one target at now_us, weighed by the module's rule.

    Args:
        own: where the region has got to.
        centred_us: when it was last centred on its own events.
        told: what the tracker says, extrapolated to now.
        now_us: the instant of both.
        read: the track is being read at its own place; then it does not jump to another.
    """
    age = float(now_us - centred_us)
    weight = max(LEAST_WEIGHT, age / (age + TRUST_US))
    if not read and own.away_px(told) > own.reach_px + told.reach_px:
        weight = 1.0
    return Place(
        own.x_px + weight * (told.x_px - own.x_px),
        own.y_px + weight * (told.y_px - own.y_px),
        own.vx_px_s + weight * (told.vx_px_s - own.vx_px_s),
        own.vy_px_s + weight * (told.vy_px_s - own.vy_px_s),
        told.reach_px,
    )
