"""Batches of events, and the units."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.events import EventBatch, checked, concatenate
from heliograph.units import bit_us


def batch(times: list[int]) -> EventBatch:
    n = len(times)
    return EventBatch(np.array(times, np.int64), np.zeros(n, np.uint16), np.zeros(n, np.uint16), np.ones(n, np.bool_))


def test_a_wrong_dtype_or_length_is_a_programmers_error() -> None:
    good = batch([1, 2])
    with pytest.raises(TypeError, match="t_us must be int64, not int32"):
        EventBatch(good.t_us.astype(np.int32), good.x_px, good.y_px, good.on)
    with pytest.raises(ValueError, match="x_px must have the shape"):
        EventBatch(good.t_us, good.x_px[:1], good.y_px, good.on)


def test_the_first_falling_time_is_named() -> None:
    with pytest.raises(ValueError, match="at event 2: 5 us after 7 us"):
        checked(batch([3, 7, 5, 4]), 1, 1)


def test_the_first_event_off_the_sensor_is_named() -> None:
    good = batch([1, 2])
    with pytest.raises(ValueError, match=r"event 0 at \(0, 0\) lies outside 0x1"):
        checked(good, 0, 1)


def test_parts_and_concatenation_give_the_whole_again() -> None:
    whole = batch([1, 2, 2, 9])
    again = concatenate([whole.part(0, 2), whole.part(2, 2), whole.part(2, 4)])
    assert np.array_equal(again.t_us, whole.t_us)
    assert len(concatenate([])) == 0


@pytest.mark.parametrize("rate", [0.0, -5.0, 1e9, float("nan")])
def test_a_bit_rate_out_of_range_is_named(rate: float) -> None:
    with pytest.raises(ValueError, match=r"bit rate must be in \[1, 100000\] bit/s"):
        bit_us(rate)
