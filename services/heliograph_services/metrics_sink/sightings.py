"""Sightings: an identified beacon from acceptance to loss, built from the states of `ids/{camera}/{track}`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from heliograph.messages import Identification
from heliograph.units import US_PER_S
from heliograph_services.metrics_sink.rows import SightingRow
from heliograph_services.metrics_sink.scoring import Received

# States come at 10 Hz. Without one for so long the decoder has died, or its `lost` never arrived.
FORGET_US: Final = 5 * US_PER_S
# A decoder follows tens of tracks; more open sightings than this are damaged input.
LIMIT: Final = 4096


@dataclass(slots=True)
class _Sighting:
    beacon: str
    protocol: str
    first_us: int
    last_us: int
    first_px: tuple[float, float]
    last_px: tuple[float, float]
    frames: int = 0
    ended: bool = False

    def row(self, camera: str, epoch: int, track: str) -> SightingRow:
        return SightingRow(
            camera=camera,
            epoch=epoch,
            track=track,
            beacon=self.beacon,
            protocol=self.protocol,
            first_us=self.first_us,
            last_us=self.last_us,
            first_x_px=self.first_px[0],
            first_y_px=self.first_px[1],
            last_x_px=self.last_px[0],
            last_y_px=self.last_px[1],
            frames=self.frames,
            ended=self.ended,
        )


class Sightings:
    """The sightings of one camera's stream."""

    def __init__(self) -> None:
        self._of: dict[str, _Sighting] = {}
        self._closed: list[tuple[str, _Sighting]] = []
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._of)

    def second(self, states: list[Identification], frames: list[Received]) -> None:
        """Take the states and the frames of one second, each in order of time."""
        for state in states:
            self._take(state)
        during: dict[str, list[_Sighting]] = {}
        for track, sighting in (*self._closed, *self._of.items()):
            during.setdefault(track, []).append(sighting)
        for frame in frames:
            for sighting in during.get(frame.track, ()):
                if sighting.first_us <= frame.t_us <= sighting.last_us or (
                    not sighting.ended and frame.t_us > sighting.last_us
                ):
                    sighting.frames += 1

    def take_rows(self, camera: str, epoch: int, now_us: int) -> list[SightingRow]:
        """Return every open sighting as it is, and those that have ended since the last call.

        Args:
            camera: for the rows.
            epoch: for the rows.
            now_us: the end of the second that was taken.
        """
        for track in [track for track, s in self._of.items() if now_us - s.last_us > FORGET_US]:
            self._close(track)
        rows = [sighting.row(camera, epoch, track) for track, sighting in self._closed]
        rows += [self._of[track].row(camera, epoch, track) for track in sorted(self._of)]
        self._closed.clear()
        return rows

    def so_far(self, waiting: list[Identification], camera: str, epoch: int) -> list[SightingRow]:
        """Return the rows as they would be with states that still wait; their frames are not counted yet.

        Args:
            waiting: in order of time; nothing of them is kept.
            camera: for the rows.
            epoch: for the rows.
        """
        trial = Sightings()
        trial._of = {track: replace(sighting) for track, sighting in self._of.items()}
        for state in waiting:
            trial._take(state)
        return trial.take_rows(camera, epoch, -(2**62))

    def close(self) -> None:
        """End all of them: the stream has ended."""
        for track in sorted(self._of):
            self._close(track)

    def _take(self, state: Identification) -> None:
        here = (state.x_px, state.y_px)
        now = self._of.get(state.track)
        if now is not None and (state.lost or now.beacon != state.beacon or now.first_us != state.since_us):
            if state.lost:
                now.last_us, now.last_px = max(now.last_us, state.t_us), here
            self._close(state.track)
            now = None
        if state.lost:
            return
        if now is None:
            if len(self._of) >= LIMIT:
                self.dropped += 1
                return
            now = _Sighting(state.beacon, state.protocol, state.since_us, state.t_us, here, here)
            self._of[state.track] = now
        now.last_us, now.last_px = state.t_us, here

    def _close(self, track: str) -> None:
        sighting = self._of.pop(track)
        sighting.ended = True
        self._closed.append((track, sighting))
