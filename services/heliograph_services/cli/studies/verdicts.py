"""What became of every frame sent: read right, read wrong, or not at all; so that readers can be paired by frames.

The definitions are the metrics sink's (docs/metrics.md), on the true path of nodes of a millisecond instead of the
truth's windows. A published frame f and a sent frame s of the same protocol match, one to one, where::

    |t_f - t1_s| <= (t1_s - t0_s) / 2      and      |p_f - p_s(t_f)| <= max(5 px, radius of the blob)

nearest in time first, then in place. A sent frame counts if the beacon is visible (in view) at every node of it, and
has been for max(0.5 s, 5 frames). It is *close* if another beacon in view comes within two blob diameters (the larger
of the two) at any node of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.accuracy import CLOSE_DIAMETERS, GATE_PX, GRACE_FRAMES, GRACE_US, HALF_LIMIT_US
from heliograph.messages import Frames, Tracks
from heliograph.truth import Truth
from heliograph_services.cli.studies.paths import Flags, Floats, Longs, TruePaths
from heliograph_services.event_source.simulation.contract import NODE_US

MISSING: Final = 0
RIGHT: Final = 1
WRONG: Final = 2


@dataclass(frozen=True, slots=True, eq=False)
class Sent:
    """n frames sent, by beacon, then time; all arrays (n,).

    Args:
        beacon: int64, number of the beacon.
        t0_us: int64, begin of the first bit.
        t1_us: int64, end of the last.
        payload: int64.
        visible: bool, counts for MAR_sent (visible).
        in_view: bool, likewise.
        close: bool, see the module.
        speed_px_s: float64, the fastest at a node of it.
    """

    beacon: Longs
    t0_us: Longs
    t1_us: Longs
    payload: Longs
    visible: Flags
    in_view: Flags
    close: Flags
    speed_px_s: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """What a reader made of them.

    Args:
        outcome: (n,) int8, MISSING, RIGHT or WRONG.
        payload: (n,) int64, as read; -1 where MISSING.
        off_px: (n,) float64, between the place published with the frame and the true one; nan where MISSING.
        published: frames published in the time of the frames that count.
        insertions: of them, those without a match.
    """

    outcome: npt.NDArray[np.int8]
    payload: Longs
    off_px: Floats
    published: int
    insertions: int


def sent_frames(truths: Sequence[Truth], paths: TruePaths) -> Sent:
    """Return the frames of a run."""
    rows = [
        (truth.frame_beacon[i], truth.frame_t1_us[i], truth.frame_t0_us[i], truth.frame_payload[i])
        for truth in truths
        for i in range(len(truth.frame_beacon))
    ]
    table = np.array(sorted(rows), np.int64).reshape(-1, 4)
    beacon, t1_us, t0_us, payload = table.T
    last = paths.x_px.shape[1] - 1
    low, high = t0_us // NODE_US, np.minimum(-(-t1_us // NODE_US), last)
    grace_us = np.maximum(GRACE_US, GRACE_FRAMES * (t1_us - t0_us))

    def counts(flags: Flags) -> Flags:
        since = _last_not(flags)[beacon, high] + 1
        out: Flags = (since <= low) & (t0_us - since * NODE_US >= grace_us)
        return out

    close = np.concatenate([np.zeros((len(paths.beacons), 1), np.int64), np.cumsum(_close(paths), axis=1)], axis=1)
    speed = np.hypot(np.diff(paths.x_px), np.diff(paths.y_px)) * (1e6 / NODE_US)
    middle = np.minimum((low + high) // 2, last - 1)
    return Sent(
        beacon,
        t0_us,
        t1_us,
        payload,
        counts(paths.visible),
        counts(paths.in_view),
        close[beacon, high + 1] > close[beacon, low],
        np.maximum.reduce([speed[beacon, np.minimum(at, last - 1)] for at in (low, middle, high)]),
    )


def verdicts(sent: Sent, frames: Sequence[Frames], paths: TruePaths) -> Verdicts:
    """Return what became of the frames, given all that a reader published."""
    t_us = np.array([t for one in frames for t in one.t_us], np.int64)
    x_px, y_px = (np.array([v for one in frames for v in getattr(one, name)], np.float64) for name in ("x_px", "y_px"))
    payload = np.array([v for one in frames for v in one.payload], np.int64)
    protocol = [v for one in frames for v in one.protocol]
    outcome, off_px = np.zeros(len(sent.t1_us), np.int8), np.full(len(sent.t1_us), np.nan)
    told = np.full(len(sent.t1_us), -1, np.int64)
    matched = np.zeros(len(t_us), np.bool_)
    if len(t_us) and len(sent.t1_us):
        for j, i, away in _matches(sent, t_us, x_px, y_px, protocol, paths):
            outcome[i] = RIGHT if payload[j] == sent.payload[i] else WRONG
            off_px[i] = away
            told[i] = payload[j]
            matched[j] = True
    counted = sent.t1_us[sent.visible]
    inside = (t_us >= counted.min()) & (t_us <= counted.max()) if len(counted) else np.zeros(len(t_us), np.bool_)
    return Verdicts(outcome, told, off_px, int(inside.sum()), int((inside & ~matched).sum()))


def tracked(sent: Sent, tracks: Sequence[Tracks], paths: TruePaths, *, carried: bool = True) -> Flags:
    """Return (n,) bool: whether the newest Tracks at each frame's end had one within the beacon's gate.

    Args:
        sent: the frames.
        tracks: in order.
        paths: of the beacons.
        carried: compared where the track's velocity has carried it by the frame's end; else where it was at the
            message's own instant: on a path that bends within a period nothing is carried along it.
    """
    out = np.zeros(len(sent.t1_us), np.bool_)
    as_of = np.array([one.as_of_us for one in tracks], np.int64)
    newest = np.searchsorted(as_of, sent.t1_us, side="right") - 1
    for m in np.unique(newest[newest >= 0]):
        one = tracks[int(m)]
        if not one.track:
            continue
        rows = np.flatnonzero(newest == m)
        of, column = sent.beacon[rows], np.arange(len(rows))
        t_us = sent.t1_us[rows] if carried else np.full(len(rows), one.as_of_us)
        x_px, y_px = paths.places(t_us)
        ahead = (t_us[:, None] - one.as_of_us) / 1e6
        dx = np.array(one.x_px) + ahead * np.array(one.vx_px_s) - x_px[of, column][:, None]
        dy = np.array(one.y_px) + ahead * np.array(one.vy_px_s) - y_px[of, column][:, None]
        out[rows] = (np.hypot(dx, dy) <= gates_px(paths, t_us)[of, column][:, None]).any(axis=1)
    return out


def gates_px(paths: TruePaths, t_us: npt.ArrayLike) -> Floats:
    """Return (k, m) how far from each beacon a place is still its, at (m,) times."""
    node, _ = paths.nodes(t_us)
    gate: Floats = np.maximum(GATE_PX, paths.radius_px[:, node])
    return gate


def _matches(
    sent: Sent, t_us: Longs, x_px: Floats, y_px: Floats, protocol: Sequence[str], paths: TruePaths
) -> list[tuple[int, int, float]]:
    """Return (published, sent, distance) of the frames that match."""
    true_x, true_y = paths.places(t_us)
    away = np.hypot(x_px - true_x, y_px - true_y)
    near = away <= gates_px(paths, t_us)
    spoken = np.array(protocol)
    pairs: list[tuple[int, float, int, int]] = []
    for k, spec in enumerate(paths.beacons):
        mine = np.flatnonzero(sent.beacon == k)
        heard = np.flatnonzero(near[k] & (spoken == spec.protocol))
        if not len(mine) or not len(heard):
            continue
        t1_us = sent.t1_us[mine]
        half_us = np.minimum((t1_us - sent.t0_us[mine]) // 2, HALF_LIMIT_US)
        first = np.searchsorted(t1_us, t_us[heard] - half_us.max())
        last = np.searchsorted(t1_us, t_us[heard] + half_us.max(), side="right")
        for j, low, high in zip(heard.tolist(), first.tolist(), last.tolist(), strict=True):
            for s in range(low, high):
                late_us = abs(int(t_us[j] - t1_us[s]))
                if late_us <= half_us[s]:
                    pairs.append((late_us, float(away[k, j]), int(mine[s]), j))
    taken_i, taken_j = set[int](), set[int]()
    found = []
    for _, distance, i, j in sorted(pairs):
        if i not in taken_i and j not in taken_j:
            taken_i.add(i)
            taken_j.add(j)
            found.append((j, i, distance))
    return found


def _last_not(flags: Flags) -> Longs:
    """Return (k, n) int64: the last node up to each at which a flag was not set; -1 for none."""
    node = np.arange(flags.shape[1], dtype=np.int64)
    out: Longs = np.maximum.accumulate(np.where(flags, -1, node), axis=1)
    return out


def _close(paths: TruePaths) -> Flags:
    """Return (k, n) bool: another beacon in view is within two blob diameters."""
    close = np.zeros(paths.x_px.shape, np.bool_)
    for i in range(len(paths.beacons)):
        for j in range(i):
            away = np.hypot(paths.x_px[i] - paths.x_px[j], paths.y_px[i] - paths.y_px[j])
            diameter = 2.0 * np.maximum(paths.radius_px[i], paths.radius_px[j])
            both = (away <= CLOSE_DIAMETERS * diameter) & paths.in_view[i] & paths.in_view[j]
            close[i] |= both
            close[j] |= both
    return close
