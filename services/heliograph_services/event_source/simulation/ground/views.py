"""The surroundings as views: ln(irradiance + dark) of every pixel, at the times that motion asks for.

Between two views nothing moves by more than half a pixel (a whole one at the fidelity "live", which also renders at
half the resolution), and a pixel's value goes on a straight line between them; so an edge that passes a pixel is a
ramp with the right beginning, end and middle, and crossings are solved on it, not at the views.

Light of the ground and of the tops of assets is ``rho E T / (4 N^2)`` (`world.optics`). The sky, where a camera sees
it, is that which lights the ground: evenly bright, of the radiance E / pi of a white surface (assumed: overcast). A
lamp on the mains adds ``m(t) = E_lamp (1 + depth sin(2 pi f t + phase)) / E`` of the light in its rectangle of the
ground, and of what stands before it::

    view = u + ln(1 + sum m(t) s),  s = c (1 - dark exp(-u))

with u the view without lamps and c the share of the pixel that the rectangle covers: u and s are rendered at keys and
mixed between them, the lamps are computed for each view, ten a period.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np

from heliograph.events import Flags
from heliograph_services.event_source.simulation.contract import CHUNK_US, Floats, Ints, View
from heliograph_services.event_source.simulation.ground.motion import (
    LONGEST_US,
    SHORTEST_US,
    Plan,
    plan,
    sees_sky,
    way_of,
)
from heliograph_services.event_source.simulation.ground.texture import make_texture
from heliograph_services.event_source.simulation.ground.warp import cover_quad, double, draw_quad, lit, render_ground
from heliograph_services.event_source.simulation.world.projection import Projection
from heliograph_services.event_source.simulation.world.spec import Ground, Mains
from heliograph_services.event_source.simulation.world.world import World

Fidelity = Literal["full", "live"]
_STEP_PX: Final[dict[Fidelity, float]] = {"full": 0.5, "live": 1.0}
# A sine cut into ten straight lines a period errs by a twentieth of its amplitude, a tenth of a threshold.
_VIEWS_A_PERIOD: Final = 10
_FLICKER_US: Final = 1_000
# Below this tilt of the ground over the whole sensor the homography is affine, but for rounding.
_FLAT: Final = 1e-9
# The cross product by columns.
_YZX: Final = [1, 2, 0]
_ZXY: Final = [2, 0, 1]
# What an interval and its successor ask for: the keys about both, and no more.
_KEPT: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What the look of the surroundings depends on at one time: the camera's pose, and the assets."""

    position: Floats
    rotation: Floats
    corners: Floats
    reflectance: Floats
    key: bytes  # equal keys look the same


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    """A scene rendered.

    Args:
        key: of the scene.
        view: u, (height, width) float32, without lamps; where there are lamps, at the resolution that is rendered.
        lit: s of each group of lamps, likewise: (groups, rows, columns).
        reach: first row, last row + 1, first column, last column + 1 of what lamps reach.
    """

    key: bytes
    view: View
    lit: View
    reach: Ints


@dataclass(frozen=True, slots=True)
class _Lamps:
    """Lamps that flicker alike: their numbers, and their shares of the group's light."""

    lamp: Mains
    members: tuple[tuple[int, float], ...]
    ratio: float  # E of the first over E of the ground

    def added(self, t_us: float) -> float:
        """Return m(t)."""
        lamp = self.lamp
        phase = 2.0 * math.pi * lamp.frequency_hz * t_us * 1e-6 + math.radians(lamp.phase_deg)
        return self.ratio * (1.0 + lamp.depth * math.sin(phase))


