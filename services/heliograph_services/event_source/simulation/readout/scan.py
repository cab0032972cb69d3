"""The scanned read-out of the Samsung S5K231Y (DVXplorer, DVXplorer Mini): column after column, again and again.

::

    |--- T_ED ---|hold|- column 0 -|- column 1 -| ... |- column 639 -|(- stretch -)|--- T_ED ---| ...
    T = T_ED + sum over the columns of max(NEXT_SEL, 5 + active groups) x 20 ns  (+ stretch),  groups of 8 pixels

An active group has a pixel with an event. T_ED, NEXT_SEL and the fixed times of the CONSTANT modes are what
dv-processing's setDVXplorerEFPS writes into the sensor's registers; clock, groups and columns are libcaer's
dvxplorer.c; that a column costs 5 cycles beside its groups is inferred from the full scan of "around 0.85 ms" that
setDVXplorerEFPS names (839 us by the formula). A fixed scan ends when its time is over: columns not yet begun then are
not read, and what their pixels held is lost (assumed: "possible data loss", setDVXplorerEFPS).

Known of the sensor: libcaer switches GLOBAL_HOLD on and GLOBAL_RESET off by default, so all pixels are sampled in one
instant, at the end of T_ED, and each is reset when it is read (`sample` = "hold"); without the hold a pixel is sampled
at its column's turn ("column"). The Mini sends one time stamp a scan, with its first column ("start"); the DVXplorer's
logic stamps the stream as columns arrive ("column"); "end" is for comparison. Not published: what the comparator does
between two reads. `latch` chooses:

- "net" (default): comparators without memory. A pixel shows the sign of its change since its last reset; opposite
  crossings cancel; a reset sets the reference to the present light, so that further crossings, and those between the
  hold and the reset, are lost. It is what the hold asks for: there would be nothing to hold if a latch kept the event.
- "first": the comparator's first crossing sets a latch until the pixel is read; later ones are lost.
- "step": as "net", but a read moves the reference by one threshold only; what is left over waits for the next scans.

The pixels behind (`pixel.array`) move their reference by a threshold at each crossing, where a reset would move it by
the whole change: what is left below the threshold (less than one event) survives a read here, and not in the sensor.

Times are integer nanoseconds from the scene's begin; scan 0 begins up to a quiet scan earlier (`phase`), since no
scan waits for a scene. A scan's length depends on the events alone.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from heliograph.events import EventBatch
from heliograph_services.event_source.simulation.contract import Labels, PixelEvents
from heliograph_services.event_source.simulation.readout.numbers import ScanNumbers
from heliograph_services.event_source.simulation.readout.scan_kernel import (
    EVENT,
    PIXEL,
    START,
    WAITING,
    quiet_ns,
    run,
)

LATCHES: Final = ("first", "net", "step")
SAMPLES: Final = ("hold", "column")
STAMPS: Final = ("start", "column", "end")
COUNTERS: Final = (
    "events in",
    "read",
    "lost: merged",  # further crossings of a pixel within a scan
    "lost: cancelled",  # crossings that an opposite one took back
    "lost: before reset",  # after the hold, before the pixel's reset
    "lost: no time",  # in columns that a fixed scan did not reach
    "waiting",  # in the pixels, to be read
    "scans",
)


class ScanReadout:
    """Reads the pixels of one scanned sensor.

    Args:
        numbers: of the read-out.
        width: pixels.
        height: pixels.
        phase: share of a quiet scan, from 0 to below 1, that has passed when the scene begins.
    """

    def __init__(self, numbers: ScanNumbers, width: int, height: int, phase: float = 0.0) -> None:
        cycle_ns = numbers.clock_ns
        # In the order of `scan_kernel`.
        self._parameters = np.array(
            [
                width,
                numbers.group_px,
                numbers.group_cycles * cycle_ns,
                numbers.column_cycles * cycle_ns,
                numbers.next_sel_cycles * cycle_ns,
                round(numbers.detect_us * 1000.0),
                round(numbers.fixed_us * 1000.0),
                round(numbers.stretch_us * 1000.0),
                LATCHES.index(numbers.latch),
                SAMPLES.index(numbers.sample),
                STAMPS.index(numbers.stamp),
            ],
            np.int64,
        )
        self._state = np.zeros(5, np.int64)
        self._state[START] = -math.floor(phase * quiet_ns(self._parameters))
        self._counts = np.zeros(len(COUNTERS), np.int64)
        self._pixels = np.zeros(width * height, PIXEL)
        self._first = np.full(width, -1, np.int32)
        self._rows = np.zeros(height, np.int32)
        # Events of a scan that has not ended yet.
        self._kept = np.empty(0, EVENT)
        self.counters: dict[str, int] = dict.fromkeys(COUNTERS, 0)

    @property
    def until_us(self) -> int:
        """The end of the last whole scan: all events before it have been returned."""
        return max(0, int(self._state[START]) // 1000)

    def feed(self, events: PixelEvents, until_us: float) -> tuple[EventBatch, Labels]:
        """Return the events of the scans that end by until_us: by scan, column, row; and the cause of each.

        Args:
            events: all in [the previous until_us, until_us).
            until_us: the pixels have no more events before this time.
        """
        kept = len(self._kept)
        # Each crossing is read at most once.
        out = np.empty(kept + len(events) + int(self._counts[WAITING]), EVENT)
        out[:kept] = self._kept
        done, written = run(
            *(events.t_us, events.pixel, events.on, events.cause, float(until_us) * 1000.0),
            *(self._parameters, self._state, self._counts, self._pixels, self._first, self._rows, out, kept),
        )
        self._kept = out[done:written].copy()
        self.counters.update(zip(COUNTERS, self._counts.tolist(), strict=True))
        read = out[:done]
        fields = (np.ascontiguousarray(read[name]) for name in ("t_us", "x_px", "y_px", "on"))
        return EventBatch(*fields), np.ascontiguousarray(read["label"])
