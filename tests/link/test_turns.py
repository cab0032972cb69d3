"""Where a light turns: whatever noise and tails there are, and without a bit rate."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.link.turns import turns

UP, DOWN = [True], [False]


@pytest.mark.parametrize("by_first", [True, False])
def test_each_burst_is_a_turn_and_lone_events_are_none(by_first: bool) -> None:
    on = np.array(UP * 9 + DOWN + UP * 3 + DOWN * 12 + UP + DOWN * 2 + UP * 10)
    at, swing = turns(on, 1 / 3, by_first=by_first)
    # swings of 11, 13 and 10: h is 11 / 3, so the fourth event completes a turn, or the one that makes up for lone ones
    assert at.tolist() == ([0, 13, 28] if by_first else [3, 16, 31])
    assert swing.tolist() == [11.0, -13.0, 10.0]


def test_a_tail_of_the_other_polarity_does_not_delay_a_turn_by_more_than_it_outweighs() -> None:
    on = np.array(UP * 20 + (DOWN * 3 + UP) * 6 + DOWN * 8)
    at, _ = turns(on, 1 / 3, by_first=True)
    assert at.tolist() == [0, 20]


def test_light_of_one_polarity_turns_once_and_darkness_never() -> None:
    assert turns(np.ones(50, np.bool_), 0.5, by_first=True)[1].tolist() == [50.0]
    assert len(turns(np.empty(0, np.bool_), 0.5, by_first=True)[0]) == 0


@settings(max_examples=60)
@given(bursts=st.lists(st.integers(3, 8), min_size=1, max_size=40), first=st.booleans())
def test_bursts_of_like_size_are_all_found(bursts: list[int], first: bool) -> None:
    on = np.concatenate([np.full(n, (k % 2 == 0) == first) for k, n in enumerate(bursts)])
    at, swing = turns(on, 1 / 3, by_first=True)
    assert at.tolist() == np.concatenate([[0], np.cumsum(bursts)[:-1]]).tolist()
    assert np.abs(swing).tolist() == bursts
    assert (swing > 0).tolist() == on[at].tolist()


@settings(max_examples=60)
@given(bursts=st.lists(st.integers(3, 5), min_size=2, max_size=40), more=st.integers(1, 8), rise=st.booleans())
def test_bursts_are_found_where_one_polarity_makes_several_times_as_many_events(
    bursts: list[int], more: int, rise: bool
) -> None:
    sizes = [n * more if (k % 2 == 0) == rise else n for k, n in enumerate(bursts)]
    on = np.concatenate([np.full(n, k % 2 == 0) for k, n in enumerate(sizes)])
    at, _ = turns(on, 1 / 3, by_first=True, balanced=True)
    assert at.tolist() == np.concatenate([[0], np.cumsum(sizes)[:-1]]).tolist()
