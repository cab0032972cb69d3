"""Constant-velocity Kalman filters, many at once, the two axes apart.

Per axis, with white acceleration of spectral density q (px^2/s^3)::

    predict   x += v dt       P_xx += 2 dt P_xv + dt^2 P_vv + q dt^3 / 3
                              P_xv += dt P_vv + q dt^2 / 2
                              P_vv += q dt
    update    S = P_xx + r,  K = (P_xx, P_xv) / S
              (x, v) += K (z - x)
              P_xx = P_xx r / S,  P_xv = P_xv r / S,  P_vv -= P_xv^2 / S      (P_xv from before)

These are the textbook's equations written out (filterpy's are the oracle in the tests). The noise of two steps adds up
to the noise of their sum, so that silent windows need no step. Rows: state (x, y, v_x, v_y), covariance
(P_xx, P_xv, P_vv of x, then of y).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.jit import kernel

Floats = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]


@kernel
def predict(state: Floats, cov: Floats, dt_s: float, q: float) -> None:
    """Move all filters forward in place.

    Args:
        state: (n, 4) float64.
        cov: (n, 6) float64.
        dt_s: seconds.
        q: density of the acceleration, px^2/s^3.
    """
    for i in range(len(state)):
        for a in range(2):
            state[i, a] += dt_s * state[i, 2 + a]
            b = 3 * a
            cov[i, b] += dt_s * (2 * cov[i, b + 1] + dt_s * cov[i, b + 2]) + q * dt_s * dt_s * dt_s / 3
            cov[i, b + 1] += dt_s * cov[i, b + 2] + q * dt_s * dt_s / 2
            cov[i, b + 2] += q * dt_s


@kernel
def update(state: Floats, cov: Floats, rows: Rows, z: Floats, r: Floats, max_speed_px_s: float) -> None:
    """Correct the filters of some rows in place.

    Args:
        state: (n, 4) float64.
        cov: (n, 6) float64.
        rows: (k,) int64, distinct.
        z: (k, 2) float64, measured positions, pixels.
        r: (k, 2) float64, their variances.
        max_speed_px_s: longer velocities are cut to it.
    """
    for k in range(len(rows)):
        i = rows[k]
        for a in range(2):
            b = 3 * a
            pxx, pxv = cov[i, b], cov[i, b + 1]
            s = pxx + r[k, a]
            innovation = z[k, a] - state[i, a]
            state[i, a] += pxx / s * innovation
            state[i, 2 + a] += pxv / s * innovation
            cov[i, b] = pxx * r[k, a] / s
            cov[i, b + 1] = pxv * r[k, a] / s
            cov[i, b + 2] -= pxv * pxv / s
        speed = np.sqrt(state[i, 2] ** 2 + state[i, 3] ** 2)
        if speed > max_speed_px_s:
            state[i, 2] *= max_speed_px_s / speed
            state[i, 3] *= max_speed_px_s / speed
