"""The big streams of a camera, as arrays in memory and on the wire: `Events` (raw), `Onsets` (compact), `Image`.

Events, body on the wire (little-endian, struct of arrays: 8.1 bytes an event)::

    camera str, stream str, width int, height int, t0_us int, t1_us int, end bool,
    n int, dt_us bytes(4 n: u4, t - t0_us),
    x_px bytes(2 n: u2), y_px bytes(2 n: u2), on bytes(ceil(n / 8): bits, LSB first)

Onsets, body on the wire (about 1.2 bytes an active pixel and tick)::

    camera, stream, width, height, t0_us, t1_us, end as above, tick_us int, pool_px int,
    n int, steps int, columns bytes: the n entries of the ticks, packed as `heliograph.onset_columns` says

Image, body on the wire::

    camera, stream, t_us int, width, height, grey bytes: zlib of width x height bytes, row by row from the top

`t1_us` is a watermark: with this message everything before t1_us has been delivered. A message may be empty: it then
says that the camera saw nothing. `stream` names one run of a camera: when it changes, time starts anew.
"""

from __future__ import annotations

import zlib
from typing import Annotated, Any, ClassVar, Final, Self

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from heliograph.events import EventBatch, checked
from heliograph.messages import WINDOW_LIMIT_US, Message, Name, Side, TimeUs
from heliograph.onset_columns import QUICKEST, SMALLEST, pack_columns, unpack_columns

# A message of more events than this is split by the source (10k events are 81 kB); receivers allow what a burst of
# the fastest sensor puts into one window, and refuse beyond.
EVENTS_LIMIT: Final = 4_000_000
TICKS_LIMIT: Final = 65_535
# An entry is one step, and 255 pixels more that are skipped another: ten times what a burst needs.
STEPS_LIMIT: Final = 10 * EVENTS_LIMIT
# What an `Onsets` message takes on a TCP link beside its columns: envelope, head of the body, key and framing of Zenoh
# (331 to 357 counted by a proxy, both ways).
OVERHEAD_BYTES: Final = 350
# Of images: the fastest level.
ZLIB_LEVEL: Final = 1

# Of an image: 4 MB; event cameras on sale have 1 Mpx at most.
IMAGE_LIMIT_PX: Final = 4_194_304

Counts = npt.NDArray[np.uint8]
Grey = npt.NDArray[np.uint8]


class _Window(msgspec.Struct, frozen=True, kw_only=True):
    """The fields that both bodies share."""

    camera: Name
    stream: Name
    width: Side
    height: Side
    t0_us: TimeUs
    t1_us: TimeUs
    end: bool

    def check(self) -> None:
        if not 0 <= self.t1_us - self.t0_us <= WINDOW_LIMIT_US:
            raise ValueError(f"window [{self.t0_us}, {self.t1_us}) must be 0 to {WINDOW_LIMIT_US} us long")


class _EventsBody(_Window, frozen=True, kw_only=True):
    n: Annotated[int, Meta(ge=0, le=EVENTS_LIMIT)]
    dt_us: bytes
    x_px: bytes
    y_px: bytes
    on: bytes


class _OnsetsBody(_Window, frozen=True, kw_only=True):
    tick_us: Annotated[int, Meta(ge=1, le=1_000_000)]
    pool_px: Annotated[int, Meta(ge=1, le=64)]
    n: Annotated[int, Meta(ge=0, le=EVENTS_LIMIT)]
    steps: Annotated[int, Meta(ge=0, le=STEPS_LIMIT)]
    columns: bytes


class _ImageBody(msgspec.Struct, frozen=True, kw_only=True):
    camera: Name
    stream: Name
    t_us: TimeUs
    width: Side
    height: Side
    grey: bytes


def inflated(packed: bytes, wanted: int) -> bytes:
    """Return zlib-packed columns; at most one byte more than wanted is ever unpacked.

    Raises:
        ValueError: they are damaged, or of another length.
    """
    unpacker = zlib.decompressobj()
    try:
        raw = unpacker.decompress(packed, wanted + 1)
    except zlib.error as error:
        raise ValueError(f"columns are no zlib stream: {error}") from None
    if len(raw) != wanted or not unpacker.eof or unpacker.unused_data:
        raise ValueError(f"columns must unpack to {wanted} bytes, not {len(raw)}{'' if unpacker.eof else ' or more'}")
    return raw


