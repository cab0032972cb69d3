"""The kernels that say which track hears an event, and how deep in its image it lies.

Lookup image, one uint16 a pixel (0 = nobody, i + 1 = track i)::

    label(p) = 1 + argmin_i |p - c_i| / r_i    over the tracks with |p - c_i| <= s_i      (equal: the lowest i)

r is the region's own radius, s >= r what it listens to for now; within r a region that is being read goes
before those that are not, so that a track of the clutter cannot take a beacon's events. It is repainted at the first
step with events in which a region has moved or grown by a pixel since; painting costs the pixels of the regions, old
and new, never those of the sensor.

Once a step (1 ms) the regions are carried (heliograph_services.decoder.region_state), and centred on what they have
heard (heliograph_services.decoder.centring). A pixel counts there at most `PIXEL_LIMIT` times a step.

An event lies in the *core* of its region's image if::

    |event - c(t)| <= max(m + CORE_MARGIN_PX, CORE_LEAST_PX) + max(0, s - r)

m is the median distance of the events within the region's gate (heliograph_services.decoder.region_state), learned one
by one, m += CORE_STEP_PX sign(|event - c(t)| - m). Half of them at least are in the core, whatever the target's size.
Those outside come from the halo: edges of little contrast, which cross a pixel's threshold late. The *heart* is
smaller::

    |event - c(t)| <= max(HEART_SHARE m + HEART_MARGIN_PX, HEART_LEAST_PX) + sqrt(P_xx) + max(0, s - r)

An image is flat in its middle, so that a lit target's motion makes few events there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, cast

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Pixels, Times
from heliograph.link.stamp import stamp
from heliograph_services.decoder import centring, region_state
from heliograph_services.decoder.centring import BINS_PER_PX, half_bins, settle, share
from heliograph_services.decoder.region_state import (
    CORE,
    EVENTS,
    FIRST,
    P_XX,
    PIXELS,
    RANK,
    REACH,
    US_PER_S,
    VX,
    VY,
    Counts,
    Depths,
    Floats,
    Ints,
    Labels,
    X,
    Y,
    carry,
    gate_of,
    grown_px,
    part,
    shown_px,
)

PIXEL_LIMIT: Final = 2
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
# Repaint as soon as a centre has moved so far; the regions' margin is more than that.
REPAINT_PX: Final = 1.0


@part
def span(centre: float, reach: float, side: int) -> tuple[int, int]:
    """Return the first and behind the last pixel of a row or column that a disc can touch, within the sensor."""
    low = min(max(math.ceil(centre - reach), 0.0), float(side))
    high = min(max(math.floor(centre + reach) + 1.0, 0.0), float(side))
    return int(low), int(high)


@part
def goes_before(state: Floats, i: int, inner: float, k: int, x: int, y: int) -> bool:
    """Return whether region i hears a pixel rather than region k; `inner` is its (|p - c_i| / r_i)^2."""
    ox, oy, reach = x - state[X, k], y - state[Y, k], state[REACH, k]
    other = (ox * ox + oy * oy) / (reach * reach)
    if state[RANK, i] > state[RANK, k] and inner <= 1.0:
        return True
    if state[RANK, k] > state[RANK, i] and other <= 1.0:
        return False
    return bool(inner < other)


@part
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


@part
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


@part
def look_up(
    t_us: Times,
    x_px: Pixels,
    y_px: Pixels,
    offset: int,
    begin_us: int,
    step_us: int,
    labels: Labels,
    state: Floats,
    n: int,
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
    # What does not change within a step: a root an event would be a third of what an event costs.
    grown, doubt = np.empty(n), np.empty(n)
    for i in range(n):
        grown[i], doubt[i] = grown_px(state, i), math.sqrt(state[P_XX, i])
    for j in range(len(t_us)):
        x, y = int(x_px[j]), int(y_px[j])
        if x >= width or y >= height:
            off += 1
            continue
        label = labels[y, x]
        # Written in any case, and kept where somebody hears it: see below.
        hit[hits] = offset + j
        hit_label[hits] = label
        hits += int(label != 0)
    for k in range(first_hit, hits):
        j, i = int(hit[k]) - offset, int(hit_label[k]) - 1
        x, y = int(x_px[j]), int(y_px[j])
        s = min((t_us[j] - begin_us) * 1e-6 - half_s, half_s)
        zx, zy = x - state[X, i] - state[VX, i] * s, y - state[Y, i] - state[VY, i] * s
        away2 = zx * zx + zy * zy
        median = state[CORE, i]
        heart = max(HEART_SHARE * median + HEART_MARGIN_PX, HEART_LEAST_PX) + doubt[i] + grown[i]
        core = max(median + CORE_MARGIN_PX, CORE_LEAST_PX) + grown[i]
        # Comparisons as numbers: what no processor can foresee is not branched on.
        in_heart = np.uint8(away2 <= heart * heart)
        hit_depth[k] = HEART_OF * in_heart + CORE_OF * (np.uint8(away2 <= core * core) & (1 - in_heart))
        gate = gate_of(median, doubt[i])
        if away2 > gate * gate:
            continue
        reach = state[REACH, i]
        within = np.float64(away2 <= reach * reach)
        beyond = np.float64(away2 > median * abs(median))
        state[CORE, i] = median + within * (2.0 * beyond - 1.0) * CORE_STEP_PX
        times = seen[y, x]
        if times >= PIXEL_LIMIT:
            continue
        seen[y, x] = times + 1
        half = half_bins(reach, counts.shape[2])
        dx = math.floor(zx * BINS_PER_PX) + half
        dy = math.floor(zy * BINS_PER_PX) + half
        counts[i, 0, min(max(dx, 0), 2 * half - 1)] += 1
        counts[i, 1, min(max(dy, 0), 2 * half - 1)] += 1
        heard[EVENTS, i] += 1
        # The first pixel of a step says nothing: see MIN_PIXELS.
        heard[PIXELS, i] += heard[FIRST, i] * np.int64(times == 0)
        heard[FIRST, i] = 1
    for j in range(first_hit, hits):
        seen[y_px[hit[j] - offset], x_px[hit[j] - offset]] = 0
    return hits, off


def _entry(sources: int) -> Callable[..., tuple[int, int, int]]:
    """Return the kernel of `follow`, cached under these sources (`heliograph.link.stamp`)."""

    @numba.njit(cache=True, nogil=True)
    def kernel_of(
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
        hits, paintings, off, k = 0, 0, 0, min(sources, 0)
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
                    labels, state, n, heard, counts, hits, hit, hit_label, hit_depth, seen,
                )  # fmt: skip
                off += missed
                carry(state, n, 0.5 * step_us)
            else:
                carry(state, n, float(step_us))
            share(state, centred_us, n, begin_us + step_us)
            settle(state, centred_us, heard, counts, n, begin_us + step_us, step_us, noise_per_px_us, self_centring)
        return hits, paintings, off

    return cast("Callable[..., tuple[int, int, int]]", kernel_of)


_KERNEL: Final = _entry(stamp(region_state, centring))


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
    return _KERNEL(
        t_us, x_px, y_px, t0_us, step_us, steps, self_centring, labels, painted, n_painted, state, centred_us,
        heard, counts, n, noise_per_px_us, hit, hit_label, hit_depth, seen,
    )  # fmt: skip
