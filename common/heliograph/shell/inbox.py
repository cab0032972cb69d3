"""The queue between the reader threads and the one thread that runs the core: bounded; it counts what it drops."""

from __future__ import annotations

import threading
from collections import Counter, deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Sample:
    """What arrived: the bytes under a key, and when (monotonic ns)."""

    topic: str
    key: str
    payload: bytes
    arrived_ns: int


class Inbox:
    """One bounded queue a topic, read in the order of arrival; a full queue drops its oldest.

    A flood of events so never pushes out tracks.

    Args:
        limits: topic -> most samples that wait.
    """

    def __init__(self, limits: dict[str, int]) -> None:
        self._limits = limits
        self._queues: dict[str, deque[tuple[int, Sample]]] = {topic: deque() for topic in limits}
        self._ready = threading.Condition()
        self._number = 0
        self.dropped: Counter[str] = Counter()

    def put(self, sample: Sample) -> None:
        """Append a sample; called by reader threads."""
        with self._ready:
            queue = self._queues[sample.topic]
            if len(queue) >= self._limits[sample.topic]:
                queue.popleft()
                self.dropped[sample.topic] += 1
            queue.append((self._number, sample))
            self._number += 1
            self._ready.notify()

    def get(self, timeout_s: float) -> Sample | None:
        """Return the sample that arrived first, or None after the time."""
        with self._ready:
            if not any(self._queues.values()):
                self._ready.wait(timeout_s)
            waiting = [queue for queue in self._queues.values() if queue]
            if not waiting:
                return None
            return min(waiting, key=lambda queue: queue[0][0]).popleft()[1]

    def depth(self) -> int:
        """Return how many samples wait."""
        with self._ready:
            return sum(len(queue) for queue in self._queues.values())
