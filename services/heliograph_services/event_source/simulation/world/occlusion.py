"""What stands between the camera and a light.

An asset hides with its top, a horizontal rectangle of sizes (a, b) at the height h, centre c, turned by the heading g
(clockwise seen from above)::

    right = (cos g, -sin g),  ahead = (sin g, cos g)         the asset's own x and y
    q     = C + s (L - C), s = (C_z - h) / (C_z - L_z)       where the way from the camera C to the light L meets h
    hidden where 0 < s < 1, |(q - c) right| <= a / 2, |(q - c) ahead| <= b / 2

An asset never hides a light that it carries. Nothing else hides: beacons and clutter are too small, the ground is
below them all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags
from heliograph_services.event_source.simulation.contract import Floats, Ints
from heliograph_services.event_source.simulation.world.spec import Asset


class Tops:
    """The tops of the assets.

    Args:
        assets: k of them.
    """

    def __init__(self, assets: Sequence[Asset]) -> None:
        self.count = len(assets)
        self._half = np.array([asset.size_m for asset in assets], np.float64).reshape(-1, 2) / 2.0
        heading = np.radians(np.array([asset.heading_deg for asset in assets], np.float64))
        self._right = np.column_stack([np.cos(heading), -np.sin(heading)])
        self._ahead = np.column_stack([np.sin(heading), np.cos(heading)])

    def corners(self, centre: Floats) -> Floats:
        """Return (k, 4, 3) corners, in turn around each rectangle, of tops centred at (k, 3)."""
        signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
        u = signs[None, :, :] * self._half[:, None, :]
        places = np.repeat(centre[:, None, :], 4, axis=1)
        places[..., :2] += u[..., :1] * self._right[:, None, :] + u[..., 1:] * self._ahead[:, None, :]
        return places

    def hides(self, camera: Floats, centre: Floats, lights: Floats, carrier: Ints) -> npt.NDArray[np.bool_]:
        """Return which lights cannot be seen.

        Args:
            camera: (n, 3) m.
            centre: (k, n, 3) m, of the tops.
            lights: (m, n, 3) m.
            carrier: (m,) int64, the asset that carries a light; -1 for none.

        Returns:
            (m, n) bool.
        """
        hidden: Flags = np.zeros(lights.shape[:2], np.bool_)
        cx, cy, cz = camera[:, 0], camera[:, 1], camera[:, 2]
        dx, dy, drop = lights[..., 0] - cx, lights[..., 1] - cy, cz - lights[..., 2]
        level = np.abs(drop) < 1e-12  # a light at the camera's height: its way meets no other height
        drop = np.where(level, 1.0, drop)
        for i in range(self.count):
            s = (cz - centre[i, :, 2]) / drop
            qx, qy = cx - centre[i, :, 0] + s * dx, cy - centre[i, :, 1] + s * dy
            (rx, ry), (ax, ay), (a, b) = self._right[i], self._ahead[i], self._half[i]
            inside = (np.abs(rx * qx + ry * qy) <= a) & (np.abs(ax * qx + ay * qy) <= b)
            hidden |= inside & (s > 0.0) & (s < 1.0) & ~level & (carrier != i)[:, None]
        return hidden


def turned(offset: Sequence[float], heading_deg: float) -> tuple[float, float, float]:
    """Return an offset in an asset's own directions as one in the world."""
    g = math.radians(heading_deg)
    x, y, z = offset
    return (x * math.cos(g) + y * math.sin(g), -x * math.sin(g) + y * math.cos(g), z)
