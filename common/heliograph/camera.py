"""A camera file: from a pixel to a bearing, and from the camera to the body that carries it. Pure: text in, values out.

The file (TOML; see `deploy/sites/cameras/example.toml`)::

    [camera]      name, width, height (pixels)
    [intrinsics]  fx_px, fy_px, cx_px, cy_px, distortion = [k1, k2, p1, p2] or [k1, k2, p1, p2, k3]
    [mount]       quaternion = [w, x, y, z]  or  roll_deg, pitch_deg, yaw_deg;  translation_m = [x, y, z]

Frames. Camera: x to the right, y down, z forward along the axis; pixel (0, 0) has its centre at (0, 0). Body: whatever
the mount is given in (a drone's x forward, y right, z down, say); ``v_body = R v_camera + translation`` for points,
``v_body = R v_camera`` for directions, R = Rz(yaw) Ry(pitch) Rx(roll). No mount: R = 1, translation = 0.

Projection of a direction (X, Y, Z), Z > 0, by Brown and Conrady (D. C. Brown, "Close-range camera calibration", 1971;
coefficients in OpenCV's order)::

    x = X / Z, y = Y / Z, r2 = x^2 + y^2, radial = 1 + k1 r2 + k2 r2^2 + k3 r2^3
    xd = x radial + 2 p1 x y + p2 (r2 + 2 x^2)
    yd = y radial + p1 (r2 + 2 y^2) + 2 p2 x y
    x_px = fx xd + cx, y_px = fy yd + cy

The inverse has no closed form: Newton's iteration from (xd, yd), which converges also where the common fixed-point
iteration does not (strong k3). A file whose distortion does not invert all over the sensor is refused when it is read,
not when a beacon stands there.
"""

from __future__ import annotations

import math
import tomllib
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from heliograph.errors import ConfigError
from heliograph.messages import Name, Side

Vector = tuple[float, float, float]

_Focal = Annotated[float, Meta(gt=0.0, le=1e5)]
_Centre = Annotated[float, Meta(ge=-1e5, le=1e5)]
_Coefficient = Annotated[float, Meta(ge=-1e3, le=1e3)]
_Angle = Annotated[float, Meta(ge=-360.0, le=360.0)]
_Metres = Annotated[float, Meta(ge=-1e4, le=1e4)]

# Lenses in use converge to 1e-12 in 3 to 6 steps; thirty mean that it does not converge.
_ITERATIONS: Final = 30
_CONVERGED: Final = 1e-12
# A bearing that projects back this far from its pixel is wrong: a tenth of what the tracker resolves.
_ROUND_TRIP_PX: Final = 0.01
_CHECK_POINTS: Final = 9  # along each side of the sensor


