"""The numbers of a sensor: what a preset says, without where it comes from (`presets.py` reads and checks that)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from heliograph_services.event_source.simulation.contract import PixelNumbers

Kind = Literal["measured", "published", "assumed"]
Latch = Literal["first", "net", "step"]
Sample = Literal["hold", "column"]
Stamp = Literal["start", "column", "end"]
Reference = Literal["changed", "last"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanNumbers:
    """A sensor that reads its columns one after another, again and again (`scan.py`).

    Args:
        mode: the read-out mode's name.
        clock_ns: one cycle of the read-out.
        group_px: pixels that are read together.
        group_cycles: cycles that each group with an event costs.
        column_cycles: cycles that a column with events costs beside its groups.
        next_sel_cycles: cycles from column to column, at least.
        detect_us: T_ED, time before the columns in which pixels may detect.
        fixed_us: length of every scan, detection included; 0: as long as it takes.
        stretch_us: what every scan lasts longer, after its columns.
        latch: what a pixel with several crossings between two reads reports.
        sample: when a pixel is looked at: all at the `hold` that ends the detection, or each at its `column`'s turn.
        stamp: the events' time: `start` of the columns, the turn of their `column`, or the `end` of the scan.
    """

    mode: str
    clock_ns: int
    group_px: int
    group_cycles: int
    column_cycles: int
    next_sel_cycles: int
    detect_us: float
    fixed_us: float
    stretch_us: float
    latch: Latch
    sample: Sample
    stamp: Stamp


@dataclass(frozen=True, slots=True, kw_only=True)
class AerNumbers:
    """A sensor whose pixels ask for a bus whenever they have an event (`aer.py`).

    Args:
        bus_hz: events a second that the bus takes.
        queue_events: events that may wait for it; what comes then is lost.
        resolution_us: of the time stamps, a whole number of microseconds.
    """

    bus_hz: float
    queue_events: int
    resolution_us: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageNumbers:
    """A camera that compares images, as the gazebo_dvs_plugin does: 8 bit, linear, at most one event a pixel an image.

    ON where ``image - reference > threshold_grey``, OFF where ``reference - image > threshold_grey``.

    Args:
        image_hz: images a second.
        threshold_grey: of 255; an event where the difference is larger.
        exposure_us: time over which an image collects light; 0: an instant, as a renderer does.
        grey_per_w_m2: grey levels per W/m2 on the sensor plane; 0: such that the mean surroundings have
            background_grey.
        background_grey: mean grey of the surroundings where grey_per_w_m2 is 0.
        reference: what the next image is compared with: `changed`: as before, but the new grey where there was an
            event; `last`: the image before.
        delay_us: from the end of an image's exposure to the time stamp of its events.
        jitter_us: standard deviation of that delay, one draw an image; it is never below 0.
    """

    image_hz: float
    threshold_grey: float
    exposure_us: float
    grey_per_w_m2: float
    background_grey: float
    reference: Reference
    delay_us: float
    jitter_us: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """A sensor, ready to be simulated.

    Args:
        name: of the preset.
        width: pixels.
        height: pixels.
        pitch_um: side of a pixel.
        kind: `images` sensors have no event pixels: of `pixel` only dark_w_m2 counts.
        pixel: what its pixels obey.
        readout: its numbers by kind.
    """

    name: str
    width: int
    height: int
    pitch_um: float
    kind: Literal["scan", "aer", "images"]
    pixel: PixelNumbers
    readout: ScanNumbers | AerNumbers | ImageNumbers
