"""What a receiver makes of a track's events, however they are cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.events import Flags, Times
from heliograph.link.contract import Identity, LinkFrame, Receiver, Text


@dataclass
class Read:
    """What a receiver made of a track."""

    frames: list[LinkFrame]
    text: str
    identity: Identity | None

    @property
    def payloads(self) -> list[int]:
        return [frame.payload for frame in self.frames]


def read(receiver: Receiver, t_us: Times, on: Flags, cuts: Sequence[int] = (), window_us: int = 0) -> Read:
    """Feed the events, in pieces that end at the cuts (times) or in windows; then the end of the stream.

    The identity is the last that the receiver held at the end of any piece.
    """
    end_us = int(t_us[-1]) + 1 if len(t_us) else 1
    ends = list(range(window_us, end_us, window_us)) if window_us else sorted(c for c in cuts if 0 < c < end_us)
    out: list[LinkFrame | Text] = []
    identity = None
    start = 0
    for until_us in [*ends, end_us]:
        stop = int(np.searchsorted(t_us, until_us))
        out += receiver.feed(t_us[start:stop], on[start:stop], until_us)
        start = stop
        identity = receiver.identity() or identity
    out += receiver.flush()
    identity = receiver.identity() or identity
    frames = [item for item in out if isinstance(item, LinkFrame)]
    return Read(frames, "".join(item.text or "" for item in out if isinstance(item, Text)), identity)
