"""The settings of the metrics sink, with the reason of each default."""

from __future__ import annotations

from typing import Annotated, Final

import msgspec
from msgspec import Meta

from heliograph.site import Beacon

# A second of camera time is settled this long after its end. Zenoh on one host delivers in milliseconds; a decoder
# that reads back half a second of backlog for a new track is the latest regular writer.
SETTLE_US: Final = 2_000_000
# Beyond this wait a frame without truth is given up: what is kept must stay small, and truth comes before its frames.
SETTLE_MAX_US: Final = 5_000_000
# 20 beacons at 5 kbit/s make 9,000 frames a second: room for ten times that over the longest wait.
MAX_WAITING: Final = 500_000
# A week of seconds is half a gigabyte for a camera with five beacons (bench/results/sink_store.json).
SECONDS_H: Final = 168.0
# Minutes, hours, sightings: a tenth of that a month.
DAYS: Final = 90.0


class MetricsSinkConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the metrics sink may be told.

    Args:
        file: the SQLite file, relative to the working directory; empty for none.
        settle_us: how long after the end of a second its counts are final.
        max_waiting: most frames, identifications and truths that wait at a time, for each camera.
        prometheus_port: of the loopback, for `GET /metrics`; 0 for none.
        keep_seconds_h: hours for which aggregates of a second are kept; 0 for ever.
        keep_days: days for which everything else is kept; 0 for ever.
        beacons: the site's list; its options say how the bits of a beacon's frames are counted.
    """

    file: Annotated[str, Meta(max_length=4096, description="SQLite file; empty keeps nothing")] = "run/metrics.sqlite"
    settle_us: Annotated[
        int, Meta(ge=1_000_000, le=SETTLE_MAX_US, description="wait for late messages before a second is final, us")
    ] = SETTLE_US
    max_waiting: Annotated[
        int, Meta(ge=1_000, le=10_000_000, description="most waiting frames, identifications and truths a camera")
    ] = MAX_WAITING
    prometheus_port: Annotated[
        int, Meta(ge=0, le=65535, description="port of the loopback for GET /metrics (Prometheus); 0 for none")
    ] = 0
    keep_seconds_h: Annotated[
        float, Meta(ge=0.0, le=87_600.0, description="hours that aggregates of a second are kept; 0 for ever")
    ] = SECONDS_H
    keep_days: Annotated[
        float, Meta(ge=0.0, le=3_650.0, description="days that minutes, hours and sightings are kept; 0 for ever")
    ] = DAYS
    beacons: Annotated[tuple[Beacon, ...], Meta(description="the site's beacons")] = ()
