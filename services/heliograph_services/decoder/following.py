"""The tracks of one stream with their regions: two lists in one order, changed together."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.errors import Refusals
from heliograph.messages import Tracks
from heliograph_services.decoder.backlog import Backlog, Heard
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.links import Decided, LinkPlan, TrackLinks
from heliograph_services.decoder.regions import Place, Regions, mixed
from heliograph_services.decoder.tracks import Plan, Told, Track, plan_of, told_by


@dataclass(frozen=True, slots=True)
class Applied:
    """What has become of a Tracks message.

    Args:
        renamed: tracks that were adopted, and the names that they had.
        ended: tracks that have ended, and where.
        begun: new tracks, and what their backlog held.
        dropped: new tracks for which there was no room.
    """

    renamed: list[tuple[Track, str]]
    ended: list[tuple[Track, Place]]
    begun: list[tuple[Track, list[Decided]]]
    dropped: int


class Following:
    """All tracks of one stream.

    Args:
        config: the decoder's settings.
        plan: the links of the site.
        width: of the sensor, px.
        height: of the sensor, px.
    """

    def __init__(self, config: DecoderConfig, plan: LinkPlan, width: int, height: int) -> None:
        self._config = config
        self._plan = plan
        self._serial = 0
        self.size = (width, height)
        self.tracks: list[Track] = []
        reach_px = config.region_max_px
        self.regions = Regions(width, height, config.max_tracks, config.step_us, reach_px)
        self._spare = Regions(width, height, config.max_tracks, config.step_us, reach_px)
        self.backlog = Backlog(config.window_us, config.backlog_us, config.backlog_events)

    def restart(self, now_us: int) -> None:
        """Forget all tracks and events; time begins anew at now_us."""
        self.tracks = []
        self.backlog.clear()
        self.regions.load([], [], now_us)

    def at(self, i: int, t_us: int) -> Place:
        """Return where track i was, or will be, at t_us."""
        extrapolated = self.regions.place(i).after(t_us - self.regions.now_us)
        return self.tracks[i].trail.at(t_us, extrapolated)

    def end(self, ended: list[Track]) -> None:
        """Let these tracks go."""
        gone = {track.serial for track in ended}
        kept = [i for i, track in enumerate(self.tracks) if track.serial not in gone]
        places = [self.regions.place(i) for i in kept]
        centred = [self.regions.centred_us(i) for i in kept]
        self.tracks = [self.tracks[i] for i in kept]
        self.regions.load(places, centred, self.regions.now_us)

    def apply(self, message: Tracks, now_us: int) -> Applied:
        """Let a Tracks message take effect at now_us, the regions' instant."""
        config = self._config
        told, left_out = told_by(message, {track.name for track in self.tracks}, config)
        elapsed_us = now_us - message.as_of_us
        places = self.regions.places()
        plan = plan_of(self.tracks, places, told, elapsed_us)
        where = {track.serial: i for i, track in enumerate(self.tracks)}
        ended = [(track, places[where[track.serial]]) for track in plan.end]
        renamed = self._go_on(plan, elapsed_us, now_us)
        self.end(plan.end)
        room = config.max_tracks - len(self.tracks)
        new = plan.new[:room]
        begun = self._begin(new, message.as_of_us, now_us) if new else []
        return Applied(renamed, ended, begun, left_out + len(plan.new) - len(new))

    def _go_on(self, plan: Plan, elapsed_us: int, now_us: int) -> list[tuple[Track, str]]:
        """Mix what is told into the regions that go on; return the tracks with a new name."""
        told_of: dict[int, Told] = {track.serial: row for track, row in (*plan.update, *plan.adopt)}
        places: list[Place] = []
        centred: list[int] = []
        for i, track in enumerate(self.tracks):
            own = self.regions.place(i)
            row = told_of.get(track.serial)
            track.told = row is not None
            if row is not None:
                there = row.place.after(elapsed_us)
                own = mixed(own, self.regions.centred_us(i), there, now_us, read=track.read)
            places.append(own)
            centred.append(self.regions.centred_us(i))
        self.regions.load(places, centred, now_us)
        renamed: list[tuple[Track, str]] = []
        for track, row in plan.adopt:
            renamed.append((track, track.name))
            track.name = row.name
        return renamed

    def _begin(self, new: list[Told], as_of_us: int, now_us: int) -> list[tuple[Track, list[Decided]]]:
        """Begin new tracks with what the backlog holds of them."""
        heard: list[Heard] = self.backlog.replay(
            self._spare, [row.place for row in new], [row.born_us for row in new], as_of_us, now_us, Refusals()
        )
        begun: list[Track] = []
        for row, one in zip(new, heard, strict=True):
            begun.append(Track(self._serial, row.name, TrackLinks(self._plan), one.trail))
            self._serial += 1
        n = len(self.tracks)
        self.tracks += begun
        places = [self.regions.place(i) for i in range(n)] + [one.now for one in heard]
        centred = [self.regions.centred_us(i) for i in range(n)] + [one.centred_us for one in heard]
        self.regions.load(places, centred, now_us)
        return [(track, track.links.feed(one.t_us, one.on, now_us)) for track, one in zip(begun, heard, strict=True)]
