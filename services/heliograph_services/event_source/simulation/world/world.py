"""The scene as the camera sees it: where every light's image is, how large and how bright; the poses; the assets.

Pure geometry and light: any time may be asked, in any order, and the same time gives the same answer. What a light
does with its time (its edges) is not known here.

A light is shown (flux above 0) where its image touches the sensor, it is `Optics.nearest_m` or more before the camera,
and no asset hides it. Elsewhere its place is held just outside the sensor, so that a straight line from node to node
never sweeps over half the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from heliograph.errors import ConfigError
from heliograph.events import Flags
from heliograph_services.event_source.simulation.contract import CHUNK_US, NODE_US, NODES, Floats
from heliograph_services.event_source.simulation.world.crowd import expanded
from heliograph_services.event_source.simulation.world.occlusion import Tops, turned
from heliograph_services.event_source.simulation.world.optics import FWHM_PER_SIGMA, Optics, lobe
from heliograph_services.event_source.simulation.world.projection import Projection, rotations
from heliograph_services.event_source.simulation.world.spec import (
    BeaconSpec,
    ClutterSpec,
    Emitter,
    Mains,
    Path,
    Scenario,
    Still,
)
from heliograph_services.event_source.simulation.world.trajectory import Angles, Paths

# A Gaussian image ends here: beyond 6 sigma lie 1e-9 of its light, a millionth of any threshold.
IMAGE_ENDS_SIGMA: Final = 6.0
_IMAGE_MARGIN_PX: Final = 2.0
_NODES_US: Final = np.arange(NODES + 1, dtype=np.float64) * NODE_US


@dataclass(frozen=True, slots=True)
class LightInfo:
    """A light of the world.

    Args:
        name: of its emitter.
        emitter: its number in beacons, then clutter; lights of one emitter share its drive.
        led: which of the emitter's discs.
    """

    name: str
    emitter: int
    led: int


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """All lights at the nodes of a chunk, (lights, NODES + 1) each: what geometry decides of a `LightChunk`."""

    x_px: Floats
    y_px: Floats
    sigma_px: Floats
    flux_w_m2: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One beacon at n times, (n,) each; or all beacons, (beacons, n) each.

    Args:
        x_px: centre of the emitter, also off the sensor; nothing where it is behind the camera.
        y_px: likewise.
        radius_px: half of the image's full width at half maximum, several LEDs together; at least 1.
        in_view: the centre is on the sensor.
        visible: the same, and nothing hides it.
        x_m: in the world.
        y_m: likewise.
        z_m: likewise.
    """

    x_px: Floats
    y_px: Floats
    radius_px: Floats
    in_view: Flags
    visible: Flags
    x_m: Floats
    y_m: Floats
    z_m: Floats

    def of(self, beacon: int) -> Seen:
        """Return one beacon of all."""
        return Seen(*(getattr(self, field.name)[beacon] for field in fields(self)))


