"""The random numbers of the lights: counter-based (`simulation.random`), so that any light can be asked of any time."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from heliograph_services.event_source.simulation.contract import Floats, Ints
from heliograph_services.event_source.simulation.random import DRIVE, normals, poisson_counts, uniforms


class Use(IntEnum):
    """What a number is for: each use of a light's counter has numbers of its own."""

    JITTER = 0
    PAYLOAD = 1
    BIT = 2
    PHASE = 3
    CLOCK_COUNT = 4
    CLOCK_TIME = 5
    CLOCK_STATE = 6


def even(seed: int, index: int, use: Use, counter: Ints) -> Floats:
    """Return (n,) float64 in (0, 1), one a counter.

    Args:
        seed: of the simulation.
        index: of the light's emitter.
        use: what for.
        counter: (n,) int64; may be negative.
    """
    return uniforms(seed, DRIVE, index, use.value, counter)


def normal(seed: int, index: int, use: Use, counter: Ints) -> Floats:
    """Return (n,) float64 of mean 0 and standard deviation 1, one a counter; arguments as of `even`."""
    return normals(seed, DRIVE, index, use.value, counter)


def poisson(seed: int, index: int, use: Use, counter: Ints, mean: float) -> Ints:
    """Return (n,) int64 of Poisson's distribution about `mean`, one a counter; arguments as of `even`."""
    return poisson_counts(seed, DRIVE, index, use.value, counter, mean=mean)


def phase(seed: int, index: int) -> float:
    """Return where in its period a light begins, in (0, 1)."""
    return float(even(seed, index, Use.PHASE, np.zeros(1, np.int64))[0])
