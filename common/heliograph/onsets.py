"""Onsets: from raw events to the compact stream that a tracker reads, gated and pooled at the source.

For each tick [t, t + tick_us) and each pooled pixel (X, Y) = (x // pool_px, y // pool_px)::

    on_count  = min(255, brighter events)        off_count = min(255, darker events)

Gate "open": every pooled pixel with an event is an entry. Gate "active": of these, the ones whose own tick holds at
least `min_events` events in the 3x3 pooled pixels around and with them; what stands alone in space and time is noise,
and is counted. An entry's counts are never changed by the gate.

A tick with more entries than a message can carry is a flash over the whole sensor, which says nothing of where a
beacon is: it is emptied, and counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch

Gate = Literal["open", "active"]
# The wire counts a tick's entries in 16 bits (heliograph.streams).
TICK_ENTRIES_LIMIT: Final = 65_535
TICKS_LIMIT: Final = 65_535

# Kernel tables, indices and masks; a de Bruijn sequence gives the place of a word's only bit, for which numba has no
# instruction: 64 different windows of 6 bits (any B(2, 6) does).
_DE_BRUIJN: Final = 0x03F79D71B4CB0A89
_BIT_PLACE: Final = np.zeros(64, np.int64)
for _place in range(64):
    _BIT_PLACE[((_DE_BRUIJN << _place) & (2**64 - 1)) >> 58] = _place
_LOW: Final = np.uint16(0x00FF)
_ONE_ON: Final = np.uint16(0x0001)
_ONE_OFF: Final = np.uint16(0x0100)


@dataclass(frozen=True, slots=True)
class OnsetSettings:
    """What an onset counter is made for; the ranges are checked by the service's configuration.

    Args:
        width: of the sensor, pixels.
        height: of the sensor, pixels.
        tick_us: length of a tick.
        pool_px: side of the square of sensor pixels that becomes one entry.
        gate: "open" or "active", see the module.
        min_events: what the active gate asks for.
    """

    width: int
    height: int
    tick_us: int
    pool_px: int = 1
    gate: Gate = "active"
    min_events: int = 2


@dataclass(frozen=True, slots=True, eq=False)
class OnsetColumns:
    """The entries of some ticks, in the order (tick, y, x); columns as in `heliograph.streams.Onsets`.

    `gated` counts entries that the gate dropped, `flooded` ticks that were emptied, `off_sensor` events that were
    ignored because they lie outside the sensor.
    """

    tick: npt.NDArray[np.uint16]
    x_px: npt.NDArray[np.uint16]
    y_px: npt.NDArray[np.uint16]
    on_count: npt.NDArray[np.uint8]
    off_count: npt.NDArray[np.uint8]
    gated: int
    flooded: int
    off_sensor: int


class OnsetCounter:
    """Counts events by tick and pixel; keeps nothing from call to call but scratch memory.

    Args:
        settings: the sensor and the gate.
    """

    def __init__(self, settings: OnsetSettings) -> None:
        self._settings = settings
        pool = settings.pool_px
        columns, rows = -(-settings.width // pool), -(-settings.height // pool)
        # A margin of one pixel all around spares the gate's neighbourhood every test for the border.
        self._stride = columns + 2
        self._counts = np.zeros((rows + 2) * self._stride, np.uint16)  # on_count + 256 * off_count
        self._marks = np.zeros(len(self._counts) // 64 + 1, np.uint64)  # a bit for each count that is not 0
        self._column = (np.arange(settings.width) // pool + 1).astype(np.int64)
        self._row = ((np.arange(settings.height) // pool + 1) * self._stride).astype(np.int64)

    def count(self, batch: EventBatch, t0_us: int, t1_us: int) -> OnsetColumns:
        """Return the entries of the ticks of [t0_us, t1_us).

        Args:
            batch: n events of this window, sorted by time.
            t0_us: beginning of the first tick.
            t1_us: end of the last tick: t0_us plus a multiple of tick_us.

        Raises:
            ValueError: the window is not made of 0 to 65535 whole ticks, or an event lies outside it.
        """
        s = self._settings
        n = len(batch)
        if (t1_us - t0_us) % s.tick_us or not 0 <= t1_us - t0_us <= TICKS_LIMIT * s.tick_us:
            raise ValueError(f"[{t0_us}, {t1_us}) must hold 0 to {TICKS_LIMIT} whole ticks of {s.tick_us} us")
        if n and not t0_us <= batch.t_us[0] <= batch.t_us[-1] < t1_us:
            raise ValueError(f"events must lie in [{t0_us}, {t1_us}), not at {batch.t_us[0]} to {batch.t_us[-1]} us")
        tick, x_px, y_px = np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.uint16)
        on_count, off_count = np.empty(n, np.uint8), np.empty(n, np.uint8)
        # The open gate asks for one event, which every entry has.
        min_events = s.min_events if s.gate == "active" else 1
        t_us, xs_px, ys_px, on = (_read_only(column) for column in (batch.t_us, batch.x_px, batch.y_px, batch.on))
        kept, gated, flooded, off_sensor = _count(
            t_us, xs_px, ys_px, on, t0_us, s.tick_us, self._column, self._row, self._stride, min_events,
            self._counts, self._marks, _BIT_PLACE, tick, x_px, y_px, on_count, off_count,
        )  # fmt: skip
        return OnsetColumns(
            tick[:kept], x_px[:kept], y_px[:kept], on_count[:kept], off_count[:kept], gated, flooded, off_sensor
        )


def _read_only(column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a view that cannot be written: numba compiles anew for each mixture of writable and read-only columns."""
    view = column.view()
    view.flags.writeable = False
    return view


