"""The paper's receiver as published: its windows, its rotation, its Algorithm 1."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph.link.frames import bits_of, seed11_code
from heliograph.link.modulations.seed11 import Seed11
from heliograph.link.paper import PaperReceiver
from support.lights import Light, Seen, read, repeated, seen

# Events in the middle of each window: the setting in which the published rule holds.
MIDDLE = Light(delay_on_us=400.0, delay_off_us=400.0, tail_us=20.0)


def test_the_papers_frame_is_read_from_any_rotation() -> None:
    link = Seed11()
    for start in range(11):
        bits = repeated(link.encode(32), 20)[start:]
        receiver = link.receiver(1000.0, "paper")
        frames = read(receiver, seen(MIDDLE, bits, 1000.0, start))
        assert {f.payload for f in frames} == {32}
        # One check for every 11 bits, after the first transition.
        assert 17 <= len(frames) <= 19


def test_five_equal_checks_make_a_track_valid_and_ten_bad_ones_end_it() -> None:
    link = Seed11()
    receiver = link.receiver(1000.0, "paper")
    what = seen(MIDDLE, repeated(link.encode(42), 7), 1000.0, 1)
    assert len(read(receiver, what)) >= 5
    identity = receiver.identity()
    assert identity is not None
    assert identity.payload == 42
    assert receiver.verdict(what.until_us) == "valid"
    assert receiver.verdict(what.until_us + 600_000) == "invalid"


def test_a_gap_longer_than_the_longest_run_clears_the_sequence() -> None:
    link = Seed11()
    bits = [*repeated(link.encode(42), 5), *[0] * 50, *repeated(link.encode(42), 5)]
    receiver = link.receiver(1000.0, "paper")
    frames = read(receiver, seen(MIDDLE, bits, 1000.0, 1))
    assert receiver.refusals[Refusal.OCCLUSION] == 1
    assert {f.payload for f in frames} == {42}
    assert len(frames) >= 7


def test_both_edges_in_one_window_are_lost_as_published() -> None:
    receiver = PaperReceiver(seed11_code(), 1000.0)
    t = np.array([100, 120, 900, 920], np.int64)
    on = np.array([True, True, False, False])
    read(receiver, Seen(t, on, 2000, 1000.0))
    assert receiver.quality(2000).mar_estimate is None
    assert receiver.verdict(2000) == "new"


@pytest.mark.parametrize(
    ("payload", "reason"), [(14, Refusal.AMBIGUOUS), (None, Refusal.NO_START_CODE), (-42, Refusal.PARITY)]
)
def test_what_it_cannot_read_is_refused_by_name(payload: int | None, reason: Refusal) -> None:
    code = seed11_code("even")
    word = {14: code.words[14], None: int("10110011010", 2), -42: seed11_code("paper_text").words[42]}[payload]
    receiver = PaperReceiver(code, 1000.0)
    assert read(receiver, seen(MIDDLE, repeated(bits_of(word, 11), 20), 1000.0, 1)) == []
    assert receiver.refusals[reason] >= 17
    assert receiver.verdict(220_000) == "invalid"


@settings(max_examples=20)
@given(st.lists(st.integers(0, 400_000), max_size=30), st.integers(0, 100))
def test_any_split_gives_the_same_with_the_papers_receiver(cuts: list[int], seed: int) -> None:
    link = Seed11()
    what = seen(Light(noise_hz=500.0, dropped=0.05), repeated(link.encode(42), 30), 1000.0, seed)
    whole, pieces = link.receiver(1000.0, "paper"), link.receiver(1000.0, "paper")
    assert read(whole, what) == read(pieces, what, cuts)
    assert whole.refusals == pieces.refusals
    assert whole.identity() == pieces.identity()


def test_time_that_runs_back_is_counted_by_the_papers_receiver() -> None:
    receiver = Seed11().receiver(1000.0, "paper")
    none = np.empty(0, np.int64), np.empty(0, np.bool_)
    receiver.feed(*none, 10)
    assert receiver.feed(*none, 9) == []
    assert receiver.flush() == []
    assert receiver.refusals[Refusal.TIME_BACKWARDS] == 1
