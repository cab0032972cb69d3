"""The state of the regions, a column a track, and what time does to it.

Each axis of a region is a Kalman filter of position and velocity, one covariance P for both axes, driven by white
acceleration of intensity q, at least that of what turns within TURN_RADIUS_PX::

    c += v T,   P <- F P F' + q [T^3/3, T^2/2; T^2/2, T]            F = [1, T; 0, 1]

and what is fast goes round a curve: its velocity v turns by w T, and c moves along the chord of that arc. What is heard
corrects c, v and w (heliograph_services.decoder.centring). A region that is not centred grows as its uncertainty
does, s = r + max(0, 3 sqrt(P_xx) - GROW_FROM_PX), up to `GROW_LIMIT_PX`: so it hears its target again behind an
occlusion. Of what it hears it takes for its target's what lies within the gate ::

    |event - c(t)| <= GATE_SHARE m + GATE_MARGIN_PX + GATE_SIGMAS sqrt(P_xx)

with m the median distance of its target's events. A light that is dark for five bits makes no events; the ground beside
it does, and would draw the region away.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Labels = npt.NDArray[np.uint16]
Counts = npt.NDArray[np.int32]
Ints = npt.NDArray[np.int64]
Depths = npt.NDArray[np.uint8]

# Rows of a state: a column a track.
X: Final = 0
Y: Final = 1
VX: Final = 2
VY: Final = 3
REACH: Final = 4  # r, px
RADIUS: Final = 5  # rho, px
P_XX: Final = 6
P_XV: Final = 7
P_VV: Final = 8
Q: Final = 9
SHARED: Final = 10  # 1 where its gate meets that of another region that follows its target
RANK: Final = 11  # 1 where frames are being read, else 0
CORE: Final = 12  # m, px
TURN: Final = 13  # w, rad/s
ROWS: Final = 14
# Rows of what the regions have heard since they were centred last: a column a track.
EVENTS: Final = 0
PIXELS: Final = 1  # sum over the steps of distinct pixels less one
AGE_US: Final = 2
FIRST: Final = 3  # a pixel was heard in this step
HEARD_ROWS: Final = 4

# Where two gates meet, an event may be either's: both go on nearly straight until they have parted. At 200 px/s
# that takes 60 ms; 1000 px/s2 bend a way by 2 px in that time.
Q_SHARED: Final = 1e3
# The margin of a region holds so much already.
GROW_FROM_PX: Final = 2.0
# Half a second of a walking pace's changes of mind; more would hear its neighbours.
GROW_LIMIT_PX: Final = 8.0
# What is fast must turn to stay in the image: s = v^2 / 600 px held for tau = .1 s is allowed from the beginning,
# q = 2 s^2 tau. 200 px/s ask for no more than the least q, 1,000 px/s for 5.5e5 px2/s3.
TURN_RADIUS_PX: Final = 600.0
TURN_S: Final = 0.1
Q_TURN_MAX: Final = 1e7
# An even disc has m = .71 of its radius, so that its rim is within the gate; and a gate that is too small grows, since
# half of an even disc's events lie beyond .71 of what is looked at. What is 2 m away is the ground's. The margin is a
# pixel's own extent.
GATE_SHARE: Final = 1.5
GATE_MARGIN_PX: Final = 0.5
GATE_SIGMAS: Final = 3.0
# Uncertainty beyond a sensor's width, or beyond any speed, says no more.
P_XX_LIMIT: Final = 1e6
P_VV_LIMIT: Final = 1e9
# Beyond it a coordinate is a damaged number; four sensors of the widest kind keep the arithmetic exact.
PLACE_LIMIT_PX: Final = 16_384.0
# 0.1 m of an LED passing 0.1 m before a 400 px lens at 10 m/s: nothing seen moves faster.
SPEED_LIMIT_PX_S: Final = 40_000.0
US_PER_S: Final = 1e6
# Regions looked at together, before one by one.
TOGETHER: Final = 64
# Of a time: not yet.
NEVER: Final = -(2**62)

_F = TypeVar("_F", bound=Callable[..., Any])


def kernel(function: _F) -> _F:
    """Return the function, compiled at its first call, cached on disk, free of the interpreter's lock."""
    return cast("_F", numba.njit(cache=True, nogil=True)(function))


