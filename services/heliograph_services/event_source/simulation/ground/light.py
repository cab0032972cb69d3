"""Lights on an image: what their discs add to each pixel over an exposure.

Pixel (i, j) sees ``flux <level> wx(i) wy(j)`` of a light (`contract`), <level> being its mean level while the image is
taken. An exposure is cut at the nodes of motion; in each part the image of a light stays where it is in the middle.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numba

# A Gaussian image ends here for an 8 bit picture: beyond 4 sigma lie 6e-5 of its light.
_ENDS_SIGMA: Final = 4.0
_SQRT1_2: Final = math.sqrt(0.5)


@numba.njit(cache=True, nogil=True)
def _mean_level(level: float, edge_us: Any, edge_level: Any, a_us: float, b_us: float) -> float:
    """Return the mean level over [a_us, b_us), or the level at a_us where both are the same."""
    total, at_us = 0.0, a_us
    for k in range(len(edge_us)):
        if edge_us[k] > at_us:
            if edge_us[k] >= b_us:
                break
            total += level * (edge_us[k] - at_us)
            at_us = edge_us[k]
        level = edge_level[k]
    if b_us <= a_us:
        return level
    return (total + level * (b_us - at_us)) / (b_us - a_us)


@numba.njit(cache=True, nogil=True)
def _weight(i: int, x: float, sigma: float) -> float:
    scale = _SQRT1_2 / sigma
    return 0.5 * (math.erf((i + 0.5 - x) * scale) - math.erf((i - 0.5 - x) * scale))


@numba.njit(cache=True, nogil=True)
def _add_disc(x: float, y: float, sigma: float, flux: float, light: int, out: Any, most: Any, owner: Any) -> None:
    height, width = out.shape
    reach = _ENDS_SIGMA * sigma + 0.5
    x0, x1 = max(0, math.ceil(x - reach)), min(width - 1, math.floor(x + reach))
    y0, y1 = max(0, math.ceil(y - reach)), min(height - 1, math.floor(y + reach))
    for j in range(y0, y1 + 1):
        row = flux * _weight(j, y, sigma)
        for i in range(x0, x1 + 1):
            light_w_m2 = row * _weight(i, x, sigma)
            out[j, i] += light_w_m2
            if light_w_m2 > most[j, i]:
                most[j, i] = light_w_m2
                owner[j, i] = light


@numba.njit(cache=True, nogil=True)
def add_lights(
    t0_us: float,
    node_us: float,
    x_px: Any,
    y_px: Any,
    sigma_px: Any,
    flux_w_m2: Any,
    level0: Any,
    edge_first: Any,
    edge_us: Any,
    edge_level: Any,
    a_us: float,
    b_us: float,
    exposure_us: float,
    out: Any,
    most: Any,
    owner: Any,
) -> None:
    """Add the mean light over [a_us, b_us], which lies in one chunk, as its part of an exposure.

    Args:
        t0_us: of the chunk; the arrays are those of `contract.LightChunk`.
        node_us: NODE_US.
        x_px: of the chunk.
        y_px: of the chunk.
        sigma_px: of the chunk.
        flux_w_m2: of the chunk.
        level0: of the chunk.
        edge_first: of the chunk.
        edge_us: of the chunk.
        edge_level: of the chunk.
        a_us: begin.
        b_us: end; the same for an instant.
        exposure_us: of the whole image; 0 for an instant.
        out: (height, width) float64, W/m2, to which the light is added.
        most: (height, width) float64, the most that a single light has added at once.
        owner: (height, width) int16, which light that was.
    """
    last = x_px.shape[1] - 2
    first_node = min(last, int((a_us - t0_us) / node_us))
    for light in range(len(x_px)):
        e0, e1 = edge_first[light], edge_first[light + 1]
        for k in range(first_node, last + 1):
            s_us, e_us = max(a_us, t0_us + k * node_us), min(b_us, t0_us + (k + 1) * node_us)
            if s_us > b_us or (s_us >= e_us and exposure_us > 0.0):
                break
            f = (0.5 * (s_us + e_us) - t0_us) / node_us - k
            flux = flux_w_m2[light, k] + f * (flux_w_m2[light, k + 1] - flux_w_m2[light, k])
            if flux > 0.0:
                level = _mean_level(level0[light], edge_us[e0:e1], edge_level[e0:e1], s_us, e_us)
                share = (e_us - s_us) / exposure_us if exposure_us > 0.0 else 1.0
                if level > 0.0:
                    _add_disc(
                        x_px[light, k] + f * (x_px[light, k + 1] - x_px[light, k]),
                        y_px[light, k] + f * (y_px[light, k + 1] - y_px[light, k]),
                        sigma_px[light, k] + f * (sigma_px[light, k + 1] - sigma_px[light, k]),
                        flux * level * share,
                        light,
                        out,
                        most,
                        owner,
                    )
            if exposure_us <= 0.0:
                break
