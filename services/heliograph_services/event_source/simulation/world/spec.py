"""What a scenario file may say: its tables, their units and ranges. Data alone; `load.py` reads it.

World frame: x east, y north, z up, metres; the ground is z = 0. Camera frame: x right, y down, z forward. A camera with
yaw 0, pitch -90, roll 0 looks straight down with north up in its image; yaw turns clockwise seen from above, pitch
lifts the axis above the horizon, roll turns the camera clockwise about its axis::

    forward = (sin yaw cos pitch, cos yaw cos pitch, sin pitch)
    right   = cos roll r + sin roll d,  r = (cos yaw, -sin yaw, 0),  d = forward x r
    down    = forward x right

Light is given as a photographer or an electrician would: W/sr of an emitter, W/m2 on the ground, within the camera's
band. Times in a file are seconds where people choose them (paths) and microseconds where a signal counts them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from heliograph.messages import Name, Payload
from heliograph.units import BIT_RATE_MAX, BIT_RATE_MIN

Metres = Annotated[float, Meta(ge=-10_000.0, le=10_000.0)]
Size = Annotated[float, Meta(gt=0.0, le=1_000.0)]
Point = tuple[Metres, Metres, Metres]
Degrees = Annotated[float, Meta(ge=-720.0, le=720.0)]
Seconds = Annotated[float, Meta(gt=0.0, le=100_000.0)]
Speed = Annotated[float, Meta(gt=0.0, le=1_000.0)]


# ---- paths: where a thing is at any time; `trajectory.py` computes them ----------------------------------------------


class Still(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="still"):
    """No motion."""

    at_m: Point


class Sine(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="sine"):
    """``x(t) = at + amplitude sin(2 pi t / period + phase)`` on each axis."""

    at_m: Point
    amplitude_m: Point
    period_s: tuple[Seconds, Seconds, Seconds]
    phase_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)


class Circle(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="circle"):
    """A horizontal circle: ``centre + radius (sin a, cos a)``, a = phase + 2 pi turns(t), north at a = 0.

    One turn takes turn_s, clockwise seen from above where that is positive. With fastest_turn_s the speed rises
    evenly from one turn in turn_s to one in fastest_turn_s over ramp_s, falls back over as long, and so on.
    """

    centre_m: Point
    radius_m: Size
    turn_s: Annotated[float, Meta(ge=-100_000.0, le=100_000.0)]
    phase_deg: Degrees = 0.0
    fastest_turn_s: Annotated[float, Meta(ge=-100_000.0, le=100_000.0)] | None = None
    ramp_s: Seconds = 10.0

    def __post_init__(self) -> None:
        # A millisecond a turn: an image on it would be anywhere between two nodes.
        for name, value in (("turn_s", self.turn_s), ("fastest_turn_s", self.fastest_turn_s)):
            if value is not None and abs(value) < 1e-3:
                raise ValueError(f"{name} must be at least 0.001 or at most -0.001, not {value:g}")


class Shuttle(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="shuttle"):
    """To and fro between two points at one speed; it turns round within turn_s, with constant acceleration.

    It stands at from_m until start_s, then sets off with that acceleration.
    """

    from_m: Point
    to_m: Point
    speed_m_s: Speed
    turn_s: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.2
    start_s: Annotated[float, Meta(ge=0.0, le=100_000.0)] = 0.0

    def __post_init__(self) -> None:
        length_m = sum((b - a) ** 2 for a, b in zip(self.from_m, self.to_m, strict=True)) ** 0.5
        if length_m <= 0.0:
            raise ValueError(f"to_m must differ from from_m, not be {list(self.to_m)} too")
        # Half a turn at each end covers speed turn_s / 4.
        if self.turn_s > 2.0 * length_m / self.speed_m_s:
            raise ValueError(
                f"turn_s must be at most {2.0 * length_m / self.speed_m_s:g}"
                f" (2 |to_m - from_m| / speed_m_s), not {self.turn_s:g}"
            )


class Waypoints(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="waypoints"
):
    """Straight lines between (t_s, x, y, z), corners rounded over smooth_s, begun anew after the last point.

    The last point should be where the first is; where it is not, the thing jumps.
    """

    points: Annotated[
        tuple[tuple[Annotated[float, Meta(ge=0.0, le=100_000.0)], Metres, Metres, Metres], ...],
        Meta(min_length=2, max_length=10_000),
    ]
    smooth_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 0.0

    def __post_init__(self) -> None:
        rising([point[0] for point in self.points])


def rising(times_s: list[float]) -> None:
    """Check the times of points.

    Raises:
        ValueError: they do not begin at 0 or do not rise.
    """
    if times_s[0] != 0.0:
        raise ValueError(f"points must begin at 0 s, not {times_s[0]:g}")
    for a, b in pairwise(times_s):
        if b - a < 1e-3:
            raise ValueError(f"points must rise in time by at least 0.001 s each, not go from {a:g} to {b:g} s")


Path = Still | Sine | Circle | Shuttle | Waypoints


class Attitude(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the camera looks: angles, and how they turn.

    `yaw_deg + yaw_rate_deg_s t + yaw_swing_deg sin(2 pi t / yaw_swing_s)`; points (t_s, yaw, pitch, roll) instead make
    straight lines between them, rounded over smooth_s, begun anew after the last (a difference of whole turns between
    the last and the first is no jump).
    """

    yaw_deg: Degrees = 0.0
    pitch_deg: Degrees = -90.0
    roll_deg: Degrees = 0.0
    yaw_rate_deg_s: Annotated[float, Meta(ge=-1_000.0, le=1_000.0)] = 0.0
    yaw_swing_deg: Degrees = 0.0
    yaw_swing_s: Seconds = 10.0
    points: Annotated[
        tuple[tuple[Annotated[float, Meta(ge=0.0, le=100_000.0)], Degrees, Degrees, Degrees], ...],
        Meta(max_length=10_000),
    ] = ()
    smooth_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 0.0

    def __post_init__(self) -> None:
        if not self.points:
            return
        if len(self.points) < 2:
            raise ValueError("points must be at least 2, not 1")
        rising([point[0] for point in self.points])
        if (self.yaw_deg, self.pitch_deg, self.roll_deg, self.yaw_rate_deg_s, self.yaw_swing_deg) != (0, -90, 0, 0, 0):
            raise ValueError("points must stand alone: they give yaw, pitch and roll themselves")


