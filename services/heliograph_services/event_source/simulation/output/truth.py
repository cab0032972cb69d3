"""What was really there, window by window: the only place of the source that makes the truth's record.

A beacon is looked at on an absolute grid of GRID_US, the nodes between which images move on straight lines
(`contract.NODE_US`), so that a place between two of them is exact. A frame was visible if the beacon was, at every
node from the last before its first bit to the first after its last: so it may be called hidden for something that hid
it up to a millisecond earlier or later, never visible while something hid it for a millisecond or longer.

The grid is worked out for a block of time and all beacons at once. What a window says depends on its times alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags
from heliograph.truth import TENTHS, Fidelity, Truth
from heliograph_services.event_source.simulation.contract import NODE_US, Drive, Floats, Ints
from heliograph_services.event_source.simulation.world.spec import BeaconSpec
from heliograph_services.event_source.simulation.world.world import Seen

GRID_US: Final = NODE_US
# 0.2 s of 100 beacons are looked at in 2 ms: longer stretches cost no less, and would be felt live.
_BLOCK: Final = 200
# Who asks for a window that does not follow the last has the time before it looked at: the slowest frames, 20 bits at
# 1 bit/s, last 20 s.
_LOOKBACK: Final = 120_000
# A beacon behind the camera is anywhere; the wire bounds what a number may be.
_FAR_PX: Final = 1e6
_BEFORE_ALL: Final = -1


class _World(Protocol):
    @property
    def beacons(self) -> Sequence[BeaconSpec]: ...

    def seen_all(self, t_us: Floats) -> Seen: ...


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """The beacons at the nodes first, first + 1, ...; arrays are (beacons, nodes).

    Args:
        first: number of the first node.
        seen: all of them.
        hidden: number of the last node, up to and with this one, at which the beacon was not visible.
    """

    first: int
    seen: Seen
    hidden: Ints

    @property
    def last(self) -> int:
        return self.first + int(self.hidden.shape[1]) - 1


class Truths:
    """Makes the truth of a scene.

    Args:
        world: where things are.
        drives: one an emitter, the beacons' first, in their order in the world.
        camera: the camera's name on the bus.
        sensor: name of its preset.
        fidelity: of the rendering.
    """

    def __init__(self, world: _World, drives: Sequence[Drive], camera: str, sensor: str, fidelity: Fidelity) -> None:
        self._world = world
        self._drives = list(drives[: len(world.beacons)])
        self._camera = camera
        self._sensor = sensor
        self._fidelity: Fidelity = fidelity
        self._names = [spec.name for spec in world.beacons]
        self._protocols = [spec.protocol for spec in world.beacons]
        self._held: _Block | None = None

    def window(self, t0_us: int, t1_us: int) -> Truth:
        """Return the truth of [t0_us, t1_us), t0_us >= 0; frames that began before time 0 were not sent.

        Quickest where windows follow one another.
        """
        block = self._block(t0_us // GRID_US, -(-t1_us // GRID_US))
        beacon, begin_us, end_us, payload = self._frames(t0_us, t1_us)
        edge_beacon, edge_us, edge_on = self._edges(t0_us, t1_us)
        every = np.arange(len(self._names))
        now = np.full(len(every), float(t1_us))
        low, high = t1_us // GRID_US - block.first, -(-t1_us // GRID_US) - block.first
        seen = block.seen
        whole = block.hidden[beacon, _up(end_us) - block.first] < _down(begin_us)
        return Truth(
            camera=self._camera,
            t0_us=t0_us,
            t1_us=t1_us,
            sensor=self._sensor,
            fidelity=self._fidelity,
            beacon=self._names,
            protocol=self._protocols,
            x_px=_between(block, seen.x_px, every, now, _FAR_PX),
            y_px=_between(block, seen.y_px, every, now, _FAR_PX),
            radius_px=_between(block, seen.radius_px, every, now, _FAR_PX),
            x_m=_between(block, seen.x_m, every, now),
            y_m=_between(block, seen.y_m, every, now),
            z_m=_between(block, seen.z_m, every, now),
            in_view=(seen.in_view[:, low] & seen.in_view[:, high]).tolist(),
            visible=(seen.visible[:, low] & seen.visible[:, high]).tolist(),
            frame_beacon=beacon.tolist(),
            frame_t0_us=np.rint(begin_us).astype(np.int64).tolist(),
            frame_t1_us=np.rint(end_us).astype(np.int64).tolist(),
            frame_payload=payload.tolist(),
            frame_x_px=_between(block, seen.x_px, beacon, end_us, _FAR_PX),
            frame_y_px=_between(block, seen.y_px, beacon, end_us, _FAR_PX),
            frame_visible=whole.tolist(),
            edge_beacon=edge_beacon,
            edge_us=edge_us,
            edge_on=edge_on,
        )

    def _frames(self, t0_us: int, t1_us: int) -> tuple[Ints, Floats, Floats, Ints]:
        """Return beacon, begin, end and payload of the frames that ended, by time, then beacon."""
        frames = [
            (i, frame.t0_us, frame.t1_us, frame.payload)
            for i, drive in enumerate(self._drives)
            for frame in drive.frames_ended(t0_us, t1_us)
            if frame.t0_us >= 0.0
        ]
        frames.sort(key=lambda frame: (frame[2], frame[0]))
        beacon = np.array([frame[0] for frame in frames], np.int64)
        begin_us = np.array([frame[1] for frame in frames], np.float64)
        end_us = np.array([frame[2] for frame in frames], np.float64)
        return beacon, begin_us, end_us, np.array([frame[3] for frame in frames], np.int64)

    def _edges(self, t0_us: int, t1_us: int) -> tuple[npt.NDArray[np.uint16], Floats, Flags]:
        """Return beacon, time and state of the edges, by beacon, then time, to a tenth of a microsecond."""
        changes = [drive.changes(t0_us, t1_us) for drive in self._drives]
        beacon = np.repeat(np.arange(len(changes), dtype=np.uint16), [len(t_us) for t_us, _ in changes])
        t_us = np.concatenate([np.empty(0), *(t_us for t_us, _ in changes)])
        level = np.concatenate([np.empty(0), *(level for _, level in changes)])
        return beacon, t0_us + np.rint((t_us - t0_us) * TENTHS) / TENTHS, level > 0.5

    def _block(self, low: int, high: int) -> _Block:
        """Return a block that holds the nodes low to high."""
        held = self._held
        if held is not None and held.first <= low and high <= held.last:
            return held
        if held is not None and held.first <= low <= held.last:
            hidden = held.hidden[:, low - held.first]
        else:
            hidden = self._hidden_before(low)
        seen = self._seen(low, max(high, low + _BLOCK) + 1)
        self._held = _Block(low, seen, _last_hidden(seen, low, hidden))
        return self._held

    def _hidden_before(self, node: int) -> Ints:
        """Return the last node before this one at which each beacon was not visible; none is after _LOOKBACK."""
        hidden = np.full(len(self._names), _BEFORE_ALL, np.int64)
        earliest = max(0, node - _LOOKBACK)
        for low in range(earliest, node, _BLOCK):
            hidden = _last_hidden(self._seen(low, min(low + _BLOCK, node)), low, hidden)[:, -1]
        return hidden

    def _seen(self, low: int, high: int) -> Seen:
        return self._world.seen_all(np.arange(low, high, dtype=np.float64) * GRID_US)


def _last_hidden(seen: Seen, first: int, before: Ints) -> Ints:
    """Return (beacons, nodes) int64: the last node up to each at which the beacon was not visible."""
    node = np.arange(first, first + seen.visible.shape[1], dtype=np.int64)
    at = np.where(seen.visible, before[:, None], node[None, :])
    hidden: Ints = np.maximum.accumulate(at, axis=1)
    return hidden


def _between(block: _Block, values: Floats, beacon: Ints, t_us: Floats, limit: float | None = None) -> list[float]:
    """Return the values (beacons, nodes) of some beacons, each at a time, on straight lines between the nodes."""
    low = _down(t_us)
    share = t_us / GRID_US - low
    here, there = values[beacon, low - block.first], values[beacon, np.minimum(low + 1, block.last) - block.first]
    if limit is not None:
        here, there = np.clip(here, -limit, limit), np.clip(there, -limit, limit)
    placed: list[float] = (here + share * (there - here)).tolist()
    return placed


def _down(t_us: Floats) -> Ints:
    return np.floor(t_us / GRID_US).astype(np.int64)


def _up(t_us: Floats) -> Ints:
    return np.ceil(t_us / GRID_US).astype(np.int64)
