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

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from heliograph.link.contract import Text
from heliograph.messages import Identification, Tracks
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.links import Accepted, TrackLinks
from heliograph_services.decoder.regions import Doubt, Place, doubt, place

# Where the tracker has been silent for so long, only what is read goes on (paper: a valid track's delay_max).
SILENCE_US: Final = 2_000_000
# Read at this moment: a frame of 20 bits at 50 bit/s takes 400 ms.
READING_US: Final = 450_000
# Two names change places if that halves the distances, and they are off by more than a centroid's error each.
EXCHANGE: Final = 0.5
EXCHANGE_PX: Final = 2.0
# No tracker is surer than that, whatever it says: half a pixel; 50 px/s and a tenth of the speed. Own edges, which come
# every few milliseconds, soon know better.
LEAST_PX2: Final = 0.25
LEAST_PX_S: Final = 50.0
LEAST_SHARE: Final = 0.1
NUMBERS: Final = (
    "x_px", "y_px", "vx_px_s", "vy_px_s", "radius_px", "x_var_px2", "x_vx_cov_px2_s", "vx_var_px2_s2",
    "y_var_px2", "y_vy_cov_px2_s", "vy_var_px2_s2",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Told:
    """What a Tracks message says of one track, at its instant."""

    name: str
    born_us: int
    place: Place
    radius_px: float
    doubt: Doubt
    unseen_us: int  # before the message's instant


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


@dataclass(frozen=True, slots=True)
class Plan:
    """What a Tracks message does to the tracks that are followed.

    Args:
        update: tracks to go on, and what is told of them.
        adopt: tracks to go on under another name.
        end: tracks that end.
        new: tracks to begin.
    """

    update: list[tuple[Track, Told]]
    adopt: list[tuple[Track, Told]]
    end: list[Track]
    new: list[Told]


def finite(message: Tracks) -> bool:
    """Return whether all numbers of a message are numbers: one that is not would spread to all that it is added to."""
    return all(math.isfinite(sum(getattr(message, column))) for column in NUMBERS)


def told_by(message: Tracks, followed: set[str], config: DecoderConfig) -> tuple[list[Told], int]:
    """Return the rows of a message with their regions, and how many rows were left out.

    A region's reach is scale * radius + margin, at most region_max_px. A track that is born after the message's own
    instant counts as born at it. Of names that are not followed, the first max_tracks are taken: a damaged message may
    have a million.
    """
    room = config.max_tracks
    rows: list[Told] = []
    for i, name in enumerate(message.track):
        if name not in followed:
            if room == 0:
                continue
            room -= 1
        reach_px = config.region_scale * message.radius_px[i] + config.region_margin_px
        at = place(
            message.x_px[i],
            message.y_px[i],
            message.vx_px_s[i],
            message.vy_px_s[i],
            min(config.region_max_px, reach_px),
        )
        # One covariance serves both axes: the larger doubt.
        speed_px_s = math.hypot(at.vx_px_s, at.vy_px_s)
        sure = doubt(
            max(message.x_var_px2[i], message.y_var_px2[i], LEAST_PX2),
            max(message.x_vx_cov_px2_s[i], message.y_vy_cov_px2_s[i], key=abs),
            max(message.vx_var_px2_s2[i], message.vy_var_px2_s2[i], (LEAST_PX_S + LEAST_SHARE * speed_px_s) ** 2),
        )
        unseen_us = min(max(message.as_of_us - message.seen_us[i], 0), SILENCE_US)
        radius_px = min(message.radius_px[i], config.region_max_px)
        rows.append(Told(name, min(message.born_us[i], message.as_of_us), at, radius_px, sure, unseen_us))
    return rows, len(message.track) - len(rows)


def plan_of(followed: list[Track], then: list[Place], told: list[Told], now_us: int) -> Plan:
    """Return what a message means for the tracks.

    Args:
        followed: the tracks, in their order.
        then: where they were at the message's instant.
        told: the message's rows.
        now_us: the time.
    """
    by_name = {row.name: row for row in told}
    at_home: dict[int, Told] = {}  # by the track's index
    for i, track in enumerate(followed):
        row = by_name.get(track.name)
        if row is not None and _one_spot(then[i], row.place):
            at_home[i] = row
    live = {i for i, track in enumerate(followed) if track.reading(now_us)}
    at_home |= _exchanged(then, {i: row for i, row in at_home.items() if i in live})
    home_names = {row.name for row in at_home.values()}

    loose = [i for i in range(len(followed)) if i not in at_home]
    free = [row for row in told if row.name not in home_names]
    given: dict[int, Told] = at_home | _pairs([i for i in loose if i in live], then, free)
    taken = {row.name for row in given.values()}
    for i in loose:
        row = by_name.get(followed[i].name)
        if i not in given and row is not None and row.name not in taken:
            given[i] = row
            taken.add(row.name)

    nameless = [i for i in range(len(followed)) if i not in given]
    gone = _merged(followed, then, given, nameless)
    gone |= {i for i in nameless if i not in given and (not followed[i].read or followed[i].name in taken)}
    gone -= given.keys()
    return Plan(
        [(followed[i], row) for i, row in sorted(given.items()) if row.name == followed[i].name],
        [(followed[i], row) for i, row in sorted(given.items()) if row.name != followed[i].name],
        [followed[i] for i in sorted(gone)],
        [row for row in told if row.name not in taken],
    )


def _one_spot(own: Place, told: Place) -> bool:
    return own.away_px(told) <= min(own.reach_px, told.reach_px)


def _exchanged(then: list[Place], at_home: dict[int, Told]) -> dict[int, Told]:
    """Return the rows by track with those exchanged that are clearly on each other's spot."""
    found = dict(at_home)
    order = sorted(found)
    if len(order) < 2:
        return found
    x_px, y_px = (np.array([getattr(then[i], name) for i in order]) for name in ("x_px", "y_px"))
    for i in order:
        own = found[i].place
        away = np.hypot(x_px - own.x_px, y_px - own.y_px)
        k = order[int(np.argmin(away))]
        if k == i:
            continue
        stay = then[i].away_px(own) + then[k].away_px(found[k].place)
        swap = then[k].away_px(own) + then[i].away_px(found[k].place)
        if stay > 2 * EXCHANGE_PX and swap <= EXCHANGE * stay:
            found[i], found[k] = found[k], found[i]
    return found


def _pairs(loose: list[int], then: list[Place], free: list[Told]) -> dict[int, Told]:
    """Return for tracks without a row on their spot the rows without a track that are: nearest first, each once."""
    if not loose or not free:
        return {}
    x_px = np.array([row.place.x_px for row in free])
    y_px = np.array([row.place.y_px for row in free])
    reach_px = np.array([row.place.reach_px for row in free])
    candidates: list[tuple[float, int, int]] = []
    for i in loose:
        own = then[i]
        away = np.hypot(x_px - own.x_px, y_px - own.y_px)
        near = np.flatnonzero(away <= np.minimum(reach_px, own.reach_px))
        candidates += [(float(away[k]), i, int(k)) for k in near]
    pairs: dict[int, Told] = {}
    used: set[int] = set()
    for _, i, k in sorted(candidates):
        if i not in pairs and k not in used:
            used.add(k)
            pairs[i] = free[k]
    return pairs


def _merged(followed: list[Track], then: list[Place], given: dict[int, Told], nameless: list[int]) -> set[int]:
    """Return the tracks that end since another one hears their beacon; where they read it better, they get its row."""
    gone: set[int] = set()
    for i in nameless:
        near = [k for k in given if then[i].away_px(then[k]) <= 0.5 * min(then[i].reach_px, then[k].reach_px)]
        if not near:
            continue
        k = min(near, key=lambda one: (then[i].away_px(then[one]), one))
        if followed[i].frame_us > followed[k].frame_us:
            given[i] = given.pop(k)
            gone.add(k)
        else:
            gone.add(i)
    return gone
