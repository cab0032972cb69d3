"""When the surroundings are looked at: the ends of the intervals within a chunk, from the motion of the images alone.

The way that images go is summed over steps of SHORTEST_US: at each the largest of the ways of nine points of the sensor
(over the ground, or with the sky) and of the assets' corners. A chunk is cut into equal ways of at most step_px, at
whole microseconds at least SHORTEST_US and at most LONGEST_US apart. Where lamps flicker, the light is looked at more
often than the geometry: views between two *keys* are mixed from theirs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, cast

import numpy as np

from heliograph_services.event_source.simulation.contract import CHUNK_US, Floats
from heliograph_services.event_source.simulation.world.projection import Projection
from heliograph_services.event_source.simulation.world.world import World

# The shortest interval, and so the grid on which motion is summed: a tremor of 500 Hz has ten of them a period.
SHORTEST_US: Final = 200
LONGEST_US: Final = 5_000
# Assets go at most 10 m/s or so, without tremor: a quarter of a chunk of their way is straight.
_ASSET_US: Final = 5_000
# A ray less than a degree below the horizon meets the ground a hundred heights away, which moves as the sky does.
_HORIZON: Final = 0.02
# The way of a point that turns up behind the camera, in px: more than any real one.
_WILD_PX: Final = 1_000.0


@dataclass(frozen=True, slots=True)
class Plan:
    """The intervals of a chunk.

    Args:
        keys_us: ends at which the geometry is rendered, the chunk's own among them, rising.
        ends_us: all ends, the keys among them, rising.
    """

    keys_us: tuple[int, ...]
    ends_us: tuple[int, ...]

    def next_us(self, t_us: int) -> int:
        """Return the first end behind t_us."""
        return next(end for end in self.ends_us if end > t_us)

    def keys_about(self, t_us: int) -> tuple[int, int]:
        """Return the keys before and after a time, the same twice where it is one."""
        before = max(key for key in self.keys_us if key <= t_us)
        return before, min(key for key in self.keys_us if key >= t_us)


def plan(t0_us: int, way_px: Floats, step_px: float, flicker_us: int) -> Plan:
    """Return the intervals of the chunk that begins at t0_us.

    Args:
        t0_us: a multiple of CHUNK_US.
        way_px: (CHUNK_US / SHORTEST_US,) float64, the way gone in each step of SHORTEST_US.
        step_px: the longest way between two keys.
        flicker_us: the longest time between two ends; LONGEST_US or more where nothing flickers.
    """
    gone = np.concatenate([np.zeros(1), np.cumsum(way_px)])
    step = gone[-1] / max(1, math.ceil(gone[-1] / step_px - 1e-6))
    # Where nothing moves for a while the way is no function of time: a trillionth of a pixel a step makes it one.
    rising = gone + np.arange(len(gone)) * 1e-12
    grid_us = np.arange(len(gone)) * float(SHORTEST_US)
    keys = [0]
    while keys[-1] < CHUNK_US:
        reached = float(np.interp(keys[-1], grid_us, rising)) + step
        cut = round(float(np.interp(reached, rising, grid_us))) if step else CHUNK_US
        cut = max(keys[-1] + SHORTEST_US, min(keys[-1] + LONGEST_US, cut))
        if CHUNK_US - cut < SHORTEST_US:
            cut = CHUNK_US if CHUNK_US - keys[-1] <= LONGEST_US else CHUNK_US - SHORTEST_US
        keys.append(cut)
    keys = [t0_us + key for key in keys]
    return Plan(tuple(keys), tuple(_divided(keys, flicker_us)))


def _divided(ends_us: list[int], longest_us: int) -> list[int]:
    """Return the ends with equal parts of at most longest_us between them."""
    found = ends_us[:1]
    for a, b in pairwise(ends_us):
        parts = -(-(b - a) // longest_us)
        found += [a + (b - a) * k // parts for k in range(1, parts + 1)]
    return found


def way_of(world: World, t0_us: int, *, plain: bool) -> Floats:
    """Return the way that images go in each step of a chunk, (CHUNK_US / SHORTEST_US,) float64 px.

    Args:
        world: camera and assets.
        t0_us: a multiple of CHUNK_US.
        plain: the ground is the same everywhere, so that only a horizon shows that the camera moves.
    """
    steps = CHUNK_US // SHORTEST_US
    t_us = t0_us + np.arange(steps + 1, dtype=np.float64) * SHORTEST_US
    way = np.zeros(steps)
    position, rotation = world.camera(t_us)
    if not world.still_camera and not (plain and not sees_sky(world.projection, rotation)):
        way = _way_of_surroundings(world.projection, position, rotation)
    if world.scenario.assets and not (world.still_camera and world.still_assets):
        coarse = _ASSET_US // SHORTEST_US
        gone = _way_of_assets(world, t_us[::coarse], position[::coarse], rotation[::coarse])
        way = np.maximum(way, np.repeat(gone / coarse, coarse))
    return way


def _rays(projection: Projection) -> Floats:
    """Return (9, 3) rays of the sensor's corners, the middles of its sides, and its middle."""
    x, y = (np.linspace(0.0, side - 1.0, 3) for side in (projection.width, projection.height))
    xs, ys = np.meshgrid((x - projection.cx_px) / projection.f_px, (y - projection.cy_px) / projection.f_px)
    return np.stack([xs.ravel(), ys.ravel(), np.ones(9)], axis=1)


