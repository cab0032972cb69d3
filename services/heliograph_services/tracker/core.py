"""The tracker: onsets in, tracks out, at every multiple of the period on the camera's clock.

Time is cut twice, both times on absolute grids: into clustering windows of W (`windows`), and at the multiples P of
the period. `Tracks` of P rest on the windows that end at P or before, extrapolated to P; so on nothing that depends on
how the onsets were cut into messages. In order of time::

    statuses that are due -> window [s, s + W)          due: as_of + period <= s
    statuses that are due -> expire, publish Tracks(P)  due: as_of + period <  P

That is the lockstep rule of `heliograph.core`: onsets up to t1 need the statuses up to t1 - 2 periods, and no status
that may or may not have come by then is used. Live, a status is used when it comes, and a birth that is confirmed or a
name that changes is also published at once: beacons are not read before the decoder knows of their tracks.
"""

from __future__ import annotations

from collections import Counter, deque
from importlib import import_module
from typing import Final

import numpy as np

from heliograph.core import Context
from heliograph.errors import Refusal, Refusals
from heliograph.messages import Message, Status, StatusWord, Tracks
from heliograph.streams import Onsets
from heliograph.units import US_PER_S
from heliograph_services.tracker import backends
from heliograph_services.tracker.config import Clustering, Flow, Kalman, TrackerConfig
from heliograph_services.tracker.follower import Follower, GridFollower
from heliograph_services.tracker.motion import Motion
from heliograph_services.tracker.one_pixel import OnePixelFollower
from heliograph_services.tracker.tracks import Numbers
from heliograph_services.tracker.windows import Cutter

# A gap of onsets up to this long is a lost message or two: tracks coast through it, period by period. A longer one is
# a jump.
JUMP_US: Final = US_PER_S
# A message of more than a minute would yield more than 600 Tracks at once: no source sends it.
SPAN_LIMIT_US: Final = 60 * US_PER_S
# A single damaged message must not move the stream's clock; a source that really started anew says so for longer.
RESYNC_AFTER: Final = 16
# Without onsets for this long no track is left to publish, and the guess of the time is no longer worth much.
SILENCE_LIMIT_US: Final = 10 * US_PER_S
# Lockstep lets the decoder run two periods ahead of us, and its status name a third.
AHEAD_PERIODS: Final = 3
# In lockstep at most a few statuses wait for their time.
STATUSES_LIMIT: Final = 64
# A pixel may occur once a tick; windows of many short ticks hold more entries than pixels.
ENTRIES_PER_PIXEL: Final = 4
# A key's chunk has at most 64 characters; the stream's name and the number share them.
PREFIX_LIMIT: Final = 48

COUNTERS: Final = (
    "windows", "windows_flooded", "active_pixels", "targets", "targets_carved", "targets_split",
    "births", "births_double", "births_over_limit", "births_quarantined",
    "tracks_born", "tracks_found_again", "tracks_ended", "tracks_ended_invalid", "tracks_renamed", "tracks_taken_over",
    "tracks_published", "tracks_at_once", "streams", "statuses",
)  # fmt: skip


