"""The records that services exchange: one class a schema, the same in memory and on the bus.

Every record is frozen and checked when it is made from the wire (`heliograph.wire`). Times are camera microseconds.
Small things travel as columns of plain lists, so that a client needs only msgpack; events and onsets travel as
little-endian arrays (layouts in `docs/wire.md`). `SCHEMA` is also the topic: the word after the site in the key.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Literal

import msgspec
from msgspec import Meta

from heliograph.errors import Refusal

# 2**53 us are 285 years: beyond it a float64 no longer holds every microsecond.
TIME_LIMIT_US: Final = 2**53
# Longest window one message may cover: an hour. A longer one is a damaged number, not a quiet camera.
WINDOW_LIMIT_US: Final = 3_600_000_000
# Widest sensor on sale is 1280 px; room for the next ones, none for a damaged number that would ask for gigabytes.
SENSOR_LIMIT_PX: Final = 4096

TimeUs = Annotated[int, Meta(ge=-TIME_LIMIT_US, le=TIME_LIMIT_US)]
Count = Annotated[int, Meta(ge=0, le=TIME_LIMIT_US)]
Side = Annotated[int, Meta(ge=1, le=SENSOR_LIMIT_PX)]
# A chunk of a key: what keys.py lets through.
Name = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.:-]*$")]
Finite = Annotated[float, Meta(ge=-1e12, le=1e12)]
Positive = Annotated[float, Meta(ge=0.0, le=1e12)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
# The widest payload of any modulation is 32 bits; 63 leave room for what is to come (msgspec checks no wider bound).
Payload = Annotated[int, Meta(ge=0, le=2**63 - 1)]
# "seed11/42": the longest protocol's name, a stroke and nineteen digits fit.
Token = Annotated[str, Meta(min_length=1, max_length=80)]
StatusWord = Literal["new", "valid", "invalid"]
Change = Literal["accepted", "changed", "duplicate", "refreshed", "lost"]
Bearing = tuple[Finite, Finite, Finite]

_REFUSAL_NAMES: Final = frozenset(reason.value for reason in Refusal)


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """What all records have in common: a schema and its version."""

    SCHEMA: ClassVar[str]
    VERSION: ClassVar[tuple[int, int]] = (1, 0)

    def to_body(self) -> dict[str, Any]:
        """Return the body for the wire: plain values, fields in the order of their definition."""
        body: dict[str, Any] = msgspec.to_builtins(self)
        return body

    @classmethod
    def from_body(cls, body: dict[str, Any]) -> Message:
        """Return the record of a body.

        Raises:
            ValueError: a field is missing, of another type, or out of range (msgspec.ValidationError included).
        """
        return msgspec.convert(body, cls, strict=True)

    @property
    def time_us(self) -> int:
        """The camera time that the envelope carries; 0 where the record has none."""
        return 0


def same_length(record: msgspec.Struct, *columns: str) -> int:
    """Return the common length of the columns.

    Raises:
        ValueError: two columns differ in length.
    """
    n = len(getattr(record, columns[0]))
    for name in columns:
        if len(getattr(record, name)) != n:
            raise ValueError(f"columns differ in length: { {name: len(getattr(record, name)) for name in columns} }")
    return n


class Tracks(Message, frozen=True, kw_only=True):
    """All tracks of a camera at one instant; a track that is missing has ended.

    `period_us` is the tracker's period: messages are sent for its multiples and, live, between them for the moment at
    which a track is born or names change. `seen_us` is the time of the last target assigned to the track, `born_us`
    of its first event. Position, velocity and their covariance (the axes are independent: P_xx, P_xv, P_vv of x, then
    of y) are the Kalman state at as_of_us; `radius_px` covers nine tenths of the target's pixels; `polarity` is the
    mean of +1 and -1.
    """

    SCHEMA: ClassVar[str] = "tracks"
    camera: Name
    as_of_us: TimeUs
    period_us: Annotated[int, Meta(ge=1, le=WINDOW_LIMIT_US)]
    track: list[Name]
    born_us: list[TimeUs]
    seen_us: list[TimeUs]
    x_px: list[Finite]
    y_px: list[Finite]
    vx_px_s: list[Finite]
    vy_px_s: list[Finite]
    x_var_px2: list[Positive]
    x_vx_cov_px2_s: list[Finite]
    vx_var_px2_s2: list[Positive]
    y_var_px2: list[Positive]
    y_vy_cov_px2_s: list[Finite]
    vy_var_px2_s2: list[Positive]
    radius_px: list[Positive]
    size_px: list[Positive]
    polarity: list[Annotated[float, Meta(ge=-1.0, le=1.0)]]
    status: list[StatusWord]

    def __post_init__(self) -> None:
        same_length(self, *self.__struct_fields__[3:])
        if len(set(self.track)) != len(self.track):
            raise ValueError("a track is named twice")

    @property
    def time_us(self) -> int:
        """The instant of the states."""
        return self.as_of_us


class Status(Message, frozen=True, kw_only=True):
    """What the decoder thinks of each track at one instant.

    `accepted_us` is the last accepted frame's end or -1. `identity` is a token of the identity that the decoder holds
    for the track, None without: equal tokens are, as far as the code can tell, the same beacon. Nothing else may be
    read from it.
    """

    SCHEMA: ClassVar[str] = "status"
    camera: Name
    as_of_us: TimeUs
    track: list[Name]
    status: list[StatusWord]
    accepted_us: list[TimeUs]
    identity: list[Token | None]

    def __post_init__(self) -> None:
        same_length(self, "track", "status", "accepted_us", "identity")

    @property
    def time_us(self) -> int:
        """The instant of the statuses."""
        return self.as_of_us


class Frames(Message, frozen=True, kw_only=True):
    """Frames decided in a window, in the order of (t_us, track), and what was refused in it, by reason.

    `beacon` is the name from the site file or None; `score` the frame's confidence, 0 to 1, from its own bits alone.
    """

    SCHEMA: ClassVar[str] = "frames"
    camera: Name
    t0_us: TimeUs
    t1_us: TimeUs
    t_us: list[TimeUs]
    track: list[Name]
    protocol: list[Name]
    beacon: list[Name | None]
    payload: list[Payload]
    x_px: list[Finite]
    y_px: list[Finite]
    score: list[Share]
    refused: dict[str, Count] = {}

    def __post_init__(self) -> None:
        same_length(self, "t_us", "track", "protocol", "beacon", "payload", "x_px", "y_px", "score")
        if self.refused and (unknown := self.refused.keys() - _REFUSAL_NAMES):
            raise ValueError(f"unknown reasons of refusal: {sorted(unknown)}")

    @property
    def time_us(self) -> int:
        """The end of the window."""
        return self.t1_us


class Identification(Message, frozen=True, kw_only=True):
    """A track's beacon: a state, sent on acceptance, change and loss, and refreshed at 10 Hz between.

    It is not refreshed while the track's region may follow another light: when a frame of another payload, or none of
    its own for three frames, has been read there.
    `beacon` is the name from the site file; a beacon that the site does not list is called PROTOCOL:PAYLOAD.
    `payload` is None where identity is not in the bits (text). `bearing` is a unit vector in the camera's frame.
    `margin` is the log-likelihood distance to the runner-up, `frames_used` the frames it rests on.
    `duplicates` names the tracks that hold the same identity elsewhere on the sensor at this time: two beacons with one
    ID, or a mirror. With the first message that names another one, `change` is "duplicate".
    """

    SCHEMA: ClassVar[str] = "ids"
    VERSION: ClassVar[tuple[int, int]] = (1, 1)
    camera: Name
    track: Name
    t_us: TimeUs
    since_us: TimeUs
    protocol: Name
    beacon: Name
    payload: Payload | None
    x_px: Finite
    y_px: Finite
    vx_px_s: Finite
    vy_px_s: Finite
    bearing: Bearing | None
    confidence: Share
    margin: Finite
    frames_used: Count
    change: Change
    lost: bool
    duplicates: list[Name] = []

    @property
    def time_us(self) -> int:
        """The time of the state."""
        return self.t_us


class Data(Message, frozen=True, kw_only=True):
    """Data that a beacon sent: text, or bytes. Joined in order, the texts of a track are what was sent."""

    SCHEMA: ClassVar[str] = "messages"
    camera: Name
    track: Name
    t_us: TimeUs
    protocol: Name
    beacon: Name | None
    text: str | None
    data: bytes | None

    def __post_init__(self) -> None:
        if (self.text is None) == (self.data is None):
            raise ValueError("exactly one of text and data must be given")

    def to_body(self) -> dict[str, Any]:
        """Return the body; bytes stay bytes."""
        return {name: getattr(self, name) for name in self.__struct_fields__}

    @property
    def time_us(self) -> int:
        """The end of the last character."""
        return self.t_us


class Link(Message, frozen=True, kw_only=True):
    """How well a track is read, over the last second; None where it is not known yet."""

    SCHEMA: ClassVar[str] = "link"
    camera: Name
    track: Name
    t_us: TimeUs
    protocol: Name
    bit_rate: Positive
    snr_db: Finite | None
    jitter_us: Positive | None
    clock_ppm: Finite | None
    events_per_transition: Positive | None
    mar_estimate: Share | None

    @property
    def time_us(self) -> int:
        """The end of the second."""
        return self.t_us


class Progress(Message, frozen=True, kw_only=True):
    """A service has finished all input of a camera before t_us, and published what follows from it.

    `published` counts what the sender had published until then, by topic: keys of different priority overtake one
    another, and a reader knows from it whether it holds all that came before.
    """

    SCHEMA: ClassVar[str] = "progress"
    VERSION: ClassVar[tuple[int, int]] = (1, 1)
    camera: Name
    service: Name
    t_us: TimeUs
    done: bool = False
    published: Annotated[dict[Name, Count], Meta(max_length=64)] = {}

    @property
    def time_us(self) -> int:
        """The time that is finished."""
        return self.t_us


class Health(Message, frozen=True, kw_only=True):
    """What a process says of itself once a second: alive and working, alive and starved, or alive and stuck."""

    SCHEMA: ClassVar[str] = "health"
    service: Name
    instance: Name
    pid: Count
    state: Literal["warming", "running", "starved", "stuck", "stopping"]
    uptime_s: Positive
    input_age_s: Positive | None
    cpu_share: Positive
    counters: dict[str, Count]
    gauges: dict[str, Finite]


class Metrics(Message, frozen=True, kw_only=True):
    """Aggregates of the metrics sink over a window of camera time."""

    SCHEMA: ClassVar[str] = "metrics"
    service: Name
    instance: Name
    t0_us: TimeUs
    t1_us: TimeUs
    counters: dict[str, Count]
    gauges: dict[str, Finite]

    @property
    def time_us(self) -> int:
        """The end of the window."""
        return self.t1_us


class Clock(Message, frozen=True, kw_only=True):
    """Where the camera's clock stands against the host's: wall = camera + offset, at t_us, give or take uncertainty."""

    SCHEMA: ClassVar[str] = "clock"
    camera: Name
    t_us: TimeUs
    offset_us: TimeUs
    drift_ppm: Finite
    uncertainty_us: Positive

    @property
    def time_us(self) -> int:
        """The time of the comparison."""
        return self.t_us
