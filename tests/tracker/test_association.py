"""Gates and assignment: as good as trying every pairing."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph_services.tracker import association
from heliograph_services.tracker.association import Candidates, Gate
from heliograph_services.tracker.config import Cost

Places = list[tuple[float, float]]
PLACE = st.tuples(st.integers(0, 40), st.integers(0, 12)).map(lambda p: (p[0] / 2, p[1] / 2))
SIZE = 20.0
RADIUS = 2.0


def gate(cost: Cost = "l2", px: float = 40.0) -> Gate:
    return Gate(chi2=13.8, px=px, noise_px=0.3, tick_s=0.005, cost=cost)


def assign(tracks: Places, targets: Places, sizes: list[float] | None = None, rule: Gate | None = None) -> list[int]:
    n = len(tracks)
    xy = np.array(targets, np.float64).reshape(-1, 2)
    seen = np.array(sizes if sizes is not None else [SIZE] * len(targets), np.float64)
    chosen: list[int] = association.assign(
        np.concatenate([np.array(tracks, np.float64).reshape(-1, 2), np.zeros((n, 2))], axis=1),
        np.tile([1.0, 0.0, 100.0, 1.0, 0.0, 100.0], (n, 1)),
        np.full(n, RADIUS),
        np.full(n, SIZE),
        np.arange(n),
        Candidates(xy[:, 0].copy(), xy[:, 1].copy(), seen, np.zeros(len(xy)), np.ones(len(xy), np.bool_)),
        rule or gate(),
    ).tolist()
    return chosen


def cost_of(tracks: Places, targets: Places, pairs: list[tuple[int, int]], l1: bool) -> float:
    total = 0.0
    for k, j in pairs:
        dx, dy = targets[j][0] - tracks[k][0], targets[j][1] - tracks[k][1]
        total += abs(dx) + abs(dy) if l1 else (dx * dx + dy * dy) / 1.09
    return total


def allowed(a: tuple[float, float], b: tuple[float, float]) -> bool:
    d2 = (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2
    return d2 <= (RADIUS + association.DISC_SLACK_PX) ** 2 or d2 / 1.09 <= 13.8


def best(tracks: Places, targets: Places, l1: bool) -> tuple[int, float]:
    """Return the most pairs and the least cost with that many, by trying all."""
    found = (0, 0.0)
    for k in range(1, min(len(tracks), len(targets)) + 1):
        costs = [
            cost_of(tracks, targets, list(zip(rows, chosen, strict=True)), l1)
            for rows in itertools.combinations(range(len(tracks)), k)
            for chosen in itertools.permutations(range(len(targets)), k)
            if all(allowed(tracks[r], targets[j]) for r, j in zip(rows, chosen, strict=True))
        ]
        if not costs:
            break
        found = (k, min(costs))
    return found


@given(st.lists(PLACE, min_size=1, max_size=4), st.lists(PLACE, min_size=1, max_size=4), st.booleans())
def test_as_many_pairs_as_possible_at_the_least_cost(tracks: Places, targets: Places, l1: bool) -> None:
    chosen = assign(tracks, targets, rule=gate("l1" if l1 else "l2"))
    pairs = [(k, j) for k, j in enumerate(chosen) if j >= 0]
    assert len({j for _, j in pairs}) == len(pairs)
    assert all(allowed(tracks[k], targets[j]) for k, j in pairs)
    count, cost = best(tracks, targets, l1)
    assert len(pairs) == count
    assert cost_of(tracks, targets, pairs, l1) == pytest.approx(cost, abs=1e-9)


def test_the_nearest_first_would_pair_worse_than_the_global_assignment() -> None:
    # Track 0 is nearest to target 0, but track 1 has no other.
    assert assign([(10, 5), (13, 5)], [(11.4, 5), (7, 5)]) == [1, 0]


def test_what_is_outside_the_gate_is_left_alone() -> None:
    assert assign([(0, 0)], [(9, 0)]) == [-1]
    assert assign([], [(9, 0)]) == []
    assert assign([(0, 0)], []) == [-1]


def test_the_gate_in_pixels_bounds_an_uncertain_track() -> None:
    state, cov = np.zeros((1, 4)), np.array([[1e4, 0.0, 1.0, 1e4, 0.0, 1.0]])
    for away, wanted in ((41.0, 0), (43.0, -1)):
        chosen = association.assign(
            state, cov, np.array([RADIUS]), np.array([SIZE]), np.arange(1),
            Candidates(np.array([away]), np.zeros(1), np.array([SIZE]), np.zeros(1), np.ones(1, np.bool_)), gate(),
        )  # fmt: skip
        assert chosen.tolist() == [wanted]


def test_a_scrap_counts_on_the_disc_only_and_loses_to_the_whole_target() -> None:
    scrap = 0.1 * SIZE
    assert assign([(0, 0)], [(4.1, 0)], [scrap]) == [-1]
    assert assign([(0, 0)], [(3.9, 0)], [scrap]) == [0]
    assert assign([(0, 0)], [(0.5, 0), (1.5, 0)], [scrap, SIZE]) == [1]


def test_a_target_much_larger_than_the_track_is_another_thing() -> None:
    assert assign([(0, 0)], [(0, 0)], [association.GROWTH * SIZE + association.GROWTH_PX]) == [0]
    assert assign([(0, 0)], [(0, 0)], [association.GROWTH * SIZE + association.GROWTH_PX + 1]) == [-1]


def test_a_group_too_large_for_the_solver_is_still_paired_one_to_one() -> None:
    n = association.DENSE_LIMIT + 20
    tracks: Places = [(0.5 * k, 0.0) for k in range(n)]
    chosen = assign(tracks, tracks)
    assert chosen == list(range(n))


def test_things_lie_on_the_nearest_place_that_they_touch() -> None:
    x = np.array([0.0, 5.0, 9.0, 30.0])
    places = np.array([[1.0, 0, 0, 0], [8.0, 0, 0, 0]])
    owner = association.owners(x, 0 * x, 0 * x, np.zeros(4), places, np.array([5.0, 3.0]))
    assert owner.tolist() == [0, 1, 1, -1]
    nothing = np.empty(0)
    assert association.owners(x, 0 * x, 0 * x, np.zeros(4), np.empty((0, 4)), nothing).tolist() == [-1] * 4
