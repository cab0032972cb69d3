"""Fixed windows of 2 ms: what they read, and where they must fail; and the paper's windows with other parameters."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.link.frames import seed11_code
from heliograph.link.modulations import modulation
from heliograph.link.modulations.seed11 import Seed11
from heliograph.link.paper import PaperParameters, PaperReceiver
from support.lights import Light, read, repeated, seen

# Events in the middle of a window of 2 ms, the phase in which fixed windows work.
MIDDLE = Light(events=3.0, delay_on_us=900.0, delay_off_us=900.0, tail_us=50.0)


@pytest.mark.parametrize("bit_rate", [100.0, 250.0, 500.0])
def test_beacons_of_up_to_500_bits_a_second_are_read(bit_rate: float) -> None:
    receiver = modulation("seed11").receiver(bit_rate, "binning")
    frames = read(receiver, seen(Light(events=30.0), repeated(Seed11().encode(42), 20), bit_rate, 1, t0_us=200.0))
    assert {f.payload for f in frames} == {42}
    assert len(frames) >= 17
    identity = receiver.identity()
    assert identity is not None
    assert identity.payload == 42


def test_words_of_a_codebook_are_read_from_their_rotation() -> None:
    link = modulation("code", codebook="code18d4")
    frames = read(link.receiver(500.0, "binning"), seen(Light(), repeated(link.encode(77), 20), 500.0, 1))
    assert {f.payload for f in frames} == {77}


def test_bits_shorter_than_a_window_are_read_as_something_else_or_not_at_all() -> None:
    receiver = modulation("seed11").receiver(2000.0, "binning")
    frames = read(receiver, seen(Light(events=30.0), repeated(Seed11().encode(42), 200), 2000.0, 1))
    assert all(f.payload != 42 for f in frames)
    identity = receiver.identity()
    assert identity is None or identity.payload != 42


def test_a_single_event_decides_a_window_where_the_paper_wants_five() -> None:
    bits = repeated(Seed11().encode(42), 20)
    few = seen(Light(events=4.0, delay_on_us=900.0, delay_off_us=900.0, tail_us=20.0), bits, 500.0, 1)
    binned = read(modulation("seed11").receiver(500.0, "binning"), few)
    assert len(binned) > 2 * len(read(modulation("seed11").receiver(500.0, "paper"), few))


@pytest.mark.parametrize("window_bits", [0.25, 0.5])
def test_shorter_windows_of_the_papers_rule_read_the_same_word(window_bits: float) -> None:
    receiver = PaperReceiver(seed11_code(), 1000.0, PaperParameters(window_bits, 0.5, 2))
    frames = read(receiver, seen(Light(), repeated(Seed11().encode(42), 20), 1000.0, 1))
    assert {f.payload for f in frames} == {42}
    assert len(frames) >= 17


@settings(max_examples=15)
@given(st.lists(st.integers(0, 500_000), max_size=20), st.integers(0, 100))
def test_any_split_gives_the_same_with_fixed_windows(cuts: list[int], seed: int) -> None:
    what = seen(Light(noise_hz=500.0, dropped=0.05), repeated(Seed11().encode(42), 20), 450.0, seed)
    whole, pieces = (modulation("seed11").receiver(450.0, "binning") for _ in range(2))
    assert read(whole, what) == read(pieces, what, cuts)
    assert whole.refusals == pieces.refusals
    assert whole.identity() == pieces.identity()


@pytest.mark.parametrize(
    ("given_", "text"),
    [
        ((0.0, 0.5, 5), r"window_bits must be in \[0.001, 1000\], not 0"),
        ((1.0, 0.0, 5), r"polarity must be in \(0, 1\], not 0"),
        ((1.0, 0.5, 0), "min_events must be at least 1, not 0"),
    ],
)
def test_parameters_out_of_range_are_named(given_: tuple[float, float, int], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        PaperParameters(*given_)