class Shake(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Tremor of a hand or of rotors: band-limited noise on the three angles."""

    rms_deg: Annotated[float, Meta(ge=0.0, le=10.0)]
    low_hz: Annotated[float, Meta(gt=0.0, le=500.0)] = 1.0
    high_hz: Annotated[float, Meta(gt=0.0, le=500.0)] = 10.0

    def __post_init__(self) -> None:
        if self.low_hz > self.high_hz:
            raise ValueError(f"high_hz must be at least low_hz, {self.low_hz:g}, not {self.high_hz:g}")


# ---- the camera ------------------------------------------------------------------------------------------------------


class Lens(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A lens: f, D = f / N, and how sharp it is.

    Defaults: the camera of the paper (3.6 mm); f/2.0, point spread and transmission are assumed.
    """

    focal_mm: Annotated[float, Meta(ge=0.5, le=1_000.0)] = 3.6
    f_number: Annotated[float, Meta(ge=0.7, le=64.0)] = 2.0
    transmission: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.9
    psf_sigma_px: Annotated[float, Meta(ge=0.3, le=20.0)] = 0.7
    # None: everything is in focus.
    focus_m: Annotated[float, Meta(gt=0.0, le=100_000.0)] | None = None


class CameraSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The camera: a sensor's preset, a lens, a path."""

    # A preset's name, or a TOML file.
    sensor: str = "dvxplorer_mini"
    # Of the preset's read-out modes; empty: the preset's default.
    mode: str = ""
    # Numbers of the preset to be changed: "pixel.threshold_on" = 0.25
    override: dict[str, float | str] = {}
    lens: Lens = Lens()
    path: Path = Still(at_m=(0.0, 0.0, 5.0))
    attitude: Attitude = Attitude()
    shake: Shake | None = None


# ---- the surroundings ------------------------------------------------------------------------------------------------


class Ground(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The plane z = 0, everywhere. `plain` has no texture; the others differ in grain and contrast."""

    texture: Literal["plain", "asphalt", "site", "boards"] = "plain"
    reflectance: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.25
    # Ratio of the reflectances of its bright and dark spots (one standard deviation up and down).
    contrast: Annotated[float, Meta(ge=1.0, le=10.0)] = 1.5
    # Size of its largest patches.
    grain_m: Size = 1.0


class Mains(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A lamp on the mains that lights a rectangle of the ground: ``E (1 + depth sin(2 pi f t + phase))``."""

    centre_m: tuple[Metres, Metres]
    size_m: tuple[Size, Size]
    irradiance_w_m2: Annotated[float, Meta(gt=0.0, le=10_000.0)]
    # Of the light, twice the mains': 100 or 120.
    frequency_hz: Annotated[float, Meta(ge=10.0, le=1_000.0)] = 100.0
    depth: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.3
    phase_deg: Degrees = 0.0


class Asset(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A thing with a flat top that lies or moves about (package, worker, crane); it hides what is below it.

    Its path is that of the centre of its top; heading_deg turns it as yaw does.
    """

    name: Name
    path: Path
    size_m: tuple[Size, Size]
    heading_deg: Degrees = 0.0
    reflectance: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.4


# ---- lights ----------------------------------------------------------------------------------------------------------


class Emitter(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What any light has: strength, size, and where it is.

    Args:
        intensity_w_sr: on its axis, while lit.
        diameter_m: of the disc that shines.
        leds: offsets (x, y, m) of several discs of that diameter, each with its share of the intensity; none: one disc.
        half_angle_deg: off its axis, at which the intensity is half (``cos^m``); none: the same everywhere.
        axis: direction of the axis in the world; up.
        path: of its centre; or
        carried_by: the asset that carries it, at
        offset_m: from the centre of the asset's top, in the asset's own directions.
    """

    name: Name
    intensity_w_sr: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 0.4
    diameter_m: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.02
    leds: Annotated[tuple[tuple[Metres, Metres], ...], Meta(max_length=64)] = ()
    half_angle_deg: Annotated[float, Meta(ge=1.0, lt=90.0)] | None = None
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    path: Path | None = None
    carried_by: str = ""
    offset_m: Point = (0.0, 0.0, 0.02)

    def __post_init__(self) -> None:
        if (self.path is None) == (not self.carried_by):
            raise ValueError(f"{self.name} must have either path or carried_by")
        if sum(a * a for a in self.axis) < 1e-12:
            raise ValueError(f"axis must have a direction, not be {list(self.axis)}")


class BeaconSpec(Emitter, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A beacon: a light that sends.

    Args:
        protocol: a row of `heliograph.link.modulations`.
        bit_rate: bits a second.
        options: of the modulation.
        payload: what it sends, over and over; or
        text: what it sends, over and over: a frame a character, or a message a line where the protocol has messages
            (then with the payload as its address); or
        fresh: a new safe payload for every frame, drawn from the seed; or
        edges: a file of edges (`t_ns,level`), a FIFO or a pty among them, from real firmware.
        gap_bits: bits of the last level between two rounds.
        start_us: when a round begins; before, it sends the same.
        clock_ppm: its clock runs so much too fast.
        jitter_us: standard deviation of each edge's time.
    """

    protocol: Name
    bit_rate: Annotated[float, Meta(ge=BIT_RATE_MIN, le=BIT_RATE_MAX)]
    options: dict[str, str | int] = {}
    payload: Payload | None = None
    text: Annotated[str, Meta(min_length=1, max_length=10_000)] | None = None
    fresh: bool = False
    edges: str = ""
    gap_bits: Annotated[int, Meta(ge=0, le=100_000)] = 0
    start_us: Annotated[float, Meta(ge=0.0, le=1e9)] = 0.0
    clock_ppm: Annotated[float, Meta(ge=-100_000.0, le=100_000.0)] = 0.0
    jitter_us: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        says = self.payload is not None or self.text is not None
        if sum((says, self.fresh, bool(self.edges))) != 1:
            raise ValueError(f"beacon {self.name} must have one of payload, text, fresh, edges")


class Bits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="bits"):
    """Random bits on a clock."""

    bit_rate: Annotated[float, Meta(ge=1.0, le=BIT_RATE_MAX)]


class Telegraph(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="telegraph"
):
    """On and off for times that are exponentially distributed."""

    mean_on_s: Seconds
    mean_off_s: Seconds


class Pwm(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="pwm"):
    """On for a share of each period."""

    frequency_hz: Annotated[float, Meta(ge=0.1, le=50_000.0)]
    duty: Annotated[float, Meta(gt=0.0, lt=1.0)] = 0.5


class Lamp(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="lamp"):
    """A lamp on the mains: ``(1 + depth sin(2 pi f t)) / (1 + depth)``, in small steps."""

    frequency_hz: Annotated[float, Meta(ge=10.0, le=1_000.0)] = 100.0
    depth: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.5


class Glint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="glint"):
    """Flashes of the sun on water or metal: at random, each of a random length about mean_us."""

    rate_hz: Annotated[float, Meta(gt=0.0, le=10_000.0)]
    mean_us: Annotated[float, Meta(gt=0.0, le=1e6)] = 2_000.0


class Steady(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="steady"):
    """Always on."""


Signal = Bits | Telegraph | Pwm | Lamp | Glint | Steady


class ClutterSpec(Emitter, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A light that is no beacon: lamps, reflections, the paper's noise beacons."""

    signal: Signal


class Crowd(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Many beacons, spread over an area without touching, each moving to and fro on its own ellipse, each with an ID.

    The names are prefix000, prefix001 ...; the payloads are evenly spread over those that the modulation can send and
    advises to send. area_m is (x_min, y_min, x_max, y_max), on the ground; the LEDs are z_m above it.
    """

    prefix: Annotated[str, Meta(pattern="^[a-z][a-z0-9_]{0,31}$")] = "b"
    count: Annotated[int, Meta(ge=1, le=500)]
    protocol: Name
    bit_rate: Annotated[float, Meta(ge=BIT_RATE_MIN, le=BIT_RATE_MAX)]
    options: dict[str, str | int] = {}
    fresh: bool = False
    area_m: tuple[Metres, Metres, Metres, Metres]
    speed_m_s: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0
    intensity_w_sr: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 0.4
    diameter_m: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.02
    z_m: Annotated[float, Meta(ge=0.0, le=10_000.0)] = 0.02

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.area_m
        if x1 <= x0 or y1 <= y0:
            raise ValueError(f"area_m must be [x_min, y_min, x_max, y_max], not {list(self.area_m)}")


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scene. irradiance_w_m2 is that of the whole ground; `[[mains]]` adds to it."""

    about: str = ""
    # How long its story is; it may be run for shorter or longer.
    duration_s: Seconds = 60.0
    irradiance_w_m2: Annotated[float, Meta(ge=0.0001, le=2_000.0)] = 2.0
    camera: CameraSpec = CameraSpec()
    ground: Ground = Ground()
    mains: Annotated[tuple[Mains, ...], Meta(max_length=16)] = ()
    assets: Annotated[tuple[Asset, ...], Meta(max_length=200)] = msgspec.field(name="asset", default=())
    beacons: Annotated[tuple[BeaconSpec, ...], Meta(max_length=500)] = msgspec.field(name="beacon", default=())
    clutter: Annotated[tuple[ClutterSpec, ...], Meta(max_length=500)] = ()
    crowds: Annotated[tuple[Crowd, ...], Meta(max_length=16)] = msgspec.field(name="crowd", default=())
