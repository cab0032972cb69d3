"""Settings of the decoder; each default with its source. Imports neither numba nor a modulation: `--help` is quick."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec
from msgspec import Meta

from heliograph.errors import ConfigError
from heliograph.messages import Name
from heliograph.site import Beacon
from heliograph.units import BIT_RATE_MAX, BIT_RATE_MIN

AUTO: Final = "auto"

_Rate = Annotated[float, Meta(ge=BIT_RATE_MIN, le=BIT_RATE_MAX)]


class DecoderConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What an operator may set.

    Raises:
        ConfigError: two grids do not nest (step in window, window in refresh and in the tracker's period).
    """

    # One camera is the usual site; the source's default has the same name.
    camera: Annotated[Name, Meta(description="the camera whose events are decoded")] = "cam0"
    beacons: Annotated[
        tuple[Beacon, ...], Meta(description="the beacons that the site lists; they say which links are tried")
    ] = ()
    # The paper's own frame.
    protocol: Annotated[Name, Meta(description="the modulation tried without listed beacons, or auto for all")] = (
        "seed11"
    )
    # The paper's outdoor rate (section on experiments: 1 kHz).
    bit_rate: Annotated[
        _Rate | Literal["auto"], Meta(description="nominal bit/s without listed beacons, or auto to measure it")
    ] = 1000.0
    receiver: Annotated[
        Name,
        Meta(description="receiver of each modulation that has it: default; to compare: paper, binning, wang2022"),
    ] = "default"
    options: Annotated[
        dict[str, str | int], Meta(description="the modulation's own settings without listed beacons")
    ] = {}
    # At 711 px/s, 2 m/s seen from 5 m through a 16 mm lens, a region moves 0.7 px in it: less than it is painted to.
    step_us: Annotated[int, Meta(ge=100, le=100_000, description="regions are moved once a step")] = 1_000
    # What a frame waits for its publication; a receiver is fed when it may decide something, so that windows of 5 ms
    # would cost four fifths of it.
    window_us: Annotated[
        int,
        Meta(ge=100, le=1_000_000, description="events are routed, due receivers fed, frames published once a window"),
    ] = 1_000
    # radius_px covers nine tenths of the target's pixels: half as much again reaches the rest and the slow fringe.
    region_scale: Annotated[float, Meta(ge=0.5, le=10.0, description="a region's radius in radii of its target")] = 1.5
    self_centring: Annotated[
        bool, Meta(description="regions are centred on their own events; else the tracker alone moves them")
    ] = True
    # What a prediction may be off before the first re-centring: 20 px/s (5 % of 400) for 100 ms are 2 px.
    region_margin_px: Annotated[float, Meta(ge=0.0, le=100.0, description="added to a region's radius")] = 2.5
    # A beacon of 50 px radius fills a sixth of a 640x480 sensor's height; beyond it is the scene, or a damaged number.
    region_max_px: Annotated[float, Meta(ge=0.5, le=1_000.0, description="the largest radius of a region")] = 80.0
    # 20 beacons on a scanned sensor, MAR of the whole and of the core: at 5 kbit/s .66 -> .99 (slow) and .09 -> .91
    # (fast); the same up to 3.5 kbit/s; and behind a scan of 199 us at 2 kbit/s .71 -> .55: there the halo spreads an
    # edge over the scans.
    core_bit_rate: Annotated[
        float, Meta(ge=0.0, le=1e9, description="bit/s from which a link hears the core of an image alone")
    ] = 3_000.0
    # A lit LED that moves makes events all along its bits: at 50 bit/s MAR .28 -> .92 on the site under a flying
    # camera; text at 2 m/s and 504 bit/s .97 -> .99 (160 px/s) and .94 -> .99 (711 px/s), codes at 200 bit/s
    # .94 -> .98; in the sun from 28 m .56 -> .56.
    heart_bit_rate: Annotated[
        float,
        Meta(ge=0.0, le=1e9, description="bit/s up to which text hears an image's heart alone; codes up to twice it"),
    ] = 1_000.0
    # The files and streams do not tell it; an imx636 has none, a DVXplorer Mini 5,000 (VARIABLE_5000).
    scan_rate_hz: Annotated[
        float, Meta(ge=0.0, le=1e6, description="scans a second of the camera, 0 if asynchronous: bounds `frequency`")
    ] = 0.0
    # The design: identifications are refreshed at 10 Hz.
    refresh_us: Annotated[
        int, Meta(ge=1_000, le=60_000_000, description="identifications are refreshed, texts joined, once in it")
    ] = 100_000
    # The paper's tracker runs at 10 Hz.
    tracker_period_us: Annotated[int, Meta(ge=1_000, le=60_000_000, description="statuses are sent once in it")] = (
        100_000
    )
    # A track arrives one to two tracker periods after its birth; two more for a late link.
    backlog_us: Annotated[
        int, Meta(ge=0, le=10_000_000, description="raw events kept for tracks that are yet to come")
    ] = 400_000
    # 0.4 s of 10 Mev/s, the fastest burst of a 1-megapixel sensor: 52 MB.
    backlog_events: Annotated[int, Meta(ge=0, le=100_000_000, description="at most so many events are kept")] = (
        4_000_000
    )
    # Twelve times the paper's twenty beacons; a receiver costs up to 3 % of a core.
    max_tracks: Annotated[int, Meta(ge=1, le=4_096, description="tracks beyond it are dropped, and counted")] = 256
    # Status messages and loss: paper-derived delay_max of a valid track.
    loss_us: Annotated[
        int, Meta(ge=1_000, le=600_000_000, description="an identity that nothing supports for so long is lost")
    ] = 2_000_000
    camera_file: Annotated[str, Meta(description="camera file (TOML) that gives identifications their bearing")] = ""

    def __post_init__(self) -> None:
        nests = (
            ("step_us", self.step_us, "window_us", self.window_us),
            ("window_us", self.window_us, "refresh_us", self.refresh_us),
            ("window_us", self.window_us, "tracker_period_us", self.tracker_period_us),
        )
        for inner, short, outer, long in nests:
            if long % short:
                raise ConfigError(f"{outer} must be a multiple of {inner} = {short}, not {long}")
        if 1_000_000 % self.window_us:
            raise ConfigError(f"window_us must divide 1000000, not {self.window_us}")
        names = [beacon.name for beacon in self.beacons]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ConfigError(f"beacons must have different names, not twice {', '.join(twice)}")