def part(function: _F) -> _F:
    """Return the function, compiled as a part of what calls it, and cached with that (heliograph.link.stamp)."""
    return cast("_F", numba.njit(nogil=True)(function))


@part
def grown_px(state: Floats, i: int) -> float:
    """Return how much farther than its reach region i listens for now."""
    grown: float = min(max(3.0 * math.sqrt(state[P_XX, i]) - GROW_FROM_PX, 0.0), GROW_LIMIT_PX)
    return grown


@part
def shown_px(state: Floats, i: int) -> float:
    """Return how far region i listens for now."""
    reach: float = state[REACH, i] + grown_px(state, i)
    return reach


@part
def gate_of(median_px: float, doubt_px: float) -> float:
    """Return how far from its centre a region takes events for its target's: m and sqrt(P_xx) of it."""
    return GATE_SHARE * median_px + GATE_MARGIN_PX + GATE_SIGMAS * doubt_px


@part
def gate_px(state: Floats, i: int) -> float:
    """Return how far from its centre region i takes events for its target's."""
    gate: float = gate_of(state[CORE, i], math.sqrt(state[P_XX, i]))
    return gate


@part
def neighbours(xs: Floats, ys: Floats, reaches: Floats, x: float, y: float, reach: float) -> int:
    """Return how many regions, (k,) each, lie less than their reach and another's from it on both axes.

    Without a branch, and over slices, so that four are compared at a time.
    """
    near = 0
    for i in range(len(xs)):
        both = reaches[i] + reach
        near += int((abs(xs[i] - x) < both) & (abs(ys[i] - y) < both))
    return near


@kernel
def fastest(state: Floats, n: int) -> float:
    """Return the speed of the fastest region, px/s."""
    most = 0.0
    for i in range(n):
        most = max(most, state[VX, i] * state[VX, i] + state[VY, i] * state[VY, i])
    return math.sqrt(most)


@kernel
def carry(state: Floats, n: int, us: float) -> None:
    """Predict all regions by so many microseconds."""
    s = us / US_PER_S
    third, half = s * s * s / 3.0, s * s / 2.0
    for i in range(n):
        vx, vy = state[VX, i], state[VY, i]
        if state[TURN, i] != 0.0:
            # The arc's chord has the direction of its middle; it is shorter by a thousandth where an arc is .15 rad.
            angle = 0.5 * state[TURN, i] * s
            cos, sin = math.cos(angle), math.sin(angle)
            vx, vy = cos * vx - sin * vy, sin * vx + cos * vy
            state[VX, i], state[VY, i] = cos * vx - sin * vy, sin * vx + cos * vy
        state[X, i] = min(max(state[X, i] + vx * s, -PLACE_LIMIT_PX), PLACE_LIMIT_PX)
        state[Y, i] = min(max(state[Y, i] + vy * s, -PLACE_LIMIT_PX), PLACE_LIMIT_PX)
        turn_px_s2 = (state[VX, i] * state[VX, i] + state[VY, i] * state[VY, i]) * (1.0 / TURN_RADIUS_PX)
        q = max(state[Q, i], min(2.0 * TURN_S * turn_px_s2 * turn_px_s2, Q_TURN_MAX))
        q = min(q, Q_SHARED) if state[SHARED, i] else q
        xx = state[P_XX, i] + s * (2.0 * state[P_XV, i] + s * state[P_VV, i]) + q * third
        xv = state[P_XV, i] + s * state[P_VV, i] + q * half
        xx = min(max(xx, 0.0), P_XX_LIMIT)
        vv = min(max(state[P_VV, i] + q * s, 0.0), P_VV_LIMIT)
        # What limits and rounding leave must be a covariance.
        if xv * xv > xx * vv:
            xv = math.copysign(math.sqrt(xx * vv), xv)
        state[P_XX, i], state[P_XV, i], state[P_VV, i] = xx, xv, vv
