"""Images of lights on the pixels: who is lit how much, and when that changes.

A light's image is a Gaussian over square pixels, ``w(i, j) = wx(i) wy(j)``, ``wx(i) = Phi((i + .5 - x) / sigma) -
Phi((i - .5 - x) / sigma)``. It is taken to be 0 where the lit light would be less than CUT of the darkest surroundings
about it. A pixel in its box sees

    I(t) = exp(view(t)) + sum over lights of level flux w,      u = ln I

The image moves in steps so small that a straight line of u between them errs by less than about 0.02 (the logarithm of
the Gaussian curves by 1 / sigma^2): STEP_PX at the smallest image, in proportion to sigma at larger ones. At each step
the pixels of the old and the new box take a straight line to the new place at the level before; at an edge they then
jump to the level after. A dark light takes no steps, a still one only its edges.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numba
import numpy as np

from heliograph_services.event_source.simulation.contract import NODE_US, NODES, Floats, Ints
from heliograph_services.event_source.simulation.pixel.leaf import leaf
from heliograph_services.event_source.simulation.pixel.model import Floats32, Indices

CUT: Final = 0.01
STEP_PX: Final = 0.25
# Smallest standard deviation of an image with its pixel: .7 px of point spread, .29 of a square.
SMALLEST_PX: Final = 0.75
# An image that moves more than 16 px within a node jumps from step to step: it is a jump in its path.
STEPS: Final = 64
# ln(flux) changes by so much a step.
STEP_LN: Final = 0.1
ROOT_HALF: Final = math.sqrt(0.5)

# Columns of `Lights.place`.
X: Final = 0
Y: Final = 1
SIGMA: Final = 2
FLUX: Final = 3  # at its placing, if it were fully lit
LEVEL: Final = 4
NOW: Final = 5  # level times flux, as it is in the pixels
LEAST: Final = 6  # w is 0 below
CHUNK: Final = 7  # of its placing
PLACE: Final = 8


class Lights(NamedTuple):
    """m lights as they are in the pixels of a width x height sensor.

    Args:
        place: (m, PLACE) float64.
        box: (m, 4) int32: columns [0, 1), rows [2, 3).
        wx: (m, width) float64, of the box's columns, from index 0.
        wy: (m, height) float64, of its rows.
        new_x: (width,) scratch.
        new_y: (height,) scratch.
        new_box: (4,) scratch.
    """

    place: Floats
    box: Indices
    wx: Floats
    wy: Floats
    new_x: Floats
    new_y: Floats
    new_box: Indices


class Chunk(NamedTuple):
    """A `LightChunk`, for kernels."""

    t0_us: float
    x_px: Floats
    y_px: Floats
    sigma_px: Floats
    flux_w_m2: Floats
    edge_first: Ints
    edge_us: Floats
    edge_level: Floats


def no_lights(count: int, width: int, height: int) -> Lights:
    """Return lights that are nowhere yet."""
    place = np.zeros((count, PLACE))
    place[:, CHUNK] = -1.0
    return Lights(
        place, np.zeros((count, 4), np.int32), np.zeros((count, width)), np.zeros((count, height)),
        np.zeros(width), np.zeros(height), np.zeros(4, np.int32),
    )  # fmt: skip


@leaf
def _profile(centre: float, sigma: float, size: int, least: float, w: Floats, box: Indices, at: int) -> None:
    """Write the weights of the columns (or rows) of at least `least`, and box[at], box[at + 1]."""
    first = min(max(round(centre), 0), size - 1)
    end = first
    scale = ROOT_HALF / sigma
    # Outwards to the left, to find the first; then everything from there to the right, each boundary's erf once.
    right = math.erf((first + 0.5 - centre) * scale)
    while first >= 0:
        left = math.erf((first - 0.5 - centre) * scale)
        if 0.5 * (right - left) < least:
            break
        right = left
        first -= 1
    first += 1
    left = math.erf((first - 0.5 - centre) * scale)
    k = first
    while k < size:
        right = math.erf((k + 0.5 - centre) * scale)
        weight = 0.5 * (right - left)
        if weight < least and k >= end:
            break
        w[k - first] = weight
        left = right
        k += 1
    box[at], box[at + 1] = first, max(k, first)


@leaf
def _darkest(view: Floats32, width: int, height: int, x: float, y: float, reach: float) -> float:
    """Return the least of nine values of the view about a place."""
    least = np.float32(np.inf)
    for b in range(-1, 2):
        row = min(max(int(y + b * reach), 0), height - 1)
        for a in range(-1, 2):
            column = min(max(int(x + a * reach), 0), width - 1)
            least = min(least, view[row * width + column])
    return math.exp(np.float64(least))


@numba.njit(nogil=True)
def arrange(
    lights: Lights, x: float, y: float, sigma: float, flux: float, view: Floats32, width: int, height: int
) -> float:
    """Write the weights of an image at a place into the scratch; return the least w that counts there."""
    least = np.inf
    for k in range(4):
        lights.new_box[k] = 0
    if flux > 0.0:
        least = CUT * _darkest(view, width, height, x, y, 2.0 * sigma + 1.0) / flux
        peak = math.erf(0.5 * ROOT_HALF / sigma)
        far = 6.0 * sigma + 1.0
        if peak * peak >= least and -far < x < width + far and -far < y < height + far:
            _profile(x, sigma, width, least / peak, lights.new_x, lights.new_box, 0)
            _profile(y, sigma, height, least / peak, lights.new_y, lights.new_box, 2)
    return least


@leaf
def at_node(table: Floats, i: int, t: float) -> float:
    """Return a light's number at t (us since the chunk began)."""
    k = min(max(int(t / NODE_US), 0), NODES - 1)
    return float(table[i, k] + (table[i, k + 1] - table[i, k]) * (t / NODE_US - k))


