"""The kernels that say which track hears an event, and how deep in its image it lies.

An event is its region's whose label the lookup image has at its pixel (heliograph_services.decoder.painting).
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
from heliograph_services.decoder import centring, painting, region_state
from heliograph_services.decoder.centring import BINS_PER_PX, half_bins, settle, share
from heliograph_services.decoder.painting import TILE_SHIFT, UNPAINTED, Stale, draw, moved, paint
from heliograph_services.decoder.region_state import (
    CORE,
    EVENTS,
    FIRST,
    P_XX,
    PIXELS,
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


@part
def look_up(
    t_us: Times,
    x_px: Pixels,
    y_px: Pixels,
    offset: int,
    begin_us: int,
    step_us: int,
    labels: Labels,
    stale: Stale,
    painted: Floats,
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
        if label == UNPAINTED:
            paint(labels, stale, painted, n, x >> TILE_SHIFT, y >> TILE_SHIFT)
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
        stale: Stale,
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
                    draw(labels, stale, painted, n_painted if n_painted >= 0 else -n_painted - 1, state, n)
                    n_painted = n
                    paintings += 1
                hits, missed = look_up(
                    t_us[first:k], x_px[first:k], y_px[first:k], first, begin_us, step_us,
                    labels, stale, painted, state, n, heard, counts, hits, hit, hit_label, hit_depth, seen,
                )  # fmt: skip
                off += missed
                carry(state, n, 0.5 * step_us)
            else:
                carry(state, n, float(step_us))
            share(state, centred_us, n, begin_us + step_us)
            settle(state, centred_us, heard, counts, n, begin_us + step_us, step_us, noise_per_px_us, self_centring)
        return hits, paintings, off

    return cast("Callable[..., tuple[int, int, int]]", kernel_of)


_KERNEL: Final = _entry(stamp(region_state, centring, painting))


def follow(
    t_us: Times,
    x_px: Pixels,
    y_px: Pixels,
    t0_us: int,
    step_us: int,
    steps: int,
    self_centring: bool,
    labels: Labels,
    stale: Stale,
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
        stale: (rows, columns) of its squares: 1 where it is to be painted anew.
        painted: (DRAWN_ROWS, capacity), what it is painted from.
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
        t_us, x_px, y_px, t0_us, step_us, steps, self_centring, labels, stale, painted, n_painted, state,
        centred_us, heard, counts, n, noise_per_px_us, hit, hit_label, hit_depth, seen,
    )  # fmt: skip
