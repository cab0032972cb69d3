"""From the world to pixels: a pinhole, principal point in the middle of the sensor, no distortion.

The camera's axes in the world (frames in `spec.py`), yaw w, pitch p, roll q::

    forward = (sin w cos p, cos w cos p, sin p),  r = (cos w, -sin w, 0),  d = forward x r
    right   = cos q r + sin q d,  down = forward x right

    (X, Y, Z) = R (world - camera), R's rows right, down, forward
    x = f X / Z + cx,  y = f Y / Z + cy,  f = focal / pitch,  cx = (width - 1) / 2,  cy = (height - 1) / 2

Pixel (0, 0) has its centre at (0, 0). A plane z = const, seen by the camera, is a homography of its x and y::

    Z (x, y, 1) = H (x_m, y_m, 1),  H = K [R_1, R_2, R_3 z - R c],  K = [[f, 0, cx], [0, f, cy], [0, 0, 1]]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.camera import Intrinsics
from heliograph_services.event_source.simulation.contract import Floats


@dataclass(frozen=True, slots=True)
class Projection:
    """A lens before a sensor.

    Args:
        f_px: focal length in pixels.
        width: of the sensor, px.
        height: of the sensor, px.
    """

    f_px: float
    width: int
    height: int

    @property
    def cx_px(self) -> float:
        """The principal point's column."""
        return (self.width - 1) / 2.0

    @property
    def cy_px(self) -> float:
        """The principal point's row."""
        return (self.height - 1) / 2.0

    @property
    def intrinsics(self) -> Intrinsics:
        """What a camera file says of this lens."""
        return Intrinsics(fx_px=self.f_px, fy_px=self.f_px, cx_px=self.cx_px, cy_px=self.cy_px)

    def matrix(self) -> Floats:
        """Return K, (3, 3) float64."""
        return np.array([[self.f_px, 0.0, self.cx_px], [0.0, self.f_px, self.cy_px], [0.0, 0.0, 1.0]])

    def pixels(self, position: Floats, rotation: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Project points, each at its own time.

        Args:
            position: (n, 3) of the camera, m.
            rotation: (n, 3, 3), from the world to the camera.
            points: (..., n, 3), m.

        Returns:
            x_px, y_px and depth_m (Z), (..., n) float64 each; behind the camera (depth_m <= 0) the pixels say nothing,
            but are finite.
        """
        ray = points - position
        x, y, z = ray[..., 0], ray[..., 1], ray[..., 2]
        r = rotation
        depth = r[:, 2, 0] * x + r[:, 2, 1] * y + r[:, 2, 2] * z
        scale = self.f_px / np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        x_px = (r[:, 0, 0] * x + r[:, 0, 1] * y + r[:, 0, 2] * z) * scale + self.cx_px
        y_px = (r[:, 1, 0] * x + r[:, 1, 1] * y + r[:, 1, 2] * z) * scale + self.cy_px
        return x_px, y_px, depth

    def plane_homography(self, position: Floats, rotation: Floats, z_m: float = 0.0) -> Floats:
        """Return H of the plane z = z_m for one pose, (3, 3) float64.

        Args:
            position: (3,) of the camera, m.
            rotation: (3, 3), from the world to the camera.
            z_m: height of the plane.
        """
        last = rotation @ (np.array([0.0, 0.0, z_m]) - position)
        return self.matrix() @ np.column_stack([rotation[:, 0], rotation[:, 1], last])

    def on_sensor(self, x_px: Floats, y_px: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Return whether points lie on a pixel, each half a pixel about its centre."""
        return (x_px >= -0.5) & (x_px < self.width - 0.5) & (y_px >= -0.5) & (y_px < self.height - 0.5)


def rotations(angles: Floats) -> Floats:
    """Return (n, 3, 3) float64 from the world to the camera, of (n, 3) yaw, pitch, roll in rad."""
    (sw, sp, sq), (cw, cp, cq) = np.sin(angles).T, np.cos(angles).T
    zero = np.zeros_like(sw)
    forward = np.stack([sw * cp, cw * cp, sp], axis=1)
    level = np.stack([cw, -sw, zero], axis=1)
    d = np.cross(forward, level)
    right = cq[:, None] * level + sq[:, None] * d
    return np.stack([right, np.cross(forward, right), forward], axis=1)
