"""When a beacon could be seen: the visible intervals and the time in view, from the windows of the truth.

A window's state, taken at t1, stands for the whole window [t0, t1). So an interval begins with the first window that
ends visible and ends with the first that does not; it is known to a window's length.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from heliograph.truth import Truth

# Closed intervals are needed while frames and identifications of the last seconds are scored; a beacon that blinks in
# and out more than 64 times in that time is a damaged truth.
INTERVALS_KEPT = 64


@dataclass(slots=True)
class Interval:
    """A stretch of time in which a beacon was visible; ended_us None: it still is."""

    began_us: int
    occluded_us: int | None
    seen_us: int
    ended_us: int | None = None
    first_right_us: int | None = None
    acquired_us: int | None = None
    changed: bool = True

    def covers(self, t_us: int) -> bool:
        """Return whether the instant lies in the interval."""
        return self.began_us <= t_us and (self.ended_us is None or t_us <= self.ended_us)


@dataclass(slots=True)
class Presence:
    """What is known of one beacon."""

    protocol: str = ""
    radius_px: float = 0.0
    payload: int | None = None
    intervals: deque[Interval] = field(default_factory=lambda: deque(maxlen=INTERVALS_KEPT))
    view_began_us: int | None = None
    in_view: bool = False

    def update(self, t0_us: int, t1_us: int, in_view: bool, visible: bool) -> None:
        """Take the state of one window; windows come in order of time."""
        if in_view and not self.in_view:
            self.view_began_us = t0_us
        self.in_view = in_view
        last = self.intervals[-1] if self.intervals else None
        is_open = last is not None and last.ended_us is None
        if visible and last is not None and is_open:
            last.seen_us = t1_us
        elif visible:
            occluded_us = None if last is None or last.ended_us is None else t0_us - last.ended_us
            self.intervals.append(Interval(t0_us, occluded_us, t1_us))
        elif last is not None and is_open:
            last.ended_us, last.changed = t0_us, True

    def interval_at(self, t_us: int) -> Interval | None:
        """Return the visible interval that covers an instant, or None."""
        for interval in reversed(self.intervals):
            if interval.covers(t_us):
                return interval
        return None

    def viewed_since(self, t_us: int) -> int | None:
        """Return since when the beacon has been in view without a break, if it already was at t_us; or None."""
        if self.in_view and self.view_began_us is not None and self.view_began_us <= t_us:
            return self.view_began_us
        return None


class Presences:
    """All beacons of one camera.

    Args:
        limit: most beacons; those beyond are left out (their frames are then no part of the score).
    """

    def __init__(self, limit: int = 1024) -> None:
        self._limit = limit
        self.beacons: dict[str, Presence] = {}

    def update(self, truth: Truth) -> None:
        """Take one window of the truth; a beacon that it does not list is out of view."""
        listed = set(truth.beacon)
        for i, name in enumerate(truth.beacon):
            presence = self.beacons.get(name)
            if presence is None:
                if len(self.beacons) >= self._limit:
                    continue
                presence = self.beacons[name] = Presence()
            presence.protocol = truth.protocol[i]
            presence.radius_px = truth.radius_px[i]
            presence.update(truth.t0_us, truth.t1_us, truth.in_view[i], truth.visible[i])
        for name, presence in self.beacons.items():
            if name not in listed:
                presence.update(truth.t0_us, truth.t1_us, in_view=False, visible=False)
