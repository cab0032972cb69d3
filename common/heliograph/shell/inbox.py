"""The queue between the reader threads and the one thread that runs the core: bounded; it counts what it drops.

A full queue of independent messages drops its oldest. A full queue of a stream (events) drops all that waits, once: a
reader that is too slow for a while then finds one hole, and what follows is whole. Were its oldest dropped, every
second message would be missing for as long as it is slow; a decoder loses every lock to that, looks for all of them
anew, which takes longer than reading, and so is too slow for good.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from dataclasses import dataclass
from queue import Empty, SimpleQueue


@dataclass(frozen=True, slots=True)
class Sample:
    """What arrived: the bytes under a key, and when (monotonic ns)."""

    topic: str
    key: str
    payload: bytes
    arrived_ns: int


class Inbox:
    """One bounded queue a topic, read in the order of arrival.

    A flood of events so never pushes out tracks.

    Args:
        limits: topic -> most samples that wait.
        streams: topics that drop all that waits when they are full; the others drop their oldest.
    """

    def __init__(self, limits: dict[str, int], streams: frozenset[str] = frozenset()) -> None:
        self._limits = limits
        self._streams = streams
        self._queues: dict[str, deque[tuple[int, Sample]]] = {topic: deque() for topic in limits}
        self._lock = threading.Lock()
        # One token a sample that waits. Waiting on it is C alone: 5 us a message less than on a condition.
        self._waiting: SimpleQueue[None] = SimpleQueue()
        self._number = 0
        self.dropped: Counter[str] = Counter()

    def put(self, sample: Sample) -> None:
        """Append a sample; called by the reader threads."""
        with self._lock:
            queue = self._queues[sample.topic]
            full = len(queue) >= self._limits[sample.topic]
            if full:
                self._drop(sample.topic, queue)
            queue.append((self._number, sample))
            self._number += 1
        if not full:
            self._waiting.put(None)

    def _drop(self, topic: str, queue: deque[tuple[int, Sample]]) -> None:
        """Make room, and leave the token of one that was dropped for the sample that comes."""
        if topic not in self._streams:
            queue.popleft()
            self.dropped[topic] += 1
            return
        self.dropped[topic] += len(queue)
        # Never empty: all that is dropped has its token, but for one that the reader may hold already.
        for _ in range(len(queue) - 1):
            self._waiting.get_nowait()
        queue.clear()

    def get(self, timeout_s: float) -> Sample | None:
        """Return the sample that arrived first, or None after the time."""
        try:
            self._waiting.get(timeout=timeout_s)
        except Empty:
            return None
        with self._lock:
            waiting = [queue for queue in self._queues.values() if queue]
            return min(waiting, key=lambda queue: queue[0][0]).popleft()[1]

    def depth(self) -> int:
        """Return how many samples wait."""
        with self._lock:
            return sum(len(queue) for queue in self._queues.values())
