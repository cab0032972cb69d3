"""The table of modulations: a name, and where it lives; imported only when asked for.

Each module has a class that obeys `heliograph.link.contract.Modulation`, made with keyword options
(`Seed11(parity="paper_text")`). A third party adds rows through the entry-point group `heliograph.modulations`.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import Final, cast

from heliograph.link.contract import Modulation

MODULATIONS: Final[dict[str, tuple[str, str]]] = {
    "seed11": ("heliograph.link.modulations.seed11", "Seed11"),
    "code": ("heliograph.link.modulations.code", "Code"),
    "uart": ("heliograph.link.modulations.uart", "Uart"),
    "pulse_interval": ("heliograph.link.modulations.pulse_interval", "PulseInterval"),
    "frequency": ("heliograph.link.modulations.frequency", "Frequency"),
    "ook_fast": ("heliograph.link.modulations.ook_fast", "OokFast"),
    "event_interval": ("heliograph.link.modulations.event_interval", "EventInterval"),
    "packet": ("heliograph.link.modulations.packet", "Packet"),
}
# Their frames are characters, their payloads the characters' codes.
TEXT: Final = frozenset({"uart", "ook_fast", "event_interval"})
# Tried only where a site lists its beacons, or a command line asks for it: any lamp speaks it.
LISTED_ONLY: Final = frozenset({"frequency"})
ENTRY_POINTS: Final = "heliograph.modulations"


def names() -> list[str]:
    """Return the names of all modulations, ours first."""
    others = sorted(point.name for point in entry_points(group=ENTRY_POINTS))
    return [*MODULATIONS, *(name for name in others if name not in MODULATIONS)]


def tried() -> list[str]:
    """Return the names of the modulations that "auto" tries."""
    return [name for name in names() if name not in LISTED_ONLY]


def modulation(name: str, **options: str | int) -> Modulation:
    """Return a modulation with its options.

    Raises:
        ValueError: no modulation has the name, or it refuses an option; the text names the value and the range.
    """
    if name in MODULATIONS:
        module, attribute = MODULATIONS[name]
        kind = getattr(import_module(module), attribute)
    else:
        found = [point for point in entry_points(group=ENTRY_POINTS) if point.name == name]
        if not found:
            raise ValueError(f"protocol must be one of {', '.join(names())}, not {name!r}")
        kind = found[0].load()
    try:
        return cast("Modulation", kind(**options))
    except TypeError as error:
        raise ValueError(f"protocol {name} does not take the options {sorted(options)}: {error}") from None
