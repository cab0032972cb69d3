"""Light for the tests of pixels: lights that blink and move, views, and a run over both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from heliograph_services.event_source.simulation.contract import (
    CHUNK_US,
    NODE_US,
    NODES,
    Floats,
    LightChunk,
    PixelEvents,
    PixelNumbers,
    View,
)
from heliograph_services.event_source.simulation.pixel.array import PixelArray


def numbers(**changes: float) -> PixelNumbers:
    """Return pixels without noise, mismatch or delay, but for what is asked for."""
    plain = {
        "threshold_on": 0.2, "threshold_off": 0.2, "threshold_sd": 0.0, "tau_ref_us": 100.0,
        "irradiance_ref_w_m2": 1.0, "tau_min_us": 10.0, "dark_w_m2": 0.0, "refractory_us": 0.0, "leak_hz": 0.0,
        "shot_noise_hz": 0.0, "hot_pixels": 0.0, "hot_pixel_hz": 0.0, "latency_us": 0.0, "latency_off_extra_us": 0.0,
        "jitter_us": 0.0,
    }  # fmt: skip
    assert not set(changes) - set(plain)
    return PixelNumbers(**{**plain, **changes})


@dataclass(frozen=True)
class Lamp:
    """A light: its numbers are functions of time in us; edges are (us, level)."""

    x: Callable[[Floats], Floats]
    y: Callable[[Floats], Floats]
    sigma: float = 0.7
    flux: Callable[[Floats], Floats] = np.ones_like
    edges: Sequence[tuple[float, float]] = ()
    level0: float = 0.0

    def level(self, t_us: float) -> float:
        """Return the level just before t_us."""
        return next((level for t, level in reversed(self.edges) if t < t_us), self.level0)


def still_lamp(x: float, y: float, flux: float = 1.0, **more: object) -> Lamp:
    return Lamp(
        lambda t: np.full_like(t, x), lambda t: np.full_like(t, y), flux=lambda t: np.full_like(t, flux), **more  # type: ignore[arg-type]
    )  # fmt: skip


def chunk_of(lamps: Sequence[Lamp], t0_us: int) -> LightChunk:
    t = t0_us + NODE_US * np.arange(NODES + 1, dtype=np.float64)
    edges = [[edge for edge in lamp.edges if t0_us <= edge[0] < t0_us + CHUNK_US] for lamp in lamps]
    flat = [edge for group in edges for edge in group]

    def table(of: Callable[[Lamp], Floats]) -> Floats:
        return np.array([of(lamp) for lamp in lamps]).reshape(len(lamps), NODES + 1)

    return LightChunk(
        t0_us, table(lambda s: s.x(t)), table(lambda s: s.y(t)), table(lambda s: np.full_like(t, s.sigma)),
        table(lambda s: s.flux(t)), np.array([lamp.level(t0_us) for lamp in lamps], np.float64),
        np.concatenate([[0], np.cumsum([len(group) for group in edges])]).astype(np.int64),
        np.array([edge[0] for edge in flat], np.float64), np.array([edge[1] for edge in flat], np.float64),
    )  # fmt: skip


def joined(parts: Sequence[PixelEvents]) -> PixelEvents:
    return PixelEvents(
        np.concatenate([part.t_us for part in parts]), np.concatenate([part.pixel for part in parts]),
        np.concatenate([part.on for part in parts]), np.concatenate([part.cause for part in parts]),
    )  # fmt: skip


def flat_view(irradiance: float, width: int = 48, height: int = 48) -> View:
    return np.full((height, width), np.log(irradiance), np.float32)


def run(
    pixels: PixelArray, view: View | Callable[[int], View], until_us: int, lamps: Sequence[Lamp] = (),
    step_us: int = 4000, t0_us: int = 0,
) -> PixelEvents:  # fmt: skip
    """Return all events before until_us; views change at multiples of step_us, or never."""
    now, parts, t = (view(t0_us) if callable(view) else view), [], t0_us
    chunk = chunk_of(lamps, t0_us - t0_us % CHUNK_US)
    while t < until_us:
        if t >= chunk.t0_us + CHUNK_US:
            chunk = chunk_of(lamps, t)
        end = min(t - t % step_us + step_us, chunk.t0_us + CHUNK_US, until_us)
        then = view(end) if callable(view) else view
        parts.append(pixels.interval(t, end, now, then, chunk))
        t, now = end, then
    return joined(parts)


def moving(pixels_view: View, change: Callable[[int], View]) -> Callable[[int], View]:
    """Return a view for `run` whose first is the very object that the pixels began with."""
    return lambda t: pixels_view if t == 0 else change(t)


def shares(x: float, y: float, sigma: float, width: int = 48, height: int = 48) -> npt.NDArray[np.float64]:
    """Return (height, width), the image's share of each pixel, by scipy's normal distribution."""
    i, j = np.arange(width), np.arange(height)
    wx = ndtr((i + 0.5 - x) / sigma) - ndtr((i - 0.5 - x) / sigma)
    wy = ndtr((j + 0.5 - y) / sigma) - ndtr((j - 0.5 - y) / sigma)
    return np.asarray(np.outer(wy, wx), np.float64)
