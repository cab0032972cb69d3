"""The stated corpus of `heliograph bench decode`: five moving beacons before a busy background, made from a seed.

::

    sensor      640 x 480
    beacons     five, seed11 at 1000 bit/s, discs of radius 3 px, each on an ellipse at 75 to 240 px/s, rows 0 to 259;
                at each edge of its code every pixel of the disc makes two events, 30 us (sd) after it and each other
    noise       at most 0.2 Mev/s, uniform over sensor and time
    texture     all the rest, in rows 290 to 479, one of
                contours:  upright edges that move at 600 px/s and make up to 4 events at each pixel that they cross,
                           as strong contours do; as many edges as that takes
                fragments: 24 upright edges that move at 300 px/s; at 1 Mev/s they make less than half an event at a
                           pixel, as weak contrast does, so that they fall to pieces, of which many look like beacons

Each 10 ms window has its own stream of random numbers, so the corpus of a second is the same in every length.
It is meant for timing: clean beacons, and a background that loads every stage. It proves nothing about accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch
from heliograph.link.contract import edges_of
from heliograph.link.modulations import modulation
from heliograph.site import Beacon
from heliograph_services.event_source.cameras.contract import Window

WIDTH: Final = 640
HEIGHT: Final = 480
WINDOW_US: Final = 10_000
BIT_RATE: Final = 1000.0
RADIUS_PX: Final = 3
EVENTS_A_PIXEL: Final = 2
JITTER_US: Final = 30.0
NOISE_HZ: Final = 200_000.0
TEXTURE_TOP_PX: Final = 290
CONTOUR_PX_S: Final = 600.0
CONTOUR_EVENTS: Final = 4
CONTOUR_HZ: Final = CONTOUR_PX_S * CONTOUR_EVENTS * (HEIGHT - TEXTURE_TOP_PX)
FRAGMENT_PX_S: Final = 300.0
FRAGMENT_EDGES: Final = 24

# Payloads of seed11 that neither another word nor a lamp can imitate.
BEACONS: Final = tuple(
    Beacon(name=name, protocol="seed11", payload=payload, bit_rate=BIT_RATE)
    for name, payload in (("crane", 42), ("lift", 18), ("truck", 37), ("mixer", 26), ("gate", 50))
)
# Centre, half axes (px) and time of a round (s) of the beacons' ellipses.
_PATHS: Final = ((90, 130, 40, 60, 2.0), (200, 120, 30, 50, 1.8), (320, 130, 45, 60, 2.2), (440, 120, 30, 70, 2.4))
_LAST_PATH: Final = (555, 130, 40, 60, 1.7)

Texture = Literal["contours", "fragments"]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Corpus:
    """Windows of events, ready to be fed.

    Args:
        seed: what it was made from.
        rate_hz: events a second, nominal.
        events: how many there are.
        seconds: of the camera's time.
        windows: of 10 ms each.
    """

    seed: int
    rate_hz: float
    events: int
    seconds: float
    windows: list[Window]


@dataclass(frozen=True, slots=True)
class _Part:
    """Events of one origin, in no order; times are float microseconds."""

    t_us: Floats
    x_px: Floats
    y_px: Floats
    on: npt.NDArray[np.bool_]


def make_corpus(rate_hz: float, seconds: float, seed: int, texture: Texture = "contours") -> Corpus:
    """Return the corpus of a density.

    Args:
        rate_hz: events a second, at least the beacons' own (about 0.2 Mev/s).
        seconds: of the camera's time; cut to whole windows.
        seed: same seed, same corpus.
        texture: see the module.
    """
    count = max(1, round(seconds * 1e6 / WINDOW_US))
    discs = [_beacon(i, count * WINDOW_US, seed) for i in range(len(BEACONS))]
    own_hz = sum(map(_nominal_hz, BEACONS))
    windows = []
    for number in range(count):
        t0_us = number * WINDOW_US
        generator = np.random.Generator(np.random.Philox(key=[seed, 1 + number]))
        noise_hz = min(NOISE_HZ, max(0.0, rate_hz - own_hz))
        parts = [_cut(disc, t0_us) for disc in discs]
        parts.append(_noise(generator, noise_hz, t0_us))
        parts.append(_texture(generator, texture, max(0.0, rate_hz - own_hz - noise_hz), t0_us))
        last = number == count - 1
        windows.append(Window(t0_us, t0_us + WINDOW_US, _merged(parts), f"bench{seed}", end=last))
    total = sum(len(window.batch) for window in windows)
    return Corpus(seed, rate_hz, total, count * WINDOW_US / 1e6, windows)


def place_px(beacon: int, t_us: Floats) -> tuple[Floats, Floats]:
    """Return a beacon's centre at times."""
    x_px, y_px, a_px, b_px, round_s = (*_PATHS, _LAST_PATH)[beacon]
    phase = 2 * np.pi * t_us / (round_s * 1e6) + beacon
    return x_px + a_px * np.cos(phase), y_px + b_px * np.sin(phase)


