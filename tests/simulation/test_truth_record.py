"""The truth's record: its edges travel packed, exactly, and damage is refused."""

from __future__ import annotations

import zlib

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.truth import EDGES_LIMIT, Truth
from heliograph.wire import pack_body
from support.truth_scenes import Sent, truth

T0_US = 3_000_000
WINDOW_US = 50_000


def with_edges(rows: list[tuple[int, int, bool]], beacons: int = 4) -> Truth:
    """A truth of beacons with edges (beacon, tenths of a us since T0_US, on)."""
    rows = sorted(rows)
    return msgspec.structs.replace(
        truth([Sent(name=f"b{i}") for i in range(beacons)], WINDOW_US, WINDOW_US)[0],
        t0_us=T0_US,
        t1_us=T0_US + WINDOW_US,
        edge_beacon=np.array([row[0] for row in rows], np.uint16),
        edge_us=T0_US + np.array([row[1] for row in rows], np.float64) / 10,
        edge_on=np.array([row[2] for row in rows], np.bool_),
    )


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 10 * WINDOW_US), st.booleans()), max_size=60))
def test_any_edges_come_back_to_the_tenth_of_a_microsecond(rows: list[tuple[int, int, bool]]) -> None:
    sent = with_edges(rows)
    back = Truth.from_body(sent.to_body())
    assert pack_body(back) == pack_body(sent)
    for name in ("edge_beacon", "edge_us", "edge_on"):
        assert np.array_equal(getattr(back, name), getattr(sent, name))
        assert getattr(back, name).dtype == getattr(sent, name).dtype


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"edge_n": 3}, "must unpack to"),
        ({"edge_n": EDGES_LIMIT + 1}, "edge_n"),
        ({"edges": b"no zlib"}, "zlib"),
        ({"edges": zlib.compress(bytes(100_000_000))}, "must unpack to"),
        ({"t1_us": T0_US + 99}, "edges must lie in"),
        ({"t1_us": T0_US - 1}, "edges must lie in"),
        ({"frame_beacon": [7], "frame_t0_us": [1]}, "differ in length"),
        ({"fidelity": "perfect"}, "fidelity"),
    ],
)
def test_a_damaged_truth_is_refused_by_name(change: dict[str, object], words: str) -> None:
    body = with_edges([(0, 10, True), (3, 1000, False)]).to_body()
    with pytest.raises(ValueError, match=words):
        Truth.from_body(body | change)


def test_edges_that_do_not_add_up_are_refused() -> None:
    columns = np.array([1, 0, 0, 0, 5, 6], "<u4").tobytes() + b"\x01"
    body = with_edges([]).to_body() | {"edge_n": 2, "edges": zlib.compress(columns)}
    with pytest.raises(ValueError, match="add up to edge_n = 2, not 1"):
        Truth.from_body(body)


@pytest.mark.parametrize(
    ("beacon", "edge_us"), [([1, 0], [T0_US, T0_US + 1.0]), ([0, 0], [T0_US + 1.0, T0_US]), ([0, 4], [T0_US, T0_US])]
)
def test_edges_out_of_order_are_the_senders_mistake(beacon: list[int], edge_us: list[float]) -> None:
    bad = msgspec.structs.replace(
        with_edges([(0, 0, True), (1, 1, False)]),
        edge_beacon=np.array(beacon, np.uint16),
        edge_us=np.array(edge_us, np.float64),
    )
    with pytest.raises(ValueError, match="edge"):
        bad.to_body()


def test_the_edges_of_five_beacons_at_1_kbit_s_cost_less_than_two_bytes_each() -> None:
    # seed11's 42 has 8 edges in 11 bits of 1 ms; beacons are out of step by whatever their clocks have drifted.
    at = np.array([3, 4, 5, 6, 7, 8, 9, 10])
    rows = [
        (beacon, int(tenths), bool(i % 2))
        for beacon in range(5)
        for i, tenths in enumerate((np.concatenate([at + 11 * k for k in range(5)]) * 9_990 + 777 * beacon)[:-5])
        if tenths < 10 * WINDOW_US
    ]
    packed = with_edges(rows, beacons=5).to_body()["edges"]
    print(f"{len(rows)} edges, {len(packed)} bytes, {len(packed) / len(rows):.2f} an edge")
    assert len(packed) < 2 * len(rows)