@numba.njit(cache=True, nogil=True)
def _around(counts: Any, p: int, stride: int, enough: int) -> bool:
    """Whether the 3x3 around p hold enough events; stops at the first moment at which they do."""
    total = np.int64(0)
    for base in (p, p - stride, p + stride):
        for q in range(base - 1, base + 2):
            c = counts[q]
            total += np.int64(c & _LOW) + np.int64(c >> 8)
        if total >= enough:
            return True
    return False


@numba.njit(cache=True, nogil=True)
def _finish_tick(
    tick: int, stride: int, min_events: int, counts: Any, marks: Any, places: Any, kept: int, tick_out: Any, x_out: Any,
    y_out: Any, on_out: Any, off_out: Any,
) -> tuple[int, int, int]:  # fmt: skip
    """Write a tick's entries from index kept on and clear the scratch; return kept, gated and flooded."""
    first, gated = kept, 0
    row, row_end = 0, stride
    for pass_clears in (False, True):
        for w in range(len(marks)):
            bits = marks[w]
            while bits != 0:
                low = bits & (~bits + np.uint64(1))
                bits ^= low
                p = w * 64 + places[(low * np.uint64(_DE_BRUIJN)) >> np.uint64(58)]
                if pass_clears:
                    counts[p] = 0
                    continue
                while p >= row_end:
                    row += 1
                    row_end += stride
                c = counts[p]
                own = np.int64(c & _LOW) + np.int64(c >> 8)
                if own < min_events and not _around(counts, p, stride, min_events):
                    gated += 1
                    continue
                tick_out[kept] = tick
                x_out[kept] = p - (row_end - stride) - 1
                y_out[kept] = row - 1
                on_out[kept] = c & _LOW
                off_out[kept] = c >> 8
                kept += 1
            if pass_clears:
                marks[w] = 0
    if kept - first > TICK_ENTRIES_LIMIT:
        return first, gated, 1
    return kept, gated, 0


@numba.njit(cache=True, nogil=True)
def _count(
    t_us: Any, x_px: Any, y_px: Any, on: Any, t0_us: int, tick_us: int, column: Any, row: Any, stride: int,
    min_events: int, counts: Any, marks: Any, places: Any, tick_out: Any, x_out: Any, y_out: Any, on_out: Any,
    off_out: Any,
) -> tuple[int, int, int, int]:  # fmt: skip
    """Return the number of entries written, gated, of flooded ticks, and of events off the sensor."""
    kept, gated, flooded, off_sensor, in_tick = 0, 0, 0, 0, 0
    tick, tick_end = 0, t0_us + tick_us
    for i in range(len(t_us)):
        if t_us[i] >= tick_end:
            if in_tick > 0:
                kept, more_gated, more_flooded = _finish_tick(
                    tick, stride, min_events, counts, marks, places, kept, tick_out, x_out, y_out, on_out, off_out
                )
                gated += more_gated
                flooded += more_flooded
                in_tick = 0
            tick = (t_us[i] - t0_us) // tick_us
            tick_end = t0_us + (tick + 1) * tick_us
        if x_px[i] >= len(column) or y_px[i] >= len(row):
            off_sensor += 1
            continue
        in_tick += 1
        p = row[y_px[i]] + column[x_px[i]]
        c = counts[p]
        if c == 0:
            marks[p >> 6] |= np.uint64(1) << np.uint64(p & 63)
        if on[i]:
            if c & _LOW != _LOW:
                counts[p] = c + _ONE_ON
        elif c >> 8 != 255:
            counts[p] = c + _ONE_OFF
    if in_tick > 0:
        kept, more_gated, more_flooded = _finish_tick(
            tick, stride, min_events, counts, marks, places, kept, tick_out, x_out, y_out, on_out, off_out
        )
        gated += more_gated
        flooded += more_flooded
    return kept, gated, flooded, off_sensor


def warm() -> None:
    """Compile or load the kernels, so that the first real window waits for nothing."""
    one = EventBatch(np.zeros(1, np.int64), np.zeros(1, np.uint16), np.zeros(1, np.uint16), np.ones(1, np.bool_))
    OnsetCounter(OnsetSettings(width=1, height=1, tick_us=1)).count(one, 0, 1)
