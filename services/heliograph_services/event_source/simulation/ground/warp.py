"""The ground as the camera sees it: a tiled texture warped by a homography, band-limited to the pixel.

For pixel (x, y) the homography M gives (X w, Y w, w) = M (x, y, 1): the point (X, Y) of the ground in metres, and how
steeply the ray goes down, w <= 0 being sky. The texture's level l has (size / 2^l)^2 texels of texel_m 2^l. A
pixel's footprint is F = sqrt((|dP/dx|^2 + |dP/dy|^2) / 2) metres. A level is used alone while its texel is .84 to 1.41
footprints, and blended with the next finer one from there to 1.68, where that is .84: so nothing jumps when the camera
rises. Levels are low-passed (standard deviation .5 texel) and read by bilinear interpolation (.41 texel): together .54
to .91 px of blur, about that of a lens with a point spread of .7 px and of a pixel's own area (.29 px): .76 px.

Coordinates are 32 bit fixed point of a tile, so that they wrap for nothing (as in the sine tables of oscillators), and
exact to 2^-10 of a texel. Where the camera is tilted they go on parabolas through exact points that are so close that
the parabola errs by at most SAG_PX.

Edges (of the horizon, of an asset) have the same blur: a smoothstep of EDGE_PX, whose density has the standard
deviation EDGE_PX / sqrt(20) = .76 px.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numba
import numpy as np

EDGE_PX: Final = 3.4
# A fortieth of the step between two views.
SAG_PX: Final = 0.0125
# Shorter pieces of a row cost more in their ends than in their pixels; in longer ones the rounding of a parabola's bend
# grows (half a unit times n^2: 2^-8 of a texel at 128). Within a piece w changes by a quarter at most: the level
# of its middle suits all of it.
_SEGMENT_MIN: Final = 8
_SEGMENT_MAX: Final = 128
_SEGMENT_TURN: Final = 0.25
# Of the horizon nearer than this the ground is its mean: its footprint is beyond the tile.
_FAR_PX: Final = 0.5
_TURN: Final = 4294967296.0


@numba.njit(cache=True, nogil=True)
def _smooth(d_px: float) -> float:
    """Return the share of a pixel at a signed distance d_px from an edge that lies on its inner side."""
    s = min(max(d_px / EDGE_PX + 0.5, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@numba.njit(cache=True, nogil=True)
def _read(texels: Any, base: int, bits: int, u: Any, v: Any, out: Any) -> None:
    """Read a level along a parabola: out[k] at u[0] + k u[1] + k^2 u[2], and so v; 32 bit fixed point of a tile."""
    shift = np.uint32(32 - bits)
    below = np.uint32((np.uint32(1) << shift) - np.uint32(1))
    unit = np.float32(1.0 / (1 << (32 - bits)))
    # Indices without a sign need no test for one, which would cost as much as the rest.
    first, one, stride = np.uint64(base), np.uint64(1), np.uint64((1 << bits) + 1)
    half = np.uint32(np.uint32(1) << (shift - np.uint32(1)))  # a texel's value is that of its middle
    uk, vk = np.uint32(u[0] - half), np.uint32(v[0] - half)
    du, dv = np.uint32(u[1] + u[2]), np.uint32(v[1] + v[2])
    bend_u, bend_v = np.uint32(u[2] + u[2]), np.uint32(v[2] + v[2])
    for k in range(len(out)):
        at = first + np.uint64(uk >> shift) + np.uint64(vk >> shift) * stride
        fu = np.float32(np.int32(uk & below)) * unit
        fv = np.float32(np.int32(vk & below)) * unit
        uk, vk = np.uint32(uk + du), np.uint32(vk + dv)
        du, dv = np.uint32(du + bend_u), np.uint32(dv + bend_v)
        a, b = texels[at], texels[at + stride]
        top = a + fu * (texels[at + one] - a)
        bottom = b + fu * (texels[at + stride + one] - b)
        out[k] = top + fv * (bottom - top)


@numba.njit(cache=True, nogil=True)
def _blend(texels: Any, base: int, bits: int, u: Any, v: Any, share: Any, out: Any) -> None:
    """Mix a share of another level into what `_read` gave; the same loop, which a test in it would slow down."""
    shift = np.uint32(32 - bits)
    below = np.uint32((np.uint32(1) << shift) - np.uint32(1))
    unit = np.float32(1.0 / (1 << (32 - bits)))
    # Indices without a sign need no test for one, which would cost as much as the rest.
    first, one, stride = np.uint64(base), np.uint64(1), np.uint64((1 << bits) + 1)
    half = np.uint32(np.uint32(1) << (shift - np.uint32(1)))  # a texel's value is that of its middle
    uk, vk = np.uint32(u[0] - half), np.uint32(v[0] - half)
    du, dv = np.uint32(u[1] + u[2]), np.uint32(v[1] + v[2])
    bend_u, bend_v = np.uint32(u[2] + u[2]), np.uint32(v[2] + v[2])
    for k in range(len(out)):
        at = first + np.uint64(uk >> shift) + np.uint64(vk >> shift) * stride
        fu = np.float32(np.int32(uk & below)) * unit
        fv = np.float32(np.int32(vk & below)) * unit
        uk, vk = np.uint32(uk + du), np.uint32(vk + dv)
        du, dv = np.uint32(du + bend_u), np.uint32(dv + bend_v)
        a, b = texels[at], texels[at + stride]
        top = a + fu * (texels[at + one] - a)
        bottom = b + fu * (texels[at + stride + one] - b)
        out[k] += share * (top + fv * (bottom - top) - out[k])


@numba.njit(cache=True, nogil=True)
def _level(m: Any, gx: float, gy: float, w: float, texel_m: float, levels: int) -> tuple[int, float]:
    """Return the level that suits the footprint where the ground is (gx, gy), and the share of the finer one."""
    a, b = (m[0, 0] - gx * m[2, 0]) / w, (m[0, 1] - gx * m[2, 1]) / w
    c, d = (m[1, 0] - gy * m[2, 0]) / w, (m[1, 1] - gy * m[2, 1]) / w
    octaves = 0.5 * math.log2(max(1e-30, 0.5 * (a * a + b * b + c * c + d * d)) / (texel_m * texel_m))
    level = math.ceil(octaves - 0.25)
    share = max(0.0, 4.0 * (level - octaves) - 2.0)
    if level <= 0:
        return 0, 0.0
    if level >= levels:
        return levels - 1, 0.0
    return int(level), share


@numba.njit(cache=True, nogil=True)
def _row(
    texels: Any, bases: Any, bits: int, tile_m: float, m: Any, pixel: float, y: float, x0: int, x1: int, out: Any
) -> None:
    """Fill out[x0:x1], all of it ground, w > 0."""
    levels = len(bases)
    texel_m = tile_m / (1 << bits)
    flat = m[2, 0] == 0.0 and m[2, 1] == 0.0
    scale = _TURN / tile_m
    x = x0
    u, v, w = _ground(m, x, y)
    while x < x1:
        n = x1 - x
        if not flat:
            steepest = max(abs(m[2, 0]), abs(m[2, 1]))
            n = min(n, _SEGMENT_MAX, max(_SEGMENT_MIN, int(_SEGMENT_TURN * w / steepest)))
            if m[2, 0] != 0.0:
                # A projective line, 1 / (1 + q k), leaves its parabola by less than n^3 q^2 / 20 px.
                n = min(n, max(_SEGMENT_MIN, int((20.0 * SAG_PX * (w / m[2, 0]) ** 2) ** (1.0 / 3.0))))
            if m[2, 0] < 0.0:  # towards the horizon: a piece ends half way to it, at the latest
                n = min(n, max(1, int(-0.5 * w / m[2, 0])))
        um, vm, wm = u, v, w
        u1, v1, w1 = u, v, w
        if n > 1:
            um, vm, wm = _ground(m, x + 0.5 * n, y)
        if x + n < x1 or n > 1:  # not behind a last pixel: that may be the sky
            u1, v1, w1 = _ground(m, x + n, y)
        level, share = _level(m, um, vm, wm, texel_m / pixel, levels)
        pu, pv = _parabola(u, um, u1, n, scale), _parabola(v, vm, v1, n, scale)
        _read(texels, bases[level], bits - level, pu, pv, out[x : x + n])
        if share > 0.0:
            _blend(texels, bases[level - 1], bits - level + 1, pu, pv, np.float32(share), out[x : x + n])
        x, u, v, w = x + n, u1, v1, w1


@numba.njit(cache=True, nogil=True)
def _ground(m: Any, x: float, y: float) -> tuple[float, float, float]:
    """Return the ground's point at a pixel, and w."""
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
    return (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w, w


@numba.njit(cache=True, nogil=True)
def _parabola(p0: float, p: float, p1: float, n: int, scale: float) -> tuple[Any, Any, Any]:
    """Return the parabola through p0 at 0, p at n / 2, p1 at n, in fixed point."""
    bend = 2.0 * (p0 - 2.0 * p + p1) / (n * n)
    slope = (p1 - p0) / n - bend * n
    return (
        np.uint32(np.int64(np.floor(p0 * scale))),
        np.uint32(np.int64(np.rint(slope * scale))),
        np.uint32(np.int64(np.rint(bend * scale))),
    )


@numba.njit(cache=True, nogil=True)
def _beyond(a: float, c: float, least: float, width: int) -> tuple[int, int]:
    """Return [x0, x1): the pixels of a row with a x + c >= least."""
    x0, x1 = 0, width
    rest = least - c
    if abs(a) < 1e-12:
        if rest > 0.0:
            x1 = 0
    elif a > 0.0:
        x0 = math.ceil(min(max(rest / a, 0.0), float(width)))
    else:
        x1 = math.floor(min(max(rest / a, -1.0), width - 1.0)) + 1
    return min(x0, x1), x1


@numba.njit(cache=True, nogil=True)
def render_ground(
    texels: Any, bases: Any, bits: int, tile_m: float, m: Any, pixel: float, far: float, sky: float, out: Any
) -> None:
    """Render ground and sky.

    Args:
        texels: (n,) float32, all levels, each with its first row and column again behind its last.
        bases: (levels,) int64, where each begins.
        bits: level 0 has 2^bits texels a side.
        tile_m: what they cover.
        m: (3, 3) float64, pixel to ground; see the module.
        pixel: side of what a pixel averages, in pixels of m: less than 1 where not all pixels are rendered.
        far: value of the ground at the horizon.
        sky: value above it.
        out: (height, width) float32, ln(irradiance + dark).
    """
    height, width = out.shape
    slope = math.hypot(m[2, 0], m[2, 1])
    for y in range(height):
        if slope == 0.0:
            if m[2, 2] > 0.0:
                _row(texels, bases, bits, tile_m, m, pixel, y, 0, width, out[y])
            else:
                out[y, :] = np.float32(sky)
            continue
        a, c = m[2, 0] / slope, (m[2, 1] * y + m[2, 2]) / slope  # a x + c: pixels below the horizon
        x0, x1 = _beyond(a, c, _FAR_PX, width)
        if x0 < x1:
            _row(texels, bases, bits, tile_m, m, pixel, y, x0, x1, out[y])
        # What the horizon's blur reaches, but for what lies clear of it.
        e0, e1 = _beyond(a, c, -0.5 * EDGE_PX, width)
        g0, g1 = _beyond(a, c, 0.5 * EDGE_PX, width)
        out[y, :e0] = np.float32(sky)
        out[y, e1:] = np.float32(sky)
        for x in range(e0, e1):
            if not g0 <= x < g1:
                ground = out[y, x] if x0 <= x < x1 else np.float32(far)
                share = _smooth(a * x + c)
                out[y, x] = math.log(share * math.exp(ground) + (1.0 - share) * math.exp(sky))


@numba.njit(cache=True, nogil=True)
def _span(lines: Any, y: float, inner_px: float, width: int) -> tuple[int, int]:
    """Return [x0, x1): the pixels of a row that are at least inner_px within all four lines."""
    x0, x1 = 0, width
    for k in range(4):
        k0, k1 = _beyond(lines[k, 0], lines[k, 1] * y + lines[k, 2], inner_px, width)
        x0, x1 = max(x0, k0), min(x1, k1)
    return x0, max(x0, x1)


@numba.njit(cache=True, nogil=True)
def _coverage(lines: Any, x: float, y: float) -> float:
    """Return the share of a pixel's light that comes from a quad: exact for a parallelogram whose blur is separable."""
    share = 1.0
    for k in range(2):
        d0 = lines[k, 0] * x + lines[k, 1] * y + lines[k, 2]
        d1 = lines[k + 2, 0] * x + lines[k + 2, 1] * y + lines[k + 2, 2]
        share *= max(0.0, _smooth(d0) + _smooth(d1) - 1.0)
    return share


@numba.njit(cache=True, nogil=True)
def draw_quad(lines: Any, value: float, out: Any) -> None:
    """Draw a quad of one value over what is there, its edges mixed in linear light.

    Args:
        lines: (4, 3) float64, of each edge in turn the signed distance a x + b y + c in pixels, positive inside.
        value: ln(irradiance + dark) of the quad.
        out: (height, width) float32.
    """
    height, width = out.shape
    linear = math.exp(value)
    for y in range(height):
        x0, x1 = _span(lines, y, -0.5 * EDGE_PX, width)
        if x0 >= x1:
            continue
        i0, i1 = _span(lines, y, 0.5 * EDGE_PX, width)
        for x in range(x0, x1):
            if i0 <= x < i1:
                out[y, x] = value
            else:
                share = _coverage(lines, x, y)
                if share > 0.0:
                    out[y, x] = math.log(share * linear + (1.0 - share) * math.exp(out[y, x]))


@numba.njit(cache=True, nogil=True)
def cover_quad(lines: Any, out: Any) -> None:
    """Write the share of each pixel that a quad covers.

    Args:
        lines: as for `draw_quad`.
        out: (height, width) float32, zeros before.
    """
    height, width = out.shape
    for y in range(height):
        x0, x1 = _span(lines, y, -0.5 * EDGE_PX, width)
        if x0 >= x1:
            continue
        i0, i1 = _span(lines, y, 0.5 * EDGE_PX, width)
        for x in range(x0, x1):
            out[y, x] = 1.0 if i0 <= x < i1 else _coverage(lines, x, y)


@numba.njit(cache=True, nogil=True)
def double(half: Any, out: Any) -> None:
    """Interpolate an image up to twice its size (or a row and column less): bilinear, edges held."""
    height, width = out.shape
    rows, columns = half.shape
    line = np.empty(columns + 2, np.float32)
    near, other = np.float32(0.75), np.float32(0.25)
    for y in range(height):
        j = y >> 1
        k = min(max(j + (1 if y & 1 else -1), 0), rows - 1)
        for i in range(columns):
            line[i + 1] = near * half[j, i] + other * half[k, i]
        line[0], line[columns + 1] = line[1], line[columns]
        row = out[y]
        for i in range(width // 2):
            row[2 * i] = near * line[i + 1] + other * line[i]
            row[2 * i + 1] = near * line[i + 1] + other * line[i + 2]
        if width & 1:
            row[width - 1] = near * line[columns] + other * line[columns - 1]


@numba.njit(cache=True, nogil=True)
def lit(dark0: Any, dark1: Any, lit0: Any, lit1: Any, share: float, added: Any, box: Any, out: Any) -> None:
    """Write a view between two shots with its lamps: u + ln(1 + sum m s), u and s on straight lines between the shots.

    The logarithm is ours so that a compiler can do several at once: x = 2^e y, 1 <= y < 2, z = (y - 1) / (y + 1),
    ln x = e ln 2 + 2 (z + z^3 / 3 + z^5 / 5 + z^7 / 7 + z^9 / 9), off by less than 2e-6.

    Args:
        dark0: (height, width) float32, u before.
        dark1: u after.
        lit0: (groups, height, width) float32, s before.
        lit1: s after.
        share: 0 to 1, of what is after.
        added: (groups,) float32, m.
        box: first row, last row + 1, first column, last column + 1 outside which all s are 0.
        out: (height, width) float32.
    """
    height, width = out.shape
    f, x0, x1 = np.float32(share), box[2], box[3]
    one, two = np.float32(1.0), np.float32(2.0)
    c3, c5, c7, c9 = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7), np.float32(1 / 9)
    ln2 = np.float32(math.log(2.0))
    total = np.empty(x1 - x0, np.float32)
    word = total.view(np.int32)
    power = np.empty(x1 - x0, np.float32)
    for y in range(height):
        before, after, row = dark0[y], dark1[y], out[y]
        for x in range(width):
            row[x] = before[x] + f * (after[x] - before[x])
        if not box[0] <= y < box[1]:
            continue
        total[:] = one
        for g in range(len(added)):
            m, s0, s1 = added[g], lit0[g, y, x0:x1], lit1[g, y, x0:x1]
            for k in range(x1 - x0):
                total[k] += m * (s0[k] + f * (s1[k] - s0[k]))
        for k in range(x1 - x0):
            power[k] = np.float32((word[k] >> np.int32(23)) - np.int32(127))
            word[k] = (word[k] & np.int32(0x7FFFFF)) | np.int32(0x3F800000)
        inner = row[x0:x1]
        for k in range(x1 - x0):
            z = (total[k] - one) / (total[k] + one)
            q = z * z
            inner[k] += power[k] * ln2 + two * z * (one + q * (c3 + q * (c5 + q * (c7 + q * c9))))
