"""The decoder's process, with a clock at its doors: `bench/bench_latency.py` starts it instead of the plain one.

Of every batch of events, one row of int64: watermark (camera us), when the source sent it, when it arrived, when the
loop took it, when the core was through with it, when its last message was out (monotonic ns). They are written to the
file that TIMED_DECODER names when the process ends. What is timed is the shell's own code; a row costs a microsecond.
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import numpy as np

from heliograph.shell import bus, loop
from heliograph.shell.inbox import Sample
from heliograph_services.decoder.__main__ import main

ROWS: list[tuple[int, int, int, int, int, int]] = []
_open, _publish, _take = bus.Bus.open, bus.Bus.publish, loop.Runner._take  # noqa: SLF001 - timed where it is called
_now: dict[str, Any] = {"header": None, "first": 0}


def opened(self: bus.Bus, sample: Sample) -> Any:
    """Note the header."""
    found = _open(self, sample)
    _now["header"] = found[0] if found is not None else None
    return found


def published(self: bus.Bus, message: Any) -> None:
    """Note when the core was through."""
    if not _now["first"] and message.SCHEMA != "health":
        _now["first"] = time.monotonic_ns()
    _publish(self, message)


def taken(self: loop.Runner, sample: Sample) -> None:
    """Time one input."""
    start, _now["first"] = time.monotonic_ns(), 0
    _take(self, sample)
    end = time.monotonic_ns()
    header = _now["header"]
    if sample.topic == "events" and header is not None:
        ROWS.append((header.t_us, header.mono_ns, sample.arrived_ns, start, _now["first"] or end, end))


bus.Bus.open, bus.Bus.publish, loop.Runner._take = opened, published, taken  # type: ignore[method-assign] # noqa: SLF001
_exit = os._exit


def leave(status: int) -> None:
    """Write what was noted; the process ends without unwinding where a thread of the bus is left."""
    np.save(os.environ["TIMED_DECODER"], np.array(ROWS, np.int64).reshape(-1, 6))
    _exit(status)


os._exit = leave  # type: ignore[assignment]
if __name__ == "__main__":
    code = main()
    np.save(os.environ["TIMED_DECODER"], np.array(ROWS, np.int64).reshape(-1, 6))
    sys.exit(code)
