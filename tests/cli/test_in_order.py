"""The order of publication, whatever overtakes what on the way."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.messages import Data, Message, Progress, Status
from heliograph.wire import Header, header_for
from heliograph_services.cli.in_order import PATIENCE_S, InOrder

TOPICS = ["messages", "status", "progress"]
Sent = tuple[Header, Message]


def text(number: int) -> Message:
    return Data(camera="cam0", track="a-1", t_us=number, protocol="uart", beacon=None, text=str(number), data=None)


def word(number: int, done: bool = False, **published: int) -> Message:
    return Progress(camera="cam0", service="decoder", t_us=number, done=done, published=published)


def status(number: int) -> Message:
    return Status(camera="cam0", as_of_us=number, track=[], status=[], accepted_us=[], identity=[])


def sent(*messages: Message, source: str = "decoder/decoder") -> list[Sent]:
    """Return messages as one sender publishes them, a nanosecond apart."""
    return [
        (header_for(message, source=source, boot="5eed5eed", seq=0, mono_ns=number, wall_ns=0), message)
        for number, message in enumerate(messages, 1)
    ]


def given_for(order: InOrder, arrivals: list[Sent]) -> Iterator[int]:
    for header, message in arrivals:
        order.put(header, message, 0.0)
        yield from (given.time_us for given in order.take(0.0))


@given(st.permutations(range(9)))
def test_any_order_of_arrival_gives_the_order_of_publication(order_of_arrival: list[int]) -> None:
    all_sent = sent(
        text(1), status(2), word(2, messages=1, status=1), status(3), text(4), text(5),
        word(5, messages=3, status=2), text(6), word(6, done=True, messages=4, status=2),
    )  # fmt: skip
    words = iter(number for number in range(9) if isinstance(all_sent[number][1], Progress))
    # Words are one key: they keep their own order.
    arrivals = [
        all_sent[next(words)] if isinstance(all_sent[n][1], Progress) else all_sent[n] for n in order_of_arrival
    ]
    order = InOrder(TOPICS, waits=True)
    assert list(given_for(order, arrivals)) == [1, 2, 3, 4, 5, 6]
    assert order.ended
    assert not order.missing


def test_a_message_is_held_until_all_that_was_published_before_is_here() -> None:
    frame, early, fence = sent(status(1), text(2), word(2, done=True, messages=1, status=1))
    order = InOrder(TOPICS, waits=True)
    assert list(given_for(order, [early, fence])) == []
    assert not order.ended
    assert list(given_for(order, [frame])) == [1, 2]


def test_a_loss_is_waited_for_counted_and_ends_the_wait() -> None:
    first, said, _, second, end = sent(
        text(1), word(1, messages=1), text(2), text(3), word(3, done=True, messages=3)
    )  # fmt: skip
    order = InOrder(TOPICS, waits=True)
    assert list(given_for(order, [first, said, second, end])) == [1]
    assert [message.time_us for message in order.take(PATIENCE_S + 1)] == [3]
    assert order.missing == {"messages": 1}
    assert order.ended


def test_what_was_said_before_a_reader_came_is_no_loss() -> None:
    said, late, end = sent(word(1, messages=7), text(2), word(2, done=True, messages=8))
    order = InOrder(TOPICS, waits=True)
    assert list(given_for(order, [said, late, end])) == []
    assert [message.time_us for message in order.take(PATIENCE_S + 1)] == [2]
    assert not order.missing
    assert order.ended


def test_a_replay_ends_when_each_of_its_decoders_has_ended() -> None:
    order = InOrder(TOPICS, waits=True)
    for source, done in (("decoder/near", True), ("decoder/far", False)):
        list(given_for(order, sent(word(1, done=done), source=source)))
    assert not order.ended
    list(given_for(order, sent(word(2, done=True), source="decoder/far")))
    assert order.ended


@pytest.mark.parametrize("waits", [True, False])
def test_without_words_messages_are_given_after_a_while_or_at_once(waits: bool) -> None:
    order = InOrder(TOPICS, waits=waits)
    assert list(given_for(order, sent(text(1), text(2)))) == ([] if waits else [1, 2])
    assert [message.time_us for message in order.take(PATIENCE_S + 1)] == ([1, 2] if waits else [])