class World:
    """A scenario before one sensor.

    Args:
        scenario: what there is.
        width: of the sensor, px.
        height: of the sensor, px.
        pixel_pitch_um: of its pixels.
        seed: of crowds and shake.
        origin: what errors call the scenario.

    Raises:
        ConfigError: a crowd cannot be, or something carries that does not exist; one line.
    """

    def __init__(
        self,
        scenario: Scenario,
        width: int,
        height: int,
        pixel_pitch_um: float,
        seed: int,
        origin: str = "scenario",
    ) -> None:
        self.scenario = scenario
        self.width, self.height = width, height
        camera = scenario.camera
        self.optics = Optics(camera.lens, pixel_pitch_um)
        self.projection = Projection(self.optics.f_px, width, height)
        self.beacons: list[BeaconSpec] = beacons_of(scenario, seed, origin)
        self.clutter: list[ClutterSpec] = list(scenario.clutter)
        self._camera_path = Paths([camera.path])
        self._angles = Angles(camera.attitude, camera.shake, seed)
        self._tops = Tops(scenario.assets)
        self._asset_paths = Paths([asset.path for asset in scenario.assets])
        self._reflectance = np.array([asset.reflectance for asset in scenario.assets], np.float64)
        self._emitters = _Emitters([*self.beacons, *self.clutter], scenario, origin)
        self.lights: list[LightInfo] = self._emitters.lights
        self.still_camera = self._camera_path.still and self._angles.still
        self.still_assets = self._asset_paths.still
        self._still: Geometry | None = None
        if self.still_camera and self.still_assets and self._emitters.still:
            self._still = self._geometry(_NODES_US)

    def camera(self, t_us: Floats) -> tuple[Floats, Floats]:
        """Return positions (n, 3) in m and rotations (n, 3, 3), world to camera, at (n,) times."""
        t_us = np.asarray(t_us, np.float64)
        return self._camera_path.at(t_us)[0], rotations(self._angles.at(t_us))

    def assets(self, t_us: float) -> tuple[Floats, Floats]:
        """Return corners (k, 4, 3) in m and reflectances (k,) of the assets' tops at a time, the lowest first."""
        if not self._tops.count:
            return np.zeros((0, 4, 3)), np.zeros(0)
        centre = self._asset_paths.at(np.array([t_us], np.float64))[:, 0]
        order = np.argsort(centre[:, 2], kind="stable")
        return self._tops.corners(centre)[order], self._reflectance[order]

    def mains(self) -> tuple[Floats, tuple[Mains, ...]]:
        """Return corners (k, 4, 3) in m of the rectangles that lamps on the mains light, and the lamps."""
        lamps = self.scenario.mains
        centre = np.array([(*lamp.centre_m, 0.0) for lamp in lamps], np.float64).reshape(-1, 1, 3)
        half = np.array([(*lamp.size_m, 0.0) for lamp in lamps], np.float64).reshape(-1, 1, 3) / 2.0
        signs = np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
        return centre + half * signs, lamps

    def chunk_geometry(self, t0_us: int) -> Geometry:
        """Return all lights at the nodes of [t0_us, t0_us + CHUNK_US]; t0_us is a multiple of CHUNK_US.

        The arrays may be those of the chunk before (nothing has moved): they are not to be written to.
        """
        if t0_us % CHUNK_US:
            raise ValueError(f"t0_us must be a multiple of {CHUNK_US}, not {t0_us}")
        return self._still or self._geometry(t0_us + _NODES_US)

    def seen(self, beacon: int, t_us: Floats) -> Seen:
        """Return one beacon at (n,) times in us: the truth.

        Args:
            beacon: its number in `beacons`.
            t_us: in any order. Many beacons at the same times: ask `seen_all` once.
        """
        return self._seen(np.asarray(t_us, np.float64), slice(beacon, beacon + 1)).of(0)

    def seen_all(self, t_us: Floats) -> Seen:
        """Return all beacons, (beacons, n) each, at (n,) times in us."""
        return self._seen(np.asarray(t_us, np.float64), slice(0, len(self.beacons)))

    def _seen(self, t_us: Floats, which: slice) -> Seen:
        e = self._emitters
        position, rotation = self.camera(t_us)
        assets = self._asset_paths.at(t_us)
        centre = e.centres(t_us, assets, which)
        x_px, y_px, depth = self.projection.pixels(position, rotation, centre)
        before = depth >= self.optics.nearest_m
        in_view = before & self.projection.on_sensor(x_px, y_px)
        hidden = self._tops.hides(position, assets, centre, e.carrier[which])
        z = np.where(before, depth, self.optics.nearest_m)
        sigma = self.optics.sigma_px(e.diameter[which][:, None], z)
        # Around the LED that is farthest out.
        radius = np.maximum(sigma * (FWHM_PER_SIGMA / 2.0) + e.reach[which][:, None] * self.optics.f_px / z, 1.0)
        return Seen(
            x_px, y_px, radius, in_view, in_view & ~hidden, centre[..., 0], centre[..., 1], centre[..., 2]
        )  # fmt: skip

    def _geometry(self, t_us: Floats) -> Geometry:
        e = self._emitters
        position, rotation = self.camera(t_us)
        assets = self._asset_paths.at(t_us)
        places = e.centres(t_us, assets)[e.of_light] + e.led[:, None, :]
        x_px, y_px, depth = self.projection.pixels(position, rotation, places)
        before = depth >= self.optics.nearest_m
        z = np.where(before, depth, self.optics.nearest_m)
        ray = places - position
        distance = np.maximum(np.sqrt(np.einsum("lnk,lnk->ln", ray, ray)), z)
        intensity = np.broadcast_to(e.intensity[:, None], z.shape)
        if e.directed:
            cosine = -np.einsum("lnk,lk->ln", ray, e.axis) / distance
            intensity = intensity * lobe(cosine, e.half_angle_deg[:, None])
        sigma = self.optics.sigma_px(e.diameter[e.of_light][:, None], z)
        margin = IMAGE_ENDS_SIGMA * sigma + _IMAGE_MARGIN_PX
        x_held = np.clip(np.where(before, x_px, -np.inf), -margin, self.width - 1 + margin)
        y_held = np.clip(np.where(before, y_px, -np.inf), -margin, self.height - 1 + margin)
        shown = before & (x_held == x_px) & (y_held == y_px)
        if self._tops.count:
            shown &= ~self._tops.hides(position, assets, places, e.carrier[e.of_light])
        flux = np.where(shown, self.optics.flux_w_m2(intensity, distance, z), 0.0)
        return Geometry(x_held, y_held, sigma, flux)


