"""The genie: the same receivers with the true paths. What it reads is what the light allows: the ceiling of a tracker.

It knows of each beacon, at every event's own time: where its image's centre is, how large it is (`paths.TruePaths`),
and whether anything hides it; and beforehand its protocol, options and true bit rate (the nominal one with its clock's
offset). It does not know a bit, an edge or a phase: clock recovery, step response and frames are the receivers' own
work. It listens to the image's *core*, half a pixel beyond its half width at half maximum: the pixels farther out see
edges of little contrast, late and smeared, and receivers read less with them (a scanned sensor at 5 kbit/s, 20 slow
beacons: .71 with all that a beacon's edges reach, 1.00 with its core). An event goes to the nearest visible beacon
whose core it lies in, and to no other. Nothing is acquired, predicted, centred, contested or lost; a place published
with a frame is the true one.

Where receivers are short of events (2 kbit/s behind a scan of 199 us) all that the image reaches may read more than its
core: with the ear `whole` the genie listens to `reach_px`. The ceiling of a path is the better of both ears.

Between the genie and the whole system stands the decoder that is *told* the truth: `ToldTracker` publishes Tracks with
the true places, velocities and sizes once a period, and the decoder extrapolates and centres its regions as always.
What that loses beside the genie the regions lose; what the system loses beside that, the tracker.
"""

from __future__ import annotations

from typing import Any, Final, Literal

import numba
import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusals
from heliograph.events import EventBatch, Flags, Pixels, Times
from heliograph.link.contract import LinkFrame, Receiver
from heliograph.link.modulations import modulation
from heliograph.messages import Frames, Message, Tracks
from heliograph.streams import Events, Onsets
from heliograph_services.cli.studies.paths import MARGIN_PX, Floats, TruePaths
from heliograph_services.event_source.simulation.contract import NODE_US
from heliograph_services.event_source.simulation.world.spec import BeaconSpec

Ear = Literal["core", "whole"]

# Beyond the half width at half maximum; half a pixel is a pixel's own extent.
CORE_PX: Final = 0.5
# A track's radius covers nine tenths of its target's pixels (heliograph.messages.Tracks): so much of a disc's own.
_COVERS: Final = 0.9**0.5


class Genie:
    """Reads a scene along its true paths (heliograph.core.Core of events alone).

    Args:
        paths: of the scene.
        receiver: which of the modulations' receivers; a modulation that lacks it uses its default.
        ear: the image's core, or all that its edges reach.

    Raises:
        ValueError: a modulation refuses an option, or a bit rate is out of range.
    """

    def __init__(self, paths: TruePaths, receiver: str = "default", ear: Ear = "core") -> None:
        self.refusals = Refusals()
        self.counters: dict[str, int] = {"events": 0, "events_heard": 0, "frames": 0}
        self.gauges: dict[str, float] = {}
        self._paths = paths
        core_px = np.where(paths.reach_px > 0.0, np.minimum(paths.reach_px, paths.radius_px + CORE_PX), 0.0)
        self._ear_px = core_px if ear == "core" else paths.reach_px
        self._receivers = [receiver_of(spec, receiver) for spec in paths.beacons]

    def feed(self, message: Message) -> list[Message]:
        """Take the events of a window; return their frames."""
        if not isinstance(message, Events):
            return []
        batch = message.batch
        whose = hearer(self._paths, self._ear_px, batch)
        rows: list[tuple[int, int, LinkFrame]] = []
        for i, receiver in enumerate(self._receivers):
            mine = whose == i
            decided = receiver.feed(batch.t_us[mine], batch.on[mine], message.t1_us)
            if message.end:
                decided += receiver.flush()
            rows += [(one.t_us, i, one) for one in decided if isinstance(one, LinkFrame)]
        self.counters["events"] += len(batch)
        self.counters["events_heard"] += int(np.count_nonzero(whose >= 0))
        self.counters["frames"] += len(rows)
        return [self._frames(message, sorted(rows, key=lambda row: row[:2]))] if rows else []

    def ready(self, message: Message) -> bool:  # noqa: ARG002 - the contract of a core
        """Return True: it waits for nobody."""
        return True

    def tick(self, now_us: int) -> list[Message]:  # noqa: ARG002 - the contract of a core
        """Return nothing: silence means nothing to it."""
        return []

    def _frames(self, events: Events, rows: list[tuple[int, int, LinkFrame]]) -> Frames:
        x_px, y_px = self._paths.places([t_us for t_us, _, _ in rows])
        specs = [self._paths.beacons[i] for _, i, _ in rows]
        return Frames(
            camera=events.camera,
            t0_us=events.t0_us,
            t1_us=events.t1_us,
            t_us=[t_us for t_us, _, _ in rows],
            track=[spec.name for spec in specs],
            protocol=[spec.protocol for spec in specs],
            beacon=[spec.name for spec in specs],
            payload=[frame.payload for _, _, frame in rows],
            x_px=[float(x_px[i, k]) for k, (_, i, _) in enumerate(rows)],
            y_px=[float(y_px[i, k]) for k, (_, i, _) in enumerate(rows)],
            score=[frame.score for _, _, frame in rows],
        )


