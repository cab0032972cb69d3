"""Sound records of absurd content: times that jump and run back, thousands of tracks, events off the sensor."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from heliograph.events import EventBatch
from heliograph.messages import Message
from heliograph.streams import Events
from support.blinkers import Disc, straight, tracks


def hostile(n: int) -> Iterable[Message]:
    """Yield sound records of absurd content: times that jump and run back, thousands of tracks, other sensors."""
    rng = np.random.default_rng(7)
    now_us = 0
    for k in range(n):
        kind = rng.integers(0, 6)
        now_us += int(rng.integers(0, 20_000))
        if kind == 0:
            now_us = int(rng.integers(-(10**9), 10**9))
        if kind <= 2:
            m = int(rng.integers(1, 400)) if k % 50 == 0 else int(rng.integers(0, 5))
            rows = [
                (f"h-{rng.integers(0, 10**6)}-{i}", Disc(0, straight(*rng.uniform(-900, 900, 4))), 0) for i in range(m)
            ]
            yield tracks(now_us, rows, period_us=int(rng.integers(1, 10**6)))
        else:
            size = (160, 120) if kind < 5 else (int(rng.integers(1, 300)), int(rng.integers(1, 300)))
            many = int(rng.integers(0, 300))
            t_us = np.sort(rng.integers(now_us, now_us + 5_000, many)).astype(np.int64)
            x_px, y_px = (rng.integers(0, 200, many).astype(np.uint16) for _ in range(2))
            batch = EventBatch(t_us, x_px, y_px, rng.random(many) < 0.5)
            yield Events(
                camera="cam0", stream="s" if rng.random() < 0.9 else "t", width=size[0], height=size[1], t0_us=now_us,
                t1_us=now_us + 5_000, batch=batch,
            )  # fmt: skip
            now_us += 5_000
