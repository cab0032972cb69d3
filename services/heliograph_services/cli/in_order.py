"""The order in which a replay's messages were published, restored by the reader.

Keys of different priority overtake one another on their way, by any time on a loaded machine. A service in lockstep
says after each batch how many messages of each topic it had published (`heliograph.messages.Progress.published`). For
a sender with such a word at its time T (header.mono_ns), the messages before T are given, in the order of their times,
once as many of each topic are here as the word counts. Only a loss is waited for in vain, and counted as one.
"""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from heliograph.messages import Message, Progress
from heliograph.wire import Header

# What has not come by then is lost: five retransmissions of TCP's first second, and a machine that swaps.
PATIENCE_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class _Word:
    """What a sender had published at a time of its clock; and when it was heard, and whether it was the last."""

    mono_ns: int
    published: dict[str, int]
    heard_s: float
    done: bool


@dataclass(slots=True)
class _Sender:
    """What came of one sender: waiting messages as a heap by its clock, and its words that do not hold yet."""

    waiting: list[tuple[int, int, str, float, Message]] = field(default_factory=list)
    words: deque[_Word] = field(default_factory=deque)
    given: Counter[str] = field(default_factory=Counter)
    # Published before this reader came, or lost.
    never: Counter[str] = field(default_factory=Counter)
    joined: bool = False
    done: bool = False


class InOrder:
    """Gives the messages of a replay in the order in which each sender published them.

    Args:
        topics: the topics that are read.
        waits: whether to wait for what was overtaken; if not, messages are given as they come.
    """

    def __init__(self, topics: Iterable[str], *, waits: bool) -> None:
        self.missing: Counter[str] = Counter()
        self._topics = [topic for topic in topics if topic != Progress.SCHEMA]
        self._waits = waits
        self._number = 0
        self._senders: dict[tuple[str, str], _Sender] = {}

    @property
    def ended(self) -> bool:
        """Whether every decoder that was heard has said its last word, and all before it was given."""
        # By source: one that was started anew speaks for the one before.
        decoders = {
            source: sender.done for (source, _), sender in self._senders.items() if source.startswith("decoder/")
        }
        return self._waits and bool(decoders) and all(decoders.values())

    def put(self, header: Header, message: Message, now_s: float) -> None:
        """Take a message, or a sender's word on its progress, heard at now_s."""
        sender = self._senders.setdefault((header.source, header.boot), _Sender())
        if isinstance(message, Progress):
            if self._waits:
                sender.words.append(_Word(header.mono_ns, message.published, now_s, message.done))
            return
        self._number += 1
        order = header.mono_ns if self._waits else 0
        heapq.heappush(sender.waiting, (order, self._number, header.schema, now_s, message))

    def take(self, now_s: float) -> Iterator[Message]:
        """Give what may be given at now_s."""
        for sender in self._senders.values():
            if not self._waits:
                yield from self._until(sender, 0)
                continue
            while sender.words and self._holds(sender, sender.words[0], now_s):
                word = sender.words.popleft()
                yield from self._until(sender, word.mono_ns)
                sender.done = word.done
            if not sender.words:
                # Of a sender that says nothing of its progress: nothing to wait for but time.
                while sender.waiting and now_s - sender.waiting[0][3] > PATIENCE_S:
                    yield self._pop(sender)

    def rest(self) -> Iterator[Message]:
        """Give what is left, at the end."""
        for sender in self._senders.values():
            while sender.waiting:
                yield self._pop(sender)

    def _holds(self, sender: _Sender, word: _Word, now_s: float) -> bool:
        here = Counter(topic for mono_ns, _, topic, _, _ in sender.waiting if mono_ns <= word.mono_ns)
        short = {
            topic: short
            for topic in self._topics
            if (short := word.published.get(topic, 0) - here[topic] - sender.given[topic] - sender.never[topic]) > 0
        }
        if short and now_s - word.heard_s <= PATIENCE_S:
            return False
        sender.never.update(short)
        if sender.joined:
            self.missing.update(short)
        # What a first word counts beyond what is here may have been said before this reader came.
        sender.joined = True
        return True

    def _until(self, sender: _Sender, mono_ns: int) -> Iterator[Message]:
        while sender.waiting and sender.waiting[0][0] <= mono_ns:
            yield self._pop(sender)

    @staticmethod
    def _pop(sender: _Sender) -> Message:
        _, _, topic, _, message = heapq.heappop(sender.waiting)
        sender.given[topic] += 1
        return message
