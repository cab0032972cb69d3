"""How each message travels: one table, chosen by the message, never by the service.

Nothing blocks: a stuck reader must not stop a source. What is dropped is seen by the gap in `seq`. Lockstep, where
nothing may be lost, goes by `progress` (one window in flight), not by back-pressure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

Priority = Literal["real_time", "interactive_high", "data_high", "data", "data_low", "background"]


@dataclass(frozen=True, slots=True)
class Profile:
    """How one kind of message travels.

    Args:
        priority: Zenoh's priority; a full link drops the lowest first.
        reliable: retransmitted by the transport.
        express: sent at once, not batched with others.
        history: how many last messages a key the publisher keeps for late and cut-off readers; 0 for none.
        kept_s: how long a key of which nothing is heard any more keeps its publisher, and so its history.
    """

    priority: Priority
    reliable: bool = True
    express: bool = False
    history: int = 0
    kept_s: float = math.inf


_STATE_HISTORY: Final = 512  # 51 s of a track at 10 Hz: a reader that was cut off for less misses nothing
_TEXT_HISTORY: Final = 1024
# A track's keys are used once: what a minute has not brought back is over, and would fill the memory for nothing.
_TRACK_KEPT_S: Final = 60.0
PROFILES: Final[dict[str, Profile]] = {
    "events": Profile("data_low"),
    "onsets": Profile("data"),
    "tracks": Profile("data_high"),
    "status": Profile("data_high"),
    "flow": Profile("data_low"),
    "image": Profile("background"),
    "truth": Profile("background"),
    "clock": Profile("data"),
    "frames": Profile("data"),
    "ids": Profile("interactive_high", history=_STATE_HISTORY, kept_s=_TRACK_KEPT_S),
    "messages": Profile("interactive_high", history=_TEXT_HISTORY),
    "link": Profile("data", kept_s=_TRACK_KEPT_S),
    "progress": Profile("data_high", express=True),
    "beacon": Profile("interactive_high", history=1),
    # Of a query and its reply, which Zenoh carries as it carries the rest of the topic.
    "beacon_cmd": Profile("interactive_high"),
    "beacon_reply": Profile("interactive_high"),
    "metrics": Profile("background"),
    "health": Profile("background"),
}
