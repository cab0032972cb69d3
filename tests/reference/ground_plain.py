"""The surroundings, rendered slowly and plainly: one ray a sub-pixel, point by point, averaged in linear light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def rays(projection: tuple[float, float, float], x: Floats, y: Floats, rotation: Floats) -> Floats:
    """Return (..., 3) rays in the world of pixels (x, y); projection is f, cx, cy."""
    f, cx, cy = projection
    camera = np.stack([(x - cx) / f, (y - cy) / f, np.ones_like(x)], axis=-1)
    return np.asarray(camera @ rotation)


def in_quad(x: Floats, y: Floats, corners: Floats) -> npt.NDArray[np.bool_]:
    """Return whether points lie within a convex quad given in turn."""
    sides = []
    for k in range(4):
        (x0, y0), (x1, y1) = corners[k, :2], corners[(k + 1) % 4, :2]
        sides.append((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0))
    signs = np.stack(sides)
    return np.asarray((signs >= 0).all(axis=0) | (signs <= 0).all(axis=0))


def render(
    projection: tuple[float, float, float],
    size: tuple[int, int],
    position: Floats,
    rotation: Floats,
    reflectance: Callable[[Floats, Floats], Floats],
    quads: list[tuple[Floats, float]],
    sky: float,
    sigma_px: float,
    samples: int = 15,
) -> Floats:
    """Return (height, width) mean reflectance under a Gaussian of sigma_px.

    `reflectance(x_m, y_m)` is the ground's; quads lie one above the other, the lowest first.
    """
    width, height = size
    span = np.linspace(-3.0 * sigma_px, 3.0 * sigma_px, samples)
    weight = np.exp(-0.5 * (span / sigma_px) ** 2)
    weight /= weight.sum()
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    total = np.zeros((height, width))
    for dy, wy in zip(span, weight, strict=True):
        for dx, wx in zip(span, weight, strict=True):
            ray = rays(projection, x + dx, y + dy, rotation)
            down = -ray[..., 2]
            with np.errstate(divide="ignore", invalid="ignore"):
                s = np.where(down > 0, position[2] / down, 0.0)
                value = np.where(
                    down > 0,
                    reflectance(position[0] + s * ray[..., 0], position[1] + s * ray[..., 1]),
                    sky,
                )
                for corners, rho in quads:
                    s = np.where(down > 0, (position[2] - corners[0, 2]) / down, np.nan)
                    hit = in_quad(position[0] + s * ray[..., 0], position[1] + s * ray[..., 1], corners)
                    value = np.where(hit, rho, value)
            total += wx * wy * value
    return total