def _nominal_hz(beacon: Beacon) -> float:
    """Return the events a second that a beacon makes: edges of its word, pixels of its disc, events at each."""
    word = modulation(beacon.protocol, **beacon.options).encode(beacon.payload)
    edges = sum(a != b for a, b in zip(word, word[1:] + word[:1], strict=True))
    return edges * beacon.bit_rate / len(word) * len(_disc()[0]) * EVENTS_A_PIXEL


def _disc() -> tuple[Floats, Floats]:
    """Return the offsets of the pixels of a disc from its centre."""
    dy, dx = np.mgrid[-RADIUS_PX : RADIUS_PX + 1, -RADIUS_PX : RADIUS_PX + 1].astype(np.float64)
    inside = dx**2 + dy**2 <= RADIUS_PX**2
    return dx[inside], dy[inside]


def _beacon(index: int, until_us: int, seed: int) -> _Part:
    """Return all events of a beacon."""
    listed = BEACONS[index]
    word = modulation(listed.protocol, **listed.options).encode(listed.payload)
    bit_us = 1e6 / listed.bit_rate
    times, levels = edges_of(word * (int(until_us / (len(word) * bit_us)) + 1), 137.0 * index, bit_us)
    generator = np.random.Generator(np.random.Philox(key=[seed + 1_000_003 * (index + 1), 0]))
    dx_px, dy_px = _disc()
    shape = (len(times), len(dx_px), EVENTS_A_PIXEL)
    late = np.cumsum(np.abs(generator.normal(0.0, JITTER_US, shape)), axis=2)
    t_us = times[:, None, None] + late
    x_px, y_px = place_px(index, times)
    ones = np.ones(shape)
    return _Part(
        t_us.ravel(),
        ((x_px[:, None, None] + dx_px[None, :, None]) * ones).ravel(),
        ((y_px[:, None, None] + dy_px[None, :, None]) * ones).ravel(),
        (levels[:, None, None] & (ones > 0)).ravel(),
    )


def _cut(part: _Part, t0_us: int) -> _Part:
    inside = (part.t_us >= t0_us) & (part.t_us < t0_us + WINDOW_US)
    return _Part(part.t_us[inside], part.x_px[inside], part.y_px[inside], part.on[inside])


def _noise(generator: np.random.Generator, rate_hz: float, t0_us: int) -> _Part:
    n = int(generator.poisson(rate_hz * WINDOW_US / 1e6))
    return _Part(
        t0_us + generator.random(n) * WINDOW_US,
        generator.random(n) * WIDTH,
        generator.random(n) * HEIGHT,
        generator.random(n) < 0.5,
    )


def _texture(generator: np.random.Generator, texture: Texture, rate_hz: float, t0_us: int) -> _Part:
    n = int(generator.poisson(rate_hz * WINDOW_US / 1e6))
    is_whole = texture == "contours"
    edges = max(1, ceil(rate_hz / CONTOUR_HZ)) if is_whole else FRAGMENT_EDGES
    speed_px_s = CONTOUR_PX_S if is_whole else FRAGMENT_PX_S
    t_us = t0_us + generator.random(n) * WINDOW_US
    edge = generator.integers(0, edges, n)
    x_px = (edge * WIDTH / edges + t_us * (speed_px_s / 1e6) + generator.normal(0.0, 0.5, n)) % WIDTH
    y_px = TEXTURE_TOP_PX + generator.random(n) * (HEIGHT - TEXTURE_TOP_PX)
    return _Part(t_us, x_px, y_px, edge % 2 == 0)


def _merged(parts: list[_Part]) -> EventBatch:
    t_us = np.concatenate([part.t_us for part in parts]).astype(np.int64)
    order = np.argsort(t_us, kind="stable")

    def pixels(columns: list[Floats], limit: int) -> npt.NDArray[np.uint16]:
        whole = np.clip(np.floor(np.concatenate(columns) + 0.5), 0, limit - 1)
        return whole.astype(np.uint16)[order]

    return EventBatch(
        t_us[order],
        pixels([part.x_px for part in parts], WIDTH),
        pixels([part.y_px for part in parts], HEIGHT),
        np.concatenate([part.on for part in parts])[order],
    )
