"""The decoder's tracks: who is followed under which name, what it is held to be, and what happens when Tracks come.

A Tracks message that lacks a track ends it, unless the decoder reads it at that moment: then its region goes on by
itself until it is no longer read, or until a new name turns up on its spot (a restarted tracker) and *adopts* it:
receiver, identity and region move over to the new name.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from heliograph.link.contract import Text
from heliograph.messages import Identification, Tracks
from heliograph_services.decoder.backlog import Trail
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.links import Accepted, TrackLinks
from heliograph_services.decoder.regions import Place, place

# Where the tracker has been silent for so long, only what is read goes on (paper: a valid track's delay_max).
SILENCE_US: Final = 2_000_000


@dataclass(frozen=True, slots=True)
class Told:
    """What a Tracks message says of one track, at its instant."""

    name: str
    born_us: int
    place: Place


@dataclass(slots=True)
class Track:
    """One followed target.

    Args:
        serial: counts the decoder's tracks; their order everywhere.
        name: the tracker's, on the bus.
        links: its receivers.
        trail: where it was before it was known.
    """

    serial: int
    name: str
    links: TrackLinks
    trail: Trail
    held: Accepted | None = None
    beacon: str = ""
    told: bool = True  # the newest Tracks message has it
    texts: list[tuple[int, Text]] = field(default_factory=list)  # link, text; since the last refresh
    state: Identification | None = None  # the last one published
    frame_us: int = -1  # end of its last frame
    frame_link: int = 0

    @property
    def read(self) -> bool:
        """Whether the decoder reads it at this moment."""
        return self.held is not None


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
        rows.append(Told(name, min(message.born_us[i], message.as_of_us), at))
    return rows, len(message.track) - len(rows)


def plan_of(followed: list[Track], places: list[Place], told: list[Told], elapsed_us: int) -> Plan:
    """Return what a message means for the tracks.

    Args:
        followed: the tracks, in their order.
        places: where they are now.
        told: the message's rows.
        elapsed_us: from the message's instant to now.
    """
    by_name = {row.name: row for row in told}
    names = {track.name for track in followed}
    update = [(track, by_name[track.name]) for track in followed if track.name in by_name]
    missing = [(track, at) for track, at in zip(followed, places, strict=True) if track.name not in by_name]
    new = [row for row in told if row.name not in names]
    adopt = _pairs(missing, new, elapsed_us) if missing and new else []
    taken_tracks = {track.serial for track, _ in adopt}
    taken_names = {row.name for _, row in adopt}
    return Plan(
        update,
        adopt,
        [track for track, _ in missing if track.serial not in taken_tracks and not track.read],
        [row for row in new if row.name not in taken_names],
    )


def _pairs(missing: list[tuple[Track, Place]], new: list[Told], elapsed_us: int) -> list[tuple[Track, Told]]:
    """Return tracks without a name and names without a track that are on one spot: nearest first, each once.

    One spot means that each one's centre lies in the other's region.
    """
    there = [row.place.after(elapsed_us) for row in new]
    x_px = np.array([at.x_px for at in there])
    y_px = np.array([at.y_px for at in there])
    reach_px = np.array([at.reach_px for at in there])
    candidates: list[tuple[float, int, int]] = []
    for i, (_, own) in enumerate(missing):
        away = np.hypot(x_px - own.x_px, y_px - own.y_px)
        near = np.flatnonzero(away <= np.minimum(reach_px, own.reach_px))
        candidates += [(float(away[k]), i, int(k)) for k in near]
    pairs: list[tuple[Track, Told]] = []
    used_i: set[int] = set()
    used_k: set[int] = set()
    for _, i, k in sorted(candidates):
        if i not in used_i and k not in used_k:
            used_i.add(i)
            used_k.add(k)
            pairs.append((missing[i][0], new[k]))
    return pairs