def _array(name: str, raw: bytes, dtype: str, n: int) -> npt.NDArray[Any]:
    wanted = n * np.dtype(dtype).itemsize
    if len(raw) != wanted:
        raise ValueError(f"{name} must have {wanted} bytes for {n} entries, not {len(raw)}")
    return np.frombuffer(raw, dtype)


class Events(Message, frozen=True, kw_only=True):
    """Raw events of one window [t0_us, t1_us) of a camera of width x height pixels."""

    SCHEMA: ClassVar[str] = "events"
    camera: str
    stream: str
    width: int
    height: int
    t0_us: int
    t1_us: int
    batch: EventBatch
    end: bool = False

    def to_body(self) -> dict[str, Any]:
        """Return the body of the module's table."""
        b = self.batch
        head = {name: getattr(self, name) for name in _Window.__struct_fields__}
        return head | {
            "n": len(b),
            "dt_us": (b.t_us - self.t0_us).astype("<u4").tobytes(),
            "x_px": b.x_px.astype("<u2", copy=False).tobytes(),
            "y_px": b.y_px.astype("<u2", copy=False).tobytes(),
            "on": np.packbits(b.on, bitorder="little").tobytes(),
        }

    @classmethod
    def from_body(cls, body: dict[str, Any]) -> Self:
        """Return the record of a body, checked: order, range and the window.

        Raises:
            ValueError: the body breaks the module's table.
        """
        raw = msgspec.convert(body, _EventsBody, strict=True)
        raw.check()
        bits = _array("on", raw.on, "u1", (raw.n + 7) // 8)
        t_us = _array("dt_us", raw.dt_us, "<u4", raw.n).astype(np.int64)
        t_us += raw.t0_us
        # Arrays that may be written, so that kernels know them; the bits are bytes of 0 and 1 already.
        batch = EventBatch(
            t_us,
            _array("x_px", raw.x_px, "<u2", raw.n).astype(np.uint16),
            _array("y_px", raw.y_px, "<u2", raw.n).astype(np.uint16),
            np.unpackbits(bits, count=raw.n, bitorder="little").view(np.bool_),
        )
        checked(batch, raw.width, raw.height)
        # The last event may lie on the watermark: a window of more than the source's limit is split there.
        if raw.n and batch.t_us[-1] > raw.t1_us:
            raise ValueError(f"event at {batch.t_us[-1]} us lies behind the window's end {raw.t1_us} us")
        return cls(
            camera=raw.camera,
            stream=raw.stream,
            width=raw.width,
            height=raw.height,
            t0_us=raw.t0_us,
            t1_us=raw.t1_us,
            batch=batch,
            end=raw.end,
        )

    @property
    def time_us(self) -> int:
        """The watermark."""
        return self.t1_us


class Onsets(Message, frozen=True, kw_only=True):
    """The active pixels of whole ticks of a window, gated and pooled at the source.

    Args:
        tick_us: length of a tick; t0_us and t1_us are multiples of it.
        pool_px: side of the square of sensor pixels that one entry stands for; x_px, y_px count such squares.
        tick: (n,) uint16, not falling: an entry's tick, counted from t0_us.
        x_px: (n,) uint16.
        y_px: (n,) uint16; within a tick, entries rise by (y, x).
        on_count: (n,) uint8, events that became brighter; on the wire 15 means 15 or more.
        off_count: (n,) uint8, events that became darker.
        zipped: number of steps and packed columns, where they are known already; see `packed`.
    """

    SCHEMA: ClassVar[str] = "onsets"
    VERSION: ClassVar[tuple[int, int]] = (2, 0)
    camera: str
    stream: str
    width: int
    height: int
    t0_us: int
    t1_us: int
    tick_us: int
    pool_px: int
    tick: npt.NDArray[np.uint16]
    x_px: npt.NDArray[np.uint16]
    y_px: npt.NDArray[np.uint16]
    on_count: Counts
    off_count: Counts
    end: bool = False
    zipped: tuple[int, bytes] | None = None

    @property
    def ticks(self) -> int:
        """The number of whole ticks in the window."""
        return (self.t1_us - self.t0_us) // self.tick_us

    def to_body(self) -> dict[str, Any]:
        """Return the body of the module's table.

        Raises:
            ValueError: a tick has more than 65535 entries, or they do not rise.
        """
        head = {name: getattr(self, name) for name in _Window.__struct_fields__}
        steps, columns = self.zipped or self._zip(QUICKEST)
        n = len(self.tick)
        return head | {"tick_us": self.tick_us, "pool_px": self.pool_px, "n": n, "steps": steps, "columns": columns}

    def packed(self) -> Onsets:
        """Return this record with its columns packed as for a slow link, once; raises as `to_body`."""
        return msgspec.structs.replace(self, zipped=self._zip(SMALLEST))

    def _zip(self, level: int) -> tuple[int, bytes]:
        per_tick = np.bincount(self.tick, minlength=self.ticks)
        row = -(-self.width // self.pool_px)
        return pack_columns(per_tick, self.x_px, self.y_px, self.on_count, self.off_count, row, level)

    @classmethod
    def from_body(cls, body: dict[str, Any]) -> Self:
        """Return the record of a body, checked: whole ticks, sums, range.

        Raises:
            ValueError: the body breaks the module's table.
        """
        raw = msgspec.convert(body, _OnsetsBody, strict=True)
        raw.check()
        span = raw.t1_us - raw.t0_us
        if span % raw.tick_us or raw.t0_us % raw.tick_us or span // raw.tick_us > TICKS_LIMIT:
            raise ValueError(f"window [{raw.t0_us}, {raw.t1_us}) must hold whole ticks of {raw.tick_us} us")
        ticks = span // raw.tick_us
        columns = inflated(raw.columns, 2 * ticks + raw.n + raw.steps)
        row, rows = -(-raw.width // raw.pool_px), -(-raw.height // raw.pool_px)
        per_tick, x_px, y_px, on_count, off_count = unpack_columns(columns, ticks, raw.n, row, rows)
        return cls(
            camera=raw.camera,
            stream=raw.stream,
            width=raw.width,
            height=raw.height,
            t0_us=raw.t0_us,
            t1_us=raw.t1_us,
            tick_us=raw.tick_us,
            pool_px=raw.pool_px,
            tick=np.repeat(np.arange(len(per_tick), dtype=np.uint16), per_tick),
            x_px=x_px,
            y_px=y_px,
            on_count=on_count,
            off_count=off_count,
            end=raw.end,
        )

    @property
    def time_us(self) -> int:
        """The watermark."""
        return self.t1_us


class Image(Message, frozen=True, kw_only=True):
    """What a camera sees at t_us as a grey image, for people to look at; no service decides anything by it.

    Args:
        stream: the run of the camera that it belongs to.
        grey: (height, width) uint8, row 0 at the top.
    """

    SCHEMA: ClassVar[str] = "image"
    camera: str
    stream: str
    t_us: int
    grey: Grey

    @property
    def width(self) -> int:
        """The number of columns."""
        return int(self.grey.shape[1])

    @property
    def height(self) -> int:
        """The number of rows."""
        return int(self.grey.shape[0])

    def to_body(self) -> dict[str, Any]:
        """Return the body of the module's table."""
        return {
            "camera": self.camera,
            "stream": self.stream,
            "t_us": self.t_us,
            "width": self.width,
            "height": self.height,
            "grey": zlib.compress(np.ascontiguousarray(self.grey).tobytes(), ZLIB_LEVEL),
        }

    @classmethod
    def from_body(cls, body: dict[str, Any]) -> Self:
        """Return the record of a body, checked.

        Raises:
            ValueError: the body breaks the module's table, or has more than IMAGE_LIMIT_PX pixels.
        """
        raw = msgspec.convert(body, _ImageBody, strict=True)
        n = raw.width * raw.height
        if n > IMAGE_LIMIT_PX:
            raise ValueError(f"an image has at most {IMAGE_LIMIT_PX} pixels, not {raw.width}x{raw.height}")
        grey = np.frombuffer(inflated(raw.grey, n), np.uint8).reshape(raw.height, raw.width)
        return cls(camera=raw.camera, stream=raw.stream, t_us=raw.t_us, grey=grey)

    @property
    def time_us(self) -> int:
        """The time of the view."""
        return self.t_us