class GroundBackground:
    """The ground, the sky, the assets and the mains' lamps (`contract.Background`).

    Args:
        world: the scenario before its sensor.
        dark_w_m2: of the sensor's pixels; above 0, or a black surface would have no logarithm.
        fidelity: "full", or "live": coarser.
        seed: of the texture.
    """

    def __init__(self, world: World, dark_w_m2: float, fidelity: Fidelity = "full", seed: int = 0) -> None:
        scenario = world.scenario
        self._world = world
        self._dark_w_m2 = dark_w_m2
        self._step_px = _STEP_PX[fidelity]
        self._grid = _Grid(world.projection, half=fidelity == "live")
        self._lamps = _grouped(scenario.mains, scenario.irradiance_w_m2)
        fastest_hz = max((lamp.frequency_hz for lamp in scenario.mains), default=0.0)
        period_us = 1e6 / (_VIEWS_A_PERIOD * fastest_hz) if fastest_hz else math.inf
        self._flicker_us = round(max(SHORTEST_US, min(_FLICKER_US, period_us))) if fastest_hz else LONGEST_US
        self._plain = scenario.ground.texture == "plain" and not scenario.mains
        gain = world.optics.background_w_m2(1.0, scenario.irradiance_w_m2)
        self._texels, self._bases, self._bits, self._tile_m = _packed(scenario.ground, seed, gain, dark_w_m2)
        self._gain = gain
        self._far = math.log(gain * scenario.ground.reflectance + dark_w_m2)
        self._sky = math.log(gain + dark_w_m2)
        self._still = world.still_camera and world.still_assets
        self._plans: dict[int, Plan] = {}
        self._shots: dict[int, _Shot] = {}
        self._views: dict[int, View] = {}
        self._loose: tuple[_Shot, ...] = ()  # the last that `at` was asked for

    def next_us(self, t_us: int) -> int:
        """Return the end of the interval that begins at t_us (`contract.Background`)."""
        return self._plan(t_us // CHUNK_US * CHUNK_US).next_us(t_us)

    def view(self, t_us: int) -> View:
        """Return (height, width) float32, ln(irradiance + dark) at an end of an interval (`contract.Background`)."""
        if not self._lamps:
            return self._shot(t_us).view
        found = self._views.get(t_us)
        if found is None:
            before, after = self._plan(t_us // CHUNK_US * CHUNK_US).keys_about(t_us)
            shots = self._shot(before), self._shot(after)
            share = (t_us - before) / (after - before) if shots[0] is not shots[1] else 0.0
            found = self._lit(*shots, share, float(t_us))
            _keep(self._views, t_us, found)
        return found

    def at(self, t_us: float) -> View:
        """Return the view of any time, rendered for it, wherever intervals end."""
        scene = self._scene(t_us)
        known = [*self._shots.values(), *self._loose]
        shot = next((shot for shot in known if shot.key == scene.key), None) or self._rendered(scene)
        self._loose = (shot,)
        return self._lit(shot, shot, 0.0, t_us) if self._lamps else shot.view

    def _plan(self, t0_us: int) -> Plan:
        found = self._plans.get(t0_us)
        if found is None:
            steps = CHUNK_US // SHORTEST_US
            way = np.zeros(steps) if self._still else way_of(self._world, t0_us, plain=self._plain)
            found = plan(t0_us, way, self._step_px, self._flicker_us)
            _keep(self._plans, t0_us, found)
        return found

    def _shot(self, t_us: int) -> _Shot:
        found = self._shots.get(t_us)
        if found is None and self._still:
            found = next(iter(self._shots.values()), None)
        if found is None:
            scene = self._scene(float(t_us))
            found = next((shot for shot in self._shots.values() if shot.key == scene.key), None)
            if found is None:
                found = self._rendered(scene)
            _keep(self._shots, t_us, found)
        return found

    def _scene(self, t_us: float) -> _Scene:
        positions, rotations = self._world.camera(np.array([t_us]))
        corners, reflectance = self._world.assets(t_us)
        key = b""
        if len(corners) or not self._plain or sees_sky(self._world.projection, rotations):
            key = b"".join(part.tobytes() for part in (positions, rotations, corners, reflectance))
        return _Scene(positions[0], rotations[0], corners, reflectance, key)

    def _rendered(self, scene: _Scene) -> _Shot:
        grid = self._grid
        view = np.empty((grid.rows, grid.columns), np.float32)
        ground = grid.to_ground(scene.position, scene.rotation)
        render_ground(
            self._texels, self._bases, self._bits, self._tile_m, ground, grid.pixel, self._far, self._sky, view
        )  # fmt: skip
        seen, lines = grid.lines((scene.corners - scene.position) @ scene.rotation.T)
        for k in np.flatnonzero(seen):
            draw_quad(lines[k], math.log(self._gain * scene.reflectance[k] + self._dark_w_m2), view)
        if not self._lamps:
            return _Shot(scene.key, grid.finished(view), np.empty((0, 0, 0), np.float32), np.zeros(4, np.int64))
        lit_by = np.stack([self._covered(lamps, scene, view) for lamps in self._lamps])
        return _Shot(scene.key, view, lit_by, _reach(lit_by))

    def _covered(self, lamps: _Lamps, scene: _Scene, view: View) -> View:
        """Return s of a group of lamps."""
        total = np.zeros_like(view)
        corners, _ = self._world.mains()
        seen, lines = self._grid.lines((corners - scene.position) @ scene.rotation.T)
        for member, weight in lamps.members:
            if seen[member]:
                covered = np.zeros_like(view)
                cover_quad(lines[member], covered)
                total += np.float32(weight) * covered
        y0, y1, x0, x1 = _reach(total[None])
        total[y0:y1, x0:x1] *= np.float32(1.0) - np.float32(self._dark_w_m2) * np.exp(-view[y0:y1, x0:x1])
        return total

    def _lit(self, before: _Shot, after: _Shot, share: float, t_us: float) -> View:
        """Return the view at a time between two shots, its lamps on."""
        view = np.empty_like(before.view)
        added = np.array([lamps.added(t_us) for lamps in self._lamps], np.float32)
        box = _box(before.reach, after.reach)
        lit(before.view, after.view, before.lit, after.lit, share, added, box, view)
        return self._grid.finished(view)


def _reach(lit_by: View) -> Ints:
    """Return the rows and columns outside which no lamp adds anything: first, last + 1 of each."""
    some = np.any(lit_by > 0.0, axis=0)
    rows, columns = np.flatnonzero(np.any(some, axis=1)), np.flatnonzero(np.any(some, axis=0))
    if not len(rows):
        return np.zeros(4, np.int64)
    return np.array([rows[0], rows[-1] + 1, columns[0], columns[-1] + 1], np.int64)


def _box(a: Ints, b: Ints) -> Ints:
    """Return the rows and columns that two reaches have between them."""
    if a[0] == a[1] or b[0] == b[1]:
        return a + b  # one is all zeros
    return np.array([min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])], np.int64)


