"""Events of a light on an asynchronous sensor, edge by edge: the law behind studies of fast links.

Each of n pixels tells each edge of the LED once, at ``t + jitter z`` (z normal, drawn for each pixel and edge; edges of
one pixel keep their order), unless it is still refractory from its last event. While a pixel is refractory its memory
follows the light, as the reset switch of the circuit makes it: an edge that falls into it is lost, not late. An event
is dropped with a chance of `loss`, all of an edge with a chance of `dropped_edges`; noise is uniform in time, of either
polarity.

Not in it: the pixel's finite bandwidth, thresholds and contrast, and the arbiter that delays events when many come
at once. What they do at an edge is summed up in jitter and loss.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times


@dataclass(frozen=True, slots=True)
class AsyncPixels:
    """A light's image.

    Args:
        pixels: how many see it.
        jitter_us: standard deviation of an event's time.
        refractory_us: a pixel's dead time after an event.
        loss: share of events that are dropped at random.
        dropped_edges: share of edges that no pixel tells.
        noise_hz: events a second of noise in the region, both polarities together.
        delay_off_us: how much later OFF events come than ON events.
    """

    pixels: int = 50
    jitter_us: float = 5.0
    refractory_us: float = 2.0
    loss: float = 0.0
    dropped_edges: float = 0.0
    noise_hz: float = 0.0
    delay_off_us: float = 0.0


def events(
    edges_us: npt.NDArray[np.float64],
    levels: Flags,
    light: AsyncPixels,
    rng: np.random.Generator,
    until_us: float | None = None,
) -> tuple[Times, Flags]:
    """Return the events of a light in order of time.

    Args:
        edges_us: (n,) when the LED changes, rising.
        levels: (n,) its new level.
        light: how it is seen.
        rng: random numbers.
        until_us: noise comes from 0 until then; None: until the last edge.

    Returns:
        (m,) int64 us, not falling and not before 0; (m,) bool.
    """
    ready = np.full(light.pixels, -np.inf)
    before = np.full(light.pixels, -np.inf)
    times: list[npt.NDArray[np.float64]] = []
    signs: list[Flags] = []
    for t_us, level in zip(edges_us.tolist(), levels.tolist(), strict=True):
        delay_us = 0.0 if level else light.delay_off_us
        seen = np.maximum(t_us + delay_us + light.jitter_us * rng.standard_normal(light.pixels), before)
        before = seen
        told = seen >= ready
        if light.dropped_edges > 0.0 and rng.random() < light.dropped_edges:
            told[:] = False
        if light.loss > 0.0:
            told &= rng.random(light.pixels) >= light.loss
        ready = np.where(told, seen + light.refractory_us, ready)
        times.append(seen[told])
        signs.append(np.full(int(told.sum()), level, np.bool_))
    end_us = until_us if until_us is not None else (float(edges_us[-1]) if len(edges_us) else 0.0)
    noise = rng.poisson(light.noise_hz * end_us * 1e-6)
    times.append(rng.random(noise) * end_us)
    signs.append(rng.random(noise) < 0.5)
    t, on = np.concatenate(times), np.concatenate(signs)
    inside = t >= 0.0
    if until_us is not None:
        inside &= t < until_us
    t, on = t[inside], on[inside]
    order = np.argsort(t, kind="stable")
    return np.floor(t[order]).astype(np.int64), on[order]
