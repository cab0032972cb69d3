"""A sensor that sees nothing but noise: uniform, of both polarities, at so many events a second."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import count

import numpy as np

from heliograph.events import EventBatch
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.core import CameraInfo, SourceCore
from heliograph_services.event_source.stream import Step

WIDTH, HEIGHT = 640, 480
CALM_HZ = 1e4


def noise(events_hz: float, seed: int, window_us: int = 10_000, calm_from_us: float = math.inf) -> Iterator[Step]:
    """Yield the steps of a source without end, onsets gated as its defaults say; from a time on of CALM_HZ."""
    rng = np.random.default_rng(seed)
    config = EventSourceConfig(backend="simulated", window_us=window_us, max_events=1_000_000)
    source = SourceCore(config, CameraInfo(WIDTH, HEIGHT))
    for t0_us in count(0, window_us):
        n = int(rng.poisson((events_hz if t0_us < calm_from_us else CALM_HZ) * window_us * 1e-6))
        batch = EventBatch(
            np.sort(rng.integers(t0_us, t0_us + window_us, n)),
            rng.integers(0, WIDTH, n).astype(np.uint16),
            rng.integers(0, HEIGHT, n).astype(np.uint16),
            rng.random(n) < 0.5,
        )
        t1_us = t0_us + window_us
        yield Step(t1_us, source.feed(Window(t0_us, t1_us, batch, "noise")), end=False)
