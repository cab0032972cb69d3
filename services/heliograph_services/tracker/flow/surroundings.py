"""The motion of the whole view, robustly: how the surroundings carry what stands still in them.

Over the samples i at (x_i, y_i), with u_i and v_i the direction and speed of a sample, and the model, about the image's
centre (the camera pans, rolls and nears)::

    V(x, y) = (a - omega dy + z dx,  b + omega dx + z dy)

    minimise  sum_i w_i rho( u_i . V(x_i, y_i) - v_i )  +  ACROSS sum_i w_i (n_i . V(x_i, y_i))^2       n_i across u_i

A straight front shows only its motion across itself, so only that is asked of the model: fronts of several directions
together fix all of it. The second sum is weak, and holds what no front has seen. rho is Tukey's, scaled by the median
of the residuals and solved by re-weighting, so that beacons and others that move on their own do not count, as long as
they are the minority.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

# A perpendicular motion as large as the one seen is held against it as much as a residual of a seventh of it.
ACROSS: Final = 0.02
# Fewer samples than parameters by four say nothing.
SAMPLES_LEAST: Final = 16
# Evidence that makes a confidence of one half, ten times that of one place (`local`): noise of 5 Mev/s has a tenth.
EVIDENCE_HALF: Final = 4.0
ROUNDS: Final = 12
# Tukey's constant for 95 % efficiency, in standard deviations; and that of the median of absolute values.
TUKEY: Final = 4.685
MAD: Final = 1.4826
# The scale of residuals never falls below this share of the median speed: timing is rounded to ticks.
SCALE_LEAST: Final = 0.05
# A round that moves no parameter by more than this share of the least scale is the last.
SETTLED: Final = 0.1
# Rotation and zoom are held where the samples' places do not tell them from a translation, rad^2/s^2 in px^2.
TURN_PRIOR: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Motion:
    """The fitted motion; `at` gives it at a place.

    Args:
        vx_px_s: of the image's centre.
        vy_px_s: of the image's centre.
        omega_rad_s: roll, from +x towards +y.
        zoom_s: growth, 1/s.
        x_px: the image's centre.
        y_px: the image's centre.
        confidence: 0 to 1: the weight of the samples that agree over that of all, times how much evidence there is.
        samples: how many there were.
    """

    vx_px_s: float
    vy_px_s: float
    omega_rad_s: float
    zoom_s: float
    x_px: float
    y_px: float
    confidence: float
    samples: int

    def at(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return (vx, vy) at a place, px/s."""
        dx, dy = x_px - self.x_px, y_px - self.y_px
        return (
            self.vx_px_s - self.omega_rad_s * dy + self.zoom_s * dx,
            self.vy_px_s + self.omega_rad_s * dx + self.zoom_s * dy,
        )

    def along(self, x_px: Floats, y_px: Floats) -> tuple[Floats, Floats]:
        """Return (n,) vx and vy at (n,) places, px/s."""
        dx, dy = x_px - self.x_px, y_px - self.y_px
        return (
            self.vx_px_s - self.omega_rad_s * dy + self.zoom_s * dx,
            self.vy_px_s + self.omega_rad_s * dx + self.zoom_s * dy,
        )


def fit_motion(
    samples: tuple[Floats, Floats, Floats, Floats, Floats],
    centre_x_px: float,
    centre_y_px: float,
    start: Motion | None = None,
) -> Motion | None:
    """Return the motion that most samples share, or None if they are too few.

    Args:
        samples: (n,) each: x and y of the places in px, vx and vy across the fronts there in px/s, not both 0, and
            the weights, above 0.
        centre_x_px: the image's centre.
        centre_y_px: the image's centre.
        start: where to begin, of the same centre; without it all samples count alike at first.
    """
    x_px, y_px, vx_px_s, vy_px_s, weight = samples
    n = len(x_px)
    if n < SAMPLES_LEAST:
        return None
    speed = np.hypot(vx_px_s, vy_px_s)
    ux, uy = vx_px_s / speed, vy_px_s / speed
    # Places in units of their spread: the four parameters are then alike.
    dx, dy = x_px - centre_x_px, y_px - centre_y_px
    spread = max(1.0, float(np.sqrt(np.mean(dx**2 + dy**2))))
    along = _rows(ux, uy, dx / spread, dy / spread)
    across = _rows(-uy, ux, dx / spread, dy / spread)
    least = SCALE_LEAST * float(np.median(speed))
    share = weight / weight.sum()
    robust = np.ones(n)
    p, residual = np.zeros(4), np.zeros(n)
    if start is not None:
        p = np.array([start.vx_px_s, start.vy_px_s, start.omega_rad_s * spread, start.zoom_s * spread])
        residual, robust = _weighed(along @ p - speed, share, least)
    for _ in range(ROUNDS):
        w = share * robust
        normal = (along * w[:, None]).T @ along + ACROSS * (across * w[:, None]).T @ across
        normal += np.diag([1e-9, 1e-9, TURN_PRIOR, TURN_PRIOR])
        before, p = p, np.linalg.solve(normal, along.T @ (w * speed))
        residual, robust = _weighed(along @ p - speed, share, least)
        if not robust.any():
            return None
        if np.abs(p - before).max() < SETTLED * least:
            break
    agrees = float(share @ (np.abs(residual) <= 2 * np.maximum(least, 0.1 * speed)))
    evidence = float(weight.sum())
    confidence = agrees * evidence / (evidence + EVIDENCE_HALF)
    return Motion(
        float(p[0]), float(p[1]), float(p[2] / spread), float(p[3] / spread), centre_x_px, centre_y_px, confidence, n
    )


def _weighed(residual: Floats, share: Floats, least: float) -> tuple[Floats, Floats]:
    """Return the residuals, and Tukey's weights at their own scale."""
    scale = max(least, MAD * _weighted_median(np.abs(residual), share))
    return residual, np.clip(1 - (residual / (TUKEY * scale)) ** 2, 0, None) ** 2


def _rows(ux: Floats, uy: Floats, dx: Floats, dy: Floats) -> Floats:
    """Return (n, 4): the share of a, b, omega and z in the motion along (ux, uy) at (dx, dy)."""
    return np.stack([ux, uy, uy * dx - ux * dy, ux * dx + uy * dy], axis=1)


def _weighted_median(value: Floats, weight: Floats) -> float:
    order = np.argsort(value, kind="stable")
    total = np.cumsum(weight[order])
    return float(value[order][np.searchsorted(total, total[-1] / 2)])
