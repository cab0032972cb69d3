"""One camera's book: what waits, second by second, and how a second is matched and finished (see core.py)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final

import msgspec

from heliograph.errors import Refusal, Refusals
from heliograph.messages import Data, Frames, Identification, Link, Message, Tracks
from heliograph.truth import Truth
from heliograph.units import US_PER_S
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.rows import AcquisitionRow, CountRow, Row
from heliograph_services.metrics_sink.scoring import Received, Scorer
from heliograph_services.metrics_sink.sightings import Sightings
from heliograph_services.metrics_sink.timeline import Place, Timeline

# What is in the name of a counter comes from the bus: beyond so many distinct ones they share one counter.
NAMES_LIMIT: Final = 4096
OTHER: Final = "other"

# The counters that are complete when their messages are in, before any truth is looked at.
_ARRIVED: Final = frozenset(
    {
        "bytes",
        "characters",
        "frames",
        "identified",
        "late",
        "late_frames",
        "lost",
        "mar_estimate_ppm",
        "mar_estimates",
        "observed_us",
        "refused",
        "track_us",
    }
)

Finished = list[tuple[int, dict[str, int]]]
_Input = Frames | Identification | Data | Link | Tracks | Truth


class Book:
    """The counts of one camera; see the module.

    Args:
        camera: its name.
        config: the sink's settings.
    """

    def __init__(self, camera: str, config: MetricsSinkConfig) -> None:
        self.camera = camera
        self.late = 0
        self.dropped = 0
        self.waiting = 0
        self._config = config
        self._epoch = -1
        self._names: set[str] = set()
        self._rows: list[Row] = []
        self._refusals: Refusals = Counter()
        self._timeline = Timeline(config.settle_us)
        self._begin_epoch()

    @property
    def clock_us(self) -> int | None:
        """The newest camera time."""
        return self._timeline.clock_us

    @property
    def sightings(self) -> int:
        """The number of beacons that are identified now."""
        return len(self._sightings)

    def take(self, message: _Input) -> Finished:
        """Take a message; return the seconds that it finishes, with their counts, in order."""
        finished: Finished = []
        t_us = message.time_us
        place = self._timeline.place(message.SCHEMA, t_us, keeps_history=isinstance(message, Identification | Data))
        if place in {Place.RESTART_FORWARD, Place.RESTART_BACKWARD}:
            forward = place is Place.RESTART_FORWARD
            self._refusals[Refusal.TIME_JUMP if forward else Refusal.TIME_BACKWARDS] += 1
            finished = self._end_epoch()
        clock_us = t_us if self._timeline.clock_us is None else self._timeline.clock_us
        finished += self._settle(_second(clock_us - self._config.settle_us))
        second = _second_of(message)
        if place is Place.STALE or second < self._matched:
            self.late += 1
            count = self._count(max(self._matched, _second(clock_us)))
            count("late", 1)
            if isinstance(message, Frames) and message.t_us:
                count("late_frames", len(message.t_us))
        elif isinstance(message, Frames):
            self._take_frames(message)
        elif isinstance(message, Truth):
            self._take_truth(message)
        elif isinstance(message, Identification):
            self._take_state(message)
        else:
            self._count_simple(message)
        return finished

    def idle(self) -> Finished:
        """Finish what waits, since nothing has come for long; the stream may go on in its next second."""
        if self._timeline.clock_us is None:
            return []
        return self._settle(_second(self._timeline.clock_us) + 1, finish_all=True)

    def close(self) -> Finished:
        """Finish everything that waits; a message that still comes begins a new epoch."""
        finished = self._end_epoch()
        self._timeline = Timeline(self._config.settle_us)
        return finished

    def take_rows(self) -> list[Row]:
        """Return the rows since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def rows_so_far(self) -> list[Row]:
        """Return what is known of the seconds that still wait: the same rows, made again, replace them later.

        A process that is killed so loses a second of its counts, not those of the whole wait. Scores are left out:
        of a second half matched they would be half a truth.
        """
        rows: list[Row] = []
        for second, counts in sorted(self._counts.items()):
            arrived = {name: n for name, n in counts.items() if n and name.partition("/")[0] in _ARRIVED}
            rows += self._count_rows(second, arrived)
        states = [state for _, waiting in sorted(self._states.items()) for state in waiting]
        states.sort(key=_order_of_states)
        return rows + list(self._sightings.so_far(states, self.camera, self._epoch))

    def take_refusals(self) -> Refusals:
        """Return the refusals since the last call."""
        refusals, self._refusals = self._refusals, Counter()
        return refusals

    def _end_epoch(self) -> Finished:
        finished = self._settle(None, finish_all=True)
        self._sightings.close()
        self._rows += self._sightings.take_rows(self.camera, self._epoch, 0)
        self._keep_intervals(ended=True)
        self.dropped += self._sightings.dropped
        self._begin_epoch()
        return finished

    def _begin_epoch(self) -> None:
        self._epoch += 1
        self._matched = -(2**62)  # every second before this one is matched
        self._counts: dict[int, Counter[str]] = {}
        self._frames: dict[int, list[Received]] = {}
        self._states: dict[int, list[Identification]] = {}
        self._truths: dict[int, list[Truth]] = {}
        self._open: list[int] = []  # matched seconds that are not finished, in order
        self._scorer = Scorer(self._config.beacons)
        self._sightings = Sightings()
        self.waiting = 0

    def _room(self, n: int) -> int:
        """Return n if so many more may wait, else 0: they are dropped, and counted."""
        taken = n if n <= self._config.max_waiting - self.waiting else 0
        self.waiting += taken
        self.dropped += n - taken
        return taken

    def _count(self, second: int) -> Callable[[str, int], None]:
        counts = self._counts.setdefault(second, Counter())

        def add(name: str, n: int) -> None:
            if name not in self._names:
                if len(self._names) >= NAMES_LIMIT:
                    name = f"{name.partition('/')[0]}/{OTHER}"
                else:
                    self._names.add(name)
            counts[name] += n

        return add

    def _take_frames(self, message: Frames) -> None:
        count = self._count(_second_of(message))
        for reason, n in message.refused.items():
            count(f"refused/{reason}", n)
        for i in range(self._room(len(message.t_us))):
            t_us = message.t_us[i]
            if t_us > message.t1_us + US_PER_S:
                self._refusals[Refusal.TIME_JUMP] += 1
                self.waiting -= 1
                continue
            if _second(t_us) < self._matched:
                self.late += 1
                self.waiting -= 1
                count("late_frames", 1)
                continue
            frame = Received(
                t_us, message.track[i], message.protocol[i], message.payload[i], message.x_px[i], message.y_px[i]
            )
            self._frames.setdefault(_second(t_us), []).append(frame)
            self._count(_second(t_us))("frames", 1)

    def _take_truth(self, message: Truth) -> None:
        if message.t1_us - message.t0_us > US_PER_S or message.t1_us < message.t0_us:
            self._refusals[Refusal.TIME_JUMP] += 1
            return
        n = 1 + len(message.frame_t1_us)
        if self._room(n) == n:
            self._truths.setdefault(_second_of(message), []).append(_without_edges(message))

    def _take_state(self, message: Identification) -> None:
        if self._room(1):
            self._states.setdefault(_second_of(message), []).append(message)
        count = self._count(_second_of(message))
        if message.change in {"accepted", "changed"}:
            count(f"identified/{message.beacon}", 1)
        if message.lost:
            count(f"lost/{message.beacon}", 1)

    def _count_simple(self, message: Data | Link | Tracks) -> None:
        count = self._count(_second_of(message))
        if isinstance(message, Tracks):
            # A period is at most a second here: exposure must not come from a damaged number.
            period_us = min(message.period_us, US_PER_S)
            count("observed_us", period_us)
            count("track_us", period_us * len(message.track))
        elif isinstance(message, Data):
            count("characters", len(message.text or ""))
            count("bytes", len(message.data or b""))
        elif message.mar_estimate is not None:
            count("mar_estimates", 1)
            count("mar_estimate_ppm", round(1e6 * message.mar_estimate))

    def _settle(self, until: int | None, *, finish_all: bool = False) -> Finished:
        """Match all waiting seconds before `until` (None: all), and finish those whose successors are matched."""
        finished: Finished = []
        waiting = self._counts.keys() | self._frames.keys() | self._states.keys() | self._truths.keys()
        for second in sorted(s for s in waiting if s >= self._matched and (until is None or s < until)):
            while self._open and self._open[0] < second - 1:
                finished.append(self._finish(self._open.pop(0)))
            self._match(second)
            self._open.append(second)
            self._matched = second + 1
        if until is not None:
            self._matched = max(self._matched, until)
        while self._open and (finish_all or self._open[0] < self._matched - 1):
            finished.append(self._finish(self._open.pop(0)))
        return finished

    def _match(self, second: int) -> None:
        truths: list[Truth] = []
        for truth in sorted(self._truths.pop(second, []), key=lambda each: (each.t0_us, each.t1_us)):
            self.waiting -= 1 + len(truth.frame_t1_us)
            if truths and truth.t0_us < truths[-1].t1_us:
                self._refusals[Refusal.TIME_BACKWARDS] += 1
            else:
                truths.append(truth)
        near = [frame for s in (second - 1, second, second + 1) for frame in self._frames.get(s, ())]
        near.sort(key=_order)
        self._scorer.match(truths, near, self._count(second))

    def _finish(self, second: int) -> tuple[int, dict[str, int]]:
        count = self._count(second)
        frames = self._frames.pop(second, [])
        states = sorted(self._states.pop(second, []), key=_order_of_states)
        self.waiting -= len(frames) + len(states)
        if self._scorer.has_truth:
            for frame in frames:
                if not frame.matched and self._scorer.covers(frame.t_us):
                    count(f"insertions/{frame.protocol}", 1)
                elif not frame.matched:
                    count("unscored_frames", 1)
            for state in states:
                if not state.lost:
                    self._scorer.judge(state, count)
        self._sightings.second(states, frames)
        end_us = (second + 1) * US_PER_S
        self._rows += self._sightings.take_rows(self.camera, self._epoch, end_us)
        self._keep_intervals(ended=False)
        counts = {name: n for name, n in self._counts.pop(second).items() if n}
        self._rows += self._count_rows(second, counts)
        return second, counts

    def _count_rows(self, second: int, counts: dict[str, int]) -> list[CountRow]:
        """Return a second's rows; `seconds` is 1, so that the number of seconds adds up like everything else."""
        t0_us = second * US_PER_S
        return [
            CountRow(self.camera, self._epoch, t0_us, name, n) for name, n in sorted((counts | {"seconds": 1}).items())
        ]

    def _keep_intervals(self, *, ended: bool) -> None:
        """Make rows of the visible intervals that have changed (ended: of all that are open, too)."""
        for name, presence in self._scorer.presences.beacons.items():
            for each in presence.intervals:
                if not each.changed and not (ended and each.ended_us is None):
                    continue
                until_us = each.seen_us if each.ended_us is None else each.ended_us
                # Written again until it is long enough to count as one that should have been acquired.
                each.changed = each.ended_us is None and until_us - each.began_us < 2 * US_PER_S
                self._rows.append(
                    AcquisitionRow(
                        camera=self.camera,
                        epoch=self._epoch,
                        beacon=name,
                        began_us=each.began_us,
                        lasted_us=until_us - each.began_us,
                        occluded_us=each.occluded_us,
                        acquired_us=each.acquired_us,
                    )
                )


def _order_of_states(state: Identification) -> tuple[int, str, bool]:
    return state.t_us, state.track, state.lost


def _order(frame: Received) -> tuple[int, str, str, int, float, float]:
    return frame.order


def _without_edges(truth: Truth) -> Truth:
    """Return a truth as it is scored: its edges, by far its largest part, would only wait."""
    edges = {name: getattr(truth, name)[:0].copy() for name in ("edge_beacon", "edge_us", "edge_on")}
    return msgspec.structs.replace(truth, **edges)


def _second(t_us: int) -> int:
    return t_us // US_PER_S


def _second_of(message: Message) -> int:
    """Return the second that a message belongs to; a window belongs to that of its last microsecond."""
    end_us = message.time_us
    return _second(end_us - 1 if isinstance(message, Frames | Truth) else end_us)
