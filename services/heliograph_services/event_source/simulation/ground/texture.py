"""Textures of the ground, made of counter-based numbers: one seed, one ground.

A texture is a tile of SIZE x SIZE texels that covers TILE_GRAINS grains and repeats without a seam. Its pattern z has
mean 0 and standard deviation 1, and the reflectance is::

    rho = c exp(z ln(contrast) / 2),  |z| <= 3,  c such that the mean of rho is the reflectance asked for, rho <= 1

so that one standard deviation up and down are apart by the ratio `contrast`. Noise is value noise, the sum of octaves
``a_k n_k``: n_k has 16 2^k cells a tile (the coarsest: one a grain), a number at each corner, smooth between.

    asphalt   a_k = 1.25^k: grain down to the texel, most of it fine
    site      soil (a_k = .75^k), beds of gravel (fine noise within patches), planks, two ruts of a wheeled machine
    boards    boards of half a grain's width, each of its own brightness, dark joints, grain along them

The levels of detail are the mean reflectance under the filter (1 3 3 1) / 8 on each axis, at half the size each. The
patterns are assumed, made to be of several scales and to have edges; no measured surface was fitted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, cast

import numba
import numpy as np
import numpy.typing as npt

from heliograph_services.event_source.simulation.random import TEXTURE, normals, uniforms
from heliograph_services.event_source.simulation.random import warm as warm_random
from heliograph_services.event_source.simulation.world.spec import Ground

Image = npt.NDArray[np.float32]

BITS: Final = 11
SIZE: Final = 1 << BITS
# At grains of 1 m a texel of 8 mm: two thirds of a pixel of the 3.6 mm lens 5 m above the ground. At 5, 10, 20 and 28 m
# one level alone then suits a pixel, which is read twice as fast as two. A view of 45 m at 28 m shows three tiles.
TILE_GRAINS: Final = 16.0
_CELLS: Final = 16
_OCTAVES: Final = 7  # 16 2^6 = 1024 cells: the finest has 2 texels a cell
# Down to 2 x 2 texels, which differ by a hundredth; beyond, near the horizon, these are read.
_LEVELS: Final = BITS
_CLIP: Final = 3.0
_PLANKS: Final = 40


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A ground's reflectance.

    Args:
        levels: each (s, s) float32 reflectance, s = SIZE, SIZE / 2 ...
        tile_m: side of the square that they cover.
    """

    levels: tuple[Image, ...]
    tile_m: float

    @property
    def bits(self) -> int:
        """Level 0 has 2^bits texels a side."""
        return int(self.levels[0].shape[0]).bit_length() - 1

    def packed(self, gain: float, dark: float) -> tuple[Image, npt.NDArray[np.int64]]:
        """Return what `warp.render_ground` reads: ln(gain rho + dark) of all levels, and where each begins."""
        parts, bases, at = [], [], 0
        for level in self.levels:
            logs = np.log(level * np.float32(gain) + np.float32(dark))
            part = np.pad(logs, ((0, 1), (0, 1)), mode="wrap").reshape(-1)
            bases.append(at)
            at += part.size
            parts.append(part)
        return np.concatenate(parts), np.array(bases, np.int64)


def make_texture(ground: Ground, seed: int) -> Texture:
    """Return the texture of a ground; of a plain one, a tile of one value."""
    if ground.texture == "plain":
        return Texture((np.full((4, 4), ground.reflectance, np.float32),), TILE_GRAINS * ground.grain_m)
    pattern = {"asphalt": _asphalt, "site": _site, "boards": _boards}[ground.texture](seed)
    return Texture(_pyramid(_reflectances(pattern, ground)), TILE_GRAINS * ground.grain_m)


def _reflectances(pattern: Image, ground: Ground) -> Image:
    z = (pattern - pattern.mean()) / pattern.std()
    rho = np.exp(np.clip(z, -_CLIP, _CLIP) * np.float32(0.5 * math.log(ground.contrast)))
    rho *= np.float32(ground.reflectance / float(rho.mean(dtype=np.float64)))
    # What the bound of 1 takes from bright texels is missed by the mean; two rounds give it back to the others.
    for _ in range(2):
        np.minimum(rho, np.float32(1.0), out=rho)
        rho *= np.float32(ground.reflectance / float(rho.mean(dtype=np.float64)))
    return cast("Image", np.minimum(rho, np.float32(1.0)))


def _pyramid(finest: Image) -> tuple[Image, ...]:
    levels = [finest]
    for _ in range(_LEVELS - 1):
        levels.append(np.ascontiguousarray(_halved(np.ascontiguousarray(_halved(levels[-1]).T)).T))
    return tuple(levels)


def _halved(rows: Image) -> Image:
    """Return rows 2 i and 2 i + 1 as one, with a neighbour on each side: (1 3 3 1) / 8."""
    even, odd = rows[0::2], rows[1::2]
    near = np.float32(0.375) * (even + odd)
    near[1:] += np.float32(0.125) * odd[:-1]
    near[0] += np.float32(0.125) * odd[-1]
    near[:-1] += np.float32(0.125) * even[1:]
    near[-1] += np.float32(0.125) * even[0]
    return cast("Image", near)


