"""The pure half of the source: from a camera's windows to the records on the bus.

For each window [t0, t1), in this order: its events, cut at `max_events` (only the last part has the window's end as
its watermark; the watermark of the others is the time of the next part's first event); the onsets of each onsets_us
that became complete, a message each, anchored at its multiples on the camera's clock, and thinned to what the link may
carry (`heliograph.onset_budget`; never with the gate open); the truth and a view, where the camera has them. A window
without events still yields its empty records: a lone beacon never waits for noise.

Onsets are counted once `COUNTED_AT` events of complete ticks have come, so that no window pays for a whole message's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import EventBatch, concatenate
from heliograph.messages import Message
from heliograph.onset_budget import OnsetBudget
from heliograph.onset_dipoles import Dipoles
from heliograph.onset_entries import OnsetColumns, joined
from heliograph.onsets import OnsetCounter, OnsetSettings
from heliograph.streams import Events, Onsets
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.cameras.windows import floor_to
from heliograph_services.event_source.config import EventSourceConfig

# To count costs 30 us and 70 us more a thousand events: a tenth of a window of 1 ms, and a third of it for nothing.
COUNTED_AT: Final = 1_000


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """The sensor of a camera, in pixels."""

    width: int
    height: int


class SourceCore:
    """Turns windows into `Events`, `Onsets` and the truth.

    Args:
        config: of the service.
        info: the sensor.
    """

    def __init__(self, config: EventSourceConfig, info: CameraInfo) -> None:
        self.refusals = Refusals()
        self.counters: dict[str, int] = dict.fromkeys(
            (
                "events", "windows", "onsets", "onsets_gated", "onsets_thinned_lights", "onsets_thinned_edges",
                "onsets_bytes", "onset_ticks_flooded", "streams",
            ), 0,
        )  # fmt: skip
        self.gauges: dict[str, float] = dict.fromkeys(("events_hz", "onsets_hz", "noise_hz", "onset_threshold"), 0.0)
        self._config = config
        self._info = info
        self._counter = OnsetCounter(
            OnsetSettings(
                width=info.width,
                height=info.height,
                tick_us=config.tick_us,
                pool_px=config.pool_px,
                gate=config.gate,
                min_events=config.min_events,
                noise_hz=config.onsets_noise_hz,
            )
        )
        self._budget = OnsetBudget(0.0 if config.gate == "open" else config.onsets_bit_rate_max, config.onsets_us)
        columns, rows = -(-info.width // config.pool_px), -(-info.height // config.pool_px)
        self._dipoles = Dipoles(columns, rows) if self._budget.limited else None
        self._stream: str | None = None
        self._t1_us = 0
        self._onsets_t1_us = 0  # the ticks before this time are out
        self._counted_us = 0  # and those before this time counted
        self._counted: list[OnsetColumns] = []  # of the message that is not complete, by their ticks from its begin
        self._pending: list[EventBatch] = []  # events of the tick that is not complete
        self._rate_from = (0, 0, 0)  # t_us, events and onsets at the last reading of the gauges

    def feed(self, window: Window) -> list[Message]:
        """Return the records of a window; one that lies before the last is refused whole."""
        return [message for part in self.parts(window) for message in part]

    def parts(self, window: Window) -> Iterator[list[Message]]:
        """Yield the same in two parts, neither made before it is asked for: the events, and what may come after."""
        if self._begin(window):
            yield [*self._events(window)]
            yield self._rest(window)

    def _begin(self, window: Window) -> bool:
        """Return whether a window is taken."""
        self.refusals.update(window.refused)
        if window.stream != self._stream:
            self._stream = window.stream
            self._pending.clear()
            self._counted.clear()
            self._counter.reset()
            self._budget.reset()
            if self._dipoles is not None:
                self._dipoles.reset()
            self._onsets_t1_us = self._counted_us = floor_to(window.t0_us, self._config.tick_us)
            self._rate_from = (window.t0_us, self.counters["events"], self.counters["onsets"])
            self.counters["streams"] += 1
        elif window.t0_us < self._t1_us:
            self.refusals[Refusal.TIME_BACKWARDS] += 1
            return False
        self._t1_us = window.t1_us
        self.counters["windows"] += 1
        self.counters["events"] += len(window.batch)
        return True

    def _rest(self, window: Window) -> list[Message]:
        """Return what follows the events of a window."""
        messages: list[Message] = [*self._onsets(window)]
        if window.truth is not None:
            messages.append(window.truth)
        if window.image is not None:
            messages.append(window.image)
        self._read_gauges()
        return messages

    def _events(self, window: Window) -> list[Events]:
        """Return the events of a window in parts of at most max_events."""
        batch, limit = window.batch, self._config.max_events
        starts = range(0, max(1, len(batch)), limit)
        parts = []
        t0_us = window.t0_us
        for start in starts:
            stop = min(start + limit, len(batch))
            last = start == starts[-1]
            t1_us = window.t1_us if last else int(batch.t_us[stop])
            parts.append(
                Events(
                    camera=self._config.camera,
                    stream=window.stream,
                    width=self._info.width,
                    height=self._info.height,
                    t0_us=t0_us,
                    t1_us=t1_us,
                    batch=batch.part(start, stop),
                    end=window.end and last,
                )
            )
            t0_us = t1_us
        return parts

    def _onsets(self, window: Window) -> list[Onsets]:
        """Return the messages that this window completes; the end of the stream completes its last tick."""
        tick_us, message_us = self._config.tick_us, self._config.onsets_us
        t0_us = self._onsets_t1_us
        ends = list(range(floor_to(t0_us, message_us) + message_us, window.t1_us + 1, message_us))
        complete_us = floor_to(window.t1_us, tick_us)
        if window.end and (not ends or ends[-1] < window.t1_us):
            complete_us = max(t0_us, floor_to(window.t1_us + tick_us - 1, tick_us))
            ends.append(complete_us)
        self._pending.append(window.batch)
        messages = []
        for t1_us in ends:
            self._count(t1_us)
            messages.append(self._message(window.stream, t1_us, window.end and t1_us == ends[-1]))
        if sum(map(len, self._pending)) >= COUNTED_AT:
            self._count(complete_us)
        return messages

    def _count(self, t1_us: int) -> None:
        """Count the ticks that end by t1_us and belong to one message."""
        t0_us = self._counted_us
        if t1_us <= t0_us:
            return
        batch = concatenate(self._pending)
        stop = int(np.searchsorted(batch.t_us, t1_us))
        self._pending = [batch.part(stop, len(batch))] if stop < len(batch) else []
        columns = self._counter.count(batch.part(0, stop), t0_us, t1_us)
        self._counted.append(columns.later((t0_us - self._onsets_t1_us) // self._config.tick_us))
        self._counted_us = t1_us

    def _message(self, stream: str, t1_us: int, end: bool) -> Onsets:
        """Return the onsets from the last message's end to t1_us, all of them counted: gated, thinned."""
        t0_us, self._onsets_t1_us = self._onsets_t1_us, t1_us
        columns = joined(self._counted)
        self._counted = []
        marks = None if self._dipoles is None else self._dipoles.mark(columns, t0_us, self._config.tick_us)
        kept = self._budget.choose(columns, t0_us, marks)
        keep = slice(None) if kept.keep.all() else kept.keep
        onsets = Onsets(
            camera=self._config.camera,
            stream=stream,
            width=self._info.width,
            height=self._info.height,
            t0_us=t0_us,
            t1_us=t1_us,
            tick_us=self._config.tick_us,
            pool_px=self._config.pool_px,
            tick=columns.tick[keep],
            x_px=columns.x_px[keep],
            y_px=columns.y_px[keep],
            on_count=columns.on_count[keep],
            off_count=columns.off_count[keep],
            end=end,
        )
        if self._budget.limited:
            onsets = onsets.packed()
            size = len(onsets.zipped[1]) if onsets.zipped else 0
            self._budget.spent(len(onsets.tick), size)
            self.counters["onsets_bytes"] += size
        self.counters["onsets"] += len(onsets.tick)
        self.counters["onsets_gated"] += columns.gated
        self.counters["onsets_thinned_lights"] += kept.lights_thinned
        self.counters["onsets_thinned_edges"] += kept.edges_thinned
        self.counters["onset_ticks_flooded"] += columns.flooded
        if columns.off_sensor:
            self.refusals[Refusal.OFF_SENSOR] += columns.off_sensor
        return onsets

    def _read_gauges(self) -> None:
        """Take the rates of the last second of the camera's time."""
        t_us, events, onsets = self._rate_from
        passed_us = self._t1_us - t_us
        if passed_us >= US_PER_S:
            self.gauges["events_hz"] = (self.counters["events"] - events) * US_PER_S / passed_us
            self.gauges["onsets_hz"] = (self.counters["onsets"] - onsets) * US_PER_S / passed_us
            self.gauges["noise_hz"] = self._counter.noise_hz
            self.gauges["onset_threshold"] = float(self._counter.threshold)
            self._rate_from = (self._t1_us, self.counters["events"], self.counters["onsets"])
