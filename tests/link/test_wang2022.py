"""The decoder of Wang et al. (2022), with its published parameters and with others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph.link.contract import LinkFrame
from heliograph.link.modulations import modulation
from heliograph.link.uart_layout import character_bits
from heliograph.link.wang2022 import WangParameters, WangReceiver, published, tuned
from reference.wang_plain import characters
from support.text_light import TextLight, Watched, hear, joined, watch_text

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "wang2022.json").read_text())
BY_HAND = WangParameters(1.5, -1.5, step=1.0)
TEXT = "the quick brown fox jumps over the lazy dog, 0123456789 times"
LIGHT = TextLight(events=200.0, tail_bits=0.05)


def frames(receiver: WangReceiver, seen: Watched, cuts: tuple[int, ...] = ()) -> list[LinkFrame]:
    return [item for item in hear(receiver, seen, cuts) if isinstance(item, LinkFrame)]


@pytest.mark.parametrize("case", VECTORS["cases"], ids=range(len(VECTORS["cases"])))
def test_vectors_worked_by_hand(case: dict[str, list[list[int]]]) -> None:
    n, apart_us = VECTORS["events_a_change"], VECTORS["apart_us"]
    t_us = np.array([t + i * apart_us for t, _ in case["changes_us"] for i in range(n)], np.int64)
    on = np.array([bool(level) for _, level in case["changes_us"] for _ in range(n)])
    found = frames(WangReceiver(1000.0, BY_HAND), Watched(t_us, on, int(t_us[-1]) + 1))
    assert [[f.t_us, f.payload, int(f.score)] for f in found] == case["characters"]


@pytest.mark.parametrize("bit_rate", [504.0, 1200.0, 3125.0])
def test_a_clean_text_is_read_with_the_published_parameters(bit_rate: float) -> None:
    receiver = modulation("uart").receiver(bit_rate, "wang2022")
    seen = watch_text(LIGHT, TEXT, bit_rate, seed=1)
    assert joined(hear(receiver, seen)) == TEXT
    identity = receiver.identity()
    assert identity is not None
    assert (identity.payload, identity.frames_used) == (None, len(TEXT))
    assert receiver.verdict(seen.until_us) == "valid"
    assert receiver.verdict(seen.until_us + 3_000_000) == "invalid"
    assert receiver.quality(seen.until_us).mar_estimate == 1.0


def test_the_published_thresholds_hold_at_their_rates_and_lie_between_them_between_them() -> None:
    assert (published(504.0).upper, published(504.0).lower) == (8.0, -5.0)
    assert np.allclose((published(3125.0).upper, published(3125.0).lower), (1.5, -1.0))
    assert published(50.0) == published(504.0)
    between = published(float(np.sqrt(504.0 * 3125.0)))
    assert np.allclose((between.upper, between.lower), (np.sqrt(12.0), -np.sqrt(5.0)))


@settings(max_examples=25)
@given(
    st.integers(0, 99), st.floats(0.0, 0.7), st.sampled_from([0.0, 3000.0]), st.lists(st.integers(0, 2**20), max_size=9)
)
def test_it_agrees_with_the_plain_form_however_the_input_is_cut(
    seed: int, lost: float, noise_hz: float, cuts: list[int]
) -> None:
    light = TextLight(events=60.0, tail_bits=0.2, lost=lost, noise_hz=noise_hz)
    seen = watch_text(light, TEXT[:20], 2000.0, seed)
    parameters = WangParameters(1.0, -0.8)
    whole = frames(WangReceiver(2000.0, parameters), seen)
    plain = characters(seen.t_us.tolist(), seen.on.tolist(), 500.0, parameters)
    assert [(f.t_us, f.payload) for f in whole] == plain
    pieces = WangReceiver(2000.0, parameters)
    assert frames(pieces, seen, tuple(1_000_000 + cut for cut in cuts)) == whole


def test_a_frame_is_not_told_before_its_end() -> None:
    seen = watch_text(LIGHT, TEXT, 1000.0, seed=2)
    receiver = WangReceiver(1000.0)
    for until_us in range(1_000_000, seen.until_us, 777):
        i, j = np.searchsorted(seen.t_us, [until_us - 777, until_us])
        assert all(item.t_us <= until_us for item in receiver.feed(seen.t_us[i:j], seen.on[i:j], until_us))


def test_noise_is_printed_but_is_no_identity() -> None:
    """As published: every eleven bits are a character."""
    random = np.random.default_rng(3)
    t_us = np.sort(random.integers(0, 20_000_000, 200_000)).astype(np.int64)
    receiver = WangReceiver(3125.0, WangParameters(0.15, -0.1))
    found = frames(receiver, Watched(t_us, random.random(len(t_us)) < 0.5, 20_000_000))
    assert len(found) > 500
    assert {f.score for f in found} == {0.0, 1.0}
    assert receiver.refusals[Refusal.PARITY] > 100
    assert receiver.identity() is None


def test_time_that_runs_back_is_refused_and_counted() -> None:
    receiver = WangReceiver(1000.0)
    none = np.empty(0, np.int64), np.empty(0, np.bool_)
    receiver.feed(*none, 10)
    assert receiver.feed(*none, 9) == []
    assert receiver.refusals[Refusal.TIME_BACKWARDS] == 1


@pytest.mark.parametrize(
    ("settings_", "text"),
    [
        ({"upper": -1.0, "lower": 1.0}, "lower must be finite and below upper = -1, not 1"),
        ({"upper": float("nan"), "lower": 1.0}, "lower must be finite"),
        ({"upper": 1.0, "lower": -1.0, "cutoff": 0.0}, r"cutoff must be in \[0.001, 1000\], not 0"),
        ({"upper": 1.0, "lower": -1.0, "middle": 1.5}, r"middle must be in \[0.1, 0.9\] bits, not 1.5"),
    ],
)
def test_a_parameter_out_of_range_is_named(settings_: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        WangParameters(**settings_)


# (file, bit rate, least share of characters right, least share of bits right); the guide has .877 and .986 at 30 m.
PUBLISHED = [("504hz_100m.mat", 504.0, 1.0, 1.0), ("3125hz_30m.mat", 3125.0, 0.877, 0.98)]


@pytest.mark.data
@pytest.mark.parametrize(("name", "bit_rate", "mar", "bar"), PUBLISHED, ids=["100 m", "30 m"])
def test_as_published_it_reads_the_authors_recordings_as_they_say(
    beacon_data: Path, name: str, bit_rate: float, mar: float, bar: float
) -> None:
    assert accuracy(beacon_data, name, bit_rate, published(bit_rate)) >= (mar, bar)


@pytest.mark.data
def test_tuned_in_hindsight_it_reads_more_of_the_near_recording(beacon_data: Path) -> None:
    was = published(3125.0)
    tuned = WangParameters(was.upper / 2, was.lower / 2, cutoff=2 / 3, middle=0.55)
    assert accuracy(beacon_data, "3125hz_30m.mat", 3125.0, tuned) >= (0.934, 0.98)


def accuracy(folder: Path, name: str, bit_rate: float, parameters: WangParameters) -> tuple[float, float]:
    """Return the shares of characters and of bits right in the whole pass of the sonnet.

    Where each character was sent is what the default receiver says, which reads the pass without an error.
    """
    scipy_io = pytest.importorskip("scipy.io", reason="reading MATLAB files needs scipy")
    content = scipy_io.loadmat(folder / name)
    t_us = np.round(content["event_t"].ravel() * 1e6).astype(np.int64)
    order = np.argsort(t_us, kind="stable")
    seen = Watched(t_us[order], content["event"].ravel()[order] > 0, int(t_us.max()) + 1)
    sonnet = (folder / "sonnet.txt").read_text()
    truth = [f for f in hear(modulation("uart").receiver(bit_rate), seen) if isinstance(f, LinkFrame)]
    begin = "".join(chr(f.payload) for f in truth).index(sonnet)
    sent = truth[begin : begin + len(sonnet)]
    ends = np.array([f.t_us for f in sent])
    right = bits = 0
    taken: set[int] = set()
    for found in frames(WangReceiver(bit_rate, parameters), seen):
        nearest = int(np.argmin(np.abs(ends - found.t_us)))
        if abs(ends[nearest] - found.t_us) > 5.5e6 / bit_rate or nearest in taken:
            continue
        taken.add(nearest)
        right += found.payload == sent[nearest].payload
        pairs = zip(character_bits(found.payload), character_bits(sent[nearest].payload), strict=True)
        bits += sum(a == b for a, b in pairs)
    print(f"{name}: MAR {right / len(sent):.3f}, BAR {bits / len(sent) / 11:.3f}")
    return right / len(sent), bits / len(sent) / 11


def test_tuned_parameters_have_lower_thresholds_and_a_higher_cutoff_than_published_ones() -> None:
    for rate in (100.0, 504.0, 1500.0, 3125.0):
        was, now = published(rate), tuned(rate)
        assert 0.0 < now.upper < was.upper
        assert was.lower < now.lower < 0.0
        assert now.cutoff > was.cutoff
