"""When a Tracks message takes effect (heliograph.core: lockstep).

Lockstep: a message of the instant A counts from event time A + period on; events up to t1 may be decoded as soon as
t1 <= newest A + 2 period, where before any message A is the first event time rounded down to a period. Live: the newest
counts from the next window on.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from heliograph.errors import Refusal
from heliograph.messages import Tracks

# A tracker that is further behind the events than this speaks of another stream: no prediction bridges it.
PAST_US: Final = 5_000_000
# Events and onsets leave the source together: a tracker that is this far ahead has a damaged time.
FUTURE_US: Final = 1_000_000
# In lockstep two are under way; more is a sender out of step.
PENDING_LIMIT: Final = 64


def _near(tracks: Tracks, now_us: int) -> bool:
    return now_us - PAST_US <= tracks.as_of_us <= now_us + FUTURE_US


class Schedule:
    """The Tracks messages that have come and not yet taken effect.

    Args:
        lockstep: see the module.
        period_us: the tracker's period, until a message says it.
    """

    def __init__(self, *, lockstep: bool, period_us: int) -> None:
        self._lockstep = lockstep
        self._period_us = period_us
        self._pending: deque[Tracks] = deque()
        self._newest: Tracks | None = None

    def restart(self) -> None:
        """Forget all: the camera's time has begun anew."""
        self._pending.clear()
        self._newest = None

    def offer(self, tracks: Tracks, now_us: int | None) -> Refusal | None:
        """Take a message, or say why not.

        Args:
            tracks: the message.
            now_us: the events' time, None before the first.
        """
        if self._newest is not None and tracks.as_of_us <= self._newest.as_of_us:
            return Refusal.TIME_BACKWARDS
        if now_us is not None and not _near(tracks, now_us):
            return Refusal.TIME_JUMP
        if not self._lockstep:
            self._pending.clear()
        elif len(self._pending) >= PENDING_LIMIT:
            return Refusal.CORE_FAULT
        self._newest = tracks
        self._pending.append(tracks)
        return None

    def due(self, now_us: int) -> Tracks | None:
        """Return the next message that takes effect in the window that begins at now_us, if there is one."""
        if not self._pending:
            return None
        first = self._pending[0]
        if self._lockstep and first.as_of_us + first.period_us > now_us:
            return None
        return self._pending.popleft()

    def begin(self, t0_us: int) -> int:
        """Drop what cannot belong to a stream that begins at t0_us; return how many messages that were."""
        kept = [one for one in self._pending if _near(one, t0_us)]
        dropped = len(self._pending) - len(kept)
        self._pending = deque(kept)
        self._newest = kept[-1] if kept else None
        return dropped

    def reaches(self, t1_us: int, first_us: int, *, anew: bool) -> bool:
        """Return whether events up to t1_us have the tracks that they need.

        Args:
            t1_us: their watermark.
            first_us: the first event time of their stream.
            anew: their stream begins with them: no message that has come is its.
        """
        if not self._lockstep:
            return True
        if anew or self._newest is None:
            return t1_us <= first_us - first_us % self._period_us + 2 * self._period_us
        return t1_us <= self._newest.as_of_us + 2 * self._newest.period_us
