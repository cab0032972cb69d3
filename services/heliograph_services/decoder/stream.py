"""The raw events of one stream, cut into windows of an absolute grid.

Windows begin at multiples of window_us, whatever the messages are; one is handed out when the watermark has passed its
end. What breaks the order of time is refused by name, and what is beyond repair begins the stream anew; no loop runs
over a gap.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.errors import Refusal
from heliograph.events import EventBatch, concatenate
from heliograph.messages import TIME_LIMIT_US
from heliograph.streams import Events

# A gap, or a message, that is longer is a jump: after a second of silence no clock is locked and no region is right.
JUMP_US: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Window:
    """The events in [t0_us, t1_us); the last window of a stream is cut short, and holds what lies on its end."""

    t0_us: int
    t1_us: int
    batch: EventBatch
    last: bool


@dataclass(frozen=True, slots=True)
class Entry:
    """What to do with a message: take it or not, begin anew before it or not, and what to count."""

    take: bool
    anew: bool
    refusal: Refusal | None


class EventStream:
    """One run of a camera.

    Args:
        first: the message that it begins with.
        window_us: length of a window.
        beat_us: whole windows; the first begins at a multiple of it.
    """

    def __init__(self, first: Events, window_us: int, beat_us: int) -> None:
        self.name = first.stream
        self.width = first.width
        self.height = first.height
        self.began_us = first.t0_us
        self.watermark_us = first.t0_us
        self.now_us = first.t0_us - first.t0_us % beat_us
        self._window_us = window_us
        self._waiting: deque[EventBatch] = deque()

    def entry(self, events: Events) -> Entry:
        """Return what a further message is to this stream."""
        if events.stream != self.name:
            return Entry(take=True, anew=True, refusal=None)
        if (events.width, events.height) != (self.width, self.height):
            return Entry(take=True, anew=True, refusal=Refusal.OTHER_GEOMETRY)
        if events.t0_us < self.watermark_us:
            # A message that comes twice, or late, is dropped; a camera that begins anew is followed.
            again = events.t0_us <= self.began_us or events.t0_us < self.watermark_us - JUMP_US
            return Entry(take=again, anew=again, refusal=Refusal.TIME_BACKWARDS)
        if events.t0_us > self.watermark_us + JUMP_US:
            return Entry(take=True, anew=True, refusal=Refusal.TIME_JUMP)
        return Entry(take=True, anew=False, refusal=None)

    def push(self, events: Events) -> None:
        """Take the events of a message that `entry` lets in."""
        if len(events.batch):
            self._waiting.append(_owned(events.batch))
        self.watermark_us = events.t1_us

    def windows(self, *, end: bool) -> Iterator[Window]:
        """Hand out the windows that the watermark has passed; at the end the rest as well."""
        while self.now_us + self._window_us <= self.watermark_us:
            t1_us = self.now_us + self._window_us
            window = Window(self.now_us, t1_us, self._until(t1_us), last=False)
            self.now_us = t1_us
            yield window
        if end:
            # The last events may lie on the watermark itself.
            t1_us = max(self.watermark_us, self.now_us) + 1
            yield Window(self.now_us, t1_us, self._until(t1_us), last=True)
            self.now_us = t1_us

    def _until(self, t_us: int) -> EventBatch:
        parts: list[EventBatch] = []
        while self._waiting:
            batch = self._waiting[0]
            n = int(np.searchsorted(batch.t_us, t_us))
            if n < len(batch):
                if n:
                    parts.append(batch.part(0, n))
                    self._waiting[0] = batch.part(n, len(batch))
                break
            parts.append(self._waiting.popleft())
        return concatenate(parts)


def fault(events: Events) -> Refusal | None:
    """Return what is wrong with a message by itself (the order of its events is the sender's word)."""
    # Windows reach over a message's ends, and may not leave what a record can carry.
    if max(abs(events.t0_us), abs(events.t1_us)) > TIME_LIMIT_US - JUMP_US:
        return Refusal.TIME_JUMP
    if not 0 <= events.t1_us - events.t0_us <= JUMP_US:
        return Refusal.TIME_JUMP
    t_us = events.batch.t_us
    if len(t_us) and not events.t0_us <= int(t_us[0]) <= int(t_us[-1]) <= events.t1_us:
        return Refusal.UNORDERED
    return None


def _owned(batch: EventBatch) -> EventBatch:
    """Return the batch in arrays that kernels take without a second compilation: writable and contiguous."""
    flags = (batch.t_us.flags, batch.x_px.flags, batch.y_px.flags, batch.on.flags)
    if all(flag.writeable and flag.c_contiguous for flag in flags):
        return batch
    return EventBatch(batch.t_us.copy(), batch.x_px.copy(), batch.y_px.copy(), batch.on.copy())
