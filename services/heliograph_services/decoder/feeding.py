"""Whose receivers are fed at the end of a window, and with what.

A window is short (1 ms), so that what a frame's last events decide is published at once; but a receiver has something
to decide once a frame only. A *beat* is some windows long (5 ms, on the absolute grid). A track's events wait until

- its own time has come: a receiver that is being read says from when on it may decide something
  (`heliograph_services.decoder.links.TrackLinks.due_us`);
- a beat ends, the track has heard something within the last `AWAKE_US`, and does not know its time, or has waited for
  `WAIT_US`;
- a beat ends at which all are asked: the records of the grid are due, or the stream is over.

A track that has never heard anything is never fed. So what hears nothing costs next to nothing, and since the times do
not depend on how events are cut into messages, neither do the results.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from heliograph.events import Flags, Times
from heliograph_services.decoder.region_state import NEVER, Depths, Ints
from heliograph_services.decoder.regions import Routed
from heliograph_services.decoder.sorting import gather, keep
from heliograph_services.decoder.tracks import READING_US

# A frame of 20 bits at 50 bit/s takes 400 ms, and may be dark for most of it.
AWAKE_US: Final = 450_000
# Of a beat. Receivers that look for a clock are fed so often; half of that would double what clutter costs.
BEAT_US: Final = 5_000
# What is due only later is fed then; but the events of slow links are not kept for longer, and a status is no older.
WAIT_US: Final = 20_000
NEVER_DUE_US: Final = 2**60
# Forgetting costs a look at each track that waits; they hold what waits for two beats and more.
WINDOWS_KEPT: Final = 32
# Grows where more is heard.
START_EVENTS: Final = 65_536

Piece = tuple[Times, Flags, Depths]


def beat_us(window_us: int, *grids_us: int) -> int:
    """Return the longest beat of whole windows, no longer than BEAT_US, that all grids are multiples of.

    A window that is longer itself is a beat.
    """
    whole = int(np.gcd.reduce(np.array(grids_us, np.int64)))
    fitting = [n * window_us for n in range(1, BEAT_US // window_us + 1) if whole % (n * window_us) == 0]
    return max(fitting, default=window_us)


class Feeding:
    """What the last windows held for each track, in the order of the tracks.

    Args:
        capacity: the most tracks there may be.
    """

    def __init__(self, capacity: int) -> None:
        self.n = 0
        # The windows' events, sorted by track within a window; window w's of track i begin at starts[w, i].
        self._t_us: Times = np.empty(START_EVENTS, np.int64)
        self._on: Flags = np.empty(START_EVENTS, np.bool_)
        self._depth: Depths = np.empty(START_EVENTS, np.uint8)
        self._starts: Ints = np.zeros((WINDOWS_KEPT, capacity + 1), np.int64)
        self._windows = 0
        self._events = 0
        self._scratch = np.empty_like(self._t_us), np.empty_like(self._on), np.empty_like(self._depth)
        self._taken: Ints = np.zeros(capacity, np.int64)  # how many of the windows a track has been fed
        self._left: list[Piece | None] = []  # of windows that are not there any more
        self._due_us: Ints = np.zeros(capacity, np.int64)
        self._heard_us: Ints = np.zeros(capacity, np.int64)  # end of the last window in which it heard something
        self._fed_us: Ints = np.zeros(capacity, np.int64)
        self._frame_us: Ints = np.zeros(capacity, np.int64)  # end of the last frame
        self._spoken: Flags = np.zeros(capacity, np.bool_)  # it has had an identity

    def keep(self, kept: list[int]) -> None:
        """Keep these tracks alone, in this order."""
        if kept == list(range(self.n)):
            return
        self._drain()
        m = len(kept)
        for row in (self._due_us, self._heard_us, self._fed_us, self._frame_us, self._spoken):
            row[:m] = row[kept]
        self._left = [self._left[i] for i in kept]
        self.n = m

    def reading(self, now_us: int) -> Flags:
        """Return of which tracks, (n,), frames come at this moment (`Track.reading`)."""
        frame_us = self._frame_us[: self.n]
        found: Flags = (frame_us >= 0) & (frame_us >= now_us - READING_US)
        return found

    def framed(self, i: int, frame_us: int) -> None:
        """Note when the last frame of track i ended."""
        self._frame_us[i] = frame_us

    def spoke(self, i: int) -> None:
        """Note that track i has an identity."""
        self._spoken[i] = True

    def spoken(self) -> list[int]:
        """Return the tracks that have an identity, or had one."""
        found: list[int] = self._spoken[: self.n].nonzero()[0].tolist()
        return found

    def awoken(self) -> list[int]:
        """Return the tracks that have ever heard anything."""
        found: list[int] = (self._heard_us[: self.n] != NEVER).nonzero()[0].tolist()
        return found

    def append(self, now_us: int, heard: list[bool], due_us: list[int]) -> None:
        """Add tracks that have been fed up to now_us: whether each has heard something so far, and when it is due."""
        k = len(heard)
        self._heard_us[self.n : self.n + k] = np.where(heard, now_us, NEVER)
        self._due_us[self.n : self.n + k] = due_us
        self._fed_us[self.n : self.n + k] = now_us
        self._frame_us[self.n : self.n + k] = -1
        self._spoken[self.n : self.n + k] = False
        # The windows before know nothing of it.
        self._drain()
        self._left += [None] * k
        self.n += k

    def note(self, routed: Routed, t1_us: int) -> None:
        """Take what a window that ends at t1_us holds."""
        if self._windows == WINDOWS_KEPT:
            self._drain()
        behind = self._events + len(routed.t_us)
        if behind > len(self._t_us):
            self._grow(behind)
        keep(
            routed.t_us, routed.on, routed.depth, routed.starts, t1_us, self._events,
            self._t_us, self._on, self._depth, self._starts[self._windows], self._heard_us,
        )  # fmt: skip
        self._events = behind
        self._windows += 1

    def _grow(self, events: int) -> None:
        room = max(2 * len(self._t_us), events)
        for name in ("_t_us", "_on", "_depth"):
            old = getattr(self, name)
            new = np.empty(room, old.dtype)
            new[: self._events] = old[: self._events]
            setattr(self, name, new)
        self._scratch = np.empty_like(self._t_us), np.empty_like(self._on), np.empty_like(self._depth)

    def whom(self, t1_us: int, *, beat: bool, every: bool) -> list[int]:
        """Return the tracks to be fed at t1_us; see the module."""
        n = self.n
        wanted = self._due_us[:n] <= t1_us
        if beat and every:
            wanted |= self._heard_us[:n] != NEVER
        elif beat:
            late = (self._due_us[:n] >= NEVER_DUE_US) | (self._fed_us[:n] <= t1_us - WAIT_US)
            wanted |= late & (self._heard_us[:n] >= t1_us - AWAKE_US)
        found: list[int] = wanted.nonzero()[0].tolist()
        return found

    def take(self, which: list[int], least: list[int]) -> list[Piece]:
        """Return what tracks have not been fed yet, of what lies so deep in their images; the rest is forgotten."""
        starts = np.empty(len(which) + 1, np.int64)
        gather(
            self._t_us, self._on, self._depth, self._starts, self._windows,
            np.array(which, np.int64), np.array(least, np.int64), self._taken, *self._scratch, starts,
        )  # fmt: skip
        ends: list[int] = starts.tolist()
        # Copied once for all: an array that a kernel returns costs more than what is in it.
        n, (t_us, on, depth) = ends[-1], self._scratch
        t_us, on, depth = t_us[:n].copy(), on[:n].copy(), depth[:n].copy()
        pieces = [(t_us[a:b], on[a:b], depth[a:b]) for a, b in pairwise(ends)]
        for k, i in enumerate(which):
            left = self._left[i]
            if left is not None:
                self._left[i] = None
                deep = left[2] >= least[k]
                pieces[k] = _joined((left[0][deep], left[1][deep], left[2][deep]), pieces[k])
        return pieces

    def fed(self, i: int, now_us: int, due_us: int) -> None:
        """Note that track i has been fed up to now_us, and when it is due again."""
        self._fed_us[i] = now_us
        self._due_us[i] = due_us

    def _drain(self) -> None:
        """Forget the windows; what waits is kept by track."""
        unfed: list[int] = (self._heard_us[: self.n] > self._fed_us[: self.n]).nonzero()[0].tolist()
        for i, piece in zip(unfed, self.take(unfed, [0] * len(unfed)), strict=True):
            self._left[i] = piece if len(piece[0]) else None
        self._taken[:] = 0
        self._windows = self._events = 0


def _joined(left: Piece, piece: Piece) -> Piece:
    return (
        np.concatenate((left[0], piece[0])),
        np.concatenate((left[1], piece[1])),
        np.concatenate((left[2], piece[2])),
    )
