"""`pulse_interval`: words as worked out by hand come back, and nothing else is one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph.link.codebook import load
from heliograph.link.contract import edges_of
from heliograph.link.frames import CyclicCode, bits_of, seed11_code
from heliograph.link.modulations import MODULATIONS, modulation
from heliograph.link.rises import Rises
from heliograph_services.cli.studies.asynchronous import AsyncPixels
from heliograph_services.cli.studies.strangers import nobody, others, sent
from support.async_lights import read

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "pulse_interval.json").read_text())
P_RATE = 5000.0
END = (1, 0, 0, 0, 1)  # the start after the last word
LIGHT = AsyncPixels(pixels=30, jitter_us=8.0, noise_hz=2e3)


@pytest.mark.parametrize("vector", VECTORS["words"], ids=lambda v: f"{v['bits']}/{v['payload']}")
def test_a_word_is_sent_as_worked_out_by_hand(vector: dict[str, Any]) -> None:
    bits = modulation("pulse_interval", bits=vector["bits"]).encode(vector["payload"])
    assert "".join(map(str, bits)) == vector["on_air"]
    assert len(bits) == vector["units"]


@pytest.mark.parametrize("vector", VECTORS["words"], ids=lambda v: f"{v['bits']}/{v['payload']}")
def test_bare_rises_of_the_vectors_are_read(vector: dict[str, Any]) -> None:
    kind = modulation("pulse_interval", bits=vector["bits"])
    rises_us = np.cumsum([7, *vector["gaps"] * 4, 4]) * 200
    got = read(kind.receiver(P_RATE), rises_us.astype(np.int64), np.ones(len(rises_us), np.bool_))
    assert got.payloads == [vector["payload"]] * 4
    assert [frame.t_us for frame in got.frames] == [(7 + vector["units"] * (k + 1)) * 200 for k in range(4)]
    assert got.identity is not None
    assert got.identity.payload == vector["payload"]


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_any_payload_of_any_length_comes_back(data: st.DataObject) -> None:
    bits = data.draw(st.integers(8, 32))
    payload = data.draw(st.integers(0, 2**bits - 1))
    kind = modulation("pulse_interval", bits=bits)
    ppm = data.draw(st.sampled_from([-20_000.0, 0.0, 300.0, 20_000.0]))
    got = read(kind.receiver(P_RATE), *sent((*kind.encode(payload) * 4, *END), P_RATE, LIGHT, 1, ppm=ppm))
    assert got.payloads == [payload] * 4
    assert got.identity is not None


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(1, 30_000), max_size=20))
def test_any_split_of_the_stream_gives_the_same_frames(cuts: list[int]) -> None:
    kind = modulation("pulse_interval")
    light = AsyncPixels(pixels=5, jitter_us=30.0, noise_hz=1e4, loss=0.2, dropped_edges=0.05)
    t_us, on = sent(kind.encode(77) * 6, P_RATE, light, 3)
    assert read(kind.receiver(P_RATE), t_us, on, cuts) == read(kind.receiver(P_RATE), t_us, on)


def test_a_lost_rise_costs_its_word_alone_and_is_counted() -> None:
    kind = modulation("pulse_interval")
    at_us, levels = edges_of((*kind.encode(42) * 5, *END), 100.0, 200.0)
    rises = at_us[levels]
    t_us = np.delete(rises, 9 + 4).astype(np.int64)  # in the second word
    receiver = kind.receiver(P_RATE)
    got = read(receiver, t_us, np.ones(len(t_us), np.bool_))
    assert got.payloads == [42] * 4
    assert sum(receiver.refusals.values()) == 1


def test_two_equal_words_are_no_identity_and_three_are() -> None:
    kind = modulation("pulse_interval")
    two = read(kind.receiver(P_RATE), *sent((*kind.encode(9) * 2, *END), P_RATE, LIGHT, 0))
    three = read(kind.receiver(P_RATE), *sent((*kind.encode(9) * 3, *END), P_RATE, LIGHT, 0))
    assert (len(two.frames), two.identity) == (2, None)
    assert three.identity is not None
    assert three.identity.frames_used == 3


def test_noise_lamps_and_blinkers_of_random_bits_are_nobody() -> None:
    kind = modulation("pulse_interval")
    for seed in range(3):
        for label, t_us, on in nobody(P_RATE, 1.0, seed):
            assert read(kind.receiver(P_RATE), t_us, on, window_us=20_000).identity is None, label


def test_no_light_of_another_protocol_is_anybody() -> None:
    kind = modulation("pulse_interval")
    for label, t_us, on in others("pulse_interval", MODULATIONS, P_RATE, 0.3, 0):
        assert read(kind.receiver(P_RATE), t_us, on, window_us=20_000).identity is None, label


def test_no_stored_codebook_word_reads_as_a_word_at_the_same_rate() -> None:
    kind = modulation("pulse_interval")
    for book in ("code18d4", "code20d4"):
        code = modulation("code", codebook=book)
        for payload in range(169):
            at_us, levels = edges_of(code.encode(payload) * 12, 100.0, 200.0)
            t_us = at_us[levels].astype(np.int64)
            assert read(kind.receiver(P_RATE), t_us, np.ones(len(t_us), np.bool_)).identity is None


def test_a_longer_word_is_not_read_for_its_first_bits() -> None:
    for bits in (9, 16, 32):
        longer = modulation("pulse_interval", bits=bits)
        receiver = modulation("pulse_interval").receiver(P_RATE)
        got = read(receiver, *sent(longer.encode(77) * 20, P_RATE, LIGHT, bits))
        assert (got.frames, got.identity) == ([], None)
        assert receiver.refusals[Refusal.NO_START_CODE] >= 19


def test_another_payload_takes_over_only_with_three_words_of_its_own() -> None:
    kind = modulation("pulse_interval")
    receiver = kind.receiver(P_RATE)
    bits = (*kind.encode(1) * 4, *kind.encode(2) * 2, *kind.encode(1) * 2, *kind.encode(3) * 3, *END)
    got = read(receiver, *sent(bits, P_RATE, LIGHT, 0))
    assert got.identity is not None
    assert got.identity.payload == 3
    assert receiver.refusals[Refusal.PAYLOAD_CHANGED] == 5


def test_times_that_run_backwards_are_refused_and_counted() -> None:
    receiver = modulation("pulse_interval").receiver(P_RATE)
    receiver.feed(np.array([10, 20], np.int64), np.ones(2, np.bool_), 100)
    receiver.feed(np.array([50], np.int64), np.ones(1, np.bool_), 200)
    receiver.feed(np.empty(0, np.int64), np.empty(0, np.bool_), 150)
    assert receiver.refusals[Refusal.TIME_BACKWARDS] == 2


def test_a_light_that_fades_after_a_glare_is_heard_again() -> None:
    glare = np.full(5000, 1000, np.int64)
    faint = np.repeat(np.arange(1, 40) * 2000 + 10_000, 4).astype(np.int64)
    t_us = np.concatenate([glare, faint])
    rises = Rises(70.0, 6400.0).find(t_us, np.ones(len(t_us), np.bool_))
    assert rises[-1] == faint[-1]


@pytest.mark.parametrize(
    ("options", "named"),
    [({"bits": 7}, r"\[8, 32\], not 7"), ({"bits": "x"}, "'x'"), ({"tolerance_percent": 15}, r"\[1, 14\], not 15")],
)
def test_an_option_out_of_range_is_refused_by_name(options: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        modulation("pulse_interval", **options)


def test_what_cannot_be_sent_or_received_is_refused_by_name() -> None:
    kind = modulation("pulse_interval")
    with pytest.raises(ValueError, match=r"\[0, 255\] \(8 bits\), not 256"):
        kind.encode(256)
    with pytest.raises(ValueError, match="'paper'"):
        kind.receiver(P_RATE, "paper")
    with pytest.raises(ValueError, match="bit rate"):
        kind.receiver(0.0)


def test_the_quality_tells_clock_jitter_and_events() -> None:
    kind = modulation("pulse_interval")
    receiver = kind.receiver(P_RATE)
    t_us, on = sent((*kind.encode(9) * 40, *END), P_RATE, AsyncPixels(pixels=30, jitter_us=3.0), 0, ppm=5000.0)
    read(receiver, t_us, on)
    quality = receiver.quality(int(t_us[-1]))
    assert quality.mar_estimate == 1.0
    assert quality.clock_ppm == pytest.approx(5000.0, abs=300.0)
    assert quality.events_per_transition == pytest.approx(30.0, rel=0.2)
    assert quality.jitter_us is not None
    assert quality.jitter_us < 5.0


@pytest.mark.parametrize(
    "code", [seed11_code(), load("code18d4").code(), load("code20d4").code()], ids=lambda c: c.name
)
def test_no_word_of_a_cyclic_code_reads_as_a_word_at_any_ratio_of_the_clocks(code: CyclicCode) -> None:
    for word in code.words:
        bits = np.array(bits_of(word, code.bits))
        rises = np.flatnonzero((bits == 1) & (np.roll(bits, 1) == 0))
        gaps = np.diff(np.append(rises, rises[0] + code.bits))
        units = gaps[:, None] * np.arange(0.2, 6.0, 0.02)
        n = np.maximum(np.round(units), 1.0)
        legal = ((n >= 2) & (n <= 4) & (np.abs(units - n) <= 0.14 * n)).all(axis=0)
        # Sent for ever, the word would need a start, eight data bits or more, and the next start.
        assert not any((n[:, i] == 4).any() and len(gaps) // (n[:, i] == 4).sum() > 8 for i in np.flatnonzero(legal))
