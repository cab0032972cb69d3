"""The decoder's tracks: who is followed under which name, and what happens when Tracks come.

A Tracks message speaks of an instant A; it is compared with where the regions were at A. Two places are one *spot* if
each one's centre lies in the other's region. Names move as the tracker says, and receiver, identity and region stay
with the light that is read:

- a name whose row is on its own track's spot stays. Where two such rows, both of tracks that are being read, would
  change places at half the distance or less, and are far enough apart to tell, their names are exchanged;
- a name that is new, or whose row is elsewhere, goes to the nearest track on its spot that is being read and has no row
  there itself: a restarted tracker, a crossing that was sorted out, a track that has found its beacon again. *Adopted*,
  it goes on under that name. A name given away leaves its old track without one, and that ends;
- what else has a row goes on under its name; what has none lives as long as it is read, unless a track that has one is
  on its spot: of two that hear one beacon, the one that was read last lives, under the name that has the row;
- the remaining rows are new tracks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from heliograph.events import Flags
from heliograph.link.contract import Text
from heliograph.messages import Identification
from heliograph_services.decoder.links import Accepted, TrackLinks
from heliograph_services.decoder.region_state import REACH, Floats, Ints
from heliograph_services.decoder.telling import Telling

# Read at this moment: a frame of 20 bits at 50 bit/s takes 400 ms.
READING_US: Final = 450_000
# Two names change places if that halves the distances, and they are off by more than a centroid's error each.
EXCHANGE: Final = 0.5
EXCHANGE_PX: Final = 2.0


@dataclass(slots=True)
class Track:
    """One followed target.

    Args:
        serial: counts the decoder's tracks; their order everywhere.
        name: the tracker's, on the bus.
        links: its receivers.
    """

    serial: int
    name: str
    links: TrackLinks
    held: Accepted | None = None
    told: bool = True  # the newest Tracks message has it
    texts: list[tuple[int, Text]] = field(default_factory=list)  # link, text; since the last refresh
    state: Identification | None = None  # the last one published
    withheld_us: int = -1  # what supports its identity no later than this counts no more
    frame_us: int = -1  # end of its last frame
    frame_link: int = 0

    @property
    def read(self) -> bool:
        """Whether the decoder holds an identity for it."""
        return self.held is not None

    def reading(self, now_us: int) -> bool:
        """Whether frames come at this moment."""
        return self.frame_us >= 0 and now_us - self.frame_us <= READING_US


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What a Tracks message does to the tracks that are followed.

    Args:
        rows: (n,) the message's row of each track; -1 where it has none.
        adopt: tracks to go on under the name of their row, by index.
        end: tracks that end, by index.
        new: rows of tracks to begin.
    """

    rows: Ints
    adopt: list[int]
    end: list[int]
    new: list[int]


def plan_of(followed: list[Track], then: Floats, told: Telling, reading: Flags) -> Plan:
    """Return what a message means for the tracks.

    Args:
        followed: the tracks, in their order.
        then: (5, n) where they were at the message's instant: x, y, vx, vy, reach.
        told: the message.
        reading: (n,) of which frames come at this moment.
    """
    row_of = {name: row for row, name in enumerate(told.names)}
    named = np.array([row_of.get(track.name, -1) for track in followed], np.int64)
    home = named >= 0
    home[home] = _one_spot(then[:, home], told.places[:, named[home]])
    given = np.where(home, named, -1)
    _exchange(then, told.places, given, np.flatnonzero(home & reading))
    loose = np.flatnonzero(~home).tolist()
    taken = np.zeros(len(told.names), np.bool_)
    taken[given[home]] = True

    free = np.flatnonzero(~taken)
    for i, row in _pairs([i for i in loose if reading[i]], then, told.places, free):
        given[i] = row
        taken[row] = True
    for i in loose:
        if given[i] < 0 and named[i] >= 0 and not taken[named[i]]:
            given[i] = named[i]
            taken[named[i]] = True

    nameless = np.flatnonzero(given < 0).tolist()
    gone = _merged(followed, then, given, nameless)
    gone |= {i for i in nameless if given[i] < 0 and not (followed[i].read and (named[i] < 0 or not taken[named[i]]))}
    elsewhere: list[int] = np.flatnonzero((given >= 0) & (given != named)).tolist()
    return Plan(given, elsewhere, sorted(i for i in gone if given[i] < 0), np.flatnonzero(~taken).tolist())


def away_px(some: Floats, others: Floats) -> Floats:
    """Return the distances, (k,), of the centres of places (2 or more, k): x, y, ..."""
    away: Floats = np.hypot(some[0] - others[0], some[1] - others[1])
    return away


def _one_spot(own: Floats, told: Floats) -> Flags:
    near: Flags = away_px(own, told) <= np.minimum(own[REACH], told[REACH])
    return near


def _exchange(then: Floats, told: Floats, given: Ints, order: Ints) -> None:
    """Exchange the rows of those tracks, by index in `order`, that are clearly on each other's spot."""
    if len(order) < 2:
        return
    known = then[:, order]
    for i in order.tolist():
        own = told[:, given[i]]
        k = int(order[np.argmin(away_px(known, own))])
        if k == i:
            continue
        others = told[:, given[k]]
        stay = away_px(then[:, i], own) + away_px(then[:, k], others)
        swap = away_px(then[:, k], own) + away_px(then[:, i], others)
        if stay > 2 * EXCHANGE_PX and swap <= EXCHANGE * stay:
            given[i], given[k] = given[k], given[i]


def _pairs(loose: list[int], then: Floats, told: Floats, free: Ints) -> list[tuple[int, int]]:
    """Return for tracks without a row on their spot the rows without a track that are: nearest first, each once."""
    if not loose or not len(free):
        return []
    places = told[:, free]
    candidates: list[tuple[float, int, int]] = []
    for i in loose:
        away = away_px(places, then[:, i])
        near = np.flatnonzero(away <= np.minimum(places[REACH], then[REACH, i]))
        candidates += [(float(away[k]), i, int(free[k])) for k in near]
    pairs: dict[int, int] = {}
    used: set[int] = set()
    for _, i, row in sorted(candidates):
        if i not in pairs and row not in used:
            used.add(row)
            pairs[i] = row
    return list(pairs.items())


def _merged(followed: list[Track], then: Floats, given: Ints, nameless: list[int]) -> set[int]:
    """Return the tracks that end since another one hears their beacon; where they read it better, they get its row."""
    gone: set[int] = set()
    for i in nameless:
        others = np.flatnonzero(given >= 0)
        away = away_px(then[:, others], then[:, i])
        near = np.flatnonzero(away <= 0.5 * np.minimum(then[REACH, others], then[REACH, i]))
        if not len(near):
            continue
        k = int(others[near[np.argmin(away[near])]])
        if followed[i].frame_us > followed[k].frame_us:
            given[i], given[k] = given[k], -1
            gone.add(k)
        else:
            gone.add(i)
    return gone
