"""The same cores in one process: source, tracker and decoder joined as on the bus in lockstep, without the bus.

Each core gets each of its inputs when it is `ready` for it, as the shell does it; so the records are those that the
processes publish, byte for byte.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from heliograph.core import Context, Core
from heliograph.messages import Message, Status, Tracks
from heliograph.streams import Events, Onsets

# The words by which cores would tell their process; in one process there is only one.
ONE_PROCESS: Final = Context(instance="pipeline", boot="0", lockstep=True)


class Pipeline:
    """Joins a tracker and a decoder.

    Args:
        tracker: fed with onsets and statuses.
        decoder: fed with events and tracks.
    """

    def __init__(self, tracker: Core, decoder: Core) -> None:
        self._tracker = tracker
        self._decoder = decoder
        self._onsets: deque[Message] = deque()
        self._events: deque[Message] = deque()

    def feed(self, messages: list[Message]) -> list[Message]:
        """Take one step of a source; return what tracker and decoder publish, tracks and statuses included."""
        for message in messages:
            if isinstance(message, Onsets):
                self._onsets.append(message)
            elif isinstance(message, Events):
                self._events.append(message)
        out: list[Message] = []
        moved = True
        while moved:
            moved = False
            while self._onsets and self._tracker.ready(self._onsets[0]):
                self._publish(self._tracker.feed(self._onsets.popleft()), out)
                moved = True
            while self._events and self._decoder.ready(self._events[0]):
                self._publish(self._decoder.feed(self._events.popleft()), out)
                moved = True
        return out

    def _publish(self, messages: list[Message], out: list[Message]) -> None:
        for message in messages:
            out.append(message)
            if isinstance(message, Tracks):
                self._publish(self._decoder.feed(message), out)
            elif isinstance(message, Status):
                self._publish(self._tracker.feed(message), out)

    @property
    def waiting(self) -> int:
        """The number of inputs that no core was ready for; 0 after a step of a whole stream."""
        return len(self._onsets) + len(self._events)