class _Grid:
    """The pixels that are rendered: the sensor's, or every second of every second row, between two of the sensor's."""

    def __init__(self, projection: Projection, *, half: bool) -> None:
        self.rows = -(-projection.height // 2) if half else projection.height
        self.columns = -(-projection.width // 2) if half else projection.width
        self._shape = (projection.height, projection.width)
        self._half = half
        # A pixel that is left out does not make its neighbour blunter: events are as many as in full views, or nearly.
        self.pixel = 0.5 if half else 1.0
        # From a pixel of the grid to the sensor's, and to a ray.
        spread = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]]) if half else np.eye(3)
        self._to_ray = np.linalg.inv(projection.matrix()) @ spread

    def to_ground(self, position: Floats, rotation: Floats) -> Floats:
        """Return M of `warp`: the ray d meets the ground at position + d z / -d_z."""
        ray = rotation.T @ self._to_ray
        m = np.stack([position[k] * -ray[2] + position[2] * ray[k] for k in (0, 1)] + [-ray[2]])
        if np.abs(m[2, :2]).sum() * max(self.rows, self.columns) < _FLAT * abs(m[2, 2]):
            m[2, :2] = 0.0
        return m

    def lines(self, corners: Floats) -> tuple[Flags, Floats]:
        """Return which quads are seen, (k,) bool, and their edges as `warp.draw_quad` takes them, (k, 4, 3) float64.

        An edge is the plane of the rays through it, and the inside is on the same side of all four, also where some of
        the corners are behind the camera. Not seen: what is all behind it, or in one plane with it.

        Args:
            corners: (k, 4, 3) float64 in the camera's frame, in turn.
        """
        after = np.concatenate([corners[:, 1:], corners[:, :1]], axis=1)
        planes = corners[..., _YZX] * after[..., _ZXY] - corners[..., _ZXY] * after[..., _YZX]
        side = (planes[:, 0] * corners[:, 2]).sum(axis=1)
        size = np.abs(corners).max(axis=(1, 2), initial=0.0)
        seen = (corners[..., 2] > 0.0).any(axis=1) & (np.abs(side) > 1e-12 * size**3)
        lines = planes @ self._to_ray * np.copysign(1.0, side)[:, None, None]
        length = np.hypot(lines[..., 0], lines[..., 1])
        return seen, lines / np.maximum(length, 1e-300)[..., None]

    def finished(self, view: View) -> View:
        """Return the view of all pixels of the sensor."""
        if not self._half:
            return view
        out = np.empty(self._shape, np.float32)
        double(view, out)
        return out


@lru_cache(maxsize=1)
def _packed(ground: Ground, seed: int, gain: float, dark: float) -> tuple[View, Ints, int, float]:
    """Return texels, bases, bits and tile_m of `warp.render_ground`; a scene and its pictures share them."""
    texture = make_texture(ground, seed)
    return *texture.packed(gain, dark), texture.bits, texture.tile_m


def _grouped(lamps: tuple[Mains, ...], irradiance_w_m2: float) -> tuple[_Lamps, ...]:
    """Return the lamps by what makes them flicker."""
    groups: dict[tuple[float, float, float], list[int]] = {}
    for i, lamp in enumerate(lamps):
        groups.setdefault((lamp.frequency_hz, lamp.depth, lamp.phase_deg), []).append(i)
    return tuple(
        _Lamps(
            lamps[members[0]],
            tuple((i, lamps[i].irradiance_w_m2 / lamps[members[0]].irradiance_w_m2) for i in members),
            lamps[members[0]].irradiance_w_m2 / irradiance_w_m2,
        )
        for members in groups.values()
    )


def _keep(kept: dict[int, Any], t_us: int, value: object) -> None:
    """Add what was made for a time, and forget the earliest beyond _KEPT."""
    kept[t_us] = value
    while len(kept) > _KEPT:
        del kept[next(iter(kept))]
