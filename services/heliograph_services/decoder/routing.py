"""The kernels: which track hears an event, and where a region's own events say that the target is.

Lookup image, one uint16 a pixel (0 = nobody, i + 1 = track i)::

    label(p) = 1 + argmin_i |p - c_i|  over the tracks with |p - c_i| <= r_i      (equal distances: the lowest i)

It is repainted at the first step with events in which a centre has moved by a pixel since it was painted; painting
costs the pixels of the regions, old and new, never those of the sensor. A window of events is routed in two passes:
look up and gather the few that fall into a region, then a counting sort into one run a track, which keeps their order.

Self-centring, once a window: with d the residuals (event minus centre at its step) of the track's n events, e the
number that the surrounding noise explains, and h the time since the last correction, a fading-memory filter (critically
damped: its time constant 1 / omega does not depend on how often an LED blinks) ::

    theta = exp(-omega min(h, h_max)),  g = (n - e) / (n + n0)
    c += (1 - theta^2) g mean(d),  v += (1 - theta)^2 g mean(d) / h

runs where n >= n_min and n >= 2 e + 3 sqrt(e). A pixel counts at most `PIXEL_LIMIT` times a window, so that a hot one
cannot pull; the mean is trimmed by a fifth at both ends of each axis, so that a neighbour's edge cannot, while the two
crescents of a moving lit disc still balance (a median would jump from one to the other). Backwards h is negative.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Pixels, Times

Floats = npt.NDArray[np.float64]
Residuals = npt.NDArray[np.float32]
Labels = npt.NDArray[np.uint16]
Ints = npt.NDArray[np.int64]

# 30 rad/s: lags a / omega^2 = 1.1 px at 1000 px/s2, and turns 0.3 px of centroid noise into 2 px/s of velocity noise.
# A faster filter follows noise, a slower one loses its target in a curve.
OMEGA_PER_S: Final = 30.0
# A single window after a long silence counts at most .78: it may be a passing edge.
GAP_LIMIT_S: Final = 0.025
# Fewer events say nothing: three pixels that fire twice. The edge of a 3 px disc makes about 30.
MIN_EVENTS: Final = 6
PIXEL_LIMIT: Final = 2
TRIM: Final = 0.2
# A quarter of a pixel: below the centroid's own noise.
BINS_PER_PX: Final = 4
# Repaint as soon as a centre has moved so far; the regions' margin is more than that.
REPAINT_PX: Final = 1.0
# Beyond it a coordinate is a damaged number; four sensors of the widest kind keep the arithmetic exact.
PLACE_LIMIT_PX: Final = 16_384.0
# 0.1 m of an LED passing 0.1 m before a 400 px lens at 10 m/s: nothing seen moves faster.
SPEED_LIMIT_PX_S: Final = 40_000.0
US_PER_S: Final = 1e6
# Of a time: not yet.
NEVER: Final = -(2**62)
PAUSE_LIMIT_US: Final = 1_000_000

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
def paint(labels: Labels, old: Floats, n_old: int, x_px: Floats, y_px: Floats, reach_px: Floats, n: int) -> None:
    """Clear the n_old regions that `old` (3, capacity: x, y, reach) names, paint the n new ones, note them in `old`."""
    height, width = labels.shape
    for i in range(n_old):
        x0, x1 = span(old[0, i], old[2, i], width)
        y0, y1 = span(old[1, i], old[2, i], height)
        labels[y0:y1, x0:x1] = 0
    for i in range(n):
        x0, x1 = span(x_px[i], reach_px[i], width)
        y0, y1 = span(y_px[i], reach_px[i], height)
        limit = reach_px[i] * reach_px[i]
        for y in range(y0, y1):
            dy = y - y_px[i]
            for x in range(x0, x1):
                dx = x - x_px[i]
                near = dx * dx + dy * dy
                if near > limit:
                    continue
                other = labels[y, x]
                if other != 0:
                    ox = x - x_px[other - 1]
                    oy = y - y_px[other - 1]
                    if ox * ox + oy * oy <= near:
                        continue
                labels[y, x] = i + 1
        old[0, i] = x_px[i]
        old[1, i] = y_px[i]
        old[2, i] = reach_px[i]


@kernel
def moved(old: Floats, n_old: int, x_px: Floats, y_px: Floats, n: int) -> bool:
    """Return whether a centre is a pixel or more from where it was painted."""
    if n != n_old:
        return True
    furthest = 0.0
    for i in range(n):
        furthest = max(furthest, abs(x_px[i] - old[0, i]), abs(y_px[i] - old[1, i]))
    return furthest >= REPAINT_PX


@kernel
def gather(
    t_us: Times,
    x_px: Pixels,
    y_px: Pixels,
    t0_us: int,
    step_us: int,
    steps: int,
    labels: Labels,
    painted: Floats,
    n_painted: int,
    state: Floats,
    n: int,
    hit: Ints,
    hit_label: Labels,
    hit_dx: Residuals,
    hit_dy: Residuals,
    seen: npt.NDArray[np.uint8],
) -> tuple[int, int, int]:
    """Look up every event of the window; return (hits, repaintings, events off the sensor).

    Args:
        t_us: (m,) times, not falling; what lies behind the last step counts as of the last step.
        x_px: (m,).
        y_px: (m,).
        t0_us: beginning of the window; `state` is as of it.
        step_us: length of a step.
        steps: how many steps the window has.
        labels: (height, width), the lookup image.
        painted: (3, capacity), what it was painted from.
        n_painted: how many regions; -(k + 1) says that there were k, and that they are to be repainted.
        state: (5, capacity): x, y, vx, vy in px and px/s, reach in px.
        n: how many tracks.
        hit: (m,) scratch: indices of the events that fell into a region.
        hit_label: (m,) scratch: their label.
        hit_dx: (m,) scratch: their distance from the track's centre at their step; NaN beyond the pixel's limit.
        hit_dy: (m,) scratch.
        seen: (height, width), zeros before and after.
    """
    height, width = labels.shape
    cx = np.empty(n, np.float64)
    cy = np.empty(n, np.float64)
    hits, paintings, off, k = 0, 0, 0, 0
    for step in range(steps):
        stop_us = t0_us + (step + 1) * step_us
        first = k
        while k < len(t_us) and (t_us[k] < stop_us or step == steps - 1):
            k += 1
        if k == first:
            continue
        seconds = (step + 0.5) * step_us / US_PER_S
        for i in range(n):
            cx[i] = state[0, i] + state[2, i] * seconds
            cy[i] = state[1, i] + state[3, i] * seconds
        if n_painted < 0 or moved(painted, n_painted, cx, cy, n):
            old = n_painted if n_painted >= 0 else -n_painted - 1
            paint(labels, painted, old, cx, cy, state[4], n)
            n_painted = n
            paintings += 1
        for j in range(first, k):
            x, y = x_px[j], y_px[j]
            if x >= width or y >= height:
                off += 1
                continue
            label = labels[y, x]
            if label != 0:
                hit[hits] = j
                hit_label[hits] = label
                fresh = seen[y, x] < PIXEL_LIMIT
                seen[y, x] += fresh
                hit_dx[hits] = x - cx[label - 1] if fresh else np.nan
                hit_dy[hits] = y - cy[label - 1]
                hits += 1
    for j in range(hits):
        seen[y_px[hit[j]], x_px[hit[j]]] = 0
    return hits, paintings, off


@kernel
def sort_by_track(t_us: Times, on: Flags, n: int, hits: int, hit: Ints, hit_label: Labels) -> tuple[Ints, Times, Flags]:
    """Return (starts, t_us, on): the hits of track i are [starts[i], starts[i + 1]), in their order."""
    starts = np.zeros(n + 1, np.int64)
    for j in range(hits):
        starts[hit_label[j]] += 1
    for i in range(n):
        starts[i + 1] += starts[i]
    at = starts[:n].copy()
    times = np.empty(hits, np.int64)
    levels = np.empty(hits, np.bool_)
    for j in range(hits):
        i = hit_label[j] - 1
        times[at[i]] = t_us[hit[j]]
        levels[at[i]] = on[hit[j]]
        at[i] += 1
    return starts, times, levels


@kernel
def residuals_by_track(
    n: int, hits: int, hit_label: Labels, hit_dx: Residuals, hit_dy: Residuals
) -> tuple[Ints, Residuals, Residuals]:
    """Return (starts, dx, dy) likewise, without the events beyond their pixel's limit."""
    starts = np.zeros(n + 1, np.int64)
    for j in range(hits):
        starts[hit_label[j]] += not math.isnan(hit_dx[j])
    for i in range(n):
        starts[i + 1] += starts[i]
    at = starts[:n].copy()
    dx = np.empty(starts[n], np.float32)
    dy = np.empty(starts[n], np.float32)
    for j in range(hits):
        if not math.isnan(hit_dx[j]):
            i = hit_label[j] - 1
            dx[at[i]] = hit_dx[j]
            dy[at[i]] = hit_dy[j]
            at[i] += 1
    return starts, dx, dy


