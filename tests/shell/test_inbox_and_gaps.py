"""The bounded queue and the count of what is missing."""

from __future__ import annotations

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.shell.bus import Gaps
from heliograph.shell.inbox import Inbox, Sample
from support.records import every_record, header_of


def sample(topic: str, n: int) -> Sample:
    return Sample(topic, "k", bytes([n]), n)


def test_samples_leave_in_the_order_in_which_they_came_across_topics() -> None:
    inbox = Inbox({"events": 10, "tracks": 10})
    for n, topic in enumerate(["events", "tracks", "events", "tracks"]):
        inbox.put(sample(topic, n))
    assert [item.payload[0] for item in iter(lambda: inbox.get(0), None)] == [0, 1, 2, 3]


def test_a_flood_drops_its_own_oldest_counts_it_and_spares_other_topics() -> None:
    inbox = Inbox({"events": 3, "tracks": 3})
    inbox.put(sample("tracks", 100))
    for n in range(10):
        inbox.put(sample("events", n))
    assert [item.payload[0] for item in iter(lambda: inbox.get(0), None)] == [100, 7, 8, 9]
    assert inbox.dropped == {"events": 7}


def test_a_full_stream_drops_all_that_waits_once_and_goes_on_without_a_hole() -> None:
    inbox = Inbox({"events": 3, "tracks": 3}, frozenset({"events"}))
    inbox.put(sample("tracks", 100))
    for n in range(11):
        inbox.put(sample("events", n))
    assert [item.payload[0] for item in iter(lambda: inbox.get(0), None)] == [100, 9, 10]
    assert inbox.dropped == {"events": 9}


@pytest.mark.parametrize("limit", [1, 2, 7])
def test_a_reader_that_is_slower_than_a_stream_gets_or_sees_counted_each_message(limit: int) -> None:
    inbox = Inbox({"events": limit, "tracks": limit}, frozenset({"events"}))

    def send(topic: str) -> None:
        for n in range(3000):
            inbox.put(Sample(topic, "k", n.to_bytes(2, "big"), n))

    senders = [threading.Thread(target=send, args=(topic,)) for topic in ("events", "tracks")]
    got: list[tuple[str, int]] = []
    for sender in senders:
        sender.start()
    while any(sender.is_alive() for sender in senders) or inbox.depth():
        found = inbox.get(0.01)
        if found is not None:
            got.append((found.topic, found.arrived_ns))
    for topic in ("events", "tracks"):
        numbers = [n for name, n in got if name == topic]
        assert numbers == sorted(set(numbers))
        assert len(numbers) + inbox.dropped[topic] == 3000


def test_a_reader_that_waits_is_woken() -> None:
    inbox = Inbox({"events": 1})
    threading.Timer(0.01, inbox.put, [sample("events", 5)]).start()
    found = inbox.get(30)
    assert found is not None
    assert found.payload == b"\x05"


@given(st.lists(st.booleans(), min_size=1, max_size=60))
def test_what_is_missing_is_exactly_what_was_lost_after_the_first_arrival(kept: list[bool]) -> None:
    gaps = Gaps()
    message = every_record()[2]
    arrived = [seq for seq, keep in enumerate(kept) if keep]
    for seq in arrived:
        gaps.see("tracks", "k", header_of(message, seq))
    lost = arrived[-1] - arrived[0] + 1 - len(arrived) if arrived else 0
    assert gaps.missing["tracks"] == lost


def test_from_the_start_the_lost_first_messages_count_too() -> None:
    gaps = Gaps()
    assert gaps.see("tracks", "k", header_of(every_record()[2], 4), from_start=True) == 4


def test_a_late_or_repeated_message_is_no_gap() -> None:
    gaps = Gaps()
    for seq in (0, 1, 5, 3, 5, 6):
        gaps.see("tracks", "k", header_of(every_record()[2], seq))
    assert gaps.missing["tracks"] == 3


def test_invented_senders_do_not_fill_the_memory() -> None:
    gaps = Gaps()
    header = header_of(every_record()[2])
    for n in range(5000):
        gaps.see("tracks", f"k{n}", header)
    assert len(gaps._next) <= 1024


def test_a_depth_is_what_waits() -> None:
    inbox = Inbox({"events": 4})
    for n in range(6):
        inbox.put(sample("events", n))
    assert inbox.depth() == 4


def test_an_unknown_topic_is_a_programmers_error() -> None:
    with pytest.raises(KeyError):
        Inbox({}).put(sample("events", 1))
