"""Packets read from a track's events: messages whole, from a cold start, whatever the cut; nothing where nothing is."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph.events import Flags, Times
from heliograph.link.contract import LinkFrame, Text
from heliograph.link.modulations import modulation
from heliograph.link.modulations.packet import Packet
from heliograph.link.packet_receiver import PacketReceiver
from support.lights import Light, Seen, repeated, seen
from support.text_light import Watched, hear

RATE = 5000.0
NOTHING = np.empty(0, np.int64), np.empty(0, np.bool_)


def spoken(count: int, seed: int = 0, address: int = 7) -> tuple[list[bytes], list[int]]:
    """Return messages of 16 random bytes, and their bits one right after another."""
    rng = np.random.default_rng(seed)
    messages = [rng.bytes(16) for _ in range(count)]
    bits = [bit for i, data in enumerate(messages) for bit in Packet().message(data, address, i)]
    return messages, bits


def receiver_of(bit_rate: float = RATE) -> PacketReceiver:
    made = Packet().receiver(bit_rate)
    assert isinstance(made, PacketReceiver)
    return made


def data_of(out: Sequence[LinkFrame | Text]) -> list[bytes | str | None]:
    return [item.text if item.data is None else item.data for item in out if isinstance(item, Text)]


@pytest.mark.parametrize(
    "light",
    [
        Light(),
        Light(dropped=0.05),
        Light(dropped=0.05, events=6.0),
        Light(dropped=0.05, noise_hz=5000.0),
        Light(dropped=0.05, edge_jitter=0.08),
        Light(clock_ppm=15_000.0),
        Light(clock_ppm=-15_000.0, lost=0.5),
        Light(tail_us=200.0, events=60.0),
    ],
    ids=["clean", "dropped", "few", "noise", "jitter", "slow", "fast", "tails"],
)
def test_every_message_is_said_once_and_in_order(light: Light) -> None:
    messages, bits = spoken(12)
    receiver = receiver_of()
    out = hear(receiver, _watched(seen(light, bits, RATE, seed=1)))
    assert data_of(out) == messages
    identity = receiver.identity()
    assert identity is not None
    assert (identity.payload, identity.frames_used) == (7, 12)
    assert receiver.refusals[Refusal.LOST] == 0


def test_a_light_whose_bursts_are_longer_than_bits_is_read() -> None:
    # As a pixel in dim light: each event is late by an exponential of two bits, but none comes after the next edge.
    messages, bits = spoken(12)
    light = Light(events=80.0, tail_us=400.0, delay_on_us=20.0, delay_off_us=60.0)
    what = _turned(seen(light, bits, RATE, seed=2), bits)
    said = data_of(hear(receiver_of(), _watched(what)))
    assert said == messages[-len(said) :]
    assert len(said) >= 10


@given(st.lists(st.integers(1, 300_000), max_size=12))
@settings(max_examples=12)
def test_how_the_events_are_cut_changes_nothing(cuts: list[int]) -> None:
    _, bits = spoken(3)
    what = _watched(seen(Light(dropped=0.05, noise_hz=2000.0), [0] * 400 + bits + [0] * 200, RATE, seed=3))
    whole, parts = receiver_of(), receiver_of()
    assert hear(whole, what) == hear(parts, what, cuts)
    assert whole.refusals == parts.refusals
    assert whole.identity() == parts.identity()
    assert whole.quality(what.until_us) == parts.quality(what.until_us)


def test_a_cold_start_in_mid_stream_costs_the_packet_that_is_cut_and_no_other() -> None:
    messages, bits = spoken(8)
    what = seen(Light(), bits, RATE, seed=4)
    for late in (70, 309, 400, 617):
        start_us = late * 200
        kept = what.t_us >= start_us
        out = hear(receiver_of(), _watched(Seen(what.t_us[kept], what.on[kept], what.until_us, what.bit_us)))
        first = -(-late // 309)
        assert data_of(out)[-(8 - first) :] == messages[first:]


def test_the_light_comes_back_after_the_dark_and_no_packet_is_lost() -> None:
    messages, bits = spoken(4)
    gap = [0] * 3000
    parts = [bits[i * 309 : (i + 1) * 309] for i in range(4)]
    sent = [bit for part in parts for bit in (*part, *gap)]
    out = hear(receiver_of(), _watched(seen(Light(), sent, RATE, seed=5)))
    assert data_of(out) == messages


def test_a_text_of_many_fragments_is_said_whole() -> None:
    text = "Grüße: " + "heliograph " * 20
    bits = [*Packet().message("first", 3, 0), *Packet().message(text, 3, 1), 0]
    out = hear(receiver_of(), _watched(seen(Light(dropped=0.02), bits, RATE, seed=6)))
    assert data_of(out) == ["first", text]
    assert all(item.whole for item in out if isinstance(item, Text))


def test_what_calls_itself_text_and_is_none_is_said_as_bytes() -> None:
    from heliograph.link.packet_layout import Layout  # noqa: PLC0415 - here alone
    from heliograph.link.packet_layout import Packet as Fields  # noqa: PLC0415

    bits = [*Layout().encode(Fields(1, True, 0, 0, False, b"\xff\xfe")), 0]
    assert data_of(hear(receiver_of(), _watched(seen(Light(), bits, RATE, seed=7)))) == [b"\xff\xfe"]


def test_an_empty_message_identifies_and_says_nothing() -> None:
    receiver = receiver_of()
    out = hear(receiver, _watched(seen(Light(), [*Packet().encode(200), 0], RATE, seed=8)))
    assert [item.payload for item in out if isinstance(item, LinkFrame)] == [200]
    assert data_of(out) == []
    identity = receiver.identity()
    assert identity is not None
    assert identity.payload == 200


def test_another_sender_on_the_track_is_another_identity() -> None:
    receiver = receiver_of()
    bits = [*Packet().message(b"a", 1, 0), *Packet().message(b"b", 2, 0), 0]
    assert data_of(hear(receiver, _watched(seen(Light(), bits, RATE, seed=9)))) == [b"a", b"b"]
    identity = receiver.identity()
    assert identity is not None
    assert (identity.payload, identity.frames_used) == (2, 1)


@pytest.mark.parametrize("dropped", [0.5, 1.0])
def test_a_light_that_loses_half_its_transitions_says_nothing_wrong(dropped: float) -> None:
    messages, bits = spoken(20)
    light = Light(dropped=dropped, noise_hz=3000.0)
    assert set(data_of(hear(receiver_of(), _watched(seen(light, bits, RATE, seed=10))))) <= set(messages)


def test_other_protocols_noise_and_random_bits_say_nothing() -> None:
    rng = np.random.default_rng(11)
    others = [
        repeated(modulation("seed11").encode(42), 500),
        repeated(modulation("code").encode(17), 300),
        list(modulation("uart").encode("Shall I compare thee to a summer's day? " * 10)),
        rng.integers(0, 2, 20_000).tolist(),
        [0, 1] * 3000,
    ]
    for i, bits in enumerate(others):
        receiver = receiver_of()
        assert hear(receiver, _watched(seen(Light(), bits, RATE, seed=i))) == []
        assert receiver.identity() is None
        assert receiver.refusals[Refusal.NO_START_CODE] + receiver.refusals[Refusal.NO_CLOCK] > 0
    receiver = receiver_of()
    assert hear(receiver, _watched(seen(Light(events=0.0, noise_hz=30_000.0), [0] * 10_000, RATE, seed=12))) == []


def test_verdicts_follow_what_was_read() -> None:
    _, bits = spoken(6)
    what = seen(Light(), bits, RATE, seed=13)
    receiver = receiver_of()
    assert receiver.verdict(0) == "new"
    hear(receiver, _watched(what), flush=False)
    assert receiver.verdict(what.until_us) == "valid"
    assert receiver.verdict(what.until_us + 2_100_000) == "invalid"
    stranger = receiver_of()
    stranger.feed(np.array([1000], np.int64), np.ones(1, np.bool_), 2000)
    assert stranger.verdict(300_000) == "new"
    assert stranger.verdict(400_000) == "invalid"


def test_quality_tells_the_clock_and_the_share_of_packets_read() -> None:
    _, bits = spoken(12)
    what = seen(Light(clock_ppm=300.0), bits, RATE, seed=14)
    receiver = receiver_of()
    assert receiver.quality(0).mar_estimate is None
    hear(receiver, _watched(what), flush=False)
    quality = receiver.quality(what.until_us)
    assert quality.mar_estimate == 1.0
    assert quality.clock_ppm == pytest.approx(-300.0, abs=150.0)
    assert quality.events_per_transition == pytest.approx(20.0, rel=0.2)


def test_time_that_runs_backwards_is_refused_and_counted() -> None:
    receiver = receiver_of()
    receiver.feed(*NOTHING, 1000)
    assert receiver.feed(*NOTHING, 500) == []
    receiver.feed(np.array([900, 1100], np.int64), np.ones(2, np.bool_), 2000)
    assert receiver.refusals[Refusal.TIME_BACKWARDS] == 2


def test_a_receiver_of_no_such_name_or_rate_is_refused() -> None:
    with pytest.raises(ValueError, match="receiver of packet must be default, not 'paper'"):
        Packet().receiver(RATE, "paper")
    with pytest.raises(ValueError, match="bit rate must be in"):
        Packet().receiver(0.1)


def _watched(what: Seen) -> Watched:
    # Tails may go on behind the last bit.
    last_us = int(what.t_us[-1]) + 1 if len(what.t_us) else 0
    return Watched(what.t_us, what.on, max(what.until_us, last_us))


def _turned(what: Seen, bits: Sequence[int]) -> Seen:
    """Return only the events whose polarity is the light's own level when they come."""
    at = np.clip(((what.t_us - 30) / what.bit_us).astype(np.int64), 0, len(bits) - 1)
    kept: Flags = np.array(bits, np.bool_)[at] == what.on
    times: Times = what.t_us[kept]
    assert all(a <= b for a, b in pairwise(times.tolist()))
    return Seen(times, what.on[kept], what.until_us, what.bit_us)
