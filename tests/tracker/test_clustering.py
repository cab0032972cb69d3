"""The grid's labels are those of scikit-learn and of the definition."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph_services.tracker.clustering import Active, Clusterer

SIDE = 24
Points = list[tuple[int, int, int]]
# (x, y, events) of distinct pixels in any order; a small side makes clusters, bridges and borders common.
POINTS = st.lists(
    st.tuples(st.integers(0, SIDE - 1), st.integers(0, SIDE - 1), st.integers(1, 4)),
    max_size=90,
    unique_by=lambda p: (p[0], p[1]),
)
EPS = st.sampled_from([1.0, 1.4142135623730951, 1.5, 2.0, 2.2360679774997896, 3.0, 5.5])


def reference() -> ModuleType:
    path = Path(__file__).parents[1] / "reference" / "dbscan_plain.py"
    spec = importlib.util.spec_from_file_location("dbscan_plain", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PLAIN = reference()


def active_of(points: Points) -> Active:
    x, y, w = (np.array([p[i] for p in points], np.int32) for i in range(3))
    return Active(x, y, w, np.zeros(len(points), np.int32), np.zeros((2, len(points))))


def grid_labels(points: Points, eps: float, min_events: int, clusterer: Clusterer | None = None) -> list[int]:
    clusterer = clusterer or Clusterer(SIDE, SIDE, eps, min_events)
    labels, count = clusterer.labels(active_of(points))
    found: list[int] = labels.tolist()
    assert sorted(set(found) - {-1}) == list(range(count))
    return found


@settings(max_examples=80)
@given(POINTS, EPS, st.integers(1, 12))
def test_labels_are_those_of_scikit_learn_with_weights(points: Points, eps: float, min_events: int) -> None:
    cluster = pytest.importorskip("sklearn.cluster")
    if points:
        xy = np.array([p[:2] for p in points], np.float64)
        weight = [p[2] for p in points]
        wanted = cluster.DBSCAN(eps=eps, min_samples=min_events).fit(xy, sample_weight=weight).labels_.tolist()
        assert grid_labels(points, eps, min_events) == wanted


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=120), EPS, st.integers(1, 12))
def test_labels_of_raw_events_are_those_of_their_pixels_in_the_order_of_first_occurrence(
    events: list[tuple[int, int]], eps: float, min_events: int
) -> None:
    cluster = pytest.importorskip("sklearn.cluster")
    wanted = cluster.DBSCAN(eps=eps, min_samples=min_events).fit(np.array(events, np.float64)).labels_.tolist()
    clusterer = Clusterer(10, 10, eps, min_events)
    x, y = np.array(events, np.uint16).T.copy()
    one = np.ones(len(events), np.uint8)
    active = clusterer.distinct(x, y, one, 0 * one, 0 * one)
    labels, _ = clusterer.labels(active)
    of_pixel = {(int(a), int(b)): int(c) for a, b, c in zip(active.x_px, active.y_px, labels, strict=True)}
    assert [of_pixel[event] for event in events] == wanted


@settings(max_examples=60)
@given(POINTS, EPS, st.integers(1, 12))
def test_labels_are_those_of_the_definition(points: Points, eps: float, min_events: int) -> None:
    x, y, w = (np.array([p[i] for p in points], np.int64) for i in range(3))
    assert grid_labels(points, eps, min_events) == PLAIN.labels(x, y, w, eps, min_events)


def test_a_border_pixel_between_two_clusters_takes_the_one_whose_core_came_first() -> None:
    # Cores at x = 4 and 8 reach 7 events with their heavy outer neighbours; the pixel between them sees 3, no core.
    left: Points = [(2, 3, 5), (4, 3, 1)]
    right: Points = [(8, 3, 1), (10, 3, 5)]
    border = (6, 3, 1)
    assert grid_labels([border, *left, *right], 2.0, 7) == [0, 0, 0, 1, 1]
    assert grid_labels([border, *right, *left], 2.0, 7) == [0, 0, 0, 1, 1]
    assert grid_labels([*right, *left, border], 2.0, 7) == [0, 0, 1, 1, 0]


def test_a_window_leaves_nothing_behind_for_the_next() -> None:
    clusterer = Clusterer(SIDE, SIDE, 2.0, 3)
    first: Points = [(x, y, 1) for x in range(5) for y in range(5)]
    second: Points = [(6, 2, 1), (7, 2, 1)]
    assert set(grid_labels(first, 2.0, 3, clusterer)) == {0}
    assert grid_labels(second, 2.0, 3, clusterer) == [-1, -1]
    assert grid_labels([], 2.0, 3, clusterer) == []


def test_pixels_in_the_corners_have_no_neighbours_across_the_edge() -> None:
    corners: Points = [
        (0, 0, 1),
        (SIDE - 1, 0, 1),
        (0, SIDE - 1, 1),
        (SIDE - 1, SIDE - 1, 1),
        (0, 1, 1),
        (SIDE - 1, 1, 1),
    ]
    assert grid_labels(corners, 3.0, 2) == [0, 1, -1, -1, 0, 1]


def test_repeated_entries_of_a_pixel_add_up_and_silent_ones_are_left_out() -> None:
    clusterer = Clusterer(8, 8, 1.0, 1)

    def column(*values: int, dtype: type[np.generic] = np.uint16) -> npt.NDArray[np.generic]:
        return np.array(values, dtype)

    active = clusterer.distinct(
        column(3, 1, 3, 7),
        column(4, 1, 4, 7),
        column(255, 0, 255, 0, dtype=np.uint8),
        column(1, 2, 3, 0, dtype=np.uint8),
        column(0, 2, 4, 1, dtype=np.int64),
    )
    rows = list(zip(*(c.tolist() for c in (active.x_px, active.y_px, active.on, active.off)), strict=True))
    assert rows == [(3, 4, 510, 4), (1, 1, 0, 2)]
    assert active.moments.tolist() == [[258 * 4, 2 * 2], [258 * 16, 2 * 4]]
