"""Kalman filters by filterpy, one after another, in the place of `tracker.kalman`: the same table, the same model.

The textbook's form, for x = (x, y, v_x, v_y) and z = (x, y)::

    predict   x = F x          P = F P F' + Q           F = I + dt E,  Q = q (dt^3/3, dt^2/2; dt^2/2, dt) per axis
    update    K = P H' (H P H' + R)^-1                  H = (I 0),     R = diag(r_x, r_y)
              x += K (z - H x)
              P = (I - K H) P (I - K H)' + K R K'       filterpy's form

Rounding apart it equals the batched one, which keeps the two axes apart as they are independent here.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import predict as predicted
from filterpy.kalman import update as updated

from heliograph_services.tracker.kalman import Floats, Rows

# Places in the 4 x 4 matrix of the table's columns (P_xx, P_xv, P_vv of x, then of y).
_ROW = np.array([0, 0, 2, 1, 1, 3])
_COLUMN = np.array([0, 2, 2, 1, 3, 3])
_H = np.eye(2, 4)


def predict(state: Floats, cov: Floats, dt_s: float, q: float) -> None:
    """Move all filters forward in place; arguments as in `tracker.kalman.predict`."""
    transition = np.eye(4) + dt_s * np.eye(4, k=2)
    noise = q * matrix(np.tile([dt_s**3 / 3, dt_s**2 / 2, dt_s], 2))
    for i in range(len(state)):
        state[i], p = predicted(state[i], matrix(cov[i]), F=transition, Q=noise)
        cov[i] = p[_ROW, _COLUMN]


def update(state: Floats, cov: Floats, rows: Rows, z: Floats, r: Floats, max_speed_px_s: float) -> None:
    """Correct the filters of some rows in place; arguments as in `tracker.kalman.update`."""
    for k, i in enumerate(rows):
        x, p = updated(state[i], matrix(cov[i]), z[k], np.diag(r[k]), H=_H)
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
