"""The kernels: which track hears an event, and where a region's own events say that the target is.

Lookup image, one uint16 a pixel (0 = nobody, i + 1 = track i)::

    label(p) = 1 + argmin_i |p - c_i| / r_i    over the tracks with |p - c_i| <= s_i      (equal: the lowest i)

r is the region's own radius, s >= r what it listens to for now (below); within r a region that is being read goes
before those that are not, so that a track of the clutter cannot take a beacon's events. It is repainted at the first
step with events in which a region has moved or grown by a pixel since; painting costs the pixels of the regions, old
and new, never those of the sensor.

Self-centring, once a step (1 ms): each axis of a region is a Kalman filter of position and velocity, one covariance P
for both axes, driven by white acceleration of intensity q::

    c += v T,   P <- F P F' + q [T^3/3, T^2/2; T^2/2, T]            F = [1, T; 0, 1]

What a region has heard since it was centred last is a measurement as soon as it holds n >= n_min events on enough
distinct pixels and stands out from the surrounding noise, n >= 2 e + 3 sqrt(e); else it is forgotten after `HOLD_US`::

    z = trimmed mean of (event - c(t)) / (1 - e / n),   R = 2 (rho^2 / 4 + 1/12) / n + R_0
    S = P_xx + R,   |z| at most 5 sqrt(S),   c += P_xx z / S,   v += P_xv z / S
    u = (z_x^2 + z_y^2) / 2 S,   q <- q exp(eta (min(u, u_max) - 1))

rho is the target's radius. The last line keeps the filter as nimble as its target: residuals larger than their
expected size are an acceleration that was not allowed for. An LED that rests or goes straight is averaged over many
edges; one that turns at 20,000 px/s2 is followed edge by edge. The mean is trimmed by a fifth at both ends of each
axis, so that a neighbour's edge cannot pull, while the two crescents of a moving lit disc still balance (a median
would jump from one to the other). A pixel counts at most `PIXEL_LIMIT` times a step, and one alone is no measurement:
a hot one cannot pull.

A region that is not centred grows as its uncertainty does, s = r + max(0, 3 sqrt(P_xx) - GROW_FROM_PX), up to
`GROW_LIMIT_PX`: so it hears its target again behind an occlusion.

An event lies in the *core* of its region's image if::

    |event - c(t)| <= max(m + CORE_MARGIN_PX, CORE_LEAST_PX) + max(0, s - r)

m is the median distance of the region's own events, learned one by one, m += CORE_STEP_PX sign(|event - c(t)| - m).
Half of the events at least are in the core, whatever the target's size. Those outside come from the halo: edges of
little contrast, which cross a pixel's threshold late. The *heart* is smaller::

    |event - c(t)| <= max(HEART_SHARE m + HEART_MARGIN_PX, HEART_LEAST_PX) + sqrt(P_xx) + max(0, s - r)

An image is flat in its middle, so that a lit target's motion makes few events there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Pixels, Times

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
SHARED: Final = 10  # 1 where another region that follows its target overlaps with it
RANK: Final = 11  # 1 where frames are being read, else 0
CORE: Final = 12  # m, px
ROWS: Final = 13
# Rows of what the regions have heard since they were centred last: a column a track.
EVENTS: Final = 0
PIXELS: Final = 1  # sum over the steps of distinct pixels less one
AGE_US: Final = 2
FIRST: Final = 3  # a pixel was heard in this step
HEARD_ROWS: Final = 4

# Fewer events say nothing: three pixels that fire twice. The edge of a 3 px disc makes about 30.
MIN_EVENTS: Final = 6
# Sum over steps of (distinct pixels - 1): a hot pixel alone never gets there.
MIN_PIXELS: Final = 2
PIXEL_LIMIT: Final = 2
TRIM: Final = 0.2
# A faint target's edge trickles in over some milliseconds; what is older is no edge.
HOLD_US: Final = 5_000
# A quarter of a pixel: below the centroid's own noise.
BINS_PER_PX: Final = 4
# A sixth of a pixel, squared: what pixels, late OFF events and half-lit crescents leave of a mean over many events.
R_0: Final = 0.05
# The filter's bandwidth is about (q / (R T))^(1/4): with R T = .03 px2 x 2 ms from 11 to 640 rad/s. Below, a filter
# forgets more slowly than its tracker's 10 Hz; above, it is the last edge alone.
Q_MIN: Final = 1.0
Q_MAX: Final = 1e7
# After ten edges of the expected size nothing is left of a turn; the first edge of one raises q fivefold at most.
ETA: Final = 0.2
U_MAX: Final = 9.0
SIGMAS_LIMIT: Final = 5.0
# Where two regions overlap, an event may be either's: both go on nearly straight until they have parted. At 200 px/s
# that takes 60 ms; 1000 px/s2 bend a way by 2 px in that time.
Q_SHARED: Final = 1e3
SHARED_VARIANCE: Final = 10.0
# A region that has not been centred for so long follows nothing that could be confused.
ALIVE_US: Final = 30_000
# The margin of a region holds so much already.
GROW_FROM_PX: Final = 2.0
# Half a second of a walking pace's changes of mind; more would hear its neighbours.
GROW_LIMIT_PX: Final = 8.0
# A pixel's own extent to each side.
CORE_MARGIN_PX: Final = 0.5
# The middle pixel and its eight neighbours: what a point of light lies on.
CORE_LEAST_PX: Final = 1.5
# Of m, and half the margin: a Gaussian has lost a fifth of its height there.
HEART_SHARE: Final = 0.5
HEART_MARGIN_PX: Final = 0.25
# The middle pixel and the four beside it.
HEART_LEAST_PX: Final = 1.0
# Depths of an event in its region's image; 0 is the halo.
CORE_OF: Final = 1
HEART_OF: Final = 2
# A hundred edges of 30 events move m by up to its whole; in between it trembles by a tenth of a pixel.
CORE_STEP_PX: Final = 0.01
# Uncertainty beyond a sensor's width, or beyond any speed, says no more.
P_XX_LIMIT: Final = 1e6
P_VV_LIMIT: Final = 1e9
# Repaint as soon as a centre has moved so far; the regions' margin is more than that.
REPAINT_PX: Final = 1.0
# Beyond it a coordinate is a damaged number; four sensors of the widest kind keep the arithmetic exact.
PLACE_LIMIT_PX: Final = 16_384.0
# 0.1 m of an LED passing 0.1 m before a 400 px lens at 10 m/s: nothing seen moves faster.
SPEED_LIMIT_PX_S: Final = 40_000.0
US_PER_S: Final = 1e6
# Of a time: not yet.
NEVER: Final = -(2**62)

_F = TypeVar("_F", bound=Callable[..., Any])


def kernel(function: _F) -> _F:
    """Return the function, compiled at its first call, cached on disk, free of the interpreter's lock."""
    return cast("_F", numba.njit(cache=True, nogil=True)(function))


