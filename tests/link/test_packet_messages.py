"""Messages in packets and out again: fragments in any order, repeats said once, losses counted, memory bounded."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from heliograph.errors import Refusal, Refusals
from heliograph.link.packet_layout import Packet
from heliograph.link.packet_messages import (
    DONE_LIMIT,
    MESSAGES_LIMIT,
    REPEAT_US,
    Message,
    Reassembler,
    packets_of,
)

PACKET_US = 60_000.0


def fresh() -> tuple[Reassembler, Refusals]:
    refusals = Refusals()
    return Reassembler(refusals, PACKET_US), refusals


def heard(reassembler: Reassembler, packets: list[Packet], t0_us: int = 0) -> list[Message]:
    taken = [reassembler.take(packet, t0_us + i * 60_000) for i, packet in enumerate(packets)]
    return [message for message in taken if message is not None]


@given(st.binary(max_size=1024), st.randoms(use_true_random=False))
def test_a_message_comes_whole_in_any_order_of_its_fragments(data: bytes, order: random.Random) -> None:
    packets = packets_of(data, 9, 3, 16)
    assert len(packets) == max(1, -(-len(data) // 16))
    order.shuffle(packets)
    said = heard(fresh()[0], packets)
    assert said == ([Message(9, False, 3, data)] if data else [])


@given(st.text(max_size=200))
def test_text_survives_where_a_fragment_ends_within_a_character(text: str) -> None:
    said = heard(fresh()[0], packets_of(text, 0, 0, 16))
    assert [message.data.decode() for message in said] == ([text] if text else [])


def test_a_repeat_is_said_once_and_counted() -> None:
    reassembler, refusals = fresh()
    first, second = packets_of(b"one", 1, 0, 16), packets_of("two, and in two fragments", 1, 1, 16)
    assert [m.data for m in heard(reassembler, [*first, *second, *first, *second, *first])] == [
        b"one",
        b"two, and in two fragments",
    ]
    assert refusals[Refusal.REPEATED] == 4
    assert refusals[Refusal.LOST] == 0


def test_a_new_message_under_a_repeated_number_is_said() -> None:
    reassembler, refusals = fresh()
    assert [m.data for m in heard(reassembler, [*packets_of(b"a", 1, 0, 16), *packets_of(b"b", 1, 0, 16)])] == [
        b"a",
        b"b",
    ]
    assert not refusals


def test_the_same_words_under_a_number_of_the_next_round_are_said_again() -> None:
    reassembler, refusals = fresh()
    packets = [packets_of(b"same", 1, number, 16)[0] for number in range(40)]
    assert len(heard(reassembler, packets)) == 40
    assert not refusals


def test_a_skipped_number_is_a_lost_message() -> None:
    reassembler, refusals = fresh()
    heard(reassembler, [packets_of(b"x", 1, number, 16)[0] for number in (14, 15, 2, 3)])
    assert refusals[Refusal.LOST] == 2
    heard(reassembler, packets_of(b"begun anew", 1, 0, 16), 10**6)
    assert refusals[Refusal.LOST] == 2


def test_an_incomplete_message_waits_for_its_repeat_and_is_given_up_after_silence() -> None:
    reassembler, refusals = fresh()
    whole = packets_of(bytes(range(48)), 1, 0, 16)
    assert not heard(reassembler, [whole[0], whole[2]])
    assert [m.data for m in heard(reassembler, [whole[1]], 5 * 10**6)] == [bytes(range(48))]
    heard(reassembler, packets_of(bytes(40), 1, 1, 16)[:2], 6 * 10**6)
    reassembler.expire(10**8)
    assert refusals[Refusal.LOST] == 1


def test_fragments_that_contradict_begin_another_message() -> None:
    reassembler, refusals = fresh()
    old, new = packets_of(bytes(48), 1, 0, 16), packets_of(bytes([1]) * 33, 1, 0, 16)
    assert [m.data for m in heard(reassembler, [*old[:2], *new])] == [bytes([1]) * 33]
    assert refusals[Refusal.LOST] == 1


def test_a_beacon_that_was_silent_for_long_says_it_again() -> None:
    reassembler, _ = fresh()
    packets = packets_of(b"hello", 1, 0, 16)
    assert len(heard(reassembler, packets)) == 1
    assert not heard(reassembler, packets, REPEAT_US)
    assert len(heard(reassembler, packets, 3 * REPEAT_US)) == 1


@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 15), st.integers(0, 63), st.booleans()), max_size=200))
def test_memory_is_bounded_whatever_comes(rows: list[tuple[int, int, int, bool]]) -> None:
    reassembler, _refusals = fresh()
    for i, (address, number, fragment, more) in enumerate(rows):
        reassembler.take(Packet(address, False, number, fragment, more, bytes(16)), i * 1000)
        assert len(reassembler._parts) <= MESSAGES_LIMIT
        assert len(reassembler._done) <= DONE_LIMIT
        assert len(reassembler._newest) <= MESSAGES_LIMIT
    reassembler.close()
    assert not reassembler._parts