@numba.njit(cache=True, nogil=True)
def _add_octave(corner: Any, weight: Any, out: Any) -> None:
    """Add weight times the value noise of (rows, columns) corners, wrapped round, to a square image."""
    size = len(out)
    rows, columns = corner.shape
    line = np.empty(columns + 1, np.float32)
    at, share = np.empty(size, np.int64), np.empty(size, np.float32)
    for x in range(size):
        u = (x + 0.5) * columns / size
        at[x] = int(u)
        f = u - at[x]
        share[x] = f * f * (3.0 - 2.0 * f)
    for y in range(size):
        v = (y + 0.5) * rows / size
        j = int(v)
        f = v - j
        s = np.float32(f * f * (3.0 - 2.0 * f))
        k = (j + 1) % rows
        for i in range(columns):
            line[i] = weight * (corner[j, i] + s * (corner[k, i] - corner[j, i]))
        line[columns] = line[0]
        for x in range(size):
            i = at[x]
            out[y, x] += line[i] + share[x] * (line[i + 1] - line[i])


def _corners(seed: int, layer: int, rows: int, columns: int) -> Image:
    """Return (rows, columns) numbers of mean 0 and variance 1, evenly spread: bounded, and quicker than normal ones."""
    draws = uniforms(seed, TEXTURE, layer, np.arange(rows)[:, None], np.arange(columns)[None, :])
    return ((draws - 0.5) * math.sqrt(12.0)).astype(np.float32)


def _noise(seed: int, layer: int, falloff: float, first: int = 0, last: int = _OCTAVES) -> Image:
    """Return the sum of octaves first to last - 1, the k-th with the weight falloff^k, scaled to about variance 1."""
    total = np.zeros((SIZE, SIZE), np.float32)
    power = 0.0
    for k in range(first, last):
        weight = falloff ** (k - first)
        _add_octave(_corners(seed, 16 * layer + k, _CELLS << k, _CELLS << k), np.float32(weight), total)
        power += weight * weight
    # Between its corners value noise has less variance than at them: 26/35 on each axis for the smoothstep.
    total /= np.float32(math.sqrt(power) * 26.0 / 35.0)
    return total


def _asphalt(seed: int) -> Image:
    return _noise(seed, 0, 1.25)


def _site(seed: int) -> Image:
    soil = _noise(seed, 0, 0.75)
    bed = _noise(seed, 1, 0.5, 0, 3)
    gravel = np.clip((bed - np.float32(0.6)) * np.float32(4.0), 0.0, 1.0)
    pattern = soil + gravel * (np.float32(0.8) + np.float32(1.2) * _noise(seed, 2, 1.0, 4) - soil * np.float32(0.5))
    _add_ruts(pattern, seed)
    _add_planks(pattern, seed)
    return cast("Image", pattern)


def _add_ruts(pattern: Image, seed: int) -> None:
    """Press two ruts, 1.6 grains apart, with the bars of a tyre, across the tile."""
    x = np.arange(SIZE, dtype=np.float32)
    texels = SIZE / TILE_GRAINS
    phase, offset = uniforms(seed, TEXTURE, 900, np.arange(2))
    middle = SIZE * offset + 1.5 * texels * np.sin(2.0 * math.pi * (x / SIZE + phase))
    bars = np.where((np.arange(SIZE) // int(0.08 * texels)) % 2 == 0, -1.4, -0.5)
    reach = int(0.2 * texels)
    for side in (-0.8, 0.8):
        for k in range(-reach, reach + 1):
            row = np.floor(middle + side * texels + k).astype(np.int64) % SIZE
            pattern[row, np.arange(SIZE)] += bars.astype(np.float32)


def _add_planks(pattern: Image, seed: int) -> None:
    """Lay planks about: 1 to 4 grains long, an eighth of a grain to a quarter wide, at any angle."""
    texels = SIZE / TILE_GRAINS
    draws = uniforms(seed, TEXTURE, 901, np.arange(_PLANKS)[:, None], np.arange(6)[None, :])
    for x0, y0, angle, length, width, tone in draws:
        half_l, half_w = (0.5 + 1.5 * length) * texels, (0.0625 + 0.0625 * width) * texels
        reach = int(half_l + half_w) + 1
        span = np.arange(-reach, reach + 1, dtype=np.float32)
        c, s = math.cos(math.pi * angle), math.sin(math.pi * angle)
        along, across = span[None, :] * c + span[:, None] * s, span[:, None] * c - span[None, :] * s
        rows, columns = np.nonzero((np.abs(along) <= half_l) & (np.abs(across) <= half_w))
        shade = 1.5 + 1.5 * tone
        pattern[(rows - reach + int(y0 * SIZE)) % SIZE, (columns - reach + int(x0 * SIZE)) % SIZE] = shade


def _boards(seed: int) -> Image:
    rows, pieces = 2 * _CELLS, _CELLS // 4
    y = np.arange(SIZE)
    board = y * rows // SIZE
    in_board = (y + 0.5) * rows / SIZE - board
    begin = uniforms(seed, TEXTURE, 902, np.arange(rows))
    along = (np.arange(SIZE)[None, :] / SIZE + begin[board][:, None]) * pieces
    piece = np.floor(along).astype(np.int64) % pieces
    shade = normals(seed, TEXTURE, 903, np.arange(rows)[:, None], np.arange(pieces)[None, :])
    pattern = shade[board[:, None], piece].astype(np.float32)
    # Wood grows in lines: long cells along the board, short ones across.
    _add_octave(_corners(seed, 904, SIZE // 4, _CELLS), np.float32(0.4), pattern)
    joint = (in_board[:, None] < 0.06) | (np.mod(along, 1.0) < 0.004)
    pattern[joint] = -3.0
    return pattern


def warm() -> None:
    """Compile the kernel, or load it from the cache."""
    warm_random()
    _add_octave(np.zeros((1, 1), np.float32), np.float32(0.0), np.zeros((2, 2), np.float32))
