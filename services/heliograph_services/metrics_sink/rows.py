"""What the metrics sink keeps: seven kinds of rows, each written whole, each replacing its older self.

Counts are kept, never ratios: counts of seconds, cameras and runs can be added, then divided. `epoch` tells apart the
streams that one camera name has carried while the sink ran; a camera's time starts anew with each. The seconds of a
process are those of its own uptime. Percentiles cannot be added, so a hop's come with their n, second by second.
"""

from __future__ import annotations

from dataclasses import dataclass

Key = tuple[str | int, ...]


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

    @property
    def key(self) -> Key:
        """Return what a later row must share to replace this one."""
        return ("count", self.camera, self.epoch, self.t0_us, self.name)


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

    @property
    def key(self) -> Key:
        """Return what a later row must share to replace this one."""
        return ("sighting", self.camera, self.epoch, self.track, self.first_us)


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

    @property
    def key(self) -> Key:
        """Return what a later row must share to replace this one."""
        return ("acquisition", self.camera, self.epoch, self.beacon, self.began_us)


@dataclass(frozen=True, slots=True)
class HealthRow:
    """The newest value of a process's own counter or gauge; keyed by service, instance, pid and name."""

    service: str
    instance: str
    pid: int
    name: str
    value: float

    @property
    def key(self) -> Key:
        """Return what a later row must share to replace this one."""
        return ("health", self.service, self.instance, self.pid, self.name)


@dataclass(frozen=True, slots=True)
class ProcessCountRow:
    """By how much a counter of a process rose in one second of its uptime: rates, gaps, drops, refusals."""

    service: str
    instance: str
    pid: int
    second: int
    name: str
    n: int

    @property
    def key(self) -> Key:
        """Return what a later row must share to replace this one."""
        return ("processcount", self.service, self.instance, self.pid, self.second, self.name)


@dataclass(frozen=True, slots=True)
class LevelRow:
    """A gauge of a process in one second of its uptime: queue depth, share of a core."""

    service: str
    instance: str
    pid: int
    second: int
    name: str
    value: float

    @property
    def key(self) -> Key:
        """Return what a later row must share to replace this one."""
        return ("level", self.service, self.instance, self.pid, self.second, self.name)


@dataclass(frozen=True, slots=True)
class HopRow:
    """How long n messages took over one hop in one second of a process's uptime."""

    service: str
    instance: str
    pid: int
    second: int
    hop: str
    n: int
    p50_us: int
    p95_us: int
    p99_us: int

    @property
    def key(self) -> Key:
        """Return what a later row must share to replace this one."""
        return ("hop", self.service, self.instance, self.pid, self.second, self.hop)


ProcessRow = HealthRow | ProcessCountRow | LevelRow | HopRow
Row = CountRow | SightingRow | AcquisitionRow | ProcessRow
