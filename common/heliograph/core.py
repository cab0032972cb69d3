"""What a core is: values in, values out, time with the data.

A core opens nothing, sleeps never and reads no clock. The shell runs it on the bus, `heliograph decode` in one
process, a test in a millisecond; the result is the same.

In *lockstep* (replay, tests) a core uses a message of the other half of the loop (tracks, statuses) exactly one tracker
period after its `as_of_us`, and says by `ready` whether it has what it needs for an input; so the result depends on
neither scheduling nor the number of processes. Live, it uses the newest at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from heliograph.errors import Refusals
from heliograph.messages import Message


@dataclass(frozen=True, slots=True)
class Context:
    """What a core is told about its process.

    Args:
        instance: the name of this process among those of its service.
        boot: a word drawn anew at each start; names made from it are never used twice.
        lockstep: see the module.
    """

    instance: str
    boot: str
    lockstep: bool


class Core(Protocol):
    """The pure half of a service."""

    refusals: Refusals  # what was refused since the start, by reason
    counters: dict[str, int]  # what was done since the start; only grows
    gauges: dict[str, float]  # what is now

    def feed(self, message: Message) -> list[Message]:
        """Take one message and return what follows from it, in the order in which it is to be published."""
        ...

    def ready(self, message: Message) -> bool:
        """Return whether, in lockstep, all that this input depends on has been fed."""
        ...

    def tick(self, now_us: int) -> list[Message]:
        """Take note that nothing came until now_us (camera time, estimated by the shell); live only."""
        ...
