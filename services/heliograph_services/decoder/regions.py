"""Regions: the pixels that each track listens to, moved by prediction and by the regions' own events.

A region is a Kalman filter of its target's place (heliograph_services.decoder.region_state). What the tracker says of
an instant A in the past is compared with where the region was at A; the difference d corrects the region now with the
weight ::

    w = P_xx / (P_xx + R),   R = variance of what is told, carried from A to now

so a region that follows its events well hardly heeds a late tracker, and one that has seen nothing obeys it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import EventBatch, Flags, Times
from heliograph_services.decoder import centring, region_state, routing
from heliograph_services.decoder.painting import DRAWN_ROWS, TILE_PX
from heliograph_services.decoder.region_state import (
    CORE,
    NEVER,
    P_VV,
    P_VV_LIMIT,
    P_XV,
    P_XX,
    P_XX_LIMIT,
    PLACE_LIMIT_PX,
    RADIUS,
    RANK,
    REACH,
    ROWS,
    US_PER_S,
    VX,
    VY,
    Floats,
    Ints,
    Q,
    X,
    Y,
)
from heliograph_services.decoder.sorting import sort_by_track

# Of the filter, before the residuals have their say: 0.3 px of doubt a tenth of a second after the last edge.
Q_START: Final = 1e3
# Half a disc's events lie within .7 of its radius, half a Gaussian's within .4 of what a threshold shows of it.
CORE_START: Final = 0.5
# The pixels of a region stay for a step; what moves on by more than its margin meanwhile is not heard. At 11,000 px/s
# that asks for a quarter of a millisecond.
STEP_PX: Final = 3.0
STEP_PARTS: Final = (1, 2, 4, 8)
# Beyond its way through a window: what its own events may move a region by.
EAR_MARGIN_PX: Final = 8.0


class Place(msgspec.Struct, frozen=True):
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


def _within(value: float, limit: float) -> float:
    # What is no number at all is off the sensor too.
    return min(value, limit) if value > -limit else -limit


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """How sure places are, on each axis: P_xx (px2), P_xv (px2/s), P_vv (px2/s2); a covariance, or (k,) of each."""

    xx: Floats
    xv: Floats
    vv: Floats

    def of(self, which: Ints | Flags | int) -> Doubt:
        """Return that of some of the places."""
        return Doubt(self.xx[which], self.xv[which], self.vv[which])

    def after(self, us: Ints | int, drive: Floats) -> Doubt:
        """Return what is left of it so many microseconds later, with an acceleration of intensity q = drive."""
        s = us / US_PER_S
        q = drive * np.abs(s)
        xx = self.xx + s * (2.0 * self.xv + s * self.vv) + q * s * s / 3.0
        return doubt(xx, self.xv + s * self.vv + q * s / 2.0, self.vv + q)


def doubt(xx: Floats, xv: Floats, vv: Floats) -> Doubt:
    """Return a doubt with every number brought into what a covariance can be."""
    xx = np.clip(xx, 0.0, P_XX_LIMIT)
    vv = np.clip(vv, 0.0, P_VV_LIMIT)
    most = np.sqrt(xx * vv)
    return Doubt(xx, np.clip(xv, -most, most), vv)


def column(at: Place, radius_px: float, sure: Doubt) -> Floats:
    """Return the state (ROWS,) of a region that begins there."""
    state = np.zeros(ROWS, np.float64)
    state[[X, Y, VX, VY, REACH]] = (at.x_px, at.y_px, at.vx_px_s, at.vy_px_s, at.reach_px)
    state[[RADIUS, P_XX, P_XV, P_VV, Q]] = (radius_px, sure.xx, sure.xv, sure.vv, Q_START)
    state[CORE] = CORE_START * radius_px
    return state


@dataclass(frozen=True, slots=True)
class Routed:
    """The events of a window by track: those of track i are [starts[i], starts[i + 1]); `outside` fell into none."""

    starts: Ints
    t_us: Times
    on: Flags
    depth: region_state.Depths
    outside: int

    def of(self, i: int) -> tuple[Times, Flags, region_state.Depths]:
        """Return times and polarities of the events of track i, and how deep in its image they lie."""
        first, behind = int(self.starts[i]), int(self.starts[i + 1])
        return self.t_us[first:behind], self.on[first:behind], self.depth[first:behind]


class Regions:
    """All regions of a camera, in the order of its tracks.

    Args:
        width: of the sensor, px.
        height: of the sensor, px.
        capacity: the most regions there may be.
        step_us: regions are moved and centred once a step, at least.
        max_reach_px: the largest reach of a region.
        self_centring: whether they are centred on their events; one pixel never is.
    """

    def __init__(
        self, width: int, height: int, capacity: int, step_us: int, max_reach_px: float, *, self_centring: bool = True
    ) -> None:
        self.n = 0
        self.now_us = 0
        self.repaintings = 0
        self._pixels = width * height
        self._step_us = step_us
        self._self_centring = self_centring and self._pixels > 1
        self._labels = np.zeros((height, width), np.uint16)
        self._seen = np.zeros((height, width), np.uint8)
        self._stale = np.zeros((-(-height // TILE_PX), -(-width // TILE_PX)), np.uint8)
        self._painted = np.zeros((DRAWN_ROWS, capacity), np.float64)
        self._n_painted = 0
        self._state = np.zeros((ROWS, capacity), np.float64)
        self._centred_us = np.full(capacity, NEVER, np.int64)
        self._heard = np.zeros((region_state.HEARD_ROWS, capacity), np.int64)
        bins = 2 * int(centring.BINS_PER_PX * (max_reach_px + region_state.GROW_LIMIT_PX + 2)) + 2
        self._counts = np.zeros((capacity, 2, bins), np.int32)
        self.noise_per_px_us = 0.0  # as of the last `measure`
        self._outside = 0  # events outside all regions since
        self._outside_us = 0

    # ---- which regions there are ---------------------------------------------------------------------------------

    def restart(self, now_us: int) -> None:
        """Forget all regions; time begins anew."""
        self.keep([])
        self.now_us = now_us
        self._outside = self._outside_us = 0

    def load(self, states: Floats, centred_us: Ints, now_us: int) -> None:
        """Replace all regions by these: states (ROWS, k) as of now_us."""
        self.restart(now_us)
        self.append(states, centred_us)

    def keep(self, kept: list[int]) -> None:
        """Keep these regions alone, in this order."""
        if kept == list(range(self.n)):
            return
        self._repaint()
        m = len(kept)
        for rows in (self._state, self._heard):
            rows[:, :m] = rows[:, kept]
        self._centred_us[:m] = self._centred_us[kept]
        self._counts[:m] = self._counts[kept]
        self._forget(m, self.n)
        self.n = m

    def append(self, states: Floats, centred_us: Ints) -> None:
        """Add regions: states (ROWS, k) as of now_us, and when each was last centred."""
        self._repaint()
        k = states.shape[1]
        self._state[:, self.n : self.n + k] = states
        self._centred_us[self.n : self.n + k] = centred_us
        self._forget(self.n, self.n + k)
        self.n += k

    def put(self, i: int, state: Floats, centred_us: int) -> None:
        """Give region i another state (ROWS,) as of now_us; what it has heard counts no more."""
        self._state[:, i] = state
        self._centred_us[i] = centred_us
        self._forget(i, i + 1)

    def shift(self, which: Ints, d_px: Floats, dv_px_s: Floats, sure: Doubt) -> None:
        """Move regions, (k,), by so much, (2, k) each, and say how sure they are then."""
        self._state[X : Y + 1, which] += d_px
        self._state[VX : VY + 1, which] += dv_px_s
        self._state[P_XX : P_VV + 1, which] = sure.xx, sure.xv, sure.vv

    def resize(self, which: Ints, reach_px: Floats, radius_px: Floats) -> None:
        """Let regions, (k,), reach so far, for targets of that radius."""
        differs = (self._state[REACH, which] != reach_px) | (self._state[RADIUS, which] != radius_px)
        if differs.any():
            # Their histograms have another width from here on.
            others = which[differs]
            self._heard[:, others] = 0
            self._counts[others] = 0
            self._state[REACH, others], self._state[RADIUS, others] = reach_px[differs], radius_px[differs]

    def rank(self, read: Flags) -> None:
        """Say which regions, (n,), are being read at this moment."""
        ranks = self._state[RANK, : self.n]
        if (ranks != read).any():
            ranks[:] = read
            self._repaint()

    def _forget(self, first: int, behind: int) -> None:
        self._heard[:, first:behind] = 0
        self._counts[first:behind] = 0

    def _repaint(self) -> None:
        if self._n_painted >= 0:
            # -(n + 1) says: repaint, and n old ones are to be cleared.
            self._n_painted = -(self._n_painted + 1)

    # ---- where they are ------------------------------------------------------------------------------------------

    def place(self, i: int) -> Place:
        """Return where region i is at now_us."""
        # The first rows of a state.
        x_px, y_px, vx_px_s, vy_px_s, reach_px = self._state[: REACH + 1, i].tolist()
        return Place(x_px, y_px, vx_px_s, vy_px_s, reach_px)

    def reach_px(self, i: int) -> float:
        """Return how far from its centre region i hears."""
        return float(self._state[REACH, i])

    def doubt(self, which: Ints) -> Doubt:
        """Return how sure the places of regions, (k,), are."""
        xx, xv, vv = self._state[P_XX : P_VV + 1, which]
        return Doubt(xx, xv, vv)

    def doubt_px(self, i: int) -> float:
        """Return sqrt(P_xx) of region i."""
        return math.sqrt(self._state[P_XX, i])

    def places(self, us: int = 0) -> Floats:
        """Return x, y, vx, vy and reach of all regions, (5, n), so many microseconds after now_us."""
        places = self._state[: REACH + 1, : self.n].copy()
        if us:
            places[:2] = np.clip(places[:2] + places[2:4] * (us / US_PER_S), -PLACE_LIMIT_PX, PLACE_LIMIT_PX)
        return places

    def motion(self) -> Floats:
        """Return a copy of x, y, vx, vy of all regions at now_us, (4, n)."""
        return self._state[: VY + 1, : self.n].copy()

    def drive(self, which: Ints) -> Floats:
        """Return q, the intensity of the acceleration that regions, (k,), are allowed."""
        drive: Floats = self._state[Q, which]
        return drive

    def states(self) -> Floats:
        """Return a copy of all states, (ROWS, n)."""
        return self._state[:, : self.n].copy()

    def centred_us(self) -> Ints:
        """Return a copy of when each region was last centred on its own events."""
        return self._centred_us[: self.n].copy()

    def advance(self, us: int) -> None:
        """Carry all regions by so much time, without events."""
        if us > 0:
            region_state.carry(self._state, self.n, float(us))
        self.now_us += us

    def _step(self, window_us: int) -> int:
        """Return how long a step of this window is: short enough for the fastest region."""
        step_us = min(self._step_us, window_us)
        per_us = region_state.fastest(self._state, self.n) / US_PER_S
        parts = next((k for k in STEP_PARTS if step_us * per_us <= STEP_PX * k), STEP_PARTS[-1])
        return max(step_us // parts, 1)

    def ears(self, window_us: int) -> tuple[Floats, Floats, Floats]:
        """Return x, y and how far (px) any region may hear through the next window_us, (n,) each."""
        x_px, y_px, vx, vy, reach = self._state[[X, Y, VX, VY, REACH], : self.n]
        ways_px = np.hypot(vx, vy) * (window_us / US_PER_S)
        return x_px, y_px, reach + ways_px + region_state.GROW_LIMIT_PX + EAR_MARGIN_PX

    def follow(self, batch: EventBatch, window_us: int, refusals: Refusals, elsewhere: int = 0) -> Routed:
        """Move and centre the regions through [now_us, now_us + window_us); return its events by track.

        Args:
            batch: the window's events; one that lies on its end belongs to the last step.
            window_us: its length.
            refusals: counts what lies off the sensor.
            elsewhere: how many events of the window are left out that no region hears (`ears`).
        """
        m = len(batch)
        step_us = self._step(window_us)
        steps = max(1, -(-window_us // step_us))
        hit, label, depth = np.empty(m, np.int64), np.empty(m, np.uint16), np.empty(m, np.uint8)
        hits, paintings, off = routing.follow(
            batch.t_us, batch.x_px, batch.y_px, self.now_us, step_us, steps, self._self_centring,
            self._labels, self._stale, self._painted, self._n_painted, self._state, self._centred_us, self._heard,
            self._counts, self.n, self.noise_per_px_us, hit, label, depth, self._seen,
        )  # fmt: skip
        self.now_us += window_us
        if paintings:
            self._n_painted = self.n
            self.repaintings += paintings
        if off:
            refusals[Refusal.OFF_SENSOR] += off
        outside = m + elsewhere - hits - off
        self._outside += outside
        self._outside_us += window_us
        return Routed(*sort_by_track(batch.t_us, batch.on, self.n, hits, hit, label, depth), outside)

    def measure(self) -> None:
        """Measure the noise outside all regions, over the time that has been followed since the last measurement."""
        if self._outside_us:
            covered = float(np.sum(np.square(self._state[REACH, : self.n]))) * np.pi
            self.noise_per_px_us = self._outside / (max(self._pixels - covered, 0.1 * self._pixels) * self._outside_us)
        self._outside = self._outside_us = 0