def receiver_of(spec: BeaconSpec, name: str = "default") -> Receiver:
    """Return a beacon's receiver, told the true rate of its clock.

    Raises:
        ValueError: see `Genie`.
    """
    kind = modulation(spec.protocol, **spec.options)
    if hasattr(kind, "advice"):
        # Payloads that a lamp can imitate are read: the genie knows that this is no lamp.
        kind = modulation(spec.protocol, **({"periodic": "believed"} | spec.options))
    rate = spec.bit_rate * (1.0 + spec.clock_ppm * 1e-6)
    try:
        return kind.receiver(rate, name)
    except ValueError:
        return kind.receiver(rate)


def hearer(paths: TruePaths, ear_px: Floats, batch: EventBatch) -> npt.NDArray[np.int64]:
    """Return (m,) int64: the nearest visible beacon within whose (k, n) ear each of m events lies; -1 for none."""
    p = paths
    return _nearest(batch.t_us, batch.x_px, batch.y_px, p.x_px, p.y_px, ear_px, p.visible)


@numba.njit(cache=True, nogil=True)
def _nearest(
    t_us: Times, x_px: Pixels, y_px: Pixels, xs: Floats, ys: Floats, reaches: Floats, visible: Flags
) -> npt.NDArray[np.int64]:
    k, n = xs.shape
    whose = np.full(len(t_us), -1, np.int64)
    for m in range(len(t_us)):
        at = min(max(t_us[m] / NODE_US, 0.0), n - 1.0)
        node = min(int(at), n - 2)
        share = at - node
        best = np.inf
        for i in range(k):
            reach = reaches[i, node]
            dx = x_px[m] - xs[i, node] - share * (xs[i, node + 1] - xs[i, node])
            if not visible[i, node] or abs(dx) > reach:
                continue
            dy = y_px[m] - ys[i, node] - share * (ys[i, node + 1] - ys[i, node])
            away = dx * dx + dy * dy
            if away <= reach * reach and away < best:
                best, whose[m] = away, i
    return whose


class ToldTracker:
    """Publishes the truth as Tracks (heliograph.core.Core, in the tracker's place).

    Args:
        paths: of the scene.
        camera: its name.
        period_us: of the messages.
    """

    def __init__(self, paths: TruePaths, camera: str, period_us: int = 1_000) -> None:
        self.refusals = Refusals()
        self.counters: dict[str, int] = {}
        self.gauges: dict[str, float] = {}
        self._paths = paths
        self._camera = camera
        self._period_us = period_us
        self._next_us = period_us
        self._born_us = np.full(len(paths.beacons), -1, np.int64)

    def feed(self, message: Message) -> list[Message]:
        """Take onsets, for their time alone; return the tracks of the instants that they complete."""
        if not isinstance(message, Onsets):
            return []
        out: list[Message] = []
        while self._next_us <= message.t1_us:
            out.append(self._tracks(self._next_us))
            self._next_us += self._period_us
        return out

    def ready(self, message: Message) -> bool:  # noqa: ARG002 - the contract of a core
        """Return True: statuses mean nothing to it."""
        return True

    def tick(self, now_us: int) -> list[Message]:  # noqa: ARG002 - the contract of a core
        """Return nothing."""
        return []

    def _tracks(self, t_us: int) -> Tracks:
        paths = self._paths
        node, _ = (int(value[0]) for value in paths.nodes([t_us]))
        (x_px, y_px), (vx, vy) = paths.places([t_us]), paths.velocities([t_us])
        told = np.flatnonzero(paths.in_view[:, node] & (paths.reach_px[:, node] > 0.0))
        self._born_us[told] = np.where(self._born_us[told] < 0, t_us, self._born_us[told])
        n = len(told)
        size_px = np.maximum(paths.reach_px[told, node] - MARGIN_PX, 0.5)
        columns: dict[str, Any] = {
            "track": [paths.beacons[i].name for i in told],
            "born_us": self._born_us[told].tolist(),
            "seen_us": [t_us] * n,
            "x_px": x_px[told, 0].tolist(),
            "y_px": y_px[told, 0].tolist(),
            "vx_px_s": vx[told, 0].tolist(),
            "vy_px_s": vy[told, 0].tolist(),
            "radius_px": (_COVERS * size_px).tolist(),
            "size_px": (np.pi * size_px**2).tolist(),
            "polarity": [0.0] * n,
            "status": ["valid"] * n,
        }
        # What is left says how sure a tracker is: quite.
        columns |= {name: [0.0] * n for name in Tracks.__struct_fields__[3:] if name not in columns}
        return Tracks(camera=self._camera, as_of_us=t_us, period_us=self._period_us, **columns)
