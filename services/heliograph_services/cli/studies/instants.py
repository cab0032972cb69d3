"""MAR_sent with places compared at one instant, for receivers whose frames end at any bit, of images that move.

The metrics sink compares where a frame was read (at its end t_f) with where the beacon was at the end t1_s of the
sent one. The paper's receiver checks the last eleven bits, wherever a frame begins, so the two lie up to half a frame
apart: at 50 bit/s 110 ms, in which an image of 100 px/s moves 11 px. Here the place is the beacon's at t_f::

    |t_f - t1_s| <= (t1_s - t0_s) / 2      and      |p_f - p_s(t_f)| <= max(5 px, radius of the blob)

nearest in time first, one to one. All else is as docs/metrics.md has it: visible frames count from max(0.5 s, 5 frames)
after the beacon became visible, frames in view from as long after it came into view. Texts are left out.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from math import hypot
from typing import Final

import numpy as np

from heliograph.link.modulations import TEXT
from heliograph.messages import Frames
from heliograph.truth import Truth

GATE_PX: Final = 5.0
GRACE_US: Final = 500_000
GRACE_FRAMES: Final = 5


@dataclass(frozen=True, slots=True)
class Counts:
    """Frames sent and read right, of those that count."""

    in_view: int
    right_in_view: int
    visible: int
    right_visible: int


@dataclass(frozen=True, slots=True)
class _Sent:
    name: str
    protocol: str
    t0_us: int
    t1_us: int
    payload: int
    in_view: bool
    visible: bool

    @property
    def half_us(self) -> float:
        return (self.t1_us - self.t0_us) / 2


class _Path:
    """Where a beacon was, and since when it has been in view and visible."""

    def __init__(self) -> None:
        self.t_us: list[int] = []
        self.x_px: list[float] = []
        self.y_px: list[float] = []
        self.radius_px = 0.0
        self.viewed_us: int | None = None
        self.seen_us: int | None = None

    def add(self, truth: Truth, i: int) -> None:
        """Take the beacon's state of a window."""
        self.t_us.append(truth.t1_us)
        self.x_px.append(truth.x_px[i])
        self.y_px.append(truth.y_px[i])
        self.radius_px = truth.radius_px[i]
        if not truth.in_view[i]:
            self.viewed_us = None
        elif self.viewed_us is None:
            self.viewed_us = truth.t0_us
        if not truth.visible[i]:
            self.seen_us = None
        elif self.seen_us is None:
            self.seen_us = truth.t0_us

    def away_px(self, t_us: int, x_px: float, y_px: float) -> float:
        """Return the distance of a place from the beacon at a time."""
        return hypot(
            x_px - float(np.interp(t_us, self.t_us, self.x_px)), y_px - float(np.interp(t_us, self.t_us, self.y_px))
        )


def _late_enough(since_us: int | None, t0_us: int, t1_us: int) -> bool:
    return since_us is not None and t0_us - since_us >= max(GRACE_US, GRACE_FRAMES * (t1_us - t0_us))


def counts_of(truths: list[Truth], frames: list[Frames]) -> Counts:
    """Return the counts of a run.

    Args:
        truths: its windows, in order of time.
        frames: all that was published.
    """
    paths: dict[str, _Path] = defaultdict(_Path)
    sent: list[_Sent] = []
    for truth in truths:
        for i, name in enumerate(truth.beacon):
            paths[name].add(truth, i)
        for k, i in enumerate(truth.frame_beacon):
            name, t0_us, t1_us = truth.beacon[i], truth.frame_t0_us[k], truth.frame_t1_us[k]
            if truth.protocol[i] in TEXT:
                continue
            viewed = _late_enough(paths[name].viewed_us, t0_us, t1_us)
            seen = truth.frame_visible[k] and _late_enough(paths[name].seen_us, t0_us, t1_us)
            sent.append(_Sent(name, truth.protocol[i], t0_us, t1_us, truth.frame_payload[k], viewed, seen))
    right = _right(sent, frames, paths)
    return Counts(
        in_view=sum(one.in_view for one in sent),
        right_in_view=sum(one.in_view for i, one in enumerate(sent) if i in right),
        visible=sum(one.visible for one in sent),
        right_visible=sum(one.visible for i, one in enumerate(sent) if i in right),
    )


def _right(sent: list[_Sent], frames: list[Frames], paths: dict[str, _Path]) -> set[int]:
    """Return which of the sent frames were read right."""
    read = [
        (message.t_us[k], message.protocol[k], message.payload[k], message.x_px[k], message.y_px[k])
        for message in frames
        for k in range(len(message.t_us))
    ]
    read.sort()
    times = np.array([one[0] for one in read], np.float64)
    pairs = []
    for i, one in enumerate(sent):
        path = paths[one.name]
        first, last = np.searchsorted(times, [one.t1_us - one.half_us, one.t1_us + one.half_us + 1])
        for j in range(int(first), int(last)):
            t_us, protocol, _, x_px, y_px = read[j]
            away_px = path.away_px(t_us, x_px, y_px)
            if protocol == one.protocol and away_px <= max(GATE_PX, path.radius_px):
                pairs.append((abs(t_us - one.t1_us), away_px, i, j))
    taken_i, taken_j, right = set[int](), set[int](), set[int]()
    for _, _, i, j in sorted(pairs):
        if i in taken_i or j in taken_j:
            continue
        taken_i.add(i)
        taken_j.add(j)
        if read[j][2] == sent[i].payload:
            right.add(i)
    return right