class TrackerCore:
    """Follows every target of one camera.

    Args:
        config: settings.
        context: the process.

    Raises:
        ConfigError: a backend's package is not installed.

    Attributes:
        refusals: messages by reason, and targets that no track used and that may not become one.
        counters: see `COUNTERS`.
        gauges: tracks published last, births under way, places closed for births.
    """

    def __init__(self, config: TrackerConfig, context: Context) -> None:
        self.refusals: Refusals = Counter()
        self.counters: dict[str, int] = dict.fromkeys(COUNTERS, 0)
        self.gauges: dict[str, float] = {"tracks": 0.0, "births": 0.0, "quarantined": 0.0}
        self._config = config
        self._backends = backends.chosen(config)
        self._context = context
        self._numbers = Numbers()
        self._stream: _Stream | None = None
        self._statuses: deque[Status] = deque(maxlen=STATUSES_LIMIT)
        self._refused_in_row = 0

    def feed(self, message: Message) -> list[Message]:
        """Take onsets or a status; return the Tracks of the periods that have passed."""
        if isinstance(message, (Onsets, Status)) and message.camera != self._config.camera:
            self.refusals[Refusal.OTHER_CAMERA] += 1
        elif isinstance(message, Onsets):
            return list(self._onsets(message))
        elif isinstance(message, Status):
            return list(self._status(message))
        return []

    def ready(self, message: Message) -> bool:
        """Return whether all statuses that these onsets depend on have come; live, they depend on none."""
        if not self._context.lockstep or not isinstance(message, Onsets) or message.camera != self._config.camera:
            return True
        stream = self._stream
        known = stream is not None and stream.continues(message) and message.t0_us - stream.until_us <= JUMP_US
        floor_us = stream.floor_us if stream is not None and known else self._floor(message.t0_us)
        # What lies too far ahead is left from a stream that has ended.
        limit_us = message.t1_us + AHEAD_PERIODS * self._config.period_us
        newest_us = max((s.as_of_us for s in self._statuses if floor_us <= s.as_of_us <= limit_us), default=floor_us)
        return message.t1_us <= newest_us + 2 * self._config.period_us

    def tick(self, now_us: int) -> list[Message]:
        """Publish the tracks, extrapolated, for periods that passed without onsets; what comes late is still used.

        A period is given one more period of grace. Without onsets for `SILENCE_LIMIT_US` there is nothing to say.
        """
        stream, period_us = self._stream, self._config.period_us
        if stream is None or self._context.lockstep or stream.ended:
            return []
        if now_us - stream.until_us > SILENCE_LIMIT_US:
            return []
        out: list[Message] = []
        while stream.next_us + period_us <= now_us:
            out.append(self._publish(stream))
        return out

    def _floor(self, t_us: int) -> int:
        return t_us // self._config.period_us * self._config.period_us

    def _onsets(self, onsets: Onsets) -> list[Message]:
        """Take onsets of this camera, window by window and period by period."""
        unsound = self._unsound(onsets)
        if unsound is not None:
            self.refusals[unsound] += 1
            return []
        stream = self._stream
        if stream is None or stream.name != onsets.stream or stream.ended:
            stream = self._open(onsets)
        refusal = _discontinuity(stream, onsets)
        if refusal is not None:
            self.refusals[refusal] += 1
            self._refused_in_row += 1
            if self._refused_in_row < RESYNC_AFTER:
                return []
            stream = self._open(onsets)
        self._refused_in_row = 0
        out = self._jump(stream, onsets.t0_us) if onsets.t0_us - stream.until_us > JUMP_US else []
        stream.motion.feed(onsets)
        for window in stream.cutter.cut(onsets):
            out += self._passed(stream, window.end_us - 1)
            self._judge(stream, window.start_us)
            self.counters["windows"] += 1
            if stream.follower.step(window):
                out += self._at_once(stream, window.end_us)
        stream.until_us = onsets.t1_us
        stream.ended = onsets.end
        out += self._passed(stream, onsets.t1_us)
        return out + stream.motion.take()

    def _unsound(self, onsets: Onsets) -> Refusal | None:
        """Return why these onsets cannot be used in any stream, or None."""
        pool_px = onsets.pool_px
        if len(onsets.tick) and (
            int(onsets.x_px.max()) * pool_px >= onsets.width or int(onsets.y_px.max()) * pool_px >= onsets.height
        ):
            return Refusal.OFF_SENSOR
        if onsets.t1_us - onsets.t0_us > SPAN_LIMIT_US:
            return Refusal.TIME_JUMP
        # In lockstep the decoder's statuses for the end of a tick depend on tracks from within it.
        if self._context.lockstep and onsets.tick_us > self._config.period_us:
            return Refusal.CORE_FAULT
        return None

    def _open(self, onsets: Onsets) -> _Stream:
        """Begin a stream: all tracks end, numbers go on."""
        config = self._config
        floor_us = self._floor(onsets.t0_us)
        limit_us = onsets.t1_us + AHEAD_PERIODS * config.period_us
        # In lockstep the decoder may have begun the stream before us.
        early = [s for s in self._statuses if floor_us <= s.as_of_us <= limit_us]
        self._statuses = deque(early, STATUSES_LIMIT)
        ticks = max(1, config.cluster_window_us // onsets.tick_us)
        cutter = Cutter(onsets.tick_us, ticks, ENTRIES_PER_PIXEL * config.max_active_pixels)
        motion = self._backends.motion(config, onsets)
        follower: Follower
        if onsets.width == onsets.height == 1:
            follower = OnePixelFollower(onsets.t0_us, self._numbers)
            self.counters["tracks_born"] += 1
        else:
            follower = GridFollower(
                config,
                self._backends,
                motion,
                width=onsets.width,
                height=onsets.height,
                pool_px=onsets.pool_px,
                window_us=cutter.window_us,
                tick_us=onsets.tick_us,
                numbers=self._numbers,
                counters=self.counters,
                refusals=self.refusals,
            )
        self.counters["streams"] += 1
        prefix = onsets.stream[:PREFIX_LIMIT] if self._context.lockstep else self._context.boot
        self._stream = _Stream(onsets, prefix, cutter, follower, motion, floor_us, floor_us + config.period_us)
        return self._stream

    def _jump(self, stream: _Stream, t0_us: int) -> list[Message]:
        """Leave out a gap: tracks whose time is up end, and one Tracks says what is left."""
        self.refusals[Refusal.TIME_JUMP] += 1
        stream.cutter.drop()
        stream.until_us = t0_us
        stream.floor_us = self._floor(t0_us)
        if stream.next_us > stream.floor_us:
            return []
        stream.next_us = stream.floor_us
        return self._passed(stream, t0_us)

    def _passed(self, stream: _Stream, until_us: int) -> list[Message]:
        """Publish the periods up to and with until_us."""
        out: list[Message] = []
        while stream.next_us <= until_us:
            self._judge(stream, stream.next_us - 1)
            stream.follower.expire(stream.next_us)
            out.append(self._publish(stream))
        return out

    def _publish(self, stream: _Stream) -> Tracks:
        """Publish the next period."""
        stream.next_us += self._config.period_us
        return self._tracks(stream, stream.next_us - self._config.period_us)

    def _at_once(self, stream: _Stream, at_us: int) -> list[Message]:
        """Publish between two periods: a birth or a new name. Live only; in lockstep all wait for the grid."""
        as_of_us = max(at_us, stream.published_us + 1)
        # The period that is due now says it too.
        if self._context.lockstep or as_of_us >= stream.next_us:
            return []
        self.counters["tracks_at_once"] += 1
        return [self._tracks(stream, as_of_us)]

    def _tracks(self, stream: _Stream, as_of_us: int) -> Tracks:
        stream.published_us = as_of_us
        s = stream.follower.snapshot(as_of_us)
        self.counters["tracks_published"] += len(s.number)
        self.gauges["tracks"] = float(len(s.number))
        if isinstance(stream.follower, GridFollower):
            self.gauges["births"] = float((~stream.follower.table.named).sum())
            self.gauges["quarantined"] = float(stream.follower.quarantined)
        return Tracks(
            camera=self._config.camera,
            as_of_us=as_of_us,
            period_us=self._config.period_us,
            track=[f"{stream.prefix}-{number}" for number in s.number],
            born_us=s.born_us,
            seen_us=s.seen_us,
            x_px=s.x_px,
            y_px=s.y_px,
            vx_px_s=s.vx_px_s,
            vy_px_s=s.vy_px_s,
            x_var_px2=s.x_var_px2,
            x_vx_cov_px2_s=s.x_vx_cov_px2_s,
            vx_var_px2_s2=s.vx_var_px2_s2,
            y_var_px2=s.y_var_px2,
            y_vy_cov_px2_s=s.y_vy_cov_px2_s,
            vy_var_px2_s2=s.vy_var_px2_s2,
            radius_px=s.radius_px,
            size_px=s.size_px,
            polarity=s.polarity,
            status=s.status,
        )

    def _status(self, status: Status) -> list[Message]:
        self.counters["statuses"] += 1
        stream = self._stream
        if self._context.lockstep:
            self._statuses.append(status)
        elif stream is not None and self._use(stream, status, stream.until_us):
            return self._at_once(stream, stream.until_us)
        return []

    def _judge(self, stream: _Stream, until_us: int) -> None:
        """In lockstep, use the statuses that are due by now; they stay, since `ready` asks for the newest."""
        period_us = self._config.period_us
        for status in self._statuses:
            if stream.judged_us < status.as_of_us and status.as_of_us + period_us <= until_us:
                stream.judged_us = status.as_of_us
                self._use(stream, status, status.as_of_us + period_us)

    def _use(self, stream: _Stream, status: Status, at_us: int) -> bool:
        """Take a status; return whether names have changed."""
        head = f"{stream.prefix}-"
        words: dict[int, StatusWord] = {}
        tokens: dict[int, str | None] = {}
        for name, word, token in zip(status.track, status.status, status.identity, strict=True):
            if name.startswith(head) and name[len(head) :].isdecimal():
                number = int(name[len(head) :])
                words[number], tokens[number] = word, token
        return stream.follower.judge(words, tokens, at_us)


class _Stream:
    """One run of a camera: its geometry, its clock, and who follows it."""

    def __init__(
        self,
        first: Onsets,
        prefix: str,
        cutter: Cutter,
        follower: Follower,
        motion: Motion,
        floor_us: int,
        next_us: int,
    ) -> None:
        self.name = first.stream
        self.prefix = prefix
        self.cutter = cutter
        self.follower = follower
        self.motion = motion
        self.until_us = first.t0_us  # the watermark
        self.published_us = floor_us  # as_of of the last Tracks
        self.floor_us = floor_us  # counts as the newest status before there is one
        self.next_us = next_us  # the next period to publish
        self.judged_us = floor_us - 1  # as_of of the last status used
        self.ended = False
        self._geometry = (first.width, first.height, first.tick_us, first.pool_px)

    def continues(self, onsets: Onsets) -> bool:
        """Return whether these onsets can be the next of this stream."""
        geometry = (onsets.width, onsets.height, onsets.tick_us, onsets.pool_px)
        return onsets.stream == self.name and geometry == self._geometry


def _discontinuity(stream: _Stream, onsets: Onsets) -> Refusal | None:
    """Return why these onsets are not the next of the stream, or None; a gap forward is not refused."""
    if not stream.continues(onsets):
        return Refusal.OTHER_GEOMETRY
    if onsets.t0_us < stream.until_us:
        return Refusal.TIME_BACKWARDS
    return None


def make_core(config: TrackerConfig, context: Context) -> TrackerCore:
    """Return the core of a tracker process."""
    return TrackerCore(config, context)


def warm(clustering: Clustering = "grid", kalman: Kalman = "batched", flow: Flow = "none") -> None:
    """Compile every kernel, or load it from the cache: three discs are born, followed, touch, and scatter.

    Args:
        clustering: the backend to warm; other people's libraries load parts of themselves at their first use.
        kalman: likewise.
        flow: likewise; its kernels are warmed if there is one.

    Raises:
        ConfigError: a backend's package is not installed.
    """
    if flow != "none":
        import_module("heliograph_services.tracker.flow.pyramid").warm()
    core = TrackerCore(
        TrackerConfig(
            clustering=clustering, kalman=kalman, flow=flow, confirm_hits=1, quarantine_us=0, quarantine_max_us=0
        ),
        Context("warm", "warm", False),
    )
    yy, xx = np.mgrid[0:64, 0:64]
    tick_us = 5_000
    for i in range(6):
        # Two discs close in on each other; a third tears into halves, so that an assignment is open.
        near = [(xx - 20 - 2 * i) ** 2 + (yy - 20) ** 2 <= 9, (xx - 36 + i) ** 2 + (yy - 20) ** 2 <= 9]
        torn = ((xx - 20) ** 2 + (yy - 48) ** 2 <= 16) & ((i < 3) | (abs(xx - 20) > 1))
        y_px, x_px = np.nonzero(near[0] | near[1] | torn)
        count = np.full(len(x_px), 3, np.uint8)
        core.feed(
            Onsets(
                camera=TrackerConfig().camera,
                stream="warm",
                width=64,
                height=64,
                t0_us=i * tick_us,
                t1_us=(i + 1) * tick_us,
                tick_us=tick_us,
                pool_px=1,
                tick=np.zeros(len(x_px), np.uint16),
                x_px=x_px.astype(np.uint16),
                y_px=y_px.astype(np.uint16),
                on_count=count,
                off_count=count,
            )
        )
