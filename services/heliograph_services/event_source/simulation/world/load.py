"""Scenarios by name or file: read, checked as a whole, refused in one line.

Built-in scenarios are the files in `scenarios/`; copy one to begin your own. `spec.py` says what a file may say.
"""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path as FilePath
from typing import Any

import msgspec

from heliograph.errors import ConfigError
from heliograph.site import Beacon
from heliograph_services.event_source.simulation.readout.presets import load_preset
from heliograph_services.event_source.simulation.world.checks import check_names, check_tables, check_view
from heliograph_services.event_source.simulation.world.explain import explained, not_finite
from heliograph_services.event_source.simulation.world.spec import Scenario
from heliograph_services.event_source.simulation.world.world import World, beacons_of


def built_in() -> list[str]:
    """Return the names of the built-in scenarios."""
    return sorted(entry.name[:-5] for entry in _folder().iterdir() if entry.name.endswith(".toml"))


def load_scenario(name: str) -> Scenario:
    """Return a built-in scenario, or the one of a file.

    Args:
        name: of a built-in scenario, or the path of a TOML file.

    Raises:
        ConfigError: neither exists, or the file is no scenario; one line says where.
    """
    if name in built_in():
        text = (_folder() / f"{name}.toml").read_text(encoding="utf-8")
    else:
        try:
            text = FilePath(name).read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            if isinstance(error, UnicodeDecodeError):
                raise ConfigError(f"scenario {name}: not UTF-8") from None
            raise ConfigError(f"scenario must be one of {', '.join(built_in())} or a TOML file, not {name!r}") from None
    return parse_scenario(text, name)


def parse_scenario(text: str, origin: str) -> Scenario:
    """Return the scenario of a TOML text.

    Raises:
        ConfigError: it is none; the text names the key, its value and what is allowed.
    """
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"scenario {origin}: {' '.join(str(error).split())}") from None
    return scenario_of(data, f"scenario {origin}")


def scenario_of(data: dict[str, Any], origin: str = "scenario") -> Scenario:
    """Return the scenario of a file's tables.

    Raises:
        ConfigError: it is none; the text names the key, its value and what is allowed.
    """
    problem = not_finite(data)
    if problem:
        raise ConfigError(f"{origin}: {problem}")
    try:
        scenario = msgspec.convert(data, Scenario, strict=True)
    except (msgspec.ValidationError, ValueError) as error:
        raise ConfigError(f"{origin}: {explained(error, data, Scenario)}") from None
    check_scenario(scenario, origin)
    return scenario


def check_scenario(scenario: Scenario, origin: str = "scenario") -> None:
    """Check a scenario before its sensor: also one that was changed after it was read (another sensor, another mode).

    Raises:
        ConfigError: the text names the key, its value and what is allowed.
    """
    check_tables(scenario, origin)
    camera = scenario.camera
    try:
        sensor = load_preset(camera.sensor, camera.mode, camera.override)
    except ConfigError as error:
        raise ConfigError(f"{origin}: camera.sensor: {error}") from None
    # Seed 0: a crowd's places depend on the seed, but not on which part of its area they lie.
    world = World(scenario, sensor.width, sensor.height, sensor.pitch_um, 0, origin)
    check_names(world, origin)
    check_view(world, origin)


def site_beacons(scenario: Scenario) -> list[Beacon]:
    """Return the beacons as a site file lists them, those of crowds included; without the payload where it changes."""
    return [
        Beacon(
            name=spec.name,
            protocol=spec.protocol,
            bit_rate=spec.bit_rate,
            payload=spec.payload,
            options=dict(spec.options),
        )
        for spec in beacons_of(scenario, 0)
    ]


def _folder() -> FilePath:
    return FilePath(str(files("heliograph_services.event_source.simulation.world"))) / "scenarios"
