"""The tracks of one stream with their regions: two lists in one order, changed together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.events import EventBatch, Flags
from heliograph.messages import Tracks
from heliograph_services.decoder.backlog import Backlog
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.feeding import Feeding, beat_us
from heliograph_services.decoder.history import History
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import CONTEST_US, Decided, TrackLinks
from heliograph_services.decoder.region_state import REACH, VX, VY, Floats, Ints, X, Y
from heliograph_services.decoder.regions import Doubt, Place, Regions, doubt
from heliograph_services.decoder.telling import Telling, telling_of
from heliograph_services.decoder.tracks import Plan, Track, away_px, plan_of

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

    def all_at(self, t_us: int) -> Floats:
        """Return where all tracks were, or will be, at t_us: x, y, vx, vy, reach, (5, n)."""
        known = self.history.all_at(t_us)
        if known is None:
            return self.regions.places(t_us - self.regions.now_us)
        places = self.regions.places()
        places[:REACH] = known
        return places

    def apply(self, message: Tracks, now_us: int) -> Applied:
        """Let a Tracks message take effect at now_us, the regions' instant."""
        config = self._config
        told, left_out = telling_of(message, {track.name for track in self.tracks}, config)
        then = self.all_at(message.as_of_us)
        reading = self.feeding.reading(now_us)
        plan = plan_of(self.tracks, then, told, reading)
        ended = [(self.tracks[i], self.regions.place(i)) for i in plan.end]
        renamed = self._go_on(plan, told, then, reading, message.as_of_us, now_us)
        self.end([track for track, _ in ended])
        new = plan.new[: config.max_tracks - len(self.tracks)]
        begun = self._begin(told, new, message.as_of_us, now_us) if new else []
        return Applied(renamed, ended, begun, left_out + len(plan.new) - len(new))

    def _go_on(
        self, plan: Plan, told: Telling, then: Floats, reading: Flags, as_of_us: int, now_us: int
    ) -> list[tuple[Track, str]]:
        """Let the regions that go on heed what is told of them; return the tracks with a new name."""
        has_row = plan.rows >= 0
        for track, is_told in zip(self.tracks, has_row.tolist(), strict=True):
            track.told = is_told
        which = np.flatnonzero(has_row)
        rows = plan.rows[which]
        share = self._news(as_of_us)
        if len(which):
            places, reach_px = told.places[:, rows], then[REACH, which]
            self.regions.resize(which, places[REACH], told.radius_px[rows])
            blind = now_us - self.regions.centred_us()[which] > BLIND_US
            reads = reading[which] & ~blind
            near = away_px(then[:, which], places) <= np.minimum(reach_px, places[REACH])
            sure = self._told_doubt(which, told, rows)
            heeding = sure.of(near).after(now_us - as_of_us, self.regions.drive(which[near]))
            self._heed(which[near], places[:, near] - then[:, which[near]], heeding, share, reads[near])
            astray = np.flatnonzero(~near & ~reads).tolist()
            states = [told.column(int(rows[k]), sure.of(k)) for k in astray]
            self._relocate(which[astray].tolist(), states, as_of_us, now_us)
        renamed = [(self.tracks[i], self.tracks[i].name) for i in plan.adopt]
        for i in plan.adopt:
            self.tracks[i].name = told.names[int(plan.rows[i])]
        return renamed

    def _heed(self, which: Ints, off: Floats, told: Doubt, share: float, reads: Flags) -> None:
        """Correct regions by what is told of places near where they were then.

        Args:
            which: (k,) regions.
            off: (4 or more, k) what is told less where they were: x, y, vx, vy.
            told: how sure that is by now, (k,) each.
            share: of what a message says, how much is new (`_news`).
            reads: (k,) whether the region's own events are being read.
        """
        own = self.regions.doubt(which)
        least = np.where(reads, 0.0, LEAST_WEIGHT) if self._config.self_centring else np.zeros(len(which))
        (w, xx), (wv, vv) = (_heeded(a, b, share, least) for a, b in ((own.xx, told.xx), (own.vv, told.vv)))
        sure = doubt(xx, (1 - np.maximum(w, wv)) * own.xv, vv)
        self.regions.shift(which, w * off[X : Y + 1], wv * off[VX : VY + 1], sure)

    def _told_doubt(self, which: Ints, told: Telling, rows: Ints) -> Doubt:
        """Return how sure rows, (k,), are: of what is not seen, no surer than the regions' own motion allows."""
        none = np.zeros(len(rows))
        unseen = Doubt(none, none, none).after(told.unseen_us[rows], self.regions.drive(which))
        sure = told.doubt.of(rows)
        return doubt(sure.xx + unseen.xx, sure.xv + unseen.xv, sure.vv + unseen.vv)

    def _news(self, as_of_us: int) -> float:
        """Return how much of a message is new since the one before, and note it: 1 at AGAIN_US apart and more."""
        since_us = AGAIN_US if self._as_of_us is None else as_of_us - self._as_of_us
        self._as_of_us = as_of_us
        return min(max(since_us, 0), AGAIN_US) / AGAIN_US

    def _relocate(self, astray: list[int], states: list[Floats], as_of_us: int, now_us: int) -> None:
        """Let regions that have lost their targets catch up with them from where the tracker saw them."""
        if not astray:
            return
        self._spare.noise_per_px_us = self.regions.noise_per_px_us
        self.backlog.catch_up(self._spare, np.stack(states, axis=1), as_of_us, now_us)
        found, centred_us = self._spare.states(), self._spare.centred_us()
        for k, i in enumerate(astray):
            self.regions.put(i, found[:, k], int(centred_us[k]))
        self.relocated += len(astray)

    def _begin(self, told: Telling, rows: list[int], as_of_us: int, now_us: int) -> list[tuple[Track, list[Decided]]]:
        """Begin new tracks, of these rows, with what the backlog holds of them."""
        read = self.all_at(as_of_us)[:, self.feeding.reading(now_us)]
        born_us = [now_us if _is_near(told.places[:, row], read) else int(told.born_us[row]) for row in rows]
        states = np.stack([told.column(row) for row in rows], axis=1)
        self._spare.noise_per_px_us = self.regions.noise_per_px_us
        heard = self.backlog.replay(self._spare, states, born_us, as_of_us, now_us)
        begun = [Track(self._serial + k, told.names[row], TrackLinks(self._plan)) for k, row in enumerate(rows)]
        self._serial += len(rows)
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


def _is_near(place: Floats, read: Floats) -> bool:
    """Return whether a new track lies on the spot of one that is being read: it does not read its past once more."""
    return bool((away_px(read, place) <= 0.5 * np.minimum(read[REACH], place[REACH])).any())


def _heeded(own: Floats, told: Floats, share: float, least: Floats) -> tuple[Floats, Floats]:
    """Return how far regions go to what is told, and the variance that is left.

    w = own / (own + told) of the two variances, at least `least`; but only a share of what is told is new, so that what
    is said again and again moves the region, and does not make it surer, than the tracker itself is at most.
    """
    w = np.maximum(least * share, own / np.maximum(own + told, 1e-12))
    fresh = np.maximum(least * share, own * share / np.maximum(own * share + told, 1e-12))
    return w, np.minimum((1.0 - fresh) * own, np.maximum(told, (1.0 - w) * own))