@kernel
def span(centre: float, reach: float, side: int) -> tuple[int, int]:
    """Return the first and behind the last pixel of a row or column that a disc can touch, within the sensor."""
    low = min(max(math.ceil(centre - reach), 0.0), float(side))
    high = min(max(math.floor(centre + reach) + 1.0, 0.0), float(side))
    return int(low), int(high)


@kernel
def grown_px(state: Floats, i: int) -> float:
    """Return how much farther than its reach region i listens for now."""
    grown: float = min(max(3.0 * math.sqrt(state[P_XX, i]) - GROW_FROM_PX, 0.0), GROW_LIMIT_PX)
    return grown


@kernel
def shown_px(state: Floats, i: int) -> float:
    """Return how far region i listens for now."""
    reach: float = state[REACH, i] + grown_px(state, i)
    return reach


@kernel
def goes_before(state: Floats, i: int, inner: float, k: int, x: int, y: int) -> bool:
    """Return whether region i hears a pixel rather than region k; `inner` is its (|p - c_i| / r_i)^2."""
    ox, oy, reach = x - state[X, k], y - state[Y, k], state[REACH, k]
    other = (ox * ox + oy * oy) / (reach * reach)
    if state[RANK, i] > state[RANK, k] and inner <= 1.0:
        return True
    if state[RANK, k] > state[RANK, i] and other <= 1.0:
        return False
    return bool(inner < other)


