"""From events and tracks to frames, identifications and texts.

One window (config.window_us, on an absolute grid) after another, some windows a beat::

    a beat begins: tracks that take effect -> regions  schedule, tracks, following, backlog
    events -> the track that hears them                regions, routing, centring
    the receivers that may decide something            feeding, links
    frames and refusals, one message a window
    identities: accepted, changed, lost                identities
    a beat ends: what heard anything is fed; what nobody follows is let go
    on the grid of refresh_us: texts joined, identities refreshed; each second: link quality
    on the grid of tracker_period_us: statuses

Whole windows alone are decoded, so the messages out do not depend on how events are cut into messages.
"""

from __future__ import annotations

from typing import Final

from heliograph.core import Context
from heliograph.errors import Refusal, Refusals
from heliograph.link.contract import LinkFrame
from heliograph.link.modulations import modulation
from heliograph.messages import Message, StatusWord, Tracks
from heliograph.streams import Events
from heliograph_services.decoder.config import AUTO, DecoderConfig
from heliograph_services.decoder.following import Following
from heliograph_services.decoder.identities import Identities
from heliograph_services.decoder.link_plan import LinkPlan, ModulationOf
from heliograph_services.decoder.links import Decided
from heliograph_services.decoder.measuring import Measure
from heliograph_services.decoder.publish import FrameRow, Publisher, bearing_of
from heliograph_services.decoder.schedule import Schedule
from heliograph_services.decoder.stream import EventStream, Window, fault
from heliograph_services.decoder.telling import SILENCE_US, finite
from heliograph_services.decoder.tracks import Track

SECOND_US: Final = 1_000_000


