"""Settings of an event source: one camera, brought to the bus. Defaults, ranges, and where each number comes from."""

from __future__ import annotations

from math import ceil
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from heliograph.errors import ConfigError
from heliograph.messages import SENSOR_LIMIT_PX, Name
from heliograph.streams import OVERHEAD_BYTES
from heliograph.units import US_PER_S

Format = Literal["auto", "aedat4", "evt2", "evt3", "dat", "es", "csv", "npz", "mat"]


class EventSourceConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All settings of the process."""

    camera: Annotated[Name, Meta(description="name of the camera on the bus")] = "cam0"
    backend: Annotated[str, Meta(description="what the events come from: recording, simulated, or an entry point")] = (
        "recording"
    )
    camera_file: Annotated[str, Meta(description="TOML with intrinsics and mount; checked against the sensor")] = ""

    # recording
    file: Annotated[str, Meta(description="recording to play")] = ""
    format: Annotated[Format, Meta(description="format of the file; auto goes by its first bytes, then its name")] = (
        "auto"
    )
    width: Annotated[int, Meta(ge=0, le=SENSOR_LIMIT_PX, description="sensor width where the file has none, px")] = 0
    height: Annotated[int, Meta(ge=0, le=SENSOR_LIMIT_PX, description="sensor height where the file has none, px")] = 0
    loop: Annotated[bool, Meta(description="play the recording again and again; time goes on")] = False

    # simulated
    scenario: Annotated[str, Meta(description="built-in scenario, or a scenario file")] = "construction_site"
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1, description="seed of the simulation")] = 0
    # Half the resolution and twice the steps of the surroundings cost a third, so that a scene runs beside its readers.
    fidelity: Annotated[
        Literal["full", "live"], Meta(description="how finely the surroundings are rendered; lights are always full")
    ] = "full"

    # images (a file of them); what a file must hold: cameras/image_file.py
    # ESIM's and v2e's usual threshold, of ln(grey); for the linear scale in levels of grey, where 10 is that of the
    # gazebo_dvs_plugin.
    image_scale: Annotated[Literal["log", "linear"], Meta(description="what images are compared in")] = "log"
    image_threshold: Annotated[
        float, Meta(ge=0.01, le=255.0, description="change of a pixel that makes an event, in units of image_scale")
    ] = 0.2
    image_max_events: Annotated[int, Meta(ge=1, le=1000, description="events a pixel and image, at most")] = 10

    # A picture of 640x480 is about 200 kB: two a second are more than the onsets of a whole scene.
    image_hz: Annotated[
        float, Meta(ge=0.0, le=100.0, description="views published a second, by a camera that has them; 0: none")
    ] = 0.0

    duration_s: Annotated[
        float, Meta(ge=0.0, le=1e6, description="stop after this time of the camera; 0: no limit")
    ] = 0.0
    pace: Annotated[float, Meta(ge=0.0, le=1000.0, description="1: real time; 2: twice as fast; 0: no waiting")] = 1.0
    # 1 to 5 ms: shorter costs more a message than it gains, longer is what a listener waits (measured on Zenoh 1.10).
    window_us: Annotated[int, Meta(ge=100, le=1_000_000, description="length of a batch of events, us")] = 2_000
    # 10k events are 81 kB: as large as a message may grow before it delays the ones behind it.
    max_events: Annotated[int, Meta(ge=1, le=1_000_000, description="events a message, at most")] = 10_000

    # onsets
    # Where within its tick an event lies is not known: at 2000 px/s 10 px in 5 ms, 2 in 1 ms, and so much less do
    # tracks of fast targets err. What crosses a radio stays at 5 ms (deploy/sites/onboard.toml): an entry a tick.
    tick_us: Annotated[int, Meta(ge=100, le=100_000, description="length of an onset tick, us")] = 1_000
    # Each message costs 0.3 kB beside its entries, so 10 ms take an eighth of a link of 2 Mbit/s and 5 ms a quarter; an
    # onset waits for half of it on the average, and for all of it at worst, before a tracker hears of it.
    onsets_us: Annotated[int, Meta(ge=100, le=1_000_000, description="time that an onsets message covers, us")] = 10_000
    pool_px: Annotated[int, Meta(ge=1, le=64, description="side of the square of pixels that makes one onset")] = 1
    gate: Annotated[
        Literal["open", "active"], Meta(description="open: every active pixel and tick; active: none that stand alone")
    ] = "active"
    # Noise at 0.1 events/(px s) has another in the 3x3 px of two ticks in 1 % of all cases; a beacon of two pixels
    # always has.
    min_events: Annotated[
        int, Meta(ge=1, le=255, description="events in 3x3 px and two ticks for the active gate, at least")
    ] = 2
    # Under 1 Mev/s of noise and texture: 5 to 10 kB/s of the 250 that the link may carry.
    onsets_noise_hz: Annotated[
        float, Meta(ge=0.0, le=1e9, description="noise a second that may pass the active gate; 0: min_events alone")
    ] = 2_000.0
    # On one host nothing is gained by thinning; a site with a radio says what it carries (deploy/sites/onboard.toml).
    onsets_bit_rate_max: Annotated[
        float,
        Meta(ge=0.0, le=1e12, description="bit/s of the onsets with all that Zenoh adds; beyond, thinned; 0: no limit"),
    ] = 0.0

    wait_for: Annotated[tuple[Name, ...], Meta(description="services that a lockstep source waits for")] = (
        "tracker",
        "decoder",
    )
    # A camera waits for nobody; a scene or a recording at real time may, so that its first second is not for nobody.
    await_s: Annotated[
        float, Meta(ge=0.0, le=600.0, description="how long a paced source waits for them before it begins, s")
    ] = 0.0

    def __post_init__(self) -> None:
        if (self.width == 0) != (self.height == 0):
            raise ConfigError(f"width and height must be given together, not {self.width} x {self.height}")
        if self.onsets_us % self.tick_us:
            raise ConfigError(f"onsets_us must be a multiple of tick_us = {self.tick_us}, not {self.onsets_us}")
        least = ceil(OVERHEAD_BYTES * 8 * 2 * US_PER_S / self.onsets_us)
        if 0 < self.onsets_bit_rate_max < least:
            raise ConfigError(
                f"onsets_bit_rate_max must be 0 or at least {least}, twice what empty messages of"
                f" onsets_us = {self.onsets_us} take, not {self.onsets_bit_rate_max:g}"
            )