@kernel
def paint(labels: Labels, old: Floats, n_old: int, state: Floats, n: int) -> None:
    """Clear the n_old regions that `old` (3, capacity: x, y, reach) names, paint the n new ones, note them in `old`."""
    height, width = labels.shape
    for i in range(n_old):
        x0, x1 = span(old[0, i], old[2, i], width)
        y0, y1 = span(old[1, i], old[2, i], height)
        labels[y0:y1, x0:x1] = 0
    for i in range(n):
        reach = shown_px(state, i)
        x0, x1 = span(state[X, i], reach, width)
        y0, y1 = span(state[Y, i], reach, height)
        limit = reach * reach
        own = state[REACH, i] * state[REACH, i]
        for y in range(y0, y1):
            dy = y - state[Y, i]
            for x in range(x0, x1):
                dx = x - state[X, i]
                near = dx * dx + dy * dy
                if near > limit:
                    continue
                if labels[y, x] != 0 and not goes_before(state, i, near / own, labels[y, x] - 1, x, y):
                    continue
                labels[y, x] = i + 1
        old[0, i] = state[X, i]
        old[1, i] = state[Y, i]
        old[2, i] = reach


@kernel
def moved(old: Floats, n_old: int, state: Floats, n: int) -> bool:
    """Return whether a region has moved or grown by a pixel since it was painted."""
    if n != n_old:
        return True
    for i in range(n):
        if max(abs(state[X, i] - old[0, i]), abs(state[Y, i] - old[1, i])) >= REPAINT_PX:
            return True
        if abs(shown_px(state, i) - old[2, i]) >= REPAINT_PX:
            return True
    return False


@kernel
def carry(state: Floats, n: int, us: float) -> None:
    """Predict all regions by so many microseconds."""
    s = us / US_PER_S
    for i in range(n):
        state[X, i] = min(max(state[X, i] + state[VX, i] * s, -PLACE_LIMIT_PX), PLACE_LIMIT_PX)
        state[Y, i] = min(max(state[Y, i] + state[VY, i] * s, -PLACE_LIMIT_PX), PLACE_LIMIT_PX)
        q = min(state[Q, i], Q_SHARED) if state[SHARED, i] else state[Q, i]
        xx = state[P_XX, i] + s * (2.0 * state[P_XV, i] + s * state[P_VV, i]) + q * s * s * s / 3.0
        xv = state[P_XV, i] + s * state[P_VV, i] + q * s * s / 2.0
        state[P_XX, i] = min(max(xx, 0.0), P_XX_LIMIT)
        state[P_VV, i] = min(max(state[P_VV, i] + q * s, 0.0), P_VV_LIMIT)
        # What limits and rounding leave must be a covariance.
        most = math.sqrt(state[P_XX, i] * state[P_VV, i])
        state[P_XV, i] = min(max(xv, -most), most)


@kernel
def share(state: Floats, centred_us: Ints, n: int, now_us: int) -> None:
    """Note which regions overlap with another one, of no lower rank, that has been centred of late."""
    for i in range(n):
        state[SHARED, i] = 0.0
    for i in range(n):
        for k in range(i):
            both = state[REACH, i] + state[REACH, k]
            dx, dy = abs(state[X, i] - state[X, k]), abs(state[Y, i] - state[Y, k])
            if dx < both and dy < both and dx * dx + dy * dy < both * both:
                if now_us - centred_us[k] <= ALIVE_US and state[RANK, k] >= state[RANK, i]:
                    state[SHARED, i] = 1.0
                if now_us - centred_us[i] <= ALIVE_US and state[RANK, i] >= state[RANK, k]:
                    state[SHARED, k] = 1.0


@kernel
def trimmed_mean(counts: Counts, n: int, half: int) -> float:
    """Return the mean of what is left after a fifth is cut from both ends, to a quarter of a bin's width.

    Args:
        counts: (2 half or more,) residuals by quarter pixel, 0 px between the bins half - 1 and half.
        n: their sum, above 0.
        half: bins on each side.
    """
    cut = TRIM * n
    low, high = cut, n - cut
    below, total = 0.0, 0.0
    for at in range(2 * half):
        above = below + counts[at]
        inside = min(above, high) - max(below, low)
        if inside > 0.0:
            total += inside * (at - half + 0.5)
        below = above
    return total / (high - low) / BINS_PER_PX


