"""Settings of the tracker, each with its range, its default and where the default comes from.

Pixels of clustering and shape are *onset pixels*: the squares of `pool_px` x `pool_px` sensor pixels that the source
counts in. Everything that has to do with motion is in sensor pixels.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec
from msgspec import Meta

from heliograph.errors import ConfigError
from heliograph.messages import Name

Shape = Literal["distinct", "paper"]
Cost = Literal["l2", "l1"]
Clustering = Literal["grid", "scikit-learn"]
Kalman = Literal["batched", "filterpy"]
Flow = Literal["none", "numba", "torch"]
FlowReading = Literal["scales", "paper"]
Prediction = Literal["none", "centroid", "flow", "both"]

_Time = Annotated[int, Meta(ge=0, le=60_000_000)]
_Pixels = Annotated[int, Meta(ge=1, le=1_000_000)]

# 1 kHz; between two clustering windows the tracks are extrapolated.
PERIOD_MIN_US: Final = 1_000


class TrackerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of one tracker; times in microseconds of camera time."""

    camera: Annotated[Name, Meta(description="the camera to follow")] = "cam0"
    # The paper, "Tracking": the loop runs at 10 Hz.
    period_us: Annotated[
        int, Meta(ge=PERIOD_MIN_US, le=10_000_000, description="tracks are published at its multiples")
    ] = 100_000

    # -- backends --
    # Ours; the others are other people's libraries, give the same tracks, and take 30 to 1800 times as long
    # (bench/results/backends.txt).
    clustering: Annotated[
        Clustering, Meta(description="who clusters: grid, or scikit-learn (needs heliograph[reference])")
    ] = "grid"
    kalman: Annotated[Kalman, Meta(description="who filters: batched, or filterpy (needs heliograph[reference])")] = (
        "batched"
    )

    # -- clustering --
    # A spot at 711 px/s keeps a roundness of .93 in 5 ms and has .17 in the paper's 100 ms, which can be asked for.
    cluster_window_us: Annotated[
        int, Meta(ge=100, le=100_000, description="window of clustering; cut to whole ticks of onsets, at least one")
    ] = 5_000
    # Reaches over one dead or gated pixel; the disc has 13 pixels, so that 1 Mev/s of noise on 640x480 puts .2 events
    # into it in 5 ms, against the 5 that make a core.
    eps_px: Annotated[float, Meta(ge=1.0, le=16.0, description="DBSCAN radius, onset pixels")] = 2.0
    # The paper, "Clustering": 5 to 30 events.
    min_events: Annotated[
        int, Meta(ge=1, le=100_000, description="DBSCAN core: events within eps, its own included")
    ] = 5
    # Three pixels in a row pass the roundness of .5 (they score .57), four do not (.45).
    min_pixels: Annotated[
        _Pixels, Meta(description="smallest target that may become a track, distinct onset pixels; half if all blink")
    ] = 4
    # A disc of 50 px across: a 12 cm LED 1 m before a lens of f = 400 px.
    max_pixels: Annotated[_Pixels, Meta(description="largest target that may be or update a track")] = 2_000
    shape: Annotated[Shape, Meta(description="measure of roundness: by variance, or the paper's by radius")] = (
        "distinct"
    )
    # Discs score .86 to 1.0 and streaks .16 to .45 (distinct); discs .66 to .89 in the paper's measure.
    min_roundness: Annotated[
        float, Meta(ge=0.0, le=1.0, description="least roundness of a target to become a track")
    ] = 0.5
    # 30,000 active pixels take about 2 ms to cluster, 80,000 take 8: longer than the window lasts.
    max_active_pixels: Annotated[
        int, Meta(ge=100, le=4_000_000, description="a window of more active pixels is a flood and is skipped")
    ] = 30_000

    # -- motion --
    flow: Annotated[Flow, Meta(description="who runs the flow network; torch needs heliograph[reference]")] = "none"
    # None: tracks stay where they were seen. Centroid: the filter's own velocity. Flow: the network's alone, the
    # paper's. Both: the filter's, with the network's at births and while a track is not seen.
    prediction: Annotated[
        Prediction, Meta(description="what moves a track between sightings: nothing, its own past, the flow, or both")
    ] = "centroid"
    # Three scales, and the paper read literally: one network of full resolution, a tick a period, every active pixel.
    flow_reading: Annotated[
        FlowReading, Meta(description="how the network is used: at our scales, or as the paper says it")
    ] = "scales"
    # 0 leaves the memory out, runs several times as fast and errs no more (flow/README.md); the paper has one.
    flow_l_tau: Annotated[float, Meta(ge=0.0, le=0.99, description="the network's memory, l(tau)")] = 0.0
    # 8 bytes a sample and 230 a record: 30 samples at 10 Hz take 5 kB/s.
    flow_samples: Annotated[
        int, Meta(ge=0, le=1000, description="samples in each record on flow/{camera}; 0: no records")
    ] = 0
    # 2 s^2 tau for accelerations of s = 210 px/s2 held for tau = .1 s. Bridging 200 ms of darkness leaves 5 px of
    # uncertainty. More follows tight turns better (30,000: .28 for .44 px at 1070 px/s2), but beacons that cross then
    # swap their names (twenty at 200 px/s: 6 swaps in 12 s for none); the decoder centres its regions itself.
    process_noise_px2_s3: Annotated[float, Meta(gt=0.0, le=1e9, description="density of the white acceleration")] = (
        9_000.0
    )
    # 2 s^2 tau for 70,000 px/s2, which hold 2,000 px/s on a circle of 60 px, for tau = .1 s.
    process_noise_max_px2_s3: Annotated[
        float, Meta(gt=0.0, le=1e10, description="the same for tracks that are seen to turn; none that turn if less")
    ] = 1e9
    # A disc of 13 pixels of which noise and thresholds move the edge: .2 to .4 px.
    measurement_noise_px: Annotated[float, Meta(gt=0.0, le=100.0, description="standard error of a whole target")] = 0.3
    # A drone at 2 m/s and 5 m sees 160 px/s at 3.6 mm: a birth is within two sigma of that.
    initial_speed_px_s: Annotated[float, Meta(gt=0.0, le=1e5, description="standard deviation of a birth's speed")] = (
        100.0
    )
    # A lens that a hand turns at 10 rad/s with f = 1,100 px.
    max_speed_px_s: Annotated[float, Meta(gt=0.0, le=1e5, description="speeds are cut to it")] = 12_000.0

    # -- association --
    # 99.9 % of a chi-squared variable with two degrees of freedom.
    gate_chi2: Annotated[float, Meta(gt=0.0, le=1e4, description="gate: squared Mahalanobis distance")] = 13.8
    # 300 px/s2 over an occlusion of .5 s are 38 px.
    gate_px: Annotated[float, Meta(gt=0.0, le=4096.0, description="gate: no farther than this beyond the radius")] = (
        40.0
    )
    cost: Annotated[Cost, Meta(description="assignment by squared Mahalanobis distance, or the paper's L1 norm")] = "l2"

    # -- life --
    # Two coincide by chance in 1 Mev/s of ungated noise, three hardly do; at 50 bit/s every safe word has four edges
    # in 220 ms.
    confirm_hits: Annotated[int, Meta(ge=1, le=100, description="windows with a round target before publication")] = 3
    # An edge that crosses never shows it; every safe word at 50 bit/s has four edges in 220 ms, so three flips in .3 s.
    confirm_blinks: Annotated[
        int, Meta(ge=0, le=100, description="of them, windows that show a blinking light and no crossing edge")
    ] = 2
    confirm_us: Annotated[_Time, Meta(description="the hits must come within this time of the birth")] = 300_000
    # Delays without a target: paper-notes 6 (2 s and .3 s); ten dark bits at 50 bit/s are .2 s.
    coast_new_us: Annotated[_Time, Meta(description="silence that ends a track of status new")] = 300_000
    coast_valid_us: Annotated[_Time, Meta(description="silence that ends a track of status valid")] = 2_000_000
    # Long enough for the decoder to change its mind with one more frame at 50 bit/s.
    invalid_us: Annotated[_Time, Meta(description="a track that stays invalid for this time ends")] = 300_000
    quarantine_us: Annotated[
        _Time, Meta(description="no births where an invalid track ended, at first; doubles with each that follows")
    ] = 1_000_000
    quarantine_max_us: Annotated[_Time, Meta(description="the doubling ends here")] = 8_000_000
    max_tracks: Annotated[
        int, Meta(ge=1, le=4096, description="most published tracks; as many again may be in birth")
    ] = 256

    def __post_init__(self) -> None:
        if self.min_pixels > self.max_pixels:
            raise ConfigError(f"min_pixels must be at most max_pixels = {self.max_pixels}, not {self.min_pixels}")
        if self.flow == "none" and self.prediction in ("flow", "both"):
            raise ConfigError(f"prediction = {self.prediction!r} needs flow = 'numba' or 'torch', not 'none'")
        if self.quarantine_us > self.quarantine_max_us:
            raise ConfigError(
                f"quarantine_us must be at most quarantine_max_us = {self.quarantine_max_us}, not {self.quarantine_us}"
            )
