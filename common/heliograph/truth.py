"""What was really there: known to a simulator alone, read by whoever scores, never by a receiver.

The record and its key live here and only here; the simulation, the metrics sink, the viewer and the command line may
import this module, a tracker or a decoder may not (import-linter keeps it so).

The LEDs' edges are many (3600 a second of five beacons at 1 kbit/s), so they travel packed, as onsets do; body on the
wire: the fields of the record, and instead of its columns `edge_*`::

    edge_n int, edges bytes: zlib of, one after another,
        per_beacon 4 k: u4, edges of each of the k beacons; their sum is n
        dt 4 n: u4, tenths of a microsecond since the beacon's edge before; of its first, since t0_us
        on ceil(n / 8): bits, LSB first
"""

from __future__ import annotations

import zlib
from typing import Annotated, Any, ClassVar, Final, Literal, Self

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from heliograph.events import Flags
from heliograph.messages import Finite, Message, Name, Payload, TimeUs, same_length
from heliograph.streams import ZLIB_LEVEL, inflated

Fidelity = Literal["full", "live"]

# A window of 50 ms of 500 beacons at 20 kbit/s has half as many; a damaged number cannot ask for more than 10 MB.
EDGES_LIMIT: Final = 1_000_000
# An edge's time is told to a tenth of a microsecond: a hundredth of the fastest bit.
TENTHS: Final = 10


class _Columns(Message, frozen=True, kw_only=True):
    """The fields that record and body share."""

    SCHEMA: ClassVar[str] = "truth"
    camera: Name
    t0_us: TimeUs
    t1_us: TimeUs
    sensor: Name
    fidelity: Fidelity
    beacon: list[Name]
    protocol: list[Name]
    x_px: list[Finite]
    y_px: list[Finite]
    radius_px: list[Finite]
    x_m: list[Finite]
    y_m: list[Finite]
    z_m: list[Finite]
    in_view: list[bool]
    visible: list[bool]
    frame_beacon: list[int]
    frame_t0_us: list[TimeUs]
    frame_t1_us: list[TimeUs]
    frame_payload: list[Payload]
    frame_x_px: list[Finite]
    frame_y_px: list[Finite]
    frame_visible: list[bool]

    def __post_init__(self) -> None:
        beacons = ("beacon", "protocol", "x_px", "y_px", "radius_px", "x_m", "y_m", "z_m", "in_view", "visible")
        n = same_length(self, *beacons)
        same_length(self, *(name for name in self.__struct_fields__ if name.startswith("frame_")))
        if any(not 0 <= i < n for i in self.frame_beacon):
            raise ValueError(f"frame_beacon must index the {n} beacons")


class _TruthBody(_Columns, frozen=True, kw_only=True):
    edge_n: Annotated[int, Meta(ge=0, le=EDGES_LIMIT)]
    edges: bytes


class Truth(_Columns, frozen=True, kw_only=True):
    """The beacons of a window [t0_us, t1_us): where they were at t1_us, and the frames whose last bit ended in it.

    `sensor` is the camera's preset, `fidelity` how finely its surroundings were rendered. Columns `beacon .. visible`
    have one entry a beacon (its state at t1_us: place in the image and, `_m`, in the world; `in_view`: the centre is
    on the sensor; `visible`: and the line of sight is clear). Columns `frame_*` have one entry a frame sent: the index
    of its beacon in `beacon`, begin and end of its bits, payload, place at its end, and whether the LED was visible
    throughout. Columns `edge_*` have one entry a change of an LED in the window; they travel packed, as `edges`.

    Args:
        edge_beacon: (n,) uint16, not falling: index of the edge's beacon in `beacon`.
        edge_us: (n,) float64, to a tenth of a microsecond; of one beacon's edges, not falling.
        edge_on: (n,) bool, the LED's state from then on.
    """

    edge_beacon: npt.NDArray[np.uint16]
    edge_us: npt.NDArray[np.float64]
    edge_on: Flags

    def __post_init__(self) -> None:
        super().__post_init__()
        same_length(self, "edge_beacon", "edge_us", "edge_on")

    def to_body(self) -> dict[str, Any]:
        """Return the body of the module's table.

        Raises:
            ValueError: edges are out of order, before t0_us, or further apart than 32 bits of tenths say (7 minutes).
        """
        body = {name: msgspec.to_builtins(getattr(self, name)) for name in _Columns.__struct_fields__}
        per_beacon = np.bincount(self.edge_beacon, minlength=len(self.beacon))
        tenths = np.rint((self.edge_us - self.t0_us) * TENTHS).astype(np.int64)
        dt = np.diff(tenths, prepend=0)
        first = _first_of_each(per_beacon)
        dt[first] = tenths[first]
        if len(per_beacon) > len(self.beacon) or (np.diff(self.edge_beacon.astype(np.int64)) < 0).any():
            raise ValueError(f"edge_beacon must index the {len(self.beacon)} beacons, in their order")
        if len(dt) and not 0 <= dt.min() <= dt.max() < 1 << 32:
            raise ValueError(f"edges of a beacon must rise from t0_us = {self.t0_us} on, by at most 429 s each")
        columns = (per_beacon.astype("<u4"), dt.astype("<u4"), np.packbits(self.edge_on, bitorder="little"))
        packed = zlib.compress(b"".join(column.tobytes() for column in columns), ZLIB_LEVEL)
        return body | {"edge_n": len(self.edge_us), "edges": packed}

    @classmethod
    def from_body(cls, body: dict[str, Any]) -> Self:
        """Return the record of a body, checked.

        Raises:
            ValueError: the body breaks the module's table.
        """
        raw = msgspec.convert(body, _TruthBody, strict=True)
        k, n = len(raw.beacon), raw.edge_n
        columns = inflated(raw.edges, 4 * k + 4 * n + (n + 7) // 8)
        per_beacon = np.frombuffer(columns, "<u4", k).astype(np.int64)
        if int(per_beacon.sum()) != n:
            raise ValueError(f"per_beacon must add up to edge_n = {n}, not {per_beacon.sum()}")
        tenths = np.cumsum(np.frombuffer(columns, "<u4", n, 4 * k), dtype=np.int64)
        first = _first_of_each(per_beacon)
        before = np.concatenate([[0], tenths])[first]
        tenths -= np.repeat(before, per_beacon[per_beacon > 0])
        if n and int(tenths.max()) > TENTHS * (raw.t1_us - raw.t0_us):
            raise ValueError(f"edges must lie in [{raw.t0_us}, {raw.t1_us}], not {tenths.max() / TENTHS} us into it")
        return cls(
            **{name: getattr(raw, name) for name in _Columns.__struct_fields__},
            edge_beacon=np.repeat(np.arange(k, dtype=np.uint16), per_beacon),
            edge_us=raw.t0_us + tenths / TENTHS,
            edge_on=np.unpackbits(
                np.frombuffer(columns, np.uint8, offset=4 * (k + n)), count=n, bitorder="little"
            ).astype(np.bool_),
        )

    @property
    def time_us(self) -> int:
        """The end of the window."""
        return self.t1_us


def _first_of_each(per_beacon: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the index of the first edge of each beacon that has any."""
    first: npt.NDArray[np.int64] = (np.cumsum(per_beacon) - per_beacon)[per_beacon > 0]
    return first


SCHEMAS: Final[dict[str, type[Message]]] = {Truth.SCHEMA: Truth}
