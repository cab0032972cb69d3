"""Constant-velocity Kalman filters, many at once, the two axes apart.

Per axis, with white acceleration of spectral density q (px^2/s^3)::

    predict   x += v dt       P_xx += 2 dt P_xv + dt^2 P_vv + q dt^3 / 3
                              P_xv += dt P_vv + q dt^2 / 2
                              P_vv += q dt
    update    c = (P_xx + d P_xv, P_xv + d P_vv),  S = c_x + d c_v + r,  K = c / S
              (x, v) += K (z - x - d v)
              P -= c c' / S

with z measured at the time d from that of the state (H = (1, d)), as far as the acceleration within d is noise of z. A
measured velocity is a second such step, with H = (0, 1).

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


def predict(state: Floats, cov: Floats, dt_s: float, q: float | Floats) -> None:
    """Move all filters forward in place.

    Args:
        state: (n, 4) float64.
        cov: (n, 6) float64.
        dt_s: seconds.
        q: density of the acceleration, px^2/s^3; (n,) float64, or of all.
    """
    _predict(state, cov, dt_s, densities(q, len(state)))


def update(
    state: Floats,
    cov: Floats,
    rows: Rows,
    z: Floats,
    r: Floats,
    max_speed_px_s: float,
    dt_s: Floats | None = None,
    v: Floats | None = None,
    v_var: Floats | None = None,
) -> None:
    """Correct the filters of some rows in place.

    Args:
        state: (n, 4) float64.
        cov: (n, 6) float64.
        rows: (k,) int64, distinct.
        z: (k, 2) float64, measured positions, pixels.
        r: (k, 2) float64, their variances.
        max_speed_px_s: longer velocities are cut to it.
        dt_s: (k,) float64, when they were measured, from the time of the state, seconds; None: all at that time.
        v: (k, 2) float64, measured velocities, px/s; None: none.
        v_var: (k,) float64, their variance on each axis, inf where there is none.
    """
    if dt_s is None:
        dt_s = np.zeros(len(rows))
    if v is None or v_var is None:
        v, v_var = np.zeros((len(rows), 2)), np.full(len(rows), np.inf)
    _update(state, cov, rows, z, r, max_speed_px_s, dt_s, v, v_var)


def densities(q: float | Floats, n: int) -> Floats:
    """Return (n,) float64, each row's density."""
    return np.full(n, q, np.float64) if isinstance(q, float) else q


@kernel
def _predict(state: Floats, cov: Floats, dt_s: float, density: Floats) -> None:
    for i in range(len(state)):
        q = density[i]
        for a in range(2):
            state[i, a] += dt_s * state[i, 2 + a]
            b = 3 * a
            cov[i, b] += dt_s * (2 * cov[i, b + 1] + dt_s * cov[i, b + 2]) + q * dt_s * dt_s * dt_s / 3
            cov[i, b + 1] += dt_s * cov[i, b + 2] + q * dt_s * dt_s / 2
            cov[i, b + 2] += q * dt_s


@kernel
def _update(
    state: Floats,
    cov: Floats,
    rows: Rows,
    z: Floats,
    r: Floats,
    max_speed_px_s: float,
    dt_s: Floats,
    v: Floats,
    v_var: Floats,
) -> None:
    for k in range(len(rows)):
        i = rows[k]
        for a in range(2):
            b = 3 * a
            cx = cov[i, b] + dt_s[k] * cov[i, b + 1]
            cv = cov[i, b + 1] + dt_s[k] * cov[i, b + 2]
            s = cx + dt_s[k] * cv + r[k, a]
            innovation = z[k, a] - state[i, a] - dt_s[k] * state[i, 2 + a]
            state[i, a] += cx / s * innovation
            state[i, 2 + a] += cv / s * innovation
            cov[i, b] -= cx * cx / s
            cov[i, b + 1] -= cx * cv / s
            cov[i, b + 2] -= cv * cv / s
            if v_var[k] < np.inf:
                cx = cov[i, b + 1]
                cv = cov[i, b + 2]
                s = cv + v_var[k]
                innovation = v[k, a] - state[i, 2 + a]
                state[i, a] += cx / s * innovation
                state[i, 2 + a] += cv / s * innovation
                cov[i, b] -= cx * cx / s
                cov[i, b + 1] -= cx * cv / s
                cov[i, b + 2] -= cv * cv / s
        speed = np.sqrt(state[i, 2] ** 2 + state[i, 3] ** 2)
        if speed > max_speed_px_s:
            state[i, 2] *= max_speed_px_s / speed
            state[i, 3] *= max_speed_px_s / speed
