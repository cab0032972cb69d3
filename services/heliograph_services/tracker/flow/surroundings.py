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
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.jit import kernel

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
    dx, dy = dx / spread, dy / spread
    # The motion seen at each sample is a row times (a, b, omega, z); so is that across its front, with (-uy, ux).
    rows = np.stack([ux, uy, uy * dx - ux * dy, ux * dx + uy * dy])
    least = SCALE_LEAST * float(np.median(speed))
    share = weight / weight.sum()
    p = np.zeros(4)
    if start is not None:
        p[:] = start.vx_px_s, start.vy_px_s, start.omega_rad_s * spread, start.zoom_s * spread
    residual = np.empty(n)
    if not _solve(rows, speed, share, least, start is not None, p, residual, np.empty((2, n))):
        return None
    agrees = float(share @ (np.abs(residual) <= 2 * np.maximum(least, 0.1 * speed)))
    evidence = float(weight.sum())
    confidence = agrees * evidence / (evidence + EVIDENCE_HALF)
    return Motion(
        float(p[0]), float(p[1]), float(p[2] / spread), float(p[3] / spread), centre_x_px, centre_y_px, confidence, n
    )


@kernel
def _solve(
    rows: Any, speed: Floats, share: Floats, least: float, started: bool, p: Floats, residual: Floats, scratch: Any
) -> bool:
    """Refine p, (4,), in place by re-weighting until it settles; return False if no sample is left.

    Args:
        rows: (4, n), see `fit_motion`.
        speed: (n,).
        share: (n,) weights, of sum 1.
        least: smallest scale of the residuals.
        started: p is a motion to begin with; else all samples count alike at first.
        p: see above.
        residual: (n,), gets those of the last p.
        scratch: (2, n).
    """
    n = len(speed)
    robust = np.ones(n)
    if started:
        _weigh(rows, speed, share, least, p, residual, scratch, robust)
    normal = np.empty((4, 4))
    right = np.empty(4)
    across = np.empty(4)
    for _ in range(ROUNDS):
        normal[:] = 0.0
        right[:] = 0.0
        for i in range(n):
            w = share[i] * robust[i]
            if w == 0.0:
                continue
            across[0] = -rows[1, i]
            across[1] = rows[0, i]
            across[2] = rows[3, i]
            across[3] = -rows[2, i]
            for j in range(4):
                right[j] += w * rows[j, i] * speed[i]
                for k in range(j + 1):
                    normal[j, k] += w * (rows[j, i] * rows[k, i] + ACROSS * across[j] * across[k])
        for j in range(4):
            normal[j, j] += 1e-9 if j < 2 else TURN_PRIOR
        moved = _cholesky(normal, right, p)
        if not _weigh(rows, speed, share, least, p, residual, scratch, robust):
            return False
        if moved < SETTLED * least:
            break
    return True


@kernel
def _cholesky(a: Any, b: Floats, x: Floats) -> float:
    """Solve a x = b, of which the lower triangle is given and lost; return the largest change of x."""
    n = len(b)
    for j in range(n):
        for k in range(j):
            a[j, j] -= a[j, k] * a[j, k]
        a[j, j] = np.sqrt(a[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                a[i, j] -= a[i, k] * a[j, k]
            a[i, j] /= a[j, j]
        for k in range(j):
            b[j] -= a[j, k] * b[k]
        b[j] /= a[j, j]
    moved = 0.0
    for j in range(n - 1, -1, -1):
        for k in range(j + 1, n):
            b[j] -= a[k, j] * b[k]
        b[j] /= a[j, j]
        moved = max(moved, abs(b[j] - x[j]))
        x[j] = b[j]
    return moved


@kernel
def _weigh(
    rows: Any, speed: Floats, share: Floats, least: float, p: Floats, residual: Floats, scratch: Any, robust: Floats
) -> bool:
    """Fill the residuals of p, and Tukey's weights at their own scale; return whether any is left."""
    n = len(speed)
    for i in range(n):
        residual[i] = rows[0, i] * p[0] + rows[1, i] * p[1] + rows[2, i] * p[2] + rows[3, i] * p[3] - speed[i]
        scratch[0, i] = abs(residual[i])
        scratch[1, i] = share[i]
    bound = TUKEY * max(least, MAD * _weighted_median(scratch[0], scratch[1]))
    left = False
    for i in range(n):
        inside = max(0.0, 1.0 - (residual[i] / bound) ** 2)
        robust[i] = inside * inside
        left |= inside > 0.0
    return left


@kernel
def _weighted_median(value: Floats, weight: Floats) -> float:
    """Return the least value that, with all below it, has half of the weight; both arrays are lost (quickselect)."""
    half = weight.sum() / 2
    low = 0
    high = len(value)
    while high - low > 1:
        a = value[low]
        b = value[(low + high) // 2]
        c = value[high - 1]
        pivot = max(min(a, b), min(max(a, b), c))
        below = 0.0
        equal = 0.0
        less = low
        more = high
        i = low
        while i < more:
            v = value[i]
            w = weight[i]
            if v < pivot:
                value[i], weight[i] = value[less], weight[less]
                value[less], weight[less] = v, w
                below += w
                less += 1
                i += 1
            elif v > pivot:
                more -= 1
                value[i], weight[i] = value[more], weight[more]
                value[more], weight[more] = v, w
            else:
                equal += w
                i += 1
        if below >= half and less > low:
            high = less
        elif below + equal >= half or more == high:
            return float(pivot)
        else:
            half -= below + equal
            low = more
    return float(value[low])
