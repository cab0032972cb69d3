"""How a beacon moves over the sensor: data of a scenario, and its position at any time.

Kinds (`kind` in the file): "still"; "sine", for each axis ``x(t) = x_px + a sin(2 pi t / period + phase)``;
"waypoints", straight lines between (t_s, x_px, y_px), begun anew after the last (it should be where the first is).
Pixel (0, 0) has its centre at (0, 0).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from heliograph.events import Times
from heliograph.messages import SENSOR_LIMIT_PX
from heliograph.units import US_PER_S

Floats = npt.NDArray[np.float64]
_Pixel = Annotated[float, Meta(ge=-SENSOR_LIMIT_PX, le=2 * SENSOR_LIMIT_PX)]
_Amplitude = Annotated[float, Meta(ge=0.0, le=SENSOR_LIMIT_PX)]
_Period = Annotated[float, Meta(ge=0.01, le=1e5)]
_Degrees = Annotated[float, Meta(ge=-360.0, le=360.0)]


class Still(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="still"):
    """No motion."""

    x_px: _Pixel
    y_px: _Pixel

    def at(self, t_us: Times | Floats) -> tuple[Floats, Floats]:
        """Return (n,) float64 x_px and y_px at the times."""
        return np.full(len(t_us), self.x_px, np.float64), np.full(len(t_us), self.y_px, np.float64)

    def speed_px_s(self) -> float:
        """Return the highest speed."""
        return 0.0


class Sine(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="sine"):
    """To and fro on both axes: lines, ellipses and Lissajous figures about (x_px, y_px)."""

    x_px: _Pixel
    y_px: _Pixel
    x_amplitude_px: _Amplitude
    y_amplitude_px: _Amplitude
    x_period_s: _Period
    y_period_s: _Period
    x_phase_deg: _Degrees = 0.0
    y_phase_deg: _Degrees = 0.0

    def at(self, t_us: Times | Floats) -> tuple[Floats, Floats]:
        """Return (n,) float64 x_px and y_px at the times."""
        turns = np.asarray(t_us, np.float64) * (2.0 * np.pi / US_PER_S)
        x = self.x_px + self.x_amplitude_px * np.sin(turns / self.x_period_s + np.radians(self.x_phase_deg))
        y = self.y_px + self.y_amplitude_px * np.sin(turns / self.y_period_s + np.radians(self.y_phase_deg))
        return x, y

    def speed_px_s(self) -> float:
        """Return a bound of the speed."""
        return float(
            2.0 * np.pi * np.hypot(self.x_amplitude_px / self.x_period_s, self.y_amplitude_px / self.y_period_s)
        )


class Waypoints(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="waypoints"
):
    """Straight lines from point to point, at constant speed between two, round after round."""

    points: Annotated[tuple[tuple[float, _Pixel, _Pixel], ...], Meta(min_length=2, max_length=10_000)]

    def __post_init__(self) -> None:
        times = [point[0] for point in self.points]
        if times[0] != 0.0 or any(b <= a for a, b in pairwise(times)):
            raise ValueError(f"waypoints must begin at 0 s and rise in time, not {times[:5]}")

    def at(self, t_us: Times | Floats) -> tuple[Floats, Floats]:
        """Return (n,) float64 x_px and y_px at the times."""
        t, x, y = np.asarray(self.points, np.float64).T
        t_s = np.mod(np.asarray(t_us, np.float64) / US_PER_S, t[-1])
        return np.interp(t_s, t, x), np.interp(t_s, t, y)

    def speed_px_s(self) -> float:
        """Return the highest speed."""
        t, x, y = np.asarray(self.points, np.float64).T
        return float(np.max(np.hypot(np.diff(x), np.diff(y)) / np.diff(t)))


Path = Still | Sine | Waypoints