class DecoderCore:
    """The pure half of the decoder service (heliograph.core.Core).

    Args:
        config: its settings.
        context: its process.
        camera_text: the camera file's text; empty for none.
        modulation_of: makes a modulation of its name and options; another one in tests.
        measure: names likely bit rates, for bit_rate "auto"; another one in tests.

    Raises:
        ConfigError: a modulation, receiver or option is unknown, or the camera file is not sound.
    """

    def __init__(
        self,
        config: DecoderConfig,
        context: Context,
        camera_text: str = "",
        modulation_of: ModulationOf = modulation,
        measure: Measure | None = None,
    ) -> None:
        self.refusals = Refusals()
        self.counters: dict[str, int] = dict.fromkeys(_COUNTERS, 0)
        self.gauges: dict[str, float] = {"tracks": 0.0, "identities": 0.0, "backlog_events": 0.0}
        self._config = config
        self._plan = LinkPlan(config, modulation_of, measure or _measure(config))
        self._publisher = Publisher(config.camera, bearing_of(camera_text))
        self._identities = Identities(self._plan, self._publisher)
        self._schedule = Schedule(lockstep=context.lockstep, period_us=config.tracker_period_us)
        self._stream: EventStream | None = None
        self._following: Following | None = None
        self._told_us = 0  # when Tracks last took effect
        self._some_untold = False  # whether they left out a track
        self._refused = Refusals()  # to be published with the next window
        self._early: list[FrameRow] = []  # frames from the backlog, likewise

    def feed(self, message: Message) -> list[Message]:
        """Take events or tracks; return frames, identifications, messages, link quality and statuses in order."""
        if isinstance(message, Tracks):
            return self._offer(message)
        if isinstance(message, Events):
            return self._events(message)
        self._refuse(Refusal.CORE_FAULT)
        return []

    def ready(self, message: Message) -> bool:
        """Return whether, in lockstep, the tracks that these events need have come."""
        if not isinstance(message, Events):
            return True
        anew = self._stream is not None and self._stream.entry(message).anew
        first_us = message.t0_us if anew or self._stream is None else self._stream.began_us
        return self._schedule.reaches(message.t1_us, first_us, anew=anew)

    def tick(self, now_us: int) -> list[Message]:
        """Return the identities that are lost because nothing came until now_us; time itself does not advance."""
        if self._stream is None or self._following is None or now_us <= self._stream.watermark_us:
            return []
        out: list[Message] = []
        for i, track in enumerate(self._following.tracks):
            if track.held is not None and track.links.accepted(now_us) is None:
                out += self._identities.lose(track, self._following.at(i, self._stream.now_us), now_us)
        return out

    def _refuse(self, reason: Refusal, n: int = 1) -> None:
        self.refusals[reason] += n
        self._refused[reason] += n

    def _offer(self, tracks: Tracks) -> list[Message]:
        if tracks.camera != self._config.camera:
            self._refuse(Refusal.OTHER_CAMERA)
            return []
        if not finite(tracks):
            # As on the bus, where the record's own ranges refuse it.
            self._refuse(Refusal.BAD_BODY)
            return []
        now_us = self._stream.now_us if self._stream is not None else None
        refusal = self._schedule.offer(tracks, now_us)
        if refusal is not None:
            self._refuse(refusal)
        return []

    def _events(self, events: Events) -> list[Message]:
        if events.camera != self._config.camera:
            self._refuse(Refusal.OTHER_CAMERA)
            return []
        broken = fault(events)
        if broken is not None:
            self._refuse(broken)
            return []
        out: list[Message] = []
        if self._stream is not None:
            entry = self._stream.entry(events)
            if entry.refusal is not None:
                self._refuse(entry.refusal)
            if not entry.take:
                return []
            if entry.anew:
                out += self._stop(self._stream.now_us)
                self._schedule.restart()
                self._stream = None
        stream = self._stream or self._begin(events)
        stream.push(events)
        self.counters["events"] += len(events.batch)
        for window in stream.windows(end=events.end):
            out += self._window(window)
        if events.end:
            out += self._stop(events.t1_us)
            self._schedule.restart()
            self._stream = None
        return out

    def _begin(self, events: Events) -> EventStream:
        size = (events.width, events.height)
        if self._following is None or self._following.size != size:
            self._following = Following(self._config, self._plan, *size)
        self._stream = EventStream(events, self._config.window_us, self._following.beat_us)
        self._following.restart(self._stream.now_us)
        self._told_us = self._stream.now_us
        for _ in range(self._schedule.begin(events.t0_us)):
            self._refuse(Refusal.TIME_JUMP)
        self.counters["streams"] += 1
        return self._stream

    def _stop(self, now_us: int) -> list[Message]:
        """End all tracks: texts that are still held, and the loss of every identity."""
        following = self._following
        if following is None:
            return []
        out: list[Message] = []
        for i, track in enumerate(following.tracks):
            out += self._identities.end(track, following.at(i, now_us), now_us)
        following.restart(now_us)
        self._early = []
        return out

    def _window(self, window: Window) -> list[Message]:
        following = self._following
        if following is None:
            return []
        out: list[Message] = []
        if window.t0_us % following.beat_us == 0:
            out += self._begin_beat(following, window.t0_us)
        off = Refusals()
        routed = following.regions.follow(window.batch, self._config.window_us, off)
        for reason, n in off.items():
            self._refuse(reason, n)
        following.feeding.note(routed, window.t1_us)
        following.heard.append(window.batch)
        self.counters["events_routed"] += len(routed.t_us)
        self.counters["windows"] += 1

        now_us = window.t1_us - 1 if window.last else window.t1_us
        ends = window.last or now_us % following.beat_us == 0
        if ends:
            following.end_beat()
        rows, self._early = self._early, []
        every = window.last or self._is_on_the_grid(now_us)
        due = following.feeding.whom(window.t1_us, beat=ends, every=every)
        stirred = self._feed(following, due, window.t1_us, now_us, rows) or ends
        if window.last:
            self._flush(following, window.t1_us, rows)
        if rows or self._refused:
            refused, self._refused = self._refused, Refusals()
            out.append(self._publisher.frames(rows, refused, window.t0_us, now_us))
        if stirred:
            out += self._identities.decide(following, now_us)
        if ends:
            out += self._end_beat(following, window, now_us)
        return out

    def _feed(self, following: Following, due: list[int], t1_us: int, now_us: int, rows: list[FrameRow]) -> bool:
        """Feed the receivers of some tracks, add their frames; return whether what they read is news."""
        feeding = following.feeding
        stirred = False
        tracks = [following.tracks[i] for i in due]
        least = [track.links.least() for track in tracks]
        for i, track, deep, piece in zip(due, tracks, least, feeding.take(due, least) if due else [], strict=True):
            links = track.links
            decided = links.feed(*piece, t1_us, deep)
            feeding.fed(i, t1_us, links.due_us())
            if links.winner is not None:
                feeding.spoke(i)
            if decided:
                rows += self._collected(following, i, decided)
            self._note_refusals(track)
            stirred = self._identities.stirs(track, now_us) or stirred
        return stirred

    def _flush(self, following: Following, t1_us: int, rows: list[FrameRow]) -> None:
        """Let all receivers decide what they hold, and add their frames."""
        for i, track in enumerate(following.tracks):
            rows += self._collected(following, i, track.links.flush(t1_us))
            if track.links.winner is not None:
                following.feeding.spoke(i)
            self._note_refusals(track)

    def _begin_beat(self, following: Following, t0_us: int) -> list[Message]:
        """Let the tracks that have come take effect, and say which regions are being read."""
        out: list[Message] = []
        while (tracks := self._schedule.due(t0_us)) is not None:
            out += self._apply(following, tracks, t0_us)
        following.history.record(t0_us, following.regions.motion())
        following.regions.rank(following.feeding.reading(t0_us))
        return out

    def _end_beat(self, following: Following, window: Window, now_us: int) -> list[Message]:
        """Let go what nobody follows; send what is due on the grid."""
        out = self._sweep(following, now_us)
        # A stream that ends on the grid has had its turn with the window before.
        if not window.last or now_us > window.t0_us:
            out += self._on_the_grid(following, now_us, last=window.last)
        if window.last or self._is_on_the_grid(now_us):
            self.gauges["identities"] = float(sum(track.read for track in following.tracks))
        self.gauges["tracks"] = float(len(following.tracks))
        self.gauges["backlog_events"] = float(following.backlog.events)
        self.counters["identifications"] = self._identities.accepted
        self.counters["identities_withheld"] = self._identities.withheld
        self.counters["refreshments_withheld"] = self._identities.unsure
        self.counters["duplicates"] = self._identities.duplicates.found
        self.counters["repaintings"] = following.regions.repaintings
        return out

    def _is_on_the_grid(self, now_us: int) -> bool:
        return now_us % self._config.refresh_us == 0 or now_us % self._config.tracker_period_us == 0

    def _note_refusals(self, track: Track) -> None:
        taken = track.links.take_refusals()
        if taken:
            self._refused.update(taken)
            self.refusals.update(taken)

    def _apply(self, following: Following, tracks: Tracks, now_us: int) -> list[Message]:
        before = {track.name: track.state for track in following.tracks if track.state is not None}
        applied = following.apply(tracks, now_us)
        self._told_us = now_us
        self._some_untold = not all(track.told for track in following.tracks)
        out: list[Message] = []
        # What a track has said so far, it has said under its old name.
        out += self._identities.renamed(before, following, applied, now_us)
        first = len(following.tracks) - len(applied.begun)
        for i, (track, decided) in enumerate(applied.begun, first):
            self._early += self._collected(following, i, decided)
            if track.links.winner is not None:
                following.feeding.spoke(i)
        self.counters["tracks_adopted"] += len(applied.renamed)
        self.counters["tracks_begun"] += len(applied.begun)
        self.counters["tracks_dropped"] += applied.dropped
        self.counters["tracks_relocated"] = following.relocated
        return out

    def _collected(self, following: Following, i: int, decided: list[Decided]) -> list[FrameRow]:
        """Note what track i has decided: return its frames, keep its texts until they are joined."""
        track = following.tracks[i]
        rows: list[FrameRow] = []
        plan = self._plan
        for one in decided:
            link, frame = one.link, one.item
            if isinstance(frame, LinkFrame):
                beacon = plan.listed(link, frame.payload) or plan.listed(link, None)
                at = following.at(i, frame.t_us)
                rows.append(FrameRow(track.serial, track.name, plan.protocol(link), beacon, frame, at))
                track.frame_us, track.frame_link = frame.t_us, link
            else:
                track.texts.append((link, frame))
        if rows:
            following.feeding.framed(i, track.frame_us)
            self.counters["frames"] += len(rows)
        return rows

    def _sweep(self, following: Following, now_us: int) -> list[Message]:
        """End what nobody follows: tracks that are not read, and of which the tracker has not told for long."""
        silent = now_us - self._told_us > SILENCE_US
        if not silent and not self._some_untold:
            return []
        ended = [
            (track, following.at(i, now_us))
            for i, track in enumerate(following.tracks)
            if not track.read and (silent or not track.told)
        ]
        if not ended:
            return []
        out: list[Message] = []
        for track, at in ended:
            out += self._identities.end(track, at, now_us)
        following.end([track for track, _ in ended])
        return out

    def _on_the_grid(self, following: Following, now_us: int, *, last: bool) -> list[Message]:
        out: list[Message] = []
        if now_us % self._config.refresh_us == 0:
            out += self._identities.refresh(following, now_us)
        if last or now_us % SECOND_US == 0:
            out += self._quality(following, now_us)
        if last or now_us % self._config.tracker_period_us == 0:
            out.append(self._status(following, now_us))
        return out

    def _status(self, following: Following, now_us: int) -> Message:
        words: list[StatusWord] = ["new"] * len(following.tracks)  # of what has never heard anything
        frames_us = [-1] * len(words)
        tokens: list[str | None] = [None] * len(words)
        for i in following.feeding.awoken():
            track = following.tracks[i]
            words[i], frames_us[i] = track.links.verdict(now_us), track.frame_us
            if track.held is not None:
                tokens[i] = self._plan.token(track.held.link, track.held.identity.payload)
        return self._publisher.status([track.name for track in following.tracks], words, frames_us, tokens, now_us)

    def _quality(self, following: Following, now_us: int) -> list[Message]:
        out: list[Message] = []
        for track in following.tracks:
            if not track.read and (track.frame_us < 0 or now_us - track.frame_us > SECOND_US):
                continue
            link = track.frame_link if track.held is None else track.held.link
            quality = track.links.quality(link, now_us)
            if quality is not None:
                out.append(self._publisher.link(track.name, self._plan.protocol(link), now_us, quality))
        return out


_COUNTERS: Final = (
    "duplicates", "events", "events_routed", "frames", "identifications", "identities_withheld", "repaintings",
    "refreshments_withheld", "streams",
    "tracks_adopted", "tracks_begun", "tracks_dropped", "tracks_relocated", "windows",
)  # fmt: skip


def _measure(config: DecoderConfig) -> Measure | None:
    """Return what names likely bit rates where one is to be measured."""
    if config.beacons or config.bit_rate != AUTO:
        return None
    from heliograph.link.bitrate import likely_bit_rates  # noqa: PLC0415 - only where it is asked for

    return likely_bit_rates


def make_core(config: DecoderConfig, context: Context, camera_text: str = "") -> DecoderCore:
    """Return the decoder's core.

    Raises:
        ConfigError: as `DecoderCore`.
    """
    return DecoderCore(config, context, camera_text)


def warm() -> None:
    """Compile, or load from the cache, every kernel that decoding needs."""
    from heliograph_services.decoder.warming import warm_all  # noqa: PLC0415 - it makes a core

    warm_all()