@leaf
def _steps(chunk: Chunk, i: int, k: int) -> int:
    """Return into how many steps the image's motion between node k and the next is cut: 0 if it stands still."""
    dx, dy = chunk.x_px[i, k + 1] - chunk.x_px[i, k], chunk.y_px[i, k + 1] - chunk.y_px[i, k]
    s0, s1 = chunk.sigma_px[i, k], chunk.sigma_px[i, k + 1]
    f0, f1 = chunk.flux_w_m2[i, k], chunk.flux_w_m2[i, k + 1]
    if (f0 == 0.0 and f1 == 0.0) or (dx == 0.0 and dy == 0.0 and s0 == s1 and f0 == f1):
        return 0
    step = STEP_PX * max(1.0, min(s0, s1) / SMALLEST_PX)
    count = (math.hypot(dx, dy) + 2.0 * abs(s1 - s0)) / step
    if f0 != f1:
        count += abs(math.log(max(f1, 1e-3 * f0) / max(f0, 1e-3 * f1))) / STEP_LN
    return min(int(count) + 1, STEPS)


@leaf
def step_us(chunk: Chunk, i: int, t: float) -> float:
    """Return how long the step is that ends at t (us since the chunk began); 0 if nothing moves."""
    count = _steps(chunk, i, min(max(math.ceil(t / NODE_US) - 1, 0), NODES - 1))
    return NODE_US / count if count > 0 else 0.0


@leaf
def _walk(chunk: Chunk, i: int, a: float, b: float, to_end: bool, when: Floats, what: Floats, n: int) -> int:
    """Write the steps of a lit light in (a, b) (us since the chunk began), one at b too if asked; return the count."""
    for k in range(int(a / NODE_US), min(math.ceil(b / NODE_US), NODES)):
        count = _steps(chunk, i, k)
        for j in range(1, count + 1):
            t = k * NODE_US + j * (NODE_US / count)
            if a < t < b:
                when[n], what[n] = t, -1.0
                n += 1
        if to_end and count > 0 and b <= (k + 1) * NODE_US:
            when[n], what[n] = b, -1.0
            n += 1
    return n


@numba.njit(nogil=True)
def instants(chunk: Chunk, lights: Lights, t0: float, t1: float) -> tuple[Floats, Ints, Floats]:
    """Return when something changes in [t0, t1) (us since the chunk began), or has moved by t1, in order of time.

    Returns:
        Times; lights; levels from then on, or -1 for a step.
    """
    m = len(lights.place)
    room = len(chunk.edge_us) + m * (int((t1 - t0) / NODE_US) + 2) * (STEPS + 1) + m
    when, what, who = np.empty(room), np.empty(room), np.empty(room, np.int64)
    n = 0
    for i in range(m):
        begin = n
        level, since = lights.place[i, LEVEL], t0
        first, last = chunk.edge_first[i], chunk.edge_first[i + 1]
        e = first + np.searchsorted(chunk.edge_us[first:last], chunk.t0_us + t0)
        while e < last and chunk.edge_us[e] < chunk.t0_us + t1:
            t = chunk.edge_us[e] - chunk.t0_us
            if level > 0.0:
                n = _walk(chunk, i, since, t, False, when, what, n)
            level, since = chunk.edge_level[e], t
            when[n], what[n] = t, level
            n += 1
            e += 1
        if level > 0.0:
            n = _walk(chunk, i, since, t1, True, when, what, n)
        for k in range(begin, n):
            who[k] = i
    order = np.argsort(when[:n], kind="mergesort")
    return when[order], who[order], what[order]
