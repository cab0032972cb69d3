"""Presets of sensors: TOML files in which every number says what it is worth.

::

    kind = "scan"                                       # scan | aer | images
    default_mode = "VARIABLE_5000"                      # scan alone
    [sensor]      width, height, pitch_um
    [pixel]       the fields of PixelNumbers (images: dark_w_m2 alone)
    [readout]     the fields of ScanNumbers, AerNumbers or ImageNumbers (`numbers.py`)
    [modes.NAME]  scan alone: those fields of the read-out that differ by mode

    width = { value = 640, kind = "published", source = "..." }      # kind: measured | published | assumed

An override names a table and a field: ``{"pixel.threshold_on": 0.25, "readout.latch": "step"}``.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib import resources
from pathlib import Path
from typing import Any, Final, TypeVar

from heliograph.errors import ConfigError
from heliograph_services.event_source.simulation.contract import PixelNumbers, Readout
from heliograph_services.event_source.simulation.readout.numbers import AerNumbers, ImageNumbers, ScanNumbers, Sensor

__all__ = ["AerNumbers", "ImageNumbers", "ScanNumbers", "Sensor", "Sourced", "load_preset", "names", "readout_of"]

KINDS: Final = ("measured", "published", "assumed")


@dataclass(frozen=True, slots=True)
class Rule:
    """What a field may be: a number from low to high (whole or not), or one of some words."""

    low: float = 0.0
    high: float = 0.0
    whole: bool = False
    words: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.words:
            return f"one of {', '.join(self.words)}"
        return f"{'a whole number ' if self.whole else ''}from {self.low:g} to {self.high:g}"

    def check(self, value: object) -> float | int | str | None:
        """Return the value in its type, or None where it breaks the rule."""
        if self.words:
            return value if isinstance(value, str) and value in self.words else None
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        number = float(value)
        if not math.isfinite(number) or not self.low <= number <= self.high or (self.whole and number % 1.0):
            return None
        return int(number) if self.whole else number


SENSOR: Final = {
    "width": Rule(8, 4096, whole=True),
    "height": Rule(8, 4096, whole=True),
    "pitch_um": Rule(0.5, 100.0),
}
PIXEL: Final = {
    "threshold_on": Rule(0.01, 5.0),
    "threshold_off": Rule(0.01, 5.0),
    "threshold_sd": Rule(0.0, 1.0),
    "tau_ref_us": Rule(0.01, 1e6),
    "irradiance_ref_w_m2": Rule(1e-9, 1e4),
    "tau_min_us": Rule(0.01, 1e6),
    "dark_w_m2": Rule(1e-9, 1e3),
    "refractory_us": Rule(0.0, 1e6),
    "leak_hz": Rule(0.0, 1e3),
    "shot_noise_hz": Rule(0.0, 1e3),
    "hot_pixels": Rule(0.0, 0.1),
    "hot_pixel_hz": Rule(0.0, 1e4),
    "latency_us": Rule(0.0, 1e5),
    "latency_off_extra_us": Rule(0.0, 1e5),
    "jitter_us": Rule(0.0, 1e4),
}
SCAN: Final = {
    "clock_ns": Rule(1, 1000, whole=True),
    "group_px": Rule(1, 4096, whole=True),
    "group_cycles": Rule(0, 1000, whole=True),
    "column_cycles": Rule(0, 1000, whole=True),
    "next_sel_cycles": Rule(1, 1000, whole=True),
    "detect_us": Rule(0.0, 1e5),
    "fixed_us": Rule(0.0, 1e5),
    "stretch_us": Rule(0.0, 1e4),
    "latch": Rule(words=("first", "net", "step")),
    "sample": Rule(words=("hold", "column")),
    "stamp": Rule(words=("start", "column", "end")),
}
AER: Final = {
    "bus_hz": Rule(1e3, 1e10),
    "queue_events": Rule(1, 16_777_216, whole=True),
    "resolution_us": Rule(1, 1000, whole=True),
}
IMAGES: Final = {
    "image_hz": Rule(1.0, 10_000.0),
    "threshold_grey": Rule(0.0, 254.0),
    "exposure_us": Rule(0.0, 1e6),
    "grey_per_w_m2": Rule(0.0, 1e9),
    "background_grey": Rule(1.0, 254.0),
    "reference": Rule(words=("changed", "last")),
    "delay_us": Rule(0.0, 1e6),
    "jitter_us": Rule(0.0, 1e5),
}
READOUTS: Final = {"scan": SCAN, "aer": AER, "images": IMAGES}

# What an images sensor has for pixels: nothing in it reads these; they are harmless if anything did.
NO_PIXEL: Final = PixelNumbers(
    threshold_on=0.2,
    threshold_off=0.2,
    threshold_sd=0.0,
    tau_ref_us=1.0,
    irradiance_ref_w_m2=1.0,
    tau_min_us=1.0,
    dark_w_m2=1e-3,
    refractory_us=0.0,
    leak_hz=0.0,
    shot_noise_hz=0.0,
    hot_pixels=0.0,
    hot_pixel_hz=0.0,
    latency_us=0.0,
    latency_off_extra_us=0.0,
    jitter_us=0.0,
)


@dataclass(frozen=True, slots=True)
class Sourced:
    """A number of a preset, or a word, and what it is worth.

    Args:
        value: the number, or the word.
        kind: `measured` (by us, on data that we name), `published`, or `assumed`.
        source: where it is from; of an assumed one the reason for the value.
    """

    value: float | int | str
    kind: str
    source: str


@dataclass(frozen=True, slots=True)
class Preset:
    """A preset's file, checked: `tables` by name (sensor, pixel, readout, modes.NAME), then by field."""

    name: str
    about: str
    kind: str
    default_mode: str
    tables: dict[str, dict[str, Sourced]]

    def modes(self) -> list[str]:
        """Return the names of its read-out modes, in the file's order."""
        return [table.removeprefix("modes.") for table in self.tables if table.startswith("modes.")]


