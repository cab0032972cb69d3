"""How long messages take over each hop of a process, by the second: what its health report tells as `latency ...`.

Of the one input that paces a process (or that it names), in microseconds::

    late      the sender's being late: sent - t_us, less the least of the last 5 to 10 s (an unknown offset of clocks)
    bus       sent -> arrived in this process         wait      arrived -> taken by its loop
    core      taken -> the core is through            publish   core through -> the last message is out
    whole     end of a window of `frames` -> published, on the clock of the sender that was least late

`sent` is the sender's monotonic clock where it is also ours (the same host: both of its clocks are as far from ours),
else its wall clock, which is as right as the two hosts' clocks agree. Percentiles are order statistics (nearest rank).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from heliograph.wire import Header

HOPS: Final = ("late", "bus", "wait", "core", "publish", "whole")
QUANTILES: Final = (("p50_us", 0.50), ("p95_us", 0.95), ("p99_us", 0.99))
# Clocks of cameras and hosts drift by 50 ppm: 0.5 ms in the longest time that a least offset is held.
_HALF_NS: Final = 5_000_000_000
# On one host the two readings differ by what lies between them; two hosts have not booted within 10 ms of each other.
_SAME_HOST_NS: Final = 10_000_000
# A source sends a thousand batches a second; what nobody takes must not fill the memory.
_KEPT: Final = 20_000
# A process reads a handful of cameras; strangers could invent more.
_CLOCKS: Final = 16


class Hops:
    """Collects in the working thread; `take` is called by the reporter.

    Args:
        mono: this host's monotonic clock, ns; for tests.
        wall: its wall clock, ns; for tests.
    """

    def __init__(self, mono: Callable[[], int] = time.monotonic_ns, wall: Callable[[], int] = time.time_ns) -> None:
        self._mono, self._wall = mono, wall
        self._times: dict[str, list[float]] = {hop: [] for hop in HOPS}
        self._offsets: dict[str, _Offset] = {}

    def note(self, header: Header, arrived_ns: int, took_ns: int, through_ns: int, frames_us: int | None) -> None:
        """Take the times of a message that has gone all its way, just now.

        Args:
            header: of the message.
            arrived_ns: when it was there (monotonic).
            took_ns: when the loop took it up.
            through_ns: when the core had worked on it.
            frames_us: camera time of the end of the newest window of frames that it led to, or None.
        """
        out_ns = self._mono()
        sent_ns = _sent_ns(header, out_ns, self._wall())
        since_ns = sent_ns - 1000 * header.t_us
        least_ns = self._least(header.clock, header.t_us, since_ns, out_ns)
        times = self._times
        if len(times["bus"]) >= _KEPT:
            return
        times["late"].append((since_ns - least_ns) / 1000)
        times["bus"].append(max(0, arrived_ns - sent_ns) / 1000)
        times["wait"].append((took_ns - arrived_ns) / 1000)
        times["core"].append((through_ns - took_ns) / 1000)
        times["publish"].append((out_ns - through_ns) / 1000)
        if frames_us is not None:
            times["whole"].append(max(0.0, (out_ns - 1000 * frames_us - least_ns) / 1000))

    def take(self) -> dict[str, float]:
        """Return gauges of what has come since the last call; nothing of hops over which nothing went."""
        # A note that is half written now may lose a number to the lists that were taken; none is ever counted twice.
        times, self._times = self._times, {hop: [] for hop in HOPS}
        gauges: dict[str, float] = {}
        for hop, values in times.items():
            ordered = sorted(values)
            if not ordered:
                continue
            gauges[f"latency {hop} n"] = float(len(ordered))
            for name, share in QUANTILES:
                gauges[f"latency {hop} {name}"] = round(ordered[math.ceil(share * len(ordered)) - 1], 1)
        return gauges

    def _least(self, clock: str, t_us: int, since_ns: float, now_ns: int) -> float:
        offset = self._offsets.get(clock)
        if offset is None or t_us < offset.last_us:  # a recording that begins again
            if len(self._offsets) >= _CLOCKS:
                self._offsets.clear()
            offset = self._offsets[clock] = _Offset(half_began_ns=now_ns)
        if now_ns - offset.half_began_ns > _HALF_NS:
            offset.half_began_ns, offset.before_ns, offset.least_ns = now_ns, offset.least_ns, math.inf
        offset.last_us, offset.least_ns = t_us, min(offset.least_ns, since_ns)
        return min(offset.least_ns, offset.before_ns)


@dataclass(slots=True)
class _Offset:
    """The least of sent - t_us of one camera's clock: of this half of the window and of the one before."""

    half_began_ns: int
    least_ns: float = math.inf
    before_ns: float = math.inf
    last_us: int = -(2**62)


def _sent_ns(header: Header, mono_ns: int, wall_ns: int) -> int:
    """Return when a message was sent, on this host's monotonic clock."""
    by_mono, by_wall = mono_ns - header.mono_ns, wall_ns - header.wall_ns
    return mono_ns - (by_mono if abs(by_mono - by_wall) < _SAME_HOST_NS else by_wall)
