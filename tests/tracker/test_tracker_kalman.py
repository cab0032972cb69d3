"""The batched filters against filterpy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from heliograph_services.tracker import kalman

Q = 30_000.0


def filters(n: int, rng: np.random.Generator) -> tuple[kalman.Floats, kalman.Floats]:
    state = rng.normal(0, 100, (n, 4))
    cov = np.tile([1.0, 0.0, 1e4, 1.0, 0.0, 1e4], (n, 1))
    return state, cov


def full(cov: kalman.Floats) -> kalman.Floats:
    """Return the 4 x 4 matrix of one row, for (x, y, v_x, v_y)."""
    p = np.zeros((4, 4))
    for a in range(2):
        xx, xv, vv = cov[3 * a : 3 * a + 3]
        p[a, a], p[a, a + 2], p[a + 2, a], p[a + 2, a + 2] = xx, xv, xv, vv
    return p


def white_acceleration(dt: float) -> kalman.Floats:
    q = np.zeros((4, 4))
    for a in range(2):
        q[a, a], q[a, a + 2], q[a + 2, a], q[a + 2, a + 2] = dt**3 / 3, dt**2 / 2, dt**2 / 2, dt
    return Q * q


def test_a_thousand_steps_of_many_filters_equal_filterpy() -> None:
    # filterpy's older releases use what newer numpy and scipy call deprecated; that is theirs.
    oracle: Any = pytest.importorskip("filterpy.kalman")
    rng = np.random.default_rng(1)
    n = 5
    state, cov = filters(n, rng)
    ours = []
    for i in range(n):
        f = oracle.KalmanFilter(dim_x=4, dim_z=2)
        f.x, f.P, f.H = state[i].reshape(4, 1).copy(), full(cov[i]), np.eye(2, 4)
        ours.append(f)
    for _ in range(1000):
        dt = float(rng.uniform(0.001, 0.05))
        seen = np.flatnonzero(rng.random(n) < 0.7)
        z = state[seen, :2] + rng.normal(0, 1, (len(seen), 2))
        r = rng.uniform(0.05, 4.0, (len(seen), 2))
        kalman.predict(state, cov, dt, Q)
        kalman.update(state, cov, seen, z, r, 1e30)
        for f in ours:
            f.predict(F=np.eye(4) + dt * np.eye(4, k=2), Q=white_acceleration(dt))
        for k, row in enumerate(seen):
            ours[row].update(z[k].reshape(2, 1), R=np.diag(r[k]))
    for i, f in enumerate(ours):
        np.testing.assert_allclose(state[i], f.x[:, 0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(full(cov[i]), f.P, rtol=1e-9, atol=1e-9)


def test_two_steps_of_silence_are_one() -> None:
    rng = np.random.default_rng(2)
    a, p = filters(3, rng)
    b, s = a.copy(), p.copy()
    kalman.predict(a, p, 0.03, Q)
    kalman.predict(a, p, 0.17, Q)
    kalman.predict(b, s, 0.2, Q)
    np.testing.assert_allclose(a, b, rtol=1e-12)
    np.testing.assert_allclose(p, s, rtol=1e-12)


def test_rows_that_are_not_named_keep_their_state() -> None:
    state, cov = filters(3, np.random.default_rng(3))
    before = state.copy(), cov.copy()
    kalman.update(state, cov, np.array([1]), np.zeros((1, 2)), np.ones((1, 2)), 1e30)
    for i in (0, 2):
        assert (state[i] == before[0][i]).all()
        assert (cov[i] == before[1][i]).all()
    assert (state[1] != before[0][1]).any()


def test_speed_is_cut_to_the_limit_and_keeps_its_direction() -> None:
    state, cov = np.zeros((1, 4)), np.array([[1.0, 10.0, 1e6, 1.0, 10.0, 1e6]])
    kalman.update(state, cov, np.array([0]), np.array([[300.0, 400.0]]), np.full((1, 2), 1e-3), 500.0)
    assert np.hypot(*state[0, 2:]) == pytest.approx(500)
    assert state[0, 3] / state[0, 2] == pytest.approx(4 / 3)


def test_measurements_of_another_time_and_of_the_velocity_equal_filterpy() -> None:
    oracle: Any = pytest.importorskip("filterpy.kalman")
    rng = np.random.default_rng(6)
    state, cov = filters(2, rng)
    ours = []
    for i in range(2):
        f = oracle.KalmanFilter(dim_x=4, dim_z=2)
        f.x, f.P = state[i].reshape(4, 1).copy(), full(cov[i])
        ours.append(f)
    rows, none = np.arange(2), np.array([900.0, np.inf])
    for _ in range(200):
        q = rng.uniform(1e3, 1e6, 2)
        z, v = rng.normal(0, 50, (2, 2)), rng.normal(0, 300, (2, 2))
        r, lag = rng.uniform(0.05, 4.0, (2, 2)), rng.uniform(-0.0025, 0.0025, 2)
        kalman.predict(state, cov, 0.005, q)
        kalman.update(state, cov, rows, z, r, 1e30, lag, v, none)
        for i, f in enumerate(ours):
            f.predict(F=np.eye(4) + 0.005 * np.eye(4, k=2), Q=white_acceleration(0.005) * q[i] / Q)
            place = np.eye(2, 4) + lag[i] * np.eye(2, 4, k=2)
            f.update(z[i].reshape(2, 1), R=np.diag(r[i]), H=place)
            if np.isfinite(none[i]):
                f.update(v[i].reshape(2, 1), R=none[i] * np.eye(2), H=np.eye(2, 4, k=2))
    for i, f in enumerate(ours):
        np.testing.assert_allclose(state[i], f.x[:, 0], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(full(cov[i]), f.P, rtol=1e-7, atol=1e-7)