def names() -> list[str]:
    """Return the names of the presets that come with the simulation."""
    return sorted(entry.name[:-5] for entry in _folder().iterdir() if entry.name.endswith(".toml"))


def load_preset(name: str, mode: str = "", override: Mapping[str, float | str] | None = None) -> Sensor:
    """Return a sensor.

    Args:
        name: of a preset, or the path of a TOML file.
        mode: of its read-out; empty: the preset's default.
        override: new values by "table.field".

    Raises:
        ConfigError: there is no such preset, mode or field, or a value is out of range; one line says which.
    """
    preset = read_preset(name)
    tables = {table: {key: item.value for key, item in entries.items()} for table, entries in preset.tables.items()}
    chosen = mode or preset.default_mode
    readout = tables["readout"]
    if chosen and chosen not in preset.modes():
        known = ", ".join(preset.modes()) or "none"
        raise ConfigError(f"preset {preset.name}: mode must be one of its modes ({known}), not {chosen!r}")
    if chosen:
        readout.update(tables[f"modes.{chosen}"])
    rules = _rules(preset.kind)
    for key, value in (override or {}).items():
        table, _, field = key.partition(".")
        if table not in rules or field not in rules[table]:
            raise ConfigError(f"preset {preset.name}: override {key!r} must name a field such as {_some(rules)}")
        tables[table][field] = _checked(preset.name, key, rules[table][field], value)
    return _sensor(preset, chosen, tables)


def read_preset(name: str) -> Preset:
    """Return a preset with the sources of its numbers.

    Raises:
        ConfigError: there is no such preset, or its file is not sound; one line says what is wrong.
    """
    if name in names():
        text = (_folder() / f"{name}.toml").read_text(encoding="utf-8")
    else:
        try:
            text = Path(name).read_text(encoding="utf-8")
        except (OSError, ValueError):
            raise ConfigError(f"sensor must be one of {', '.join(names())} or a TOML file, not {name!r}") from None
    return parse_preset(text, name)


