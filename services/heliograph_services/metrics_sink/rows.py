"""What the metrics sink keeps: four kinds of rows, each written whole, each replacing its older self.

Counts are kept, never ratios: counts of seconds, cameras and runs can be added, then divided. `epoch` tells apart the
streams that one camera name has carried while the sink ran; a camera's time starts anew with each.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CountRow:
    """One counter of one camera in one second.

    Args:
        camera: its name.
        epoch: see the module.
        t0_us: the second's beginning, a multiple of 1,000,000 of camera time.
        name: the counter; the list is in the service's README.
        n: how many, in that second alone.
    """

    camera: str
    epoch: int
    t0_us: int
    name: str
    n: int


@dataclass(frozen=True, slots=True)
class SightingRow:
    """An identified beacon from acceptance to loss; keyed by camera, epoch, track and first_us.

    Args:
        first_us: end of the frame with which it was accepted.
        last_us: the newest state of it.
        frames: accepted frames of the track in between.
        ended: the beacon is lost, or the stream has ended.
    """

    camera: str
    epoch: int
    track: str
    beacon: str
    protocol: str
    first_us: int
    last_us: int
    first_x_px: float
    first_y_px: float
    last_x_px: float
    last_y_px: float
    frames: int
    ended: bool


@dataclass(frozen=True, slots=True)
class AcquisitionRow:
    """A visible interval of a beacon, and when it was first identified in it; keyed by beacon and began_us.

    Args:
        began_us: the first visible instant.
        lasted_us: how long the interval has lasted.
        occluded_us: how long the beacon was not visible before, or None for its first appearance.
        acquired_us: camera time of the first right identification that a right frame of this interval supports, less
            began_us; None while there is none.
    """

    camera: str
    epoch: int
    beacon: str
    began_us: int
    lasted_us: int
    occluded_us: int | None
    acquired_us: int | None


@dataclass(frozen=True, slots=True)
class HealthRow:
    """The newest value of a process's own counter or gauge; keyed by service, instance, pid and name."""

    service: str
    instance: str
    pid: int
    name: str
    value: float


Row = CountRow | SightingRow | AcquisitionRow | HealthRow
