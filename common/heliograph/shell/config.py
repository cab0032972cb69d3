"""Settings of a service: defaults < site file < environment < flags, each with its origin.

A service's settings are one frozen `msgspec.Struct`; ranges stand in its annotations. A field `bit_rate` of the decoder
is `bit_rate = ...` in its `[[service]]`, `HELIOGRAPH_DECODER_BIT_RATE` in the environment and `--bit-rate` as a flag.
A field `beacons` is filled from the site's `[[beacon]]` tables.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import msgspec

from heliograph.errors import ConfigError
from heliograph.shell.site import ServiceEntry, Site

ConfigT = TypeVar("ConfigT", bound=msgspec.Struct)
_FROM_SITE: Final = "beacons"


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a setting's value comes from: "default", "FILE", "$VARIABLE" or "--flag"."""

    value: Any
    where: str


def variable(kind: str, field: str) -> str:
    """Return the name of a setting's environment variable."""
    return f"HELIOGRAPH_{kind}_{field}".upper()


def add_flags(parser: argparse.ArgumentParser, config_type: type[msgspec.Struct]) -> None:
    """Add a flag for each setting; flags that are not given stay absent, so that they override nothing."""
    group = parser.add_argument_group("settings", "each may also stand in the site file or the environment")
    for field in msgspec.structs.fields(config_type):
        if field.name == _FROM_SITE:
            continue
        group.add_argument(
            "--" + field.name.replace("_", "-"),
            dest=f"setting_{field.name}",
            default=argparse.SUPPRESS,
            metavar="VALUE",
            help=_help(field),
        )


def given_flags(arguments: argparse.Namespace) -> dict[str, str]:
    """Return the settings that were given as flags."""
    return {name[8:]: value for name, value in vars(arguments).items() if name.startswith("setting_")}


def resolve(
    config_type: type[ConfigT],
    entry: ServiceEntry,
    site: Site,
    environment: Mapping[str, str],
    flags: Mapping[str, str],
) -> tuple[ConfigT, dict[str, Origin]]:
    """Return the settings of a process, and where each comes from.

    Raises:
        ConfigError: an unknown setting, a wrong type, or a value out of range; names the origin.
    """
    fields = {field.name: field for field in msgspec.structs.fields(config_type)}
    where = f"{site.path} [[service]] {entry.kind}/{entry.instance}"
    unknown = [name for name in entry.settings if name not in fields or name == _FROM_SITE]
    if unknown:
        known = ", ".join(name for name in fields if name != _FROM_SITE)
        raise ConfigError(f"{where}: unknown setting {unknown[0]!r}; known: {known}")
    origins = {name: Origin(_default(field), "default") for name, field in fields.items()}
    for name, value in entry.settings.items():
        origins[name] = Origin(_converted(fields[name], value, f"{where}: {name}", text=False), site.path)
    for name, field in fields.items():
        text = environment.get(variable(entry.kind, name))
        if text is not None and name != _FROM_SITE:
            label = "$" + variable(entry.kind, name)
            origins[name] = Origin(_converted(field, text, label, text=True), label)
    for name, text in flags.items():
        label = "--" + name.replace("_", "-")
        origins[name] = Origin(_converted(fields[name], text, label, text=True), label)
    if _FROM_SITE in fields:
        origins[_FROM_SITE] = Origin(site.beacon, site.path or "default")
    try:
        config = config_type(**{name: origin.value for name, origin in origins.items()})
    except (ValueError, TypeError) as error:  # a rule between several settings, from __post_init__
        raise ConfigError(f"{where}: {error}") from None
    return config, origins


def _default(field: msgspec.structs.FieldInfo) -> Any:
    if field.default is not msgspec.NODEFAULT:
        return field.default
    if field.default_factory is not msgspec.NODEFAULT:
        return field.default_factory()
    raise TypeError(f"setting {field.name} has no default")


def _converted(field: msgspec.structs.FieldInfo, value: Any, label: str, *, text: bool) -> Any:
    """Return the value in the field's type; text from the environment or a flag is read leniently."""
    try:
        return msgspec.convert(value, field.type, strict=not text)
    except msgspec.ValidationError as error:
        if text:
            try:
                return msgspec.convert(tomllib.loads(f"v = {value}")["v"], field.type, strict=True)
            except (tomllib.TOMLDecodeError, msgspec.ValidationError):
                pass
        raise ConfigError(f"{label}: {error}, not {value!r}") from None


def _help(field: msgspec.structs.FieldInfo) -> str:
    info = msgspec.inspect.type_info(field.type)
    description = ""
    if isinstance(info, msgspec.inspect.Metadata):
        description = str((info.extra_json_schema or {}).get("description", ""))
    default = _default(field)
    return f"{description} (default: {default})".strip().replace("%", "%%")
