"""What was really there: known to a simulator alone, read by whoever scores, never by a receiver.

The record and its key live here and only here; the simulation, the metrics sink, the viewer and the command line may
import this module, a tracker or a decoder may not (import-linter keeps it so).
"""

from __future__ import annotations

from typing import ClassVar, Final

from heliograph.messages import Finite, Message, Name, Payload, TimeUs, same_length


class Truth(Message, frozen=True, kw_only=True):
    """The beacons of a window [t0_us, t1_us): where they were at t1_us, and the frames whose last bit ended in it.

    Columns `beacon .. visible` have one entry a beacon (its state at t1_us; `in_view`: the centre is on the sensor;
    `visible`: and the line of sight is clear). Columns `frame_*` have one entry a frame sent: the index of its beacon
    in `beacon`, begin and end of its bits, payload, and whether the LED was visible throughout.
    """

    SCHEMA: ClassVar[str] = "truth"
    camera: Name
    t0_us: TimeUs
    t1_us: TimeUs
    beacon: list[Name]
    protocol: list[Name]
    x_px: list[Finite]
    y_px: list[Finite]
    radius_px: list[Finite]
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
        n = same_length(self, "beacon", "protocol", "x_px", "y_px", "radius_px", "in_view", "visible")
        same_length(self, *(name for name in self.__struct_fields__ if name.startswith("frame_")))
        if any(not 0 <= i < n for i in self.frame_beacon):
            raise ValueError(f"frame_beacon must index the {n} beacons")

    @property
    def time_us(self) -> int:
        """The end of the window."""
        return self.t1_us


SCHEMAS: Final[dict[str, type[Message]]] = {Truth.SCHEMA: Truth}
