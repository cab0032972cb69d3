"""Kalman filters by filterpy, one after another, in the place of `tracker.kalman`: the same table, the same model.

The textbook's form, for x = (x, y, v_x, v_y) and z = (x, y)::

    predict   x = F x          P = F P F' + Q           F = I + dt E,  Q = q (dt^3/3, dt^2/2; dt^2/2, dt) per axis
    update    K = P H' (H P H' + R)^-1                  H = (I d I),   R = diag(r_x, r_y), z of the time d;
                                                        a measured velocity adds the rows (0 I)
              x += K (z - H x)
              P = (I - K H) P (I - K H)' + K R K'       filterpy's form

Rounding apart it equals the batched one, which keeps the two axes apart as they are independent here.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import predict as predicted
from filterpy.kalman import update as updated

from heliograph_services.tracker.kalman import Floats, Rows, densities

# Places in the 4 x 4 matrix of the table's columns (P_xx, P_xv, P_vv of x, then of y).
_ROW = np.array([0, 0, 2, 1, 1, 3])
_COLUMN = np.array([0, 2, 2, 1, 3, 3])
_H = np.eye(2, 4)


def predict(state: Floats, cov: Floats, dt_s: float, q: float | Floats) -> None:
    """Move all filters forward in place; arguments as in `tracker.kalman.predict`."""
    transition = np.eye(4) + dt_s * np.eye(4, k=2)
    noise = matrix(np.tile([dt_s**3 / 3, dt_s**2 / 2, dt_s], 2))
    for i, density in enumerate(densities(q, len(state))):
        state[i], p = predicted(state[i], matrix(cov[i]), F=transition, Q=density * noise)
        cov[i] = p[_ROW, _COLUMN]


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
    """Correct the filters of some rows in place; arguments as in `tracker.kalman.update`."""
    times_s = np.zeros(len(rows)) if dt_s is None else dt_s
    for k, i in enumerate(rows):
        h = _H + times_s[k] * np.eye(2, 4, k=2)
        if v is None or v_var is None or not np.isfinite(v_var[k]):
            x, p = updated(state[i], matrix(cov[i]), z[k], np.diag(r[k]), H=h)
        else:
            noise = np.diag([*r[k], v_var[k], v_var[k]])
            h = np.concatenate([h, np.eye(2, 4, k=2)])
            x, p = updated(state[i], matrix(cov[i]), np.concatenate([z[k], v[k]]), noise, H=h)
        speed = float(np.hypot(x[2], x[3]))
        if speed > max_speed_px_s:
            x[2:] *= max_speed_px_s / speed
        state[i] = x
        cov[i] = p[_ROW, _COLUMN]


def matrix(columns: Floats) -> Floats:
    """Return the (4, 4) covariance of one row's (6,) columns."""
    p = np.zeros((4, 4))
    p[_ROW, _COLUMN] = columns
    p[_COLUMN, _ROW] = columns
    return p