class _Emitters:
    """Where all emitters and their LEDs are; arrays over emitters (E) or lights (L)."""

    def __init__(self, specs: Sequence[Emitter], scenario: Scenario, origin: str) -> None:
        number = {asset.name: i for i, asset in enumerate(scenario.assets)}
        for spec in specs:
            if spec.carried_by and spec.carried_by not in number:
                raise ConfigError(
                    f"{origin}: carried_by of {spec.name} must be one of the assets"
                    f" ({', '.join(number) or 'there are none'}), not {spec.carried_by!r}"
                )
        heading = [scenario.assets[number[s.carried_by]].heading_deg if s.carried_by else 0.0 for s in specs]
        self.carrier = np.array([number[s.carried_by] if s.carried_by else -1 for s in specs], np.int64)
        self._offset = np.array(
            [turned(s.offset_m, g) if s.carried_by else (0.0, 0.0, 0.0) for s, g in zip(specs, heading, strict=True)],
            np.float64,
        ).reshape(-1, 1, 3)
        # A carried light has a path of its own only for form's sake; the asset's place is added to it.
        own: list[Path] = [s.path or Still(at_m=(0.0, 0.0, 0.0)) for s in specs]
        self._own = Paths(own)
        self.still = self._own.still
        self.diameter = np.array([s.diameter_m for s in specs], np.float64)
        self.reach = np.array([max((np.hypot(*led) for led in s.leds), default=0.0) for s in specs], np.float64)
        self.lights = [LightInfo(s.name, i, k) for i, s in enumerate(specs) for k in range(max(1, len(s.leds)))]
        self.of_light = np.array([light.emitter for light in self.lights], np.int64)
        self.led = np.array(
            [
                turned((*specs[light.emitter].leds[light.led], 0.0), heading[light.emitter])
                if specs[light.emitter].leds
                else (0.0, 0.0, 0.0)
                for light in self.lights
            ],
            np.float64,
        ).reshape(-1, 3)
        of = [specs[light.emitter] for light in self.lights]
        self.intensity = np.array([s.intensity_w_sr / max(1, len(s.leds)) for s in of], np.float64)
        self.half_angle_deg = np.array(
            [np.nan if s.half_angle_deg is None else s.half_angle_deg for s in of], np.float64
        )
        self.directed = bool((~np.isnan(self.half_angle_deg)).any())
        axis = np.array([s.axis for s in of], np.float64).reshape(-1, 3)
        self.axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)

    def centres(self, t_us: Floats, assets: Floats, which: slice = slice(None)) -> Floats:
        """Return (E, n, 3) m of the emitters, (k, n, 3) being the centres of the assets' tops."""
        places = self._own.at(t_us)[which] + self._offset[which]
        carried = np.flatnonzero(self.carrier[which] >= 0)
        places[carried] += assets[self.carrier[which][carried]]
        return places


def beacons_of(scenario: Scenario, seed: int, origin: str = "scenario") -> list[BeaconSpec]:
    """Return a scenario's beacons, those of crowds behind the others.

    Raises:
        ConfigError: a crowd cannot be; one line.
    """
    beacons = list(scenario.beacons)
    for which, crowd in enumerate(scenario.crowds):
        try:
            beacons += expanded(crowd, which, seed)
        except ValueError as error:
            raise ConfigError(f"{origin}: crowd[{which}]: {error}") from None
    return beacons
