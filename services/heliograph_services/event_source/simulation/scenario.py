"""A scenario: which beacons move how over which sensor, and how noisy it is.

Data (TOML), built in or a user's own::

    about = "..."      width, height (px)      noise_hz (events/s of the whole sensor)
    latency_us (of every event behind its cause)      jitter_us (standard deviation of it)
    [[beacon]]         name, protocol, payload or text, bit_rate, options,
                       radius_px, events_per_edge, gap_bits, start_us
    [beacon.path]      kind = "still" | "sine" | "waypoints" (paths.py)

Built-in scenarios are the files in `scenarios/`; copy one to begin your own.
"""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path as FilePath
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from heliograph.errors import ConfigError
from heliograph.messages import Name, Payload, Side
from heliograph.site import Beacon
from heliograph.units import BIT_RATE_MAX, BIT_RATE_MIN
from heliograph_services.event_source.simulation.paths import Path

# 10 px in a step of motion (1 ms): beyond it the disc would jump over itself, and no lens shows such a thing.
SPEED_LIMIT_PX_S: Final = 10_000.0


class BeaconSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One beacon of a scenario.

    Args:
        name: as in a site file.
        protocol: a row of `heliograph.link.modulations`.
        bit_rate: bits a second.
        path: its motion.
        payload: what it sends, over and over; or
        text: what it sends, a frame a character, over and over.
        options: of the modulation.
        radius_px: of its disc.
        events_per_edge: fewest and most events that a change of its light makes in a pixel.
        gap_bits: bits of the last level between two rounds.
        start_us: when a round begins; before, it sends the same (scenes begin in the middle of things).
    """

    name: Name
    protocol: Name
    bit_rate: Annotated[float, Meta(ge=BIT_RATE_MIN, le=BIT_RATE_MAX)]
    path: Path
    payload: Payload | None = None
    text: Annotated[str, Meta(max_length=10_000)] | None = None
    options: dict[str, str | int] = {}
    radius_px: Annotated[float, Meta(ge=0.5, le=100.0)] = 3.0
    events_per_edge: tuple[Annotated[int, Meta(ge=1, le=20)], Annotated[int, Meta(ge=1, le=20)]] = (1, 3)
    gap_bits: Annotated[int, Meta(ge=0, le=100_000)] = 0
    start_us: Annotated[int, Meta(ge=0, le=10**9)] = 0

    def __post_init__(self) -> None:
        if (self.payload is None) == (self.text is None):
            raise ValueError(f"beacon {self.name} must have either payload or text")
        if self.events_per_edge[0] > self.events_per_edge[1]:
            raise ValueError(f"events_per_edge must be [fewest, most], not {list(self.events_per_edge)}")
        if self.path.speed_px_s() > SPEED_LIMIT_PX_S:
            raise ValueError(
                f"beacon {self.name} must move at most {SPEED_LIMIT_PX_S:g} px/s, not {self.path.speed_px_s():.0f}"
            )

    @property
    def beacon(self) -> Beacon:
        """The beacon as a site file lists it."""
        return Beacon(
            name=self.name,
            protocol=self.protocol,
            bit_rate=self.bit_rate,
            payload=self.payload,
            options=dict(self.options),
        )


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scene; see the module."""

    about: str = ""
    width: Side = 640
    height: Side = 480
    noise_hz: Annotated[float, Meta(ge=0.0, le=1e8)] = 20_000.0
    latency_us: Annotated[float, Meta(ge=0.0, le=2000.0)] = 60.0
    jitter_us: Annotated[float, Meta(ge=0.0, le=500.0)] = 30.0
    beacons: Annotated[tuple[BeaconSpec, ...], Meta(max_length=1000)] = msgspec.field(name="beacon", default=())

    def __post_init__(self) -> None:
        names = [spec.name for spec in self.beacons]
        if len(set(names)) != len(names):
            raise ValueError(f"beacons must have names of their own, not {names}")


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
        except OSError:
            raise ConfigError(f"scenario must be one of {', '.join(built_in())} or a TOML file, not {name!r}") from None
        except UnicodeDecodeError:
            raise ConfigError(f"scenario {name}: not UTF-8") from None
    return parse_scenario(text, name)


def parse_scenario(text: str, origin: str) -> Scenario:
    """Return the scenario of a TOML text.

    Raises:
        ConfigError: it is none; the text names the field and what is allowed.
    """
    try:
        return msgspec.convert(tomllib.loads(text), Scenario, strict=True)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, ValueError) as error:
        raise ConfigError(f"scenario {origin}: {' '.join(str(error).split())}") from None


def _folder() -> FilePath:
    return FilePath(str(files("heliograph_services.event_source.simulation"))) / "scenarios"
