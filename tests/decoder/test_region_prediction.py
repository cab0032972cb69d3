"""A region that turns: P <- F P F' + q [T^3/3, T^2/2; T^2/2, T], on an arc of constant speed."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph_services.decoder.region_state import P_VV, P_XV, P_XX, ROWS, TURN, VX, VY, Q, X, Y, carry

T_S = 1e-3


@pytest.mark.parametrize("turn", [0.0, 8.0, -40.0])
def test_the_covariance_of_a_region_that_turns_grows_as_that_of_one_that_does_not(turn: float) -> None:
    rng = np.random.default_rng(4)
    state = np.zeros((ROWS, 2))
    state[Q], state[TURN] = 1e6, turn
    state[VX], state[VY] = 30.0, -40.0  # too slow for the least q of what turns
    half = rng.normal(size=(2, 2)) * [[2.0], [300.0]]
    wanted = half @ half.T
    state[[P_XX, P_XV, P_VV]] = wanted[[0, 0, 1], [0, 1, 1]][:, None]
    step = np.array([[1.0, T_S], [0.0, 1.0]])
    noise = 1e6 * np.array([[T_S**3 / 3, T_S**2 / 2], [T_S**2 / 2, T_S]])
    for _ in range(50):
        carry(state, 2, 1e6 * T_S)
        wanted = step @ wanted @ step.T + noise
    np.testing.assert_allclose(state[[P_XX, P_XV, P_VV], 1], wanted[[0, 0, 1], [0, 1, 1]], rtol=1e-9)


def test_a_region_that_turns_goes_round_its_circle() -> None:
    state = np.zeros((ROWS, 1))
    state[VX], state[TURN] = 500.0, 10.0  # a circle of 50 px about (0, 50)
    steps = round(np.pi / 10.0 / T_S)
    for _ in range(steps):
        carry(state, 1, 1e6 * T_S)
    angle = 10.0 * steps * T_S
    assert state[X, 0] == pytest.approx(50 * np.sin(angle), abs=0.01)
    assert state[Y, 0] == pytest.approx(50 - 50 * np.cos(angle), abs=0.01)
    assert np.hypot(state[VX, 0], state[VY, 0]) == pytest.approx(500.0)
