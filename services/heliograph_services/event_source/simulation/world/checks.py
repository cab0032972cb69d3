"""What a scenario must hold that its tables alone do not say: IDs that can be sent, a scene to see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from heliograph.errors import ConfigError, FileError
from heliograph.events import Flags
from heliograph.link.modulations import modulation
from heliograph.units import US_PER_S
from heliograph_services.event_source.simulation.contract import NODE_US, Floats
from heliograph_services.event_source.simulation.world.crowd import sendable
from heliograph_services.event_source.simulation.world.spec import BeaconSpec, Scenario
from heliograph_services.event_source.simulation.world.text import frames_of_text
from heliograph_services.event_source.simulation.world.world import World

# An image that goes farther than this between two nodes (1 ms) is no longer where a straight line has it.
SPEED_LIMIT_PX_S: Final = 20_000.0
# A quarter of the largest sensor's side. Beyond it an image is no spot, and its pixels cost more than all the rest.
SIGMA_LIMIT_PX: Final = 250.0
# Tangent of the angle between axis and corner: 76 degrees. No lens that images straight lines straight sees more.
FIELD_LIMIT: Final = 4.0
# The story is looked at every 20 ms, or at so many moments if it is longer.
_EVERY_US: Final = 20_000.0
_MOMENTS: Final = 1_000
_AT_ONCE: Final = 100


def check_tables(scenario: Scenario, origin: str) -> None:
    """Check what needs no sensor.

    Raises:
        ConfigError: one line with key, value and range.
    """
    _check_names("asset", [asset.name for asset in scenario.assets], origin)
    assets = {asset.name for asset in scenario.assets}
    for table, specs in (("beacon", scenario.beacons), ("clutter", scenario.clutter)):
        for i, spec in enumerate(specs):
            if spec.carried_by and spec.carried_by not in assets:
                known = ", ".join(sorted(assets)) or "of which there are none"
                raise ConfigError(
                    f"{origin}: {table}[{i}].carried_by must be one of the assets ({known}), not {spec.carried_by!r}"
                )
    for i, beacon in enumerate(scenario.beacons):
        problem = _unsendable(beacon)
        if problem:
            raise ConfigError(f"{origin}: beacon[{i}] ({beacon.name}): {problem}")
    lens = scenario.camera.lens
    if lens.focus_m is not None and lens.focus_m * 1e3 < 2.0 * lens.focal_mm:
        raise ConfigError(
            f"{origin}: camera.lens.focus_m must be at least twice the focal length,"
            f" {2e-3 * lens.focal_mm:g} m, not {lens.focus_m:g}"
        )


def check_names(world: World, origin: str) -> None:
    """Check that no two lights share a name, those of crowds included.

    Raises:
        ConfigError: two do.
    """
    _check_names("beacon or clutter", [spec.name for spec in (*world.beacons, *world.clutter)], origin)


def check_view(world: World, origin: str) -> None:
    """Check that the camera, during the scenario's duration, sees what it is to see.

    Raises:
        ConfigError: one line with key, value and range.
    """
    corner = np.hypot(world.projection.cx_px, world.projection.cy_px) / world.projection.f_px
    if corner > FIELD_LIMIT:
        least_mm = world.scenario.camera.lens.focal_mm * corner / FIELD_LIMIT
        raise ConfigError(
            f"{origin}: camera.lens.focal_mm must be at least {least_mm:.3g} with this sensor"
            f" ({world.width}x{world.height}, {world.optics.pitch_um:g} um),"
            f" not {world.scenario.camera.lens.focal_mm:g}"
        )
    duration_us = world.scenario.duration_s * US_PER_S
    moments = np.linspace(0.0, duration_us, int(min(_MOMENTS, duration_us / _EVERY_US)) + 2)
    _check_camera(world, moments, origin)
    if world.beacons:
        _check_beacons(world, moments, origin)


def _check_camera(world: World, t_us: Floats, origin: str) -> None:
    z = world.camera(t_us)[0][:, 2]
    worst = int(np.argmin(z))
    least = world.optics.nearest_m
    if not z[worst] >= least:
        raise ConfigError(
            f"{origin}: camera.path must stay above the ground (z at least {least:g} m, 5 focal lengths),"
            f" not come to {z[worst]:.4g} m at {t_us[worst] / US_PER_S:.4g} s"
        )


@dataclass(slots=True)
class _Story:
    """What becomes of every beacon (b) over the duration."""

    seen: Flags  # (b,) on the sensor at some time
    lowest_m: Floats
    nearest_m: Floats  # of those moments when it is in the camera's field
    fastest_px_s: Floats
    largest_px: Floats


def _check_beacons(world: World, moments: Floats, origin: str) -> None:
    story = _story(world, moments)
    for i, spec in enumerate(world.beacons):
        # A crowd's beacon has no table of its own.
        where = f"{origin}: beacon[{i}] ({spec.name})" if i < len(world.scenario.beacons) else f"{origin}: {spec.name}"
        for problem in _problems(world, story, i):
            raise ConfigError(f"{where} {problem}")


def _problems(world: World, story: _Story, i: int) -> Iterator[str]:
    duration_s = world.scenario.duration_s
    if story.lowest_m[i] < 0.0:
        yield f"must stay on or above the ground (z at least 0 m), not come to {story.lowest_m[i]:.4g} m"
    if story.nearest_m[i] < world.optics.nearest_m:
        yield (
            f"must stay at least {world.optics.nearest_m:g} m (5 focal lengths) from the camera,"
            f" not come within {story.nearest_m[i]:.4g} m"
        )
    if not story.seen[i]:
        yield (
            f"must be on the sensor ({world.width}x{world.height} px) at some time of its"
            f" {duration_s:g} s (duration_s), but its path never comes there"
        )
    if story.fastest_px_s[i] > SPEED_LIMIT_PX_S:
        yield f"must move at most {SPEED_LIMIT_PX_S:g} px/s over the sensor, not {story.fastest_px_s[i]:.0f}"
    if story.largest_px[i] > SIGMA_LIMIT_PX:
        yield (
            f"must have an image of at most {SIGMA_LIMIT_PX:g} px (standard deviation), not {story.largest_px[i]:.0f}:"
            " it is too large, too near, or too far out of focus"
        )


def _story(world: World, moments: Floats) -> _Story:
    n = len(world.beacons)
    story = _Story(np.zeros(n, np.bool_), np.full(n, np.inf), np.full(n, np.inf), np.zeros(n), np.zeros(n))
    for first in range(0, len(moments), _AT_ONCE):
        t_us = moments[first : first + _AT_ONCE]
        now, soon = world.seen_all(t_us), world.seen_all(t_us + NODE_US)
        story.seen |= now.in_view.any(axis=1)
        story.lowest_m = np.minimum(story.lowest_m, now.z_m.min(axis=1))
        position, rotation = world.camera(t_us)
        ray = np.stack([now.x_m, now.y_m, now.z_m], axis=-1) - position
        depth = np.einsum("nk,bnk->bn", rotation[:, 2], ray)
        distance = np.sqrt(np.einsum("bnk,bnk->bn", ray, ray))
        before = np.where(depth > 0.0, distance, np.inf)
        story.nearest_m = np.minimum(story.nearest_m, before.min(axis=1))
        speed = np.hypot(soon.x_px - now.x_px, soon.y_px - now.y_px) / (NODE_US / US_PER_S)
        both = now.in_view & soon.in_view
        story.fastest_px_s = np.maximum(story.fastest_px_s, np.where(both, speed, 0.0).max(axis=1))
        diameter = np.array([spec.diameter_m for spec in world.beacons])[:, None]
        sigma = world.optics.sigma_px(diameter, np.maximum(depth, world.optics.nearest_m))
        story.largest_px = np.maximum(story.largest_px, np.where(now.in_view, sigma, 0.0).max(axis=1))
    return story


def _check_names(what: str, names: list[str], origin: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ConfigError(f"{origin}: every {what} must have a name of its own, but two are called {name!r}")
        seen.add(name)


def _unsendable(spec: BeaconSpec) -> str | None:
    """Return why a beacon cannot send what it is to send, or None."""
    what = "this"
    try:
        kind: Any = modulation(spec.protocol, **spec.options)
        if spec.text is not None:
            what = f"text {spec.text[:20]!r}"
            frames_of_text(kind, spec)
        elif spec.payload is not None:
            what = f"payload {spec.payload}"
            kind.encode(spec.payload)
        elif spec.fresh:
            what = "fresh payloads"
            if not sendable(spec.protocol, spec.options):
                return f"fresh must be false: {spec.protocol} has no payloads to draw from"
    except (ValueError, FileError) as error:
        return " ".join(str(error).split())
    except (TypeError, AttributeError):
        return f"protocol {spec.protocol} cannot send {what}: it sends {'text' if spec.text is None else 'payloads'}"
    return None
