"""Events of one light, ideal but for what is named: a step response for every pixel, and no scene around it.

Each of the blob's pixels sees the LED's log intensity change by D thresholds, D even between 1 and 5, through a low
pass; so its event number j (1 <= j <= D) of an edge comes at::

    t_j = t_edge + delay + tau ln(D / (D - j)) + jitter         delay and tau apart for ON and OFF, jitter normal

The mean is 2.5 events a pixel and edge. What can be done to them, in this order: the edge itself displaced
(`edge_jitter_bits`) or dropped whole (`dropped`); each event displaced (`event_jitter_bits`); the first events of an
edge lost (`first_lost`); each event lost by chance (`lost`); noise added (`noise_hz`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times
from heliograph.link.contract import edges_of

# Within the spread of the sensors' published latencies; OFF is the slower one, as in the recordings.
DELAY_US: Final = {True: 40.0, False: 60.0}
TAU_US: Final = {True: 30.0, False: 45.0}
PIXEL_JITTER_US: Final = 10.0
CONTRAST: Final = (1.0, 5.0)
# Real beacons were .03 to .04 % off.
CLOCK_PPM: Final = 400.0


@dataclass(frozen=True, slots=True)
class Damage:
    """What is done to the light's events.

    Args:
        lost: share of events lost by chance.
        first_lost: so many of an edge's first events are lost.
        event_jitter_bits: standard deviation of each event.
        edge_jitter_bits: standard deviation of each edge.
        noise_hz: events a second at random times.
        dropped: share of edges without any event.
    """

    lost: float = 0.0
    first_lost: int = 0
    event_jitter_bits: float = 0.0
    edge_jitter_bits: float = 0.0
    noise_hz: float = 0.0
    dropped: float = 0.0


@dataclass(frozen=True, slots=True)
class Seen:
    """Events of one track, until until_us."""

    t_us: Times
    on: Flags
    until_us: int


def watch(
    bits: Sequence[int], t0_us: float, bit_us: float, pixels: int, damage: Damage, rng: np.random.Generator
) -> Seen:
    """Return the events of an LED that sends these bits from t0_us on, lit before and dark after them.

    Args:
        bits: 0 and 1.
        t0_us: when the first begins.
        bit_us: length of a bit.
        pixels: of the blob.
        damage: what is done to the events.
        rng: of all that is drawn.
    """
    edges, on = edges_of(bits, t0_us, bit_us, level=True)
    kept = rng.random(len(edges)) >= damage.dropped
    edges, on = edges[kept], on[kept]
    edges = edges + rng.normal(0.0, 1.0, len(edges)) * damage.edge_jitter_bits * bit_us
    contrast = rng.uniform(*CONTRAST, pixels)
    late = _lateness(contrast)
    columns = [_events(edges[on == is_on], is_on, late, bit_us, damage, rng) for is_on in (True, False)]
    t = np.concatenate(columns)
    polarity = np.repeat([True, False], [len(column) for column in columns])
    end_us = t0_us + len(bits) * bit_us
    stray = rng.uniform(0.0, end_us, rng.poisson(damage.noise_hz * end_us * 1e-6))
    t, polarity = np.concatenate([t, stray]), np.concatenate([polarity, rng.random(len(stray)) < 0.5])
    whole = np.floor(np.maximum(t, 0.0)).astype(np.int64)
    order = np.argsort(whole, kind="stable")
    last = int(whole[order[-1]]) + 1 if len(whole) else 0
    return Seen(whole[order], polarity[order], max(int(end_us) + 1, last))


def _lateness(contrast: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return ln(D / (D - j)) of all events of an edge, rising."""
    late = [np.log(contrast[contrast > j] / (contrast[contrast > j] - j)) for j in range(1, int(CONTRAST[1]) + 1)]
    return np.sort(np.concatenate(late))


def _events(
    edges: npt.NDArray[np.float64],
    is_on: bool,
    late: npt.NDArray[np.float64],
    bit_us: float,
    damage: Damage,
    rng: np.random.Generator,
) -> npt.NDArray[np.float64]:
    shape = (len(edges), len(late))
    t = edges[:, None] + DELAY_US[is_on] + TAU_US[is_on] * late
    t = t + rng.normal(0.0, 1.0, shape) * np.hypot(PIXEL_JITTER_US, damage.event_jitter_bits * bit_us)
    if damage.first_lost:
        t = np.sort(t, axis=1)[:, damage.first_lost :]
    kept: npt.NDArray[np.float64] = t[rng.random(t.shape) >= damage.lost]
    return kept