@kernel
def trimmed_mean(residual: Residuals, reach_px: float, counts: Ints) -> float:
    """Return the mean of what is left after a fifth is cut from both ends, to a quarter of a bin's width.

    Args:
        residual: (n,) px, n > 0, each within reach_px and a pixel of 0.
        reach_px: the region's radius.
        counts: scratch, at least 2 BINS_PER_PX (reach_px + 2) long.
    """
    half = int((reach_px + 2.0) * BINS_PER_PX)
    bins = 2 * half
    counts[:bins] = 0
    for value in residual:
        at = math.floor(value * BINS_PER_PX) + half
        counts[min(max(at, 0), bins - 1)] += 1
    cut = TRIM * len(residual)
    low, high = cut, len(residual) - cut
    below, total = 0.0, 0.0
    for at in range(bins):
        above = below + counts[at]
        inside = min(above, high) - max(below, low)
        if inside > 0.0:
            total += inside * (at - half + 0.5)
        below = above
    return total / (high - low) / BINS_PER_PX


@kernel
def recentre(
    starts: Ints,
    dx: Residuals,
    dy: Residuals,
    state: Floats,
    centred_us: Ints,
    n: int,
    noise_per_px: float,
    now_us: int,
    window_us: int,
    counts: Ints,
) -> int:
    """Run the filter of the module's head over all tracks; return how many had enough events.

    Args:
        starts: as `residuals_by_track` returns.
        dx: (hits,) px.
        dy: (hits,) px.
        state: (5, capacity), as of now_us; corrected in place.
        centred_us: (capacity,) when each was centred last; noted in place.
        n: how many tracks.
        noise_per_px: events of the window a pixel outside all regions.
        now_us: the window's end, or its beginning where the filter runs back.
        window_us: the window's length, negative where the filter runs back.
        counts: scratch of `trimmed_mean`.
    """
    centred = 0
    for i in range(n):
        first, behind = starts[i], starts[i + 1]
        events = behind - first
        reach = state[4, i]
        noise = noise_per_px * math.pi * reach * reach
        if events < MIN_EVENTS or events < 2.0 * noise + 3.0 * math.sqrt(noise):
            continue
        gain = (events - noise) / (events + MIN_EVENTS)
        rx = gain * trimmed_mean(dx[first:behind], reach, counts)
        ry = gain * trimmed_mean(dy[first:behind], reach, counts)
        # A region that was never centred is as if it had been so a window ago; a longer pause counts as the longest.
        gap_us = min(max(abs(now_us - centred_us[i]), abs(window_us)), PAUSE_LIMIT_US)
        if centred_us[i] == NEVER:
            gap_us = abs(window_us)
        theta = math.exp(-OMEGA_PER_S * min(gap_us / US_PER_S, GAP_LIMIT_S))
        gap_s = math.copysign(gap_us / US_PER_S, window_us)
        state[0, i] += (1.0 - theta * theta) * rx
        state[1, i] += (1.0 - theta * theta) * ry
        state[2, i] += (1.0 - theta) * (1.0 - theta) * rx / gap_s
        state[3, i] += (1.0 - theta) * (1.0 - theta) * ry / gap_s
        centred_us[i] = now_us
        centred += 1
    return centred
