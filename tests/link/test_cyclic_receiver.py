"""The default receiver: what is sent comes back, whatever the cut, the clock, the jitter or the noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph.link.cyclic import CyclicReceiver
from heliograph.link.frames import bits_of, rotated
from heliograph.link.modulations import modulation
from heliograph.link.modulations.code import Code
from heliograph.link.modulations.seed11 import Seed11
from support.lights import Light, Seen, payloads, read, repeated, seen

SAFE = [p for p in range(64) if p not in Seed11().code.twins and p not in Seed11().code.periodic]
LINKS: dict[str, Seed11 | Code] = {
    "seed11": Seed11(),
    "paper_text": Seed11("paper_text"),
    "code18d4": Code("code18d4"),
    "code20d4": Code("code20d4"),
}


def varied(link: Seed11 | Code, frames: int, seed: int) -> tuple[list[int], list[int]]:
    """Return payloads drawn anew for each frame, and their bits."""
    rng = np.random.default_rng(seed)
    safe = [p for p in range(len(link.code.words)) if p not in link.code.twins and p not in link.code.periodic]
    drawn = [int(p) for p in rng.choice(safe, frames)]
    return drawn, [bit for p in drawn for bit in link.encode(p)]


def right(link: Seed11 | Code, light: Light, bit_rate: float, frames: int, seed: int) -> tuple[int, int]:
    """Return how many frames, each with a payload of its own, come back right, and how many do not."""
    sent, bits = varied(link, frames, seed)
    what = seen(light, bits, bit_rate, seed)
    ends = (1 + np.arange(frames)) * link.code.bits * what.bit_us
    found: set[int] = set()
    wrong = 0
    for frame in read(link.receiver(bit_rate), what):
        i = int(np.argmin(np.abs(ends - frame.t_us)))
        if abs(ends[i] - frame.t_us) < link.code.bits * what.bit_us / 2 and frame.payload == sent[i] and i not in found:
            found.add(i)
        else:
            wrong += 1
    return len(found), wrong


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize("bit_rate", [100.0, 500.0, 1000.0, 2500.0, 5000.0])
def test_every_frame_comes_back_the_first_included(name: str, bit_rate: float) -> None:
    # The first bit's rise may be the first thing seen at all, so one frame may be missing; none may be wrong.
    count, wrong = right(LINKS[name], Light(), bit_rate, 60, 1)
    assert count >= 59
    assert wrong == 0


@settings(max_examples=40)
@given(
    payload=st.sampled_from(SAFE),
    start=st.integers(0, 10),
    clock_ppm=st.floats(-20_000, 20_000),
    bit_rate=st.sampled_from([250.0, 1000.0, 4000.0]),
    jitter=st.floats(0.0, 0.24),
    seed=st.integers(0, 2**31),
)
def test_any_safe_payload_comes_back_under_jitter_loss_and_clock_error(
    payload: int, start: int, clock_ppm: float, bit_rate: float, jitter: float, seed: int
) -> None:
    link = Seed11()
    word = rotated(link.code.words[payload], 11, start)
    scale = 1000.0 / bit_rate
    light = Light(
        delay_on_us=40 * scale,
        delay_off_us=60 * scale,
        tail_us=30 * scale,
        lost=0.2,
        event_jitter=jitter,
        clock_ppm=clock_ppm,
    )
    what = seen(light, repeated(bits_of(word, 11), 40), bit_rate, seed)
    receiver = link.receiver(bit_rate)
    frames = read(receiver, what)
    identity = receiver.identity()
    assert identity is not None
    assert identity.payload == payload
    assert {frame.payload for frame in frames} == {payload}
    assert len(frames) >= 36


@settings(max_examples=30)
@given(
    name=st.sampled_from(sorted(LINKS)),
    cuts=st.lists(st.integers(0, 700_000), max_size=30),
    seed=st.integers(0, 1000),
    noise=st.sampled_from([0.0, 3000.0]),
)
def test_any_split_of_the_events_gives_the_same(name: str, cuts: list[int], seed: int, noise: float) -> None:
    link = LINKS[name]
    bits = [0] * 30 + varied(link, 20, seed)[1] + [0] * 300 + varied(link, 10, seed + 1)[1]
    what = seen(Light(noise_hz=noise, dropped=0.05), bits, 1000.0, seed)
    whole, pieces = link.receiver(1000.0), link.receiver(1000.0)
    assert read(whole, what) == read(pieces, what, cuts)
    assert whole.refusals == pieces.refusals
    assert whole.identity() == pieces.identity()
    assert whole.verdict(what.until_us) == pieces.verdict(what.until_us)
    assert whole.quality(what.until_us) == pieces.quality(what.until_us)


@pytest.mark.parametrize("flipped", range(11))
def test_one_flipped_bit_is_refused_or_another_payload(flipped: int) -> None:
    link = Seed11()
    for payload in (42, 5, 51):
        sent = list(link.encode(payload))
        sent[flipped] ^= 1
        read_ = payloads(link, Light(), payload, 1000.0, 10, 1)
        assert set(read_) == {payload}
        bits = [*repeated(link.encode(payload), 12), *sent, *repeated(link.encode(payload), 12)]
        what = seen(Light(), bits, 1000.0, 1)
        at = [f.payload for f in read(link.receiver(1000.0), what) if abs(f.t_us - 13 * 11_000) < 5_000]
        assert payload not in at


def test_a_code_of_distance_4_corrects_a_flipped_bit() -> None:
    link = LINKS["code20d4"]
    assert isinstance(link, Code)
    sent = list(link.encode(100))
    # A lone one taken away: both its transitions are missing.
    spot = next(i for i in range(1, 19) if sent[i - 1 : i + 2] == [0, 1, 0])
    sent[spot] = 0
    bits = [*repeated(link.encode(100), 8), *sent, *repeated(link.encode(100), 8)]
    frames = read(link.receiver(1000.0), seen(Light(), bits, 1000.0, 1))
    assert [f.payload for f in frames] == [100] * len(frames)
    assert len(frames) >= 16


@pytest.mark.parametrize(
    ("light", "bit_rate", "least"),
    [
        (Light(noise_hz=1e5), 5000.0, 0.97),
        (Light(noise_hz=1e5), 1000.0, 0.95),
        (Light(lost=0.8), 5000.0, 0.92),
        (Light(dropped=0.1), 1000.0, 0.78),
        (Light(edge_jitter=0.15), 1000.0, 0.95),
        (Light(delay_on_us=40.0, delay_off_us=66.0, tail_us=5.0), 5000.0, 0.99),
        (Light(events=300.0, tail_us=100.0), 1000.0, 0.99),
    ],
    ids=["noise-5k", "noise-1k", "lost", "dropped", "jitter", "slow-off", "many"],
)
def test_each_frame_alone_survives_a_bad_light(light: Light, bit_rate: float, least: float) -> None:
    count, wrong = right(LINKS["seed11"], light, bit_rate, 200, 7)
    assert count >= least * 200
    assert wrong <= 0.05 * 200


def test_a_moving_led_is_read_through_its_own_events() -> None:
    link = Seed11()
    sent, bits = varied(link, 120, 5)
    what = seen(Light(), bits, 1000.0, 5)
    # While it is lit and moves, its rims make as many ON as OFF events; four each a bit.
    rng = np.random.default_rng(6)
    lit = np.repeat(np.flatnonzero(bits), 8)
    t = (lit * 1000.0 + rng.uniform(0, 1000, len(lit))).astype(np.int64)
    times, on = np.concatenate([what.t_us, t]), np.concatenate([what.on, rng.random(len(t)) < 0.5])
    order = np.argsort(times, kind="stable")
    frames = read(link.receiver(1000.0), Seen(times[order], on[order], what.until_us, what.bit_us))
    assert [f.payload for f in frames] == sent[-len(frames) :]
    assert len(frames) >= 118


def test_the_light_is_read_again_after_half_a_second_of_occlusion() -> None:
    link = Seed11()
    word = repeated(link.encode(42), 40)
    bits = [*word, *[0] * 500, *word]
    what = seen(Light(), bits, 1000.0, 2)
    receiver = link.receiver(1000.0)
    frames = read(receiver, what)
    after = [f for f in frames if f.t_us > 940_000]
    assert {f.payload for f in frames} == {42}
    assert len(after) == 40
    assert len(frames) >= 79
    assert receiver.refusals[Refusal.OCCLUSION] > 0
    identity = receiver.identity()
    assert identity is not None
    assert identity.since_us < 100_000
    assert receiver.verdict(what.until_us) == "valid"


def test_each_frame_sent_is_published_at_most_once_and_ends_when_its_last_bit_does() -> None:
    link = LINKS["code18d4"]
    _, bits = varied(link, 50, 3)
    what = seen(Light(dropped=0.2, noise_hz=2e4, clock_ppm=9000), bits, 2500.0, 3)
    ends = [f.t_us for f in read(link.receiver(2500.0), what)]
    gaps = np.diff(ends) / what.bit_us
    assert len(ends) > 25
    assert gaps.min() > 17.5
    # 18 bits each, and every one at the same place.
    assert np.abs(gaps / 18 - np.round(gaps / 18)).max() < 0.02


@pytest.mark.parametrize("payload", [14, 61])
def test_an_ambiguous_word_is_told_and_never_guessed(payload: int) -> None:
    link = Seed11()
    what = seen(Light(), repeated(bits_of(link.code.words[payload], 11), 60), 1000.0, 1)
    receiver = link.receiver(1000.0)
    assert read(receiver, what) == []
    assert receiver.refusals[Refusal.AMBIGUOUS] > 30
    assert receiver.identity() is None
    assert receiver.verdict(what.until_us) == "invalid"


@pytest.mark.parametrize("payload", [0, 1, 7, 31])
def test_a_square_wave_is_refused_or_read_and_is_an_identity_only_where_it_is_expected(payload: int) -> None:
    what = seen(Light(), repeated(Seed11().encode(payload), 60), 1000.0, 1)
    receiver = modulation("seed11").receiver(1000.0)
    assert read(receiver, what) == []
    assert receiver.refusals[Refusal.PERIODIC] > 50
    reading = modulation("seed11", periodic="read").receiver(1000.0)
    assert {f.payload for f in read(reading, what)} == {payload}
    assert reading.identity() is None
    assert reading.refusals[Refusal.PERIODIC] > 50
    expecting = modulation("seed11", periodic="believed").receiver(1000.0)
    assert {f.payload for f in read(expecting, what)} == {payload}
    identity = expecting.identity()
    assert identity is not None
    assert identity.payload == payload


def test_the_other_parity_and_a_lost_start_are_refused_by_name() -> None:
    text = Seed11("paper_text")
    what = seen(Light(), repeated(text.encode(42), 60), 1000.0, 1)
    receiver = Seed11().receiver(1000.0)
    assert read(receiver, what) == []
    assert receiver.refusals[Refusal.PARITY] > 30
    what = seen(Light(), [1, 0, 1, 1, 0, 0, 1, 1, 0, 1, 0] * 60, 1000.0, 1)
    receiver = Seed11().receiver(1000.0)
    assert read(receiver, what) == []
    assert receiver.refusals[Refusal.NO_START_CODE] > 30
    what = seen(Light(), repeated(text.encode(42), 60), 1000.0, 1)
    receiver = Code().receiver(1000.0)
    assert read(receiver, what) == []
    assert receiver.refusals[Refusal.UNKNOWN_WORD] > 10


def test_a_changed_payload_is_counted_and_then_believed() -> None:
    link = Seed11()
    bits = [*repeated(link.encode(42), 30), *repeated(link.encode(5), 30)]
    receiver = link.receiver(1000.0)
    read(receiver, seen(Light(), bits, 1000.0, 1))
    identity = receiver.identity()
    assert identity is not None
    assert identity.payload == 5
    assert receiver.refusals[Refusal.PAYLOAD_CHANGED] == 4


def test_the_link_is_measured() -> None:
    link = Seed11()
    what = seen(Light(clock_ppm=-3000, noise_hz=2000), repeated(link.encode(42), 200), 1000.0, 1)
    receiver = link.receiver(1000.0)
    assert receiver.quality(0).mar_estimate is None
    read(receiver, what)
    quality = receiver.quality(what.until_us)
    assert quality.bit_rate == pytest.approx(1003.0, abs=0.5)
    assert quality.clock_ppm == pytest.approx(3009, abs=300)
    assert quality.events_per_transition == pytest.approx(20, abs=3)
    assert quality.mar_estimate == 1.0
    assert quality.jitter_us is not None
    assert quality.jitter_us < 50
    assert quality.snr_db is not None
    assert quality.snr_db > 5


def test_time_that_runs_back_is_refused_and_counted() -> None:
    receiver = Seed11().receiver(1000.0)
    none = np.empty(0, np.int64), np.empty(0, np.bool_)
    receiver.feed(*none, 1_000_000)
    assert receiver.feed(*none, 999_999) == []
    receiver.feed(np.array([5, 2_000_000]), np.array([True, False]), 3_000_000)
    assert receiver.refusals[Refusal.TIME_BACKWARDS] == 2


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(-(2**52), 2**52), st.booleans()), max_size=40), st.integers(0, 1000))
def test_times_that_jump_by_years_cost_nothing_and_break_nothing(jumps: list[tuple[int, bool]], seed: int) -> None:
    link = Seed11()
    receiver = link.receiver(5000.0)
    assert isinstance(receiver, CyclicReceiver)
    bits = repeated(link.encode(42), 30)
    for start, _ in sorted(jumps):
        what = seen(Light(), bits, 5000.0, seed)
        receiver.feed(what.t_us + start, what.on, start + what.until_us)
    receiver.flush()
    assert receiver.verdict(2**53) in {"new", "valid", "invalid"}


def test_a_track_without_events_says_nothing() -> None:
    receiver = Seed11().receiver(1000.0)
    none = np.empty(0, np.int64), np.empty(0, np.bool_)
    assert receiver.feed(*none, 10**12) == []
    assert receiver.flush() == []
    assert receiver.identity() is None
    assert receiver.verdict(10**13) == "new"
    assert receiver.refusals == {}
