"""Which messages belong to the camera's present stream: time that leaps is a new stream, or damage.

Each schema's own time only moves on within a stream. Where it leaps (falls, or jumps by more than a minute) away from
the camera's clock, the camera has begun anew: everything restarts there. Messages of other schemas, still on their way
from the old stream, are then *stale* until they leap too or agree with the new clock. Should a leap have been damage,
the stale ones outnumber it, and the clock returns to them.

States and texts keep a history on the bus: after a cut they come late, so their time starts nothing anew.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from heliograph.units import US_PER_S

JUMP_US: Final = 60 * US_PER_S
# The topics of one camera bring some 20 messages a second even where nothing is seen: five seconds of disagreement.
STALE_LIMIT: Final = 100


class Place(Enum):
    """What to do with a message."""

    TAKE = "take"
    STALE = "stale"
    RESTART_FORWARD = "restart forward"
    RESTART_BACKWARD = "restart backward"


class Timeline:
    """The clock of one camera.

    Args:
        settle_us: how far a message may lie behind the clock.
    """

    def __init__(self, settle_us: int) -> None:
        self.clock_us: int | None = None
        self._settle_us = settle_us
        self._last: dict[str, int] = {}
        self._here: set[str] = set()  # schemas that have been seen since the last restart
        self._stale = 0

    def place(self, schema: str, t_us: int, *, keeps_history: bool) -> Place:
        """Say where a message belongs, and move the clock where it does.

        Args:
            schema: its schema; each has a time of its own.
            t_us: its time.
            keeps_history: whether old messages of the schema may come late.
        """
        clock_us = self.clock_us
        if clock_us is None:
            self._begin(schema, t_us)
            return Place.TAKE
        if keeps_history:
            if t_us > clock_us + JUMP_US or (t_us > clock_us + self._settle_us and self._here):
                return self._note_stale(schema, t_us)
            self.clock_us = max(clock_us, t_us)
            return Place.TAKE
        last_us = self._last.get(schema)
        agrees = abs(t_us - clock_us) <= self._settle_us
        leaps = last_us is not None and (t_us < last_us - self._settle_us or t_us > last_us + JUMP_US)
        is_far = t_us > clock_us + JUMP_US or (last_us is None and t_us < clock_us - JUMP_US)
        if not agrees and (leaps or (last_us is None and is_far)):
            return self._restart(schema, t_us)
        if not agrees and schema not in self._here and last_us is not None:
            return self._note_stale(schema, t_us)
        self._last[schema] = max(t_us, t_us if last_us is None or leaps else last_us)
        self._here.add(schema)
        self.clock_us = max(clock_us, t_us)
        self._stale = 0
        return Place.TAKE

    def _begin(self, schema: str, t_us: int) -> None:
        self.clock_us = t_us
        self._last[schema] = t_us
        self._here = {schema}
        self._stale = 0

    def _restart(self, schema: str, t_us: int) -> Place:
        forward = self.clock_us is not None and t_us > self.clock_us
        self._begin(schema, t_us)
        return Place.RESTART_FORWARD if forward else Place.RESTART_BACKWARD

    def _note_stale(self, schema: str, t_us: int) -> Place:
        self._stale += 1
        if self._stale > STALE_LIMIT:
            return self._restart(schema, t_us)
        self._last[schema] = t_us
        return Place.STALE
