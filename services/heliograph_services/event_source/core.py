"""The pure half of the source: from a camera's windows to the records on the bus.

For each window [t0, t1), in this order: its events, cut at `max_events` (only the last part has the window's end as
its watermark; the watermark of the others is the time of the next part's first event); once in onsets_us the onsets of
the ticks that became complete, both anchored at their multiples on the camera's clock; the truth and a view, where the
camera has them. A window without events still yields its empty records: a lone beacon never waits for noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import EventBatch, concatenate
from heliograph.messages import Message
from heliograph.onsets import OnsetCounter, OnsetSettings
from heliograph.streams import Events, Onsets
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.cameras.windows import floor_to
from heliograph_services.event_source.config import EventSourceConfig


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
            ("events", "windows", "onsets", "onsets_gated", "onset_ticks_flooded", "streams"), 0
        )
        self.gauges: dict[str, float] = {"events_hz": 0.0, "onsets_hz": 0.0}
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
            )
        )
        self._stream: str | None = None
        self._t1_us = 0
        self._onsets_t1_us = 0  # the ticks before this time are out
        self._pending: list[EventBatch] = []  # events of the tick that is not complete
        self._rate_from = (0, 0, 0)  # t_us, events and onsets at the last reading of the gauges

    def feed(self, window: Window) -> list[Message]:
        """Return the records of a window; one that lies before the last is refused whole."""
        self.refusals.update(window.refused)
        if window.stream != self._stream:
            self._stream = window.stream
            self._pending.clear()
            self._onsets_t1_us = floor_to(window.t0_us, self._config.tick_us)
            self._rate_from = (window.t0_us, self.counters["events"], self.counters["onsets"])
            self.counters["streams"] += 1
        elif window.t0_us < self._t1_us:
            self.refusals[Refusal.TIME_BACKWARDS] += 1
            return []
        self._t1_us = window.t1_us
        self.counters["windows"] += 1
        self.counters["events"] += len(window.batch)
        messages: list[Message] = [*self._events(window)]
        onsets = self._onsets(window)
        if onsets is not None:
            messages.append(onsets)
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

    def _onsets(self, window: Window) -> Onsets | None:
        """Return the ticks since the last, once they fill a message; the end of the stream completes its last tick."""
        tick_us = self._config.tick_us
        t0_us = self._onsets_t1_us
        if window.end:
            t1_us = floor_to(window.t1_us + tick_us - 1, tick_us)
        else:
            t1_us = max(t0_us, floor_to(window.t1_us, self._config.onsets_us))
        self._pending.append(window.batch)
        if t1_us == t0_us and not window.end:
            return None
        batch = concatenate(self._pending)
        stop = int(np.searchsorted(batch.t_us, t1_us))
        self._pending = [batch.part(stop, len(batch))] if stop < len(batch) else []
        self._onsets_t1_us = t1_us
        columns = self._counter.count(batch.part(0, stop), t0_us, t1_us)
        self.counters["onsets"] += len(columns.tick)
        self.counters["onsets_gated"] += columns.gated
        self.counters["onset_ticks_flooded"] += columns.flooded
        if columns.off_sensor:
            self.refusals[Refusal.OFF_SENSOR] += columns.off_sensor
        return Onsets(
            camera=self._config.camera,
            stream=window.stream,
            width=self._info.width,
            height=self._info.height,
            t0_us=t0_us,
            t1_us=t1_us,
            tick_us=tick_us,
            pool_px=self._config.pool_px,
            tick=columns.tick,
            x_px=columns.x_px,
            y_px=columns.y_px,
            on_count=columns.on_count,
            off_count=columns.off_count,
            end=window.end,
        )

    def _read_gauges(self) -> None:
        """Take the rates of the last second of the camera's time."""
        t_us, events, onsets = self._rate_from
        passed_us = self._t1_us - t_us
        if passed_us >= US_PER_S:
            self.gauges["events_hz"] = (self.counters["events"] - events) * US_PER_S / passed_us
            self.gauges["onsets_hz"] = (self.counters["onsets"] - onsets) * US_PER_S / passed_us
            self._rate_from = (self._t1_us, self.counters["events"], self.counters["onsets"])