def parse_preset(text: str, name: str) -> Preset:
    """Return the preset of a TOML text.

    Raises:
        ConfigError: it is none; one line names the preset, the field, the value and what is allowed.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"preset {name}: {' '.join(str(error).split())}") from None
    kind = data.pop("kind", None)
    if kind not in READOUTS:
        raise ConfigError(f"preset {name}: kind must be one of {', '.join(READOUTS)}, not {kind!r}")
    about, default_mode = data.pop("about", ""), data.pop("default_mode", "")
    for key, value in (("about", about), ("default_mode", default_mode)):
        if not isinstance(value, str):
            raise ConfigError(f"preset {name}: {key} must be text, not {value!r}")
    modes = data.pop("modes", {}) if kind == "scan" else {}
    if not isinstance(modes, dict):
        raise ConfigError(f"preset {name}: modes must be a table, not {modes!r}")
    rules = _rules(kind)
    for table in data:
        if table not in rules:
            raise ConfigError(f"preset {name}: {table!r} must be one of {', '.join(rules)}, modes, about, default_mode")
    varying = {field for mode in modes.values() if isinstance(mode, dict) for field in mode}
    tables: dict[str, dict[str, Sourced]] = {}
    for table, fields_of in rules.items():
        wanted = [field for field in fields_of if table != "readout" or field not in varying]
        tables[table] = _table(name, table, data.get(table, {}), fields_of, wanted)
    for mode, entries in modes.items():
        tables[f"modes.{mode}"] = _table(name, f"modes.{mode}", entries, rules["readout"], sorted(varying))
    preset = Preset(name, about, kind, default_mode, tables)
    if (default_mode or modes) and default_mode not in preset.modes():
        raise ConfigError(f"preset {name}: default_mode must be one of {preset.modes()}, not {default_mode!r}")
    return preset


def readout_of(sensor: Sensor, seed: int) -> Readout:
    """Return a fresh read-out of a sensor that has event pixels.

    Args:
        sensor: of the kind scan or aer.
        seed: of the scan's phase against the scene.

    Raises:
        ConfigError: the sensor compares images; `ground.images` does that.
    """
    if isinstance(sensor.readout, ScanNumbers):
        from heliograph_services.event_source.simulation.random import SCAN, uniforms  # noqa: PLC0415  (numba)
        from heliograph_services.event_source.simulation.readout.scan import ScanReadout  # noqa: PLC0415  (numba)

        return ScanReadout(sensor.readout, sensor.width, sensor.height, float(uniforms(seed, SCAN, 0)))
    if isinstance(sensor.readout, AerNumbers):
        from heliograph_services.event_source.simulation.readout.aer import AerReadout  # noqa: PLC0415  (numba)

        return AerReadout(sensor.readout, sensor.width, sensor.height)
    raise ConfigError(f"preset {sensor.name}: an images camera has no read-out of pixels")


def _rules(kind: str) -> dict[str, dict[str, Rule]]:
    pixel = {"dark_w_m2": PIXEL["dark_w_m2"]} if kind == "images" else PIXEL
    return {"sensor": SENSOR, "pixel": pixel, "readout": READOUTS[kind]}


def _some(rules: Mapping[str, Mapping[str, Rule]]) -> str:
    return ", ".join(f"{table}.{field}" for table in ("pixel", "readout") for field in list(rules[table])[:3])


def _checked(name: str, key: str, rule: Rule, value: object) -> float | int | str:
    checked = rule.check(value)
    if checked is None:
        raise ConfigError(f"preset {name}: {key} must be {rule}, not {value!r}")
    return checked


def _table(name: str, table: str, entries: object, rules: Mapping[str, Rule], wanted: list[str]) -> dict[str, Sourced]:
    if not isinstance(entries, dict):
        raise ConfigError(f"preset {name}: {table} must be a table, not {entries!r}")
    for field in entries:
        if field not in wanted:
            raise ConfigError(f"preset {name}: {table}.{field} must be one of {', '.join(wanted)}")
    checked = {}
    for field in wanted:
        if field not in entries:
            raise ConfigError(f"preset {name}: {table}.{field} must be given ({rules[field]})")
        checked[field] = _sourced(name, f"{table}.{field}", rules[field], entries[field])
    return checked


def _sourced(name: str, key: str, rule: Rule, entry: object) -> Sourced:
    if not isinstance(entry, dict) or set(entry) != {"value", "kind", "source"}:
        raise ConfigError(f"preset {name}: {key} must be {{ value, kind, source }}, not {entry!r}")
    if entry["kind"] not in KINDS:
        raise ConfigError(f"preset {name}: {key} kind must be one of {', '.join(KINDS)}, not {entry['kind']!r}")
    source = entry["source"]
    if not isinstance(source, str) or not source.strip():
        raise ConfigError(f"preset {name}: {key} source must say where the number is from, not {source!r}")
    return Sourced(_checked(name, key, rule, entry["value"]), entry["kind"], source)


_Numbers = TypeVar("_Numbers", PixelNumbers, ScanNumbers, AerNumbers, ImageNumbers)


def _numbers(cls: type[_Numbers], values: Mapping[str, Any]) -> _Numbers:
    """Return the record; the rules have checked that each value has its field's type."""
    return cls(**{field.name: values[field.name] for field in fields(cls)})


def _sensor(preset: Preset, mode: str, tables: Mapping[str, Mapping[str, Any]]) -> Sensor:
    readout: ScanNumbers | AerNumbers | ImageNumbers
    if preset.kind == "scan":
        readout = _numbers(ScanNumbers, {**tables["readout"], "mode": mode})
        if 0.0 < readout.fixed_us <= readout.detect_us:
            raise ConfigError(
                f"preset {preset.name}: readout.fixed_us must be 0 or more than readout.detect_us = "
                f"{readout.detect_us:g}, not {readout.fixed_us:g}"
            )
        kind = "scan"
    elif preset.kind == "aer":
        readout, kind = _numbers(AerNumbers, tables["readout"]), "aer"
    else:
        readout, kind = _numbers(ImageNumbers, tables["readout"]), "images"
    pixel = tables["pixel"]
    sensor = tables["sensor"]
    return Sensor(
        name=preset.name,
        width=sensor["width"],
        height=sensor["height"],
        pitch_um=sensor["pitch_um"],
        kind=kind,  # type: ignore[arg-type]  # one of READOUTS
        pixel=replace(NO_PIXEL, **pixel) if kind == "images" else _numbers(PixelNumbers, pixel),
        readout=readout,
    )


def _folder() -> Any:
    return resources.files(__package__) / "presets"