class _Head(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    name: Name
    width: Side
    height: Side


class Intrinsics(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The lens: focal lengths, principal point and distortion, in pixels; see the module's equations."""

    fx_px: _Focal
    fy_px: _Focal
    cx_px: _Centre
    cy_px: _Centre
    distortion: tuple[_Coefficient, ...] = ()

    def __post_init__(self) -> None:
        if len(self.distortion) not in {0, 4, 5}:
            raise ValueError(f"distortion must have 0, 4 (k1 k2 p1 p2) or 5 (and k3) numbers, not {self.distortion}")

    def _distorted(self, x: float, y: float) -> tuple[float, float]:
        if not self.distortion:
            return x, y
        k1, k2, p1, p2 = self.distortion[:4]
        k3 = self.distortion[4] if len(self.distortion) > 4 else 0.0
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )

    def _undistorted(self, xd: float, yd: float) -> tuple[float, float]:
        x, y = xd, yd
        for _ in range(_ITERATIONS if self.distortion else 0):
            xn, yn = self._distorted(x, y)
            a, b, d = self._slopes(x, y)
            determinant = a * d - b * b
            if determinant == 0.0 or not math.isfinite(determinant):
                break
            ex, ey = xd - xn, yd - yn
            dx, dy = (d * ex - b * ey) / determinant, (a * ey - b * ex) / determinant
            x, y = x + dx, y + dy
            if abs(dx) + abs(dy) < _CONVERGED:
                break
        return x, y

    def _slopes(self, x: float, y: float) -> tuple[float, float, float]:
        """Return d xd / dx, d xd / dy = d yd / dx, and d yd / dy."""
        k1, k2, p1, p2 = self.distortion[:4]
        k3 = self.distortion[4] if len(self.distortion) > 4 else 0.0
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        twice = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d radial / dx = x twice
        return (
            radial + x * x * twice + 2.0 * p1 * y + 6.0 * p2 * x,
            x * y * twice + 2.0 * p1 * x + 2.0 * p2 * y,
            radial + y * y * twice + 6.0 * p1 * y + 2.0 * p2 * x,
        )

    def project(self, direction: Vector) -> tuple[float, float]:
        """Return the pixel (x_px, y_px) at which a direction in front of the camera is seen.

        Raises:
            ValueError: the direction lies behind the camera.
        """
        x, y, z = direction
        if not z > 0.0:
            raise ValueError(f"direction must lie before the camera (z > 0), not {direction}")
        xd, yd = self._distorted(x / z, y / z)
        return self.fx_px * xd + self.cx_px, self.fy_px * yd + self.cy_px

    def bearing(self, x_px: float, y_px: float) -> Vector:
        """Return the unit vector, in the camera's frame, towards what is seen at a pixel."""
        x, y = self._undistorted((x_px - self.cx_px) / self.fx_px, (y_px - self.cy_px) / self.fy_px)
        norm = math.sqrt(x * x + y * y + 1.0)
        if not math.isfinite(norm):
            return (0.0, 0.0, 1.0)  # far off the sensor, where the model says nothing
        return (x / norm, y / norm, 1.0 / norm)


class Mount(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the camera sits on its body: a rotation, given in one of two ways, and where it sits."""

    quaternion: tuple[float, float, float, float] | None = None
    roll_deg: _Angle | None = None
    pitch_deg: _Angle | None = None
    yaw_deg: _Angle | None = None
    translation_m: tuple[_Metres, _Metres, _Metres] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        angles = (self.roll_deg, self.pitch_deg, self.yaw_deg)
        if self.quaternion is not None:
            if any(angle is not None for angle in angles):
                raise ValueError("mount must give quaternion or roll_deg, pitch_deg, yaw_deg, not both")
            norm = math.sqrt(sum(q * q for q in self.quaternion))
            if not 0.99 <= norm <= 1.01:
                raise ValueError(f"mount quaternion [w, x, y, z] must have length 1 (0.99 to 1.01), not {norm:.4g}")

    def rotation(self) -> tuple[Vector, Vector, Vector]:
        """Return R of the module's equation, row by row."""
        w, x, y, z = self._unit_quaternion()
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )

    def _unit_quaternion(self) -> tuple[float, float, float, float]:
        if self.quaternion is not None:
            norm = math.sqrt(sum(q * q for q in self.quaternion))
            w, x, y, z = self.quaternion
            return w / norm, x / norm, y / norm, z / norm
        roll, pitch, yaw = (math.radians(a or 0.0) / 2 for a in (self.roll_deg, self.pitch_deg, self.yaw_deg))
        cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
        return (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )


class Camera(msgspec.Struct, frozen=True, kw_only=True):
    """A camera file, checked."""

    name: str
    width: int
    height: int
    intrinsics: Intrinsics
    mount: Mount

    def bearing(self, x_px: float, y_px: float) -> Vector:
        """Return the unit vector, in the camera's frame, towards what is seen at a pixel."""
        return self.intrinsics.bearing(x_px, y_px)

    def project(self, direction: Vector) -> tuple[float, float]:
        """Return the pixel at which a direction of the camera's frame is seen (`Intrinsics.project`)."""
        return self.intrinsics.project(direction)

    def in_body(self, direction: Vector) -> Vector:
        """Return a direction of the camera's frame in the body's frame."""
        x, y, z = direction
        a, b, c = self.mount.rotation()
        return (
            a[0] * x + a[1] * y + a[2] * z,
            b[0] * x + b[1] * y + b[2] * z,
            c[0] * x + c[1] * y + c[2] * z,
        )


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    camera: _Head
    intrinsics: Intrinsics
    mount: Mount = Mount()


def parse(text: str, origin: str = "camera file") -> Camera:
    """Return the camera of a camera file's text.

    Args:
        text: TOML.
        origin: what the error calls the text: its path.

    Raises:
        ConfigError: it is no TOML, a field is missing, unknown or out of range, or the distortion does not invert.
    """
    try:
        file = msgspec.convert(tomllib.loads(text), _File, strict=True)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, ValueError) as error:
        raise ConfigError(f"{origin}: {' '.join(str(error).split())}") from None
    camera = Camera(
        name=file.camera.name,
        width=file.camera.width,
        height=file.camera.height,
        intrinsics=file.intrinsics,
        mount=file.mount,
    )
    _check_inverse(camera, origin)
    return camera


def _check_inverse(camera: Camera, origin: str) -> None:
    for j in range(_CHECK_POINTS):
        for i in range(_CHECK_POINTS):
            x_px = (camera.width - 1) * i / (_CHECK_POINTS - 1)
            y_px = (camera.height - 1) * j / (_CHECK_POINTS - 1)
            back = camera.project(camera.bearing(x_px, y_px))
            if not math.hypot(back[0] - x_px, back[1] - y_px) <= _ROUND_TRIP_PX:
                raise ConfigError(
                    f"{origin}: distortion {list(camera.intrinsics.distortion)} cannot be undone at pixel"
                    f" ({x_px:g}, {y_px:g}): it comes back at ({back[0]:.3g}, {back[1]:.3g})"
                )
