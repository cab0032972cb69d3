"""The motion that a tracker's flow network sees: `Flow`, for those who draw it or want the camera's own motion.

Body on the wire (little-endian, struct of arrays: 8 bytes a sample)::

    camera str, as_of_us int, period_us int, confidence float, vx_px_s, vy_px_s, omega_rad_s, zoom_s float,
    centre_x_px, centre_y_px float, n int,
    x_px bytes(2 n: u2), y_px bytes(2 n: u2), sample_vx_px_s bytes(2 n: i2), sample_vy_px_s bytes(2 n: i2)

The surroundings of a place (x, y) move by (dx, dy from the centre)::

    (vx - omega dy + zoom dx,  vy + omega dx + zoom dy)

A confidence of 0 says that too little moved to say. Of a straight front a sample shows the motion across it alone.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Self

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from heliograph.messages import WINDOW_LIMIT_US, Finite, Message, Name, Share, TimeUs

SAMPLES_LIMIT: Final = 1000
_COLUMNS: Final = (("x_px", "<u2"), ("y_px", "<u2"), ("sample_vx_px_s", "<i2"), ("sample_vy_px_s", "<i2"))
_HEAD: Final = (
    "camera", "as_of_us", "period_us", "confidence", "vx_px_s", "vy_px_s", "omega_rad_s", "zoom_s",
    "centre_x_px", "centre_y_px",
)  # fmt: skip


class _FlowBody(msgspec.Struct, frozen=True, kw_only=True):
    camera: Name
    as_of_us: TimeUs
    period_us: Annotated[int, Meta(ge=1, le=WINDOW_LIMIT_US)]
    confidence: Share
    vx_px_s: Finite
    vy_px_s: Finite
    omega_rad_s: Finite
    zoom_s: Finite
    centre_x_px: Finite
    centre_y_px: Finite
    n: Annotated[int, Meta(ge=0, le=SAMPLES_LIMIT)]
    x_px: bytes
    y_px: bytes
    sample_vx_px_s: bytes
    sample_vy_px_s: bytes


class Flow(Message, frozen=True, kw_only=True):
    """How the view moves at an instant, and samples of what was seen to move in the tracker's period before it.

    Args:
        as_of_us: the instant, a multiple of the period.
        confidence: of the surroundings' motion, 0 to 1; 0 says that it is unknown.
        vx_px_s: of the surroundings at the centre.
        omega_rad_s: roll, from +x towards +y.
        zoom_s: growth, 1/s.
        x_px: (n,) uint16, of the samples.
        y_px: (n,) uint16.
        sample_vx_px_s: (n,) int16.
        sample_vy_px_s: (n,) int16.
    """

    SCHEMA: ClassVar[str] = "flow"
    camera: str
    as_of_us: int
    period_us: int
    confidence: float
    vx_px_s: float
    vy_px_s: float
    omega_rad_s: float
    zoom_s: float
    centre_x_px: float
    centre_y_px: float
    x_px: npt.NDArray[np.uint16]
    y_px: npt.NDArray[np.uint16]
    sample_vx_px_s: npt.NDArray[np.int16]
    sample_vy_px_s: npt.NDArray[np.int16]

    def to_body(self) -> dict[str, Any]:
        """Return the body of the module's table."""
        head = {name: getattr(self, name) for name in _HEAD} | {"n": len(self.x_px)}
        return head | {name: getattr(self, name).astype(dtype, copy=False).tobytes() for name, dtype in _COLUMNS}

    @classmethod
    def from_body(cls, body: dict[str, Any]) -> Self:
        """Return the record of a body, checked.

        Raises:
            ValueError: the body breaks the module's table.
        """
        raw = msgspec.convert(body, _FlowBody, strict=True)
        columns: dict[str, Any] = {}
        for name, dtype in _COLUMNS:
            packed = getattr(raw, name)
            if len(packed) != 2 * raw.n:
                raise ValueError(f"{name} must have {2 * raw.n} bytes for {raw.n} samples, not {len(packed)}")
            columns[name] = np.frombuffer(packed, dtype).astype(dtype[1:], copy=False)
        head: dict[str, Any] = {name: getattr(raw, name) for name in _HEAD}
        return cls(**head, **columns)

    @property
    def time_us(self) -> int:
        """The instant."""
        return self.as_of_us