def sees_sky(projection: Projection, rotation: Floats) -> bool:
    """Return whether any of (n, 3, 3) rotations shows the horizon, or comes near to it."""
    upwards = np.einsum("nj,pj->np", rotation[:, :, 2], _rays(projection))
    return bool((upwards > -_HORIZON).any())


def _way_of_surroundings(projection: Projection, position: Floats, rotation: Floats) -> Floats:
    rays = _rays(projection)
    world = np.einsum("nji,pj->npi", rotation[:-1], rays)
    down = -world[..., 2:]
    far = down < _HORIZON
    point = position[:-1, None, :] + world * (position[:-1, None, 2:] / np.where(far, 1.0, down))
    ray = np.where(far, world, point - position[1:, None, :])
    return cast("Floats", _shift(projection, np.einsum("nij,npj->npi", rotation[1:], ray), rays).max(axis=1))


def _shift(projection: Projection, now: Floats, before: Floats) -> Floats:
    """Return how far apart, in pixels, two rays of the camera's frame are; at most _WILD_PX."""
    ahead = (now[..., 2] > 1e-9) & (before[..., 2] > 1e-9)
    z0, z1 = (np.where(ahead, ray[..., 2], 1.0) for ray in (before, now))
    dx, dy = (now[..., k] / z1 - before[..., k] / z0 for k in (0, 1))
    return np.where(ahead, np.minimum(projection.f_px * np.hypot(dx, dy), _WILD_PX), _WILD_PX)


def _way_of_assets(world: World, t_us: Floats, position: Floats, rotation: Floats) -> Floats:
    """Return the largest way of a corner that is on the sensor, or near it, between each two times."""
    projection = world.projection
    # The lowest first: where two change places they seem to leap, and a few views more are made.
    corners = np.stack([world.assets(float(t))[0] for t in t_us])  # (n, k, 4, 3)
    rays = np.einsum("nij,nkcj->nkci", rotation, corners - position[:, None, None, :])
    shift = np.where(rays[:-1, ..., 2] > 1e-9, _shift(projection, rays[1:], rays[:-1]), 0.0)
    near = np.zeros(shift.shape[:2], np.bool_)
    for ray in (rays[:-1], rays[1:]):
        z = np.maximum(ray[..., 2], 1e-9)
        x, y = (projection.f_px * ray[..., k] / z for k in (0, 1))
        outside = (x.max(-1) < -projection.width) | (x.min(-1) > projection.width)
        outside |= (y.max(-1) < -projection.height) | (y.min(-1) > projection.height)
        near |= ~outside & (ray[..., 2] > 0.0).any(axis=-1)
    return cast("Floats", np.where(near[..., None], shift, 0.0).max(axis=(1, 2), initial=0.0))
