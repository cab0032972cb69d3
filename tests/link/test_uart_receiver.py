"""Text sent is text read, however the light, the sensor and the cutting of the input are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.link.contract import LinkFrame
from heliograph.link.modulations import modulation
from heliograph.link.modulations.uart import Uart
from heliograph.link.uart_layout import text_bits
from heliograph_services.cli.link_light import Damage
from heliograph_services.cli.link_trials import Section, make_trial, run_trial, slots_of
from support.text_light import TextLight, Watched, edits, hear, joined, watch, watch_text

TEXT = (
    "Rough winds do shake the darling buds of May,\nAnd summer's lease hath all too short a date:\n"
    "Sometime too hot the eye of heaven shines,\n"
)
LIGHTS = {
    "plain": TextLight(),
    "three events a change": TextLight(events=3, tail_bits=0.01, jitter_bits=0.005),
    "a fifth of the events lost": TextLight(events=8, lost=0.2),
    "slow clock": TextLight(clock=0.01),
    "fast clock": TextLight(clock=-0.01),
    "a tail of one bit": TextLight(events=100, tail_bits=1.0),
    "jitter": TextLight(jitter_bits=0.15),
    "late falls": TextLight(tail_bits=0.3, off_bits=0.13),
}


@pytest.mark.parametrize("bit_rate", [100.0, 504.0, 5000.0])
@pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS.keys())
def test_a_text_is_read_from_its_first_character_on(light: TextLight, bit_rate: float) -> None:
    seen = watch_text(light, TEXT, bit_rate, seed=7)
    receiver = modulation("uart").receiver(bit_rate)
    out = hear(receiver, seen)
    assert joined(out) == TEXT
    assert not receiver.refusals
    assert receiver.verdict(seen.until_us) == "valid"


@pytest.mark.parametrize("bit_rate", [200.0, 500.0, 1000.0])
def test_a_scanned_sensor_reads_up_to_a_fifth_of_a_bit_a_scan(bit_rate: float) -> None:
    out = hear(Uart().receiver(bit_rate), watch_text(TextLight(scan_us=199.0), TEXT, bit_rate, seed=3))
    assert edits(TEXT, joined(out)) <= 1


@pytest.mark.parametrize("weaker", [True, False], ids=["rises", "falls"])
def test_changes_of_one_kind_may_make_a_fifth_of_the_others_events(weaker: bool) -> None:
    seen = watch_text(TextLight(events=60), TEXT, 1000.0, seed=11)
    kept = (seen.on != weaker) | (np.random.default_rng(1).random(len(seen.on)) < 0.2)
    assert joined(hear(Uart().receiver(1000.0), Watched(seen.t_us[kept], seen.on[kept], seen.until_us))) == TEXT


def test_noise_of_half_the_lights_own_events_costs_hardly_a_character() -> None:
    out = hear(Uart().receiver(504.0), watch_text(TextLight(noise_hz=2500.0), TEXT, 504.0, seed=5))
    assert edits(TEXT, joined(out)) <= 1


@settings(max_examples=20)
@given(
    text=st.text(st.characters(max_codepoint=126), min_size=20, max_size=40),
    bit_rate=st.floats(100.0, 5000.0),
    seed=st.integers(0, 1 << 30),
)
def test_any_varied_text_comes_back(text: str, bit_rate: float, seed: int) -> None:
    # what is identified must be news: an opening that no periodic signal could be
    text = "Shall I compare " + text
    assert joined(hear(Uart().receiver(bit_rate), watch_text(TextLight(), text, bit_rate, seed))) == text


def test_a_frame_is_a_character_and_ends_with_its_second_stop_bit() -> None:
    bit_rate, lead = 500.0, 30
    seen = watch_text(TextLight(events=50, tail_bits=0.02, jitter_bits=0.0), TEXT, bit_rate, seed=1)
    frames = [f for f in hear(Uart().receiver(bit_rate), seen) if isinstance(f, LinkFrame)]
    assert "".join(chr(frame.payload) for frame in frames) == TEXT
    ends = 1_000_000 + (lead + 11 * np.arange(1, len(TEXT) + 1)) * 1e6 / bit_rate
    late_bits = (np.array([frame.t_us for frame in frames]) - ends) * bit_rate / 1e6
    assert np.all(np.abs(late_bits) < 0.25)
    assert all(0.5 <= frame.score <= 1.0 for frame in frames)


def two_texts(gap_us: int) -> Watched:
    first = watch_text(TextLight(events=10, lost=0.1, noise_hz=300.0), TEXT[:50], 1000.0, seed=3)
    second = watch_text(TextLight(events=10), TEXT[50:90], 1000.0, seed=4, t0_us=first.until_us + gap_us)
    return Watched(
        np.concatenate([first.t_us, second.t_us]), np.concatenate([first.on, second.on]), second.until_us
    )  # fmt: skip


@settings(max_examples=25)
@given(cuts=st.lists(st.integers(1_000_000, 5_200_000), max_size=60), seed=st.integers(0, 1000))
def test_cutting_the_input_anywhere_changes_nothing(cuts: list[int], seed: int) -> None:
    seen = two_texts(gap_us=3_000_000)
    whole, pieces = Uart().receiver(1000.0), Uart().receiver(1000.0)
    expected = hear(whole, seen)
    every = np.random.default_rng(seed).integers(1_000_000, 5_200_000, 500).tolist() if seed % 2 else []
    assert hear(pieces, seen, [*cuts, *every]) == expected
    assert pieces.refusals == whole.refusals
    assert pieces.identity() == whole.identity()
    assert pieces.quality(seen.until_us) == whole.quality(seen.until_us)
    assert joined(expected) == TEXT[:90]


def test_idle_time_of_any_length_between_characters_is_no_character_and_loses_none() -> None:
    rng = np.random.default_rng(2)
    bits: list[int] = []
    for character in TEXT:
        bits += [*text_bits(character), *[1] * int(rng.integers(0, 40) * (rng.random() < 0.3))]
    assert joined(hear(Uart().receiver(1000.0), watch(TextLight(), bits, 1000.0, seed=1))) == TEXT


def test_time_fill_is_a_frame_and_no_text() -> None:
    bits = [*text_bits(TEXT), *[0, *[1] * 10], *[1] * 6, *text_bits(TEXT)]
    out = hear(Uart().receiver(1000.0), watch(TextLight(), bits, 1000.0, seed=1))
    assert joined(out) == TEXT + TEXT
    assert [f.payload for f in out if isinstance(f, LinkFrame)].count(0x7F) == 1


def test_a_character_leaves_within_one_and_a_half_characters_of_its_end() -> None:
    bit_rate = 1000.0
    seen = watch_text(TextLight(), TEXT, bit_rate, seed=1)
    receiver = Uart().receiver(bit_rate)
    late: list[int] = []
    for until_us in range(1_000_000, seen.until_us, 1000):
        i, j = np.searchsorted(seen.t_us, [until_us - 1000, until_us])
        accepted = receiver.identity() is not None
        out = receiver.feed(seen.t_us[i:j], seen.on[i:j], until_us)
        late += [until_us - item.t_us for item in out if accepted]
    assert len(late) > 100
    assert max(late) <= 1.5 * 11 / bit_rate * 1e6


def test_an_occluded_stretch_costs_its_own_characters_and_is_counted() -> None:
    seen = watch_text(TextLight(), TEXT, 1000.0, seed=1)
    begin = 1_030_000 + 11_000 * 60
    kept = (seen.t_us < begin) | (seen.t_us >= begin + 11_000 * 8)
    receiver = Uart().receiver(1000.0)
    got = joined(hear(receiver, Watched(seen.t_us[kept], seen.on[kept], seen.until_us)))
    assert got.startswith(TEXT[:59])
    assert got.endswith(TEXT[72:])
    assert edits(TEXT, got) <= 13


@pytest.mark.parametrize("jump_us", [10_000_000, 3_600_000_000, 1 << 61])
def test_a_jump_of_time_costs_neither_memory_nor_the_text_after_it(jump_us: int) -> None:
    first = watch_text(TextLight(), TEXT, 1000.0, seed=1)
    second = watch_text(TextLight(), TEXT, 1000.0, seed=2, t0_us=first.until_us)
    seen = Watched(
        np.concatenate([first.t_us, second.t_us + jump_us]),
        np.concatenate([first.on, second.on]),
        second.until_us + jump_us,
    )
    assert joined(hear(Uart().receiver(1000.0), seen)) == TEXT + TEXT


def test_the_quality_is_that_of_the_light() -> None:
    seen = watch_text(TextLight(events=40, clock=0.002), TEXT, 1000.0, seed=1)
    receiver = Uart().receiver(1000.0)
    hear(receiver, seen)
    quality = receiver.quality(seen.until_us)
    assert quality.bit_rate == pytest.approx(1000.0 / 1.002, rel=2e-4)
    assert quality.clock_ppm == pytest.approx(-1996, abs=200)
    assert quality.events_per_transition == pytest.approx(40, rel=0.1)
    assert quality.mar_estimate == 1.0
    assert quality.snr_db is not None
    assert quality.snr_db > 10
    assert quality.jitter_us is not None
    assert quality.jitter_us < 100


def test_nothing_is_known_of_a_track_without_events() -> None:
    receiver = Uart().receiver(504.0)
    empty = Watched(np.empty(0, np.int64), np.empty(0, np.bool_), 10_000_000)
    assert hear(receiver, empty) == []
    assert receiver.identity() is None
    assert receiver.verdict(10_000_000) == "new"
    assert receiver.quality(10_000_000).mar_estimate is None


@pytest.mark.parametrize(
    ("damage", "read_least", "wrong_most"),
    [
        (Damage(edge_jitter_bits=0.1), 0.98, 4),
        (Damage(edge_jitter_bits=0.2), 0.96, 16),
        (Damage(dropped=0.02), 0.94, 4),
    ],
    ids=["edges early or late by .1 bit", "by .2 bit", "one edge in fifty lost"],
)
def test_edges_that_are_displaced_or_lost_cost_hardly_more_than_what_they_make_ambiguous(
    damage: Damage, read_least: float, wrong_most: int
) -> None:
    section = Section("uart", 3125.0, 80)
    trial = make_trial(section, damage, 2.5, 9)
    scored = run_trial(trial, lambda: Uart().receiver(3125.0), slots_of(section))
    sent, right, wrong = (sum(getattr(c, k) for c in scored.seconds.values()) for k in ("sent", "right", "wrong"))
    assert right >= read_least * sent
    assert wrong <= wrong_most
