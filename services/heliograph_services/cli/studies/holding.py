"""Who is held for whom: published identities and track numbers against the truth, over time, crossings and occlusions.

A beacon's *number* at an instant is the nearest track within its gate, max(5 px, radius). A published identity is
*right* if a beacon of its protocol and payload is within its gate of the place, *confused* if only another is,
*nowhere* if none is. A *swap* is a track's step from another state (or none) to confused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from heliograph.messages import Identification, Tracks
from heliograph_services.cli.studies.paths import TruePaths
from heliograph_services.cli.studies.running import Said
from heliograph_services.cli.studies.tracking import paired
from heliograph_services.cli.studies.verdicts import gates_px
from heliograph_services.event_source.simulation.contract import NODE_US

What = Literal["right", "confused", "nowhere"]
# After light has come back a beacon must be held again so soon.
BACK_US: Final = 500_000


@dataclass(slots=True)
class Held:
    """Counts of published identities.

    Args:
        right: states published, refreshed ones included.
        confused: likewise.
        nowhere: likewise.
        swaps: see the module.
        first_us: by beacon, when its first right identity was published.
    """

    right: int = 0
    confused: int = 0
    nowhere: int = 0
    swaps: int = 0
    first_us: dict[str, int] = field(default_factory=dict)


def judged(state: Identification, paths: TruePaths) -> tuple[What, str]:
    """Return what an identity is, and the beacon that is meant where it is right."""
    x_px, y_px = paths.places([state.t_us])
    node = int(paths.nodes([state.t_us])[0][0])
    away = np.hypot(x_px[:, 0] - state.x_px, y_px[:, 0] - state.y_px)
    near = np.flatnonzero((away <= gates_px(paths, [state.t_us])[:, 0]) & paths.in_view[:, node])
    for i in near.tolist():
        spec = paths.beacons[i]
        if spec.protocol == state.protocol and (spec.payload is None or spec.payload == state.payload):
            return "right", spec.name
    return ("confused" if len(near) else "nowhere"), ""


def held(said: Said, paths: TruePaths) -> Held:
    """Return the counts of a run."""
    out, last = Held(), dict[str, str]()
    for published_us, state in said.states:
        if state.lost:
            last.pop(state.track, None)
            continue
        what, name = judged(state, paths)
        setattr(out, what, getattr(out, what) + 1)
        out.swaps += what == "confused" and last.get(state.track) != "confused"
        last[state.track] = what
        if what == "right":
            out.first_us.setdefault(name, published_us)
    return out


def numbers(tracks: Tracks, paths: TruePaths) -> dict[str, str]:
    """Return the track of each beacon that has one, at the message's instant."""
    x_px, y_px = paths.places([tracks.as_of_us])
    away = np.hypot(x_px - np.array(tracks.x_px), y_px - np.array(tracks.y_px)).reshape(len(paths.beacons), -1)
    rows, columns = paired(away, away <= gates_px(paths, [tracks.as_of_us]))
    names = paths.names
    return {names[i]: tracks.track[j] for i, j in zip(rows.tolist(), columns.tolist(), strict=True)}


def at_or_before(tracks: Sequence[Tracks], t_us: int) -> Tracks | None:
    """Return the newest message of an instant up to t_us."""
    return next((one for one in reversed(tracks) if one.as_of_us <= t_us), None)


def reads(said: Said, paths: TruePaths, track: str, beacon: str, since_us: int, until_us: int) -> bool:
    """Return whether a track's newest identity up to until_us is this beacon's, and rests on a frame after since_us."""
    states = [s for t, s in said.states if s.track == track and t <= until_us]
    if not states or states[-1].lost:
        return False
    what, name = judged(states[-1], paths)
    spec = paths.beacons[paths.names.index(beacon)]
    frames = any(
        f.track[i] == track and f.payload[i] == spec.payload and since_us < f.t_us[i] <= until_us
        for f in said.frames
        for i in range(len(f.t_us))
    )
    return what == "right" and name == beacon and frames


def occlusion(said: Said, paths: TruePaths, beacon: int) -> dict[str, str | int]:
    """Return what became of a beacon that was hidden once: `kept`, or why not.

    `late`: it was not read under a number before; `lost`: no track BACK_US after the light came back; `renamed`:
    another number; `unread`: the number without the right payload.
    """
    name = paths.names[beacon]
    hidden = np.flatnonzero(~paths.visible[beacon])
    begin_us, end_us = int(hidden[0]) * NODE_US, int(hidden[-1] + 1) * NODE_US
    out: dict[str, str | int] = {"hidden_us": end_us - begin_us}
    # Images fade over their own extent: the last instant at which all of it is seen lies some way before.
    before = at_or_before(said.tracks, begin_us - 20_000)
    was = numbers(before, paths).get(name) if before is not None else None
    if was is None or not reads(said, paths, was, name, -1, begin_us):
        return out | {"outcome": "late"}
    after = at_or_before(said.tracks, end_us + BACK_US)
    now = numbers(after, paths).get(name) if after is not None else None
    if now is None:
        return out | {"outcome": "lost"}
    if now != was:
        return out | {"outcome": "renamed"}
    kept = reads(said, paths, now, name, end_us, end_us + BACK_US)
    return out | {"outcome": "kept" if kept else "unread"}


def crossing(said: Said, paths: TruePaths) -> dict[str, str | bool]:
    """Return what became of two beacons that crossed: `numbers` kept, swapped, renamed, lost or late, and `read`.

    `late`: one was without a number before they touched; `read`: at the end both numbers hold the right identities.
    """
    away = np.hypot(paths.x_px[0] - paths.x_px[1], paths.y_px[0] - paths.y_px[1])
    touching = np.flatnonzero(away <= paths.reach_px[0] + paths.reach_px[1])
    first_us = int(touching[0]) * NODE_US if len(touching) else paths.until_us // 2
    # With its stream a decoder ends all that it holds.
    end_us = said.tracks[-1].as_of_us - 1
    before, last = at_or_before(said.tracks, first_us), said.tracks[-1]
    was = numbers(before, paths) if before is not None else {}
    now = numbers(last, paths)
    read = len(now) == 2 and all(reads(said, paths, number, name, first_us, end_us) for name, number in now.items())
    a, b = paths.names
    if len(was) < 2:
        what = "late"
    elif len(now) < 2:
        what = "lost"
    elif now == was:
        what = "kept"
    else:
        what = "swapped" if now == {a: was[b], b: was[a]} else "renamed"
    return {"numbers": what, "read": read}