@kernel
def half_bins(reach: float, bins: int) -> int:
    """Return how many bins each side of a region's histogram has."""
    return min(int((reach + GROW_LIMIT_PX + 2.0) * BINS_PER_PX), bins // 2)


@kernel
def correct(state: Floats, i: int, zx: float, zy: float, variance: float) -> None:
    """Let a measurement correct region i: residuals in px, their variance in px2."""
    if state[SHARED, i]:
        variance *= SHARED_VARIANCE
    size = state[P_XX, i] + variance
    limit = SIGMAS_LIMIT * math.sqrt(size)
    away = math.sqrt(zx * zx + zy * zy)
    surprise = away * away / (2.0 * size)
    if away > limit:
        zx *= limit / away
        zy *= limit / away
    gx, gv = state[P_XX, i] / size, state[P_XV, i] / size
    state[X, i] += gx * zx
    state[Y, i] += gx * zy
    state[VX, i] = min(max(state[VX, i] + gv * zx, -SPEED_LIMIT_PX_S), SPEED_LIMIT_PX_S)
    state[VY, i] = min(max(state[VY, i] + gv * zy, -SPEED_LIMIT_PX_S), SPEED_LIMIT_PX_S)
    state[P_VV, i] -= gv * state[P_XV, i]
    state[P_XV, i] *= 1.0 - gx
    state[P_XX, i] *= 1.0 - gx
    if not state[SHARED, i]:
        state[Q, i] = min(max(state[Q, i] * math.exp(ETA * (min(surprise, U_MAX) - 1.0)), Q_MIN), Q_MAX)


@kernel
def centre(state: Floats, i: int, heard: Ints, counts: Counts, noise: float) -> bool:
    """Correct region i if what it has heard is a measurement; return whether it was.

    Args:
        state: as of the step's end.
        i: which region.
        heard: (HEARD_ROWS, capacity).
        counts: (2, bins): its residuals by quarter pixel.
        noise: events of the surrounding noise to be expected among them.
    """
    n = heard[EVENTS, i]
    if n < MIN_EVENTS or heard[PIXELS, i] < MIN_PIXELS or n < 2.0 * noise + 3.0 * math.sqrt(noise):
        return False
    half = half_bins(state[REACH, i], counts.shape[1])
    signal = 1.0 - noise / n
    zx = trimmed_mean(counts[0], n, half) / signal
    zy = trimmed_mean(counts[1], n, half) / signal
    spread = state[RADIUS, i] * state[RADIUS, i] / 4.0 + 1.0 / 12.0
    correct(state, i, zx, zy, 2.0 * spread / n / (signal * signal) + R_0)
    return True


@kernel
def look_up(
    t_us: Times,
    x_px: Pixels,
    y_px: Pixels,
    offset: int,
    begin_us: int,
    step_us: int,
    labels: Labels,
    state: Floats,
    heard: Ints,
    counts: Counts,
    hits: int,
    hit: Ints,
    hit_label: Labels,
    hit_depth: Depths,
    seen: npt.NDArray[np.uint8],
) -> tuple[int, int]:
    """Look up the events of a step and note their residuals; return (hits so far, events off the sensor).

    Args: as of `follow`; `state` is as of the step's middle, `offset` the number of its first event.
    """
    height, width = labels.shape
    half_s = 0.5 * step_us / US_PER_S
    first_hit, off = hits, 0
    for j in range(len(t_us)):
        x, y = x_px[j], y_px[j]
        if x >= width or y >= height:
            off += 1
            continue
        label = labels[y, x]
        if label == 0:
            continue
        i = label - 1
        s = min((t_us[j] - begin_us) / US_PER_S - half_s, half_s)
        zx, zy = x - state[X, i] - state[VX, i] * s, y - state[Y, i] - state[VY, i] * s
        away = math.sqrt(zx * zx + zy * zy)
        hit[hits] = offset + j
        hit_label[hits] = label
        beyond = away - grown_px(state, i)
        doubt_px = math.sqrt(state[P_XX, i])
        if beyond <= max(HEART_SHARE * state[CORE, i] + HEART_MARGIN_PX, HEART_LEAST_PX) + doubt_px:
            hit_depth[hits] = HEART_OF
        else:
            hit_depth[hits] = CORE_OF if beyond <= max(state[CORE, i] + CORE_MARGIN_PX, CORE_LEAST_PX) else 0
        hits += 1
        if away <= state[REACH, i]:
            state[CORE, i] += CORE_STEP_PX if away > state[CORE, i] else -CORE_STEP_PX
        times = seen[y, x]
        if times >= PIXEL_LIMIT:
            continue
        seen[y, x] = times + 1
        half = half_bins(state[REACH, i], counts.shape[2])
        dx = math.floor(zx * BINS_PER_PX) + half
        dy = math.floor(zy * BINS_PER_PX) + half
        counts[i, 0, min(max(dx, 0), 2 * half - 1)] += 1
        counts[i, 1, min(max(dy, 0), 2 * half - 1)] += 1
        heard[EVENTS, i] += 1
        if times == 0:
            # The first pixel of a step says nothing: see MIN_PIXELS.
            heard[PIXELS, i] += heard[FIRST, i]
            heard[FIRST, i] = 1
    for j in range(first_hit, hits):
        seen[y_px[hit[j] - offset], x_px[hit[j] - offset]] = 0
    return hits, off


@kernel
def settle(
    state: Floats,
    centred_us: Ints,
    heard: Ints,
    counts: Counts,
    n: int,
    now_us: int,
    step_us: int,
    noise_per_px_us: float,
    self_centring: bool,
) -> None:
    """Centre the regions that have heard enough, and forget what has led to nothing; arguments as of `follow`."""
    for i in range(n):
        if heard[EVENTS, i] == 0:
            continue
        heard[FIRST, i] = 0
        heard[AGE_US, i] += step_us
        reach = shown_px(state, i)
        noise = noise_per_px_us * heard[AGE_US, i] * math.pi * reach * reach
        done = self_centring and centre(state, i, heard, counts[i], noise)
        if done:
            centred_us[i] = now_us
        if done or heard[AGE_US, i] >= HOLD_US:
            counts[i, :, : 2 * half_bins(state[REACH, i], counts.shape[2])] = 0
            heard[:, i] = 0


@kernel
def follow(
    t_us: Times,
    x_px: Pixels,
    y_px: Pixels,
    t0_us: int,
    step_us: int,
    steps: int,
    self_centring: bool,
    labels: Labels,
    painted: Floats,
    n_painted: int,
    state: Floats,
    centred_us: Ints,
    heard: Ints,
    counts: Counts,
    n: int,
    noise_per_px_us: float,
    hit: Ints,
    hit_label: Labels,
    hit_depth: Depths,
    seen: npt.NDArray[np.uint8],
) -> tuple[int, int, int]:
    """Look up every event of a window, move and centre the regions; return (hits, repaintings, events off the sensor).

    Args:
        t_us: (m,) times, not falling; what lies behind the last step counts as of the last step.
        x_px: (m,).
        y_px: (m,).
        t0_us: beginning of the window; `state` is as of it, and as of the window's end afterwards.
        step_us: length of a step.
        steps: how many steps the window has.
        self_centring: regions are centred on their events; else they are carried alone.
        labels: (height, width), the lookup image.
        painted: (3, capacity), what it was painted from.
        n_painted: how many regions; -(k + 1) says that there were k, and that they are to be repainted.
        state: (ROWS, capacity).
        centred_us: (capacity,) when each was centred last; noted in place.
        heard: (HEARD_ROWS, capacity); kept between windows.
        counts: (capacity, 2, bins), see `centre`; kept between windows.
        n: how many tracks.
        noise_per_px_us: events a pixel and microsecond outside all regions.
        hit: (m,) scratch: indices of the events that fell into a region.
        hit_label: (m,) scratch: their label.
        hit_depth: (m,) scratch: how deep in their region's image they lie.
        seen: (height, width), zeros before and after.
    """
    hits, paintings, off, k = 0, 0, 0, 0
    for step in range(steps):
        begin_us = t0_us + step * step_us
        first = k
        while k < len(t_us) and (t_us[k] < begin_us + step_us or step == steps - 1):
            k += 1
        if k > first:
            # A region is painted where it is in the middle of the step.
            carry(state, n, 0.5 * step_us)
            if n_painted < 0 or moved(painted, n_painted, state, n):
                paint(labels, painted, n_painted if n_painted >= 0 else -n_painted - 1, state, n)
                n_painted = n
                paintings += 1
            hits, missed = look_up(
                t_us[first:k], x_px[first:k], y_px[first:k], first, begin_us, step_us,
                labels, state, heard, counts, hits, hit, hit_label, hit_depth, seen,
            )  # fmt: skip
            off += missed
            carry(state, n, 0.5 * step_us)
        else:
            carry(state, n, float(step_us))
        share(state, centred_us, n, begin_us + step_us)
        settle(state, centred_us, heard, counts, n, begin_us + step_us, step_us, noise_per_px_us, self_centring)
    return hits, paintings, off
