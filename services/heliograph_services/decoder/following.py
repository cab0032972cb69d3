"""The tracks of one stream with their regions: two lists in one order, changed together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from heliograph.events import EventBatch
from heliograph.messages import Tracks
from heliograph_services.decoder.backlog import Backlog
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.feeding import Feeding, beat_us
from heliograph_services.decoder.history import History
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import CONTEST_US, Decided, TrackLinks
from heliograph_services.decoder.regions import Doubt, Place, Regions, column, doubt
from heliograph_services.decoder.tracks import Plan, Told, Track, plan_of, told_by

# A frame is published at most a contest and some frames of 220 ms (11 bits at 50 bit/s) after its end.
HISTORY_US: Final = CONTEST_US + 1_000_000
# What is not read yields a twentieth at least at 10 Hz: it forgets a wrong centre within 2 s.
LEAST_WEIGHT: Final = 0.05
# A tracker's errors last about so long (the paper's runs at 10 Hz): what it says more often it says again.
AGAIN_US: Final = 100_000
# A region that has not been centred for so long follows nothing: twice the longest run of a code at 1 kbit/s.
BLIND_US: Final = 20_000


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
        self.beat_us = beat_us(config.window_us, config.refresh_us, config.tracker_period_us)
        self.tracks: list[Track] = []
        self.relocated = 0
        self.heard: list[EventBatch] = []  # the windows of the beat
        self._as_of_us: int | None = None  # of the last message
        self.regions = self._free_regions()
        self._spare = self._free_regions()
        self.backlog = Backlog(self.size, self.beat_us, config.backlog_us, config.backlog_events)
        self.history = History(-(-HISTORY_US // self.beat_us))
        self.feeding = Feeding(config.max_tracks)

    def _free_regions(self) -> Regions:
        config = self._config
        return Regions(
            *self.size, config.max_tracks, config.step_us, config.region_max_px, self_centring=config.self_centring
        )

    def restart(self, now_us: int) -> None:
        """Forget all tracks and events; time begins anew at now_us."""
        self.tracks = []
        self._as_of_us = None
        self.backlog.clear()
        self.history.clear()
        self.heard = []
        self.feeding = Feeding(self._config.max_tracks)
        self.regions.restart(now_us)
        self.regions.noise_per_px_us = 0.0

    def end_beat(self) -> None:
        """Note where the regions are, measure the noise, and keep the events of the beat."""
        now_us = self.regions.now_us
        self.history.record(now_us, self.regions.motion())
        self.regions.measure()
        self.backlog.push(now_us - now_us % -self.beat_us - self.beat_us, self.heard)
        self.heard = []

    def at(self, i: int, t_us: int) -> Place:
        """Return where track i was, or will be, at t_us."""
        known = self.history.at(i, t_us)
        if known is None:
            return self.regions.place(i).after(t_us - self.regions.now_us)
        return Place(*known, self.regions.reach_px(i))

    def end(self, ended: list[Track]) -> None:
        """Let these tracks go."""
        gone = {track.serial for track in ended}
        kept = [i for i, track in enumerate(self.tracks) if track.serial not in gone]
        self.tracks = [self.tracks[i] for i in kept]
        self.regions.keep(kept)
        self.history.keep(kept)
        self.feeding.keep(kept)

    def apply(self, message: Tracks, now_us: int) -> Applied:
        """Let a Tracks message take effect at now_us, the regions' instant."""
        config = self._config
        told, left_out = told_by(message, {track.name for track in self.tracks}, config)
        then = [self.at(i, message.as_of_us) for i in range(len(self.tracks))]
        plan = plan_of(self.tracks, then, told, now_us)
        index = {track.serial: i for i, track in enumerate(self.tracks)}
        ended = [(track, self.regions.place(index[track.serial])) for track in plan.end]
        renamed = self._go_on(plan, then, message.as_of_us, now_us)
        self.end(plan.end)
        room = config.max_tracks - len(self.tracks)
        new = plan.new[:room]
        heard = [
            at
            for track, at in ((track, self.at(i, message.as_of_us)) for i, track in enumerate(self.tracks))
            if track.reading(now_us)
        ]
        begun = self._begin([_not_twice(row, heard, now_us) for row in new], message.as_of_us, now_us) if new else []
        return Applied(renamed, ended, begun, left_out + len(plan.new) - len(new))

    def _go_on(self, plan: Plan, then: list[Place], as_of_us: int, now_us: int) -> list[tuple[Track, str]]:
        """Let the regions that go on heed what is told of them; return the tracks with a new name."""
        told_of: dict[int, Told] = {track.serial: row for track, row in (*plan.update, *plan.adopt)}
        centred_us = self.regions.centred_us()
        share = self._news(as_of_us)
        astray: list[tuple[int, Told]] = []
        for i, track in enumerate(self.tracks):
            row = told_of.get(track.serial)
            track.told = row is not None
            if row is None:
                continue
            self.regions.resize(i, row.place.reach_px, row.radius_px)
            blind = now_us - int(centred_us[i]) > BLIND_US
            reads = track.reading(now_us) and not blind
            if then[i].away_px(row.place) <= min(then[i].reach_px, row.place.reach_px):
                self._heed(i, row, then[i], now_us - as_of_us, share, reads=reads)
            elif not reads:
                astray.append((i, replace(row, doubt=self._told_doubt(i, row))))
        self._relocate(astray, as_of_us, now_us)
        renamed = [(track, track.name) for track, _ in plan.adopt]
        for track, row in plan.adopt:
            track.name = row.name
        return renamed

    def _heed(self, i: int, row: Told, then: Place, elapsed_us: int, share: float, *, reads: bool) -> None:
        """Correct region i by what is told of a place near where it was then.

        Args:
            i: which region.
            row: what is told.
            then: where it was at the row's instant.
            elapsed_us: since then.
            share: of what a message says, how much is new (`_news`).
            reads: whether the region's own events are being read.
        """
        own, told = self.regions.doubt(i), self._told_doubt(i, row).after(elapsed_us, self.regions.drive(i))
        least = 0.0 if reads or not self._config.self_centring else LEAST_WEIGHT
        (w, xx), (wv, vv) = (_heeded(a, b, share, least) for a, b in ((own.xx, told.xx), (own.vv, told.vv)))
        dv = (row.place.vx_px_s - then.vx_px_s, row.place.vy_px_s - then.vy_px_s)
        d = (row.place.x_px - then.x_px, row.place.y_px - then.y_px)
        self.regions.shift(
            i,
            (w * d[0], w * d[1]),
            (wv * dv[0], wv * dv[1]),
            doubt(xx, (1 - max(w, wv)) * own.xv, vv),
        )

    def _told_doubt(self, i: int, row: Told) -> Doubt:
        """Return how sure a row is, at its instant: of what is not seen, no surer than region i's own motion allows."""
        unseen = Doubt(0.0, 0.0, 0.0).after(row.unseen_us, self.regions.drive(i))
        return doubt(row.doubt.xx + unseen.xx, row.doubt.xv + unseen.xv, row.doubt.vv + unseen.vv)

    def _news(self, as_of_us: int) -> float:
        """Return how much of a message is new since the one before, and note it: 1 at AGAIN_US apart and more."""
        since_us = AGAIN_US if self._as_of_us is None else as_of_us - self._as_of_us
        self._as_of_us = as_of_us
        return min(max(since_us, 0), AGAIN_US) / AGAIN_US

    def _relocate(self, astray: list[tuple[int, Told]], as_of_us: int, now_us: int) -> None:
        """Let regions that have lost their targets catch up with them from where the tracker saw them."""
        if not astray:
            return
        states = np.stack([column(row.place, row.radius_px, row.doubt) for _, row in astray], axis=1)
        self._spare.noise_per_px_us = self.regions.noise_per_px_us
        self.backlog.catch_up(self._spare, states, as_of_us, now_us)
        found, centred_us = self._spare.states(), self._spare.centred_us()
        for k, (i, _) in enumerate(astray):
            self.regions.put(i, found[:, k], int(centred_us[k]))
        self.relocated += len(astray)

    def _begin(self, new: list[Told], as_of_us: int, now_us: int) -> list[tuple[Track, list[Decided]]]:
        """Begin new tracks with what the backlog holds of them."""
        states = np.stack([column(row.place, row.radius_px, row.doubt) for row in new], axis=1)
        self._spare.noise_per_px_us = self.regions.noise_per_px_us
        heard = self.backlog.replay(self._spare, states, [row.born_us for row in new], as_of_us, now_us)
        begun = [Track(self._serial + k, row.name, TrackLinks(self._plan)) for k, row in enumerate(new)]
        self._serial += len(new)
        self.tracks += begun
        self.regions.append(self._spare.states(), self._spare.centred_us())
        for one in heard:
            self.history.append(one.trail_us, one.trail)
        fed = [
            (track, track.links.feed(one.t_us, one.on, one.depth, now_us))
            for track, one in zip(begun, heard, strict=True)
        ]
        self.feeding.append(now_us, [len(one.t_us) > 0 for one in heard], [track.links.due_us() for track in begun])
        return fed


def _not_twice(row: Told, heard: list[Place], now_us: int) -> Told:
    """Return a new track's row; what lies on the spot of one that is being read does not read its past once more."""
    near = any(row.place.away_px(at) <= 0.5 * min(row.place.reach_px, at.reach_px) for at in heard)
    return replace(row, born_us=now_us) if near else row


def _heeded(own: float, told: float, share: float, least: float) -> tuple[float, float]:
    """Return how far a region goes to what is told, and the variance that is left.

    w = own / (own + told) of the two variances, at least `least`; but only a share of what is told is new, so that what
    is said again and again moves the region, and does not make it surer, than the tracker itself is at most.
    """
    w = max(least * share, own / max(own + told, 1e-12))
    fresh = max(least * share, own * share / max(own * share + told, 1e-12))
    return w, min((1.0 - fresh) * own, max(told, (1.0 - w) * own))
