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
}
ENTRY_POINTS: Final = "heliograph.modulations"


def names() -> list[str]:
    """Return the names of all modulations, ours first."""
    others = sorted(point.name for point in entry_points(group=ENTRY_POINTS))
    return [*MODULATIONS, *(name for name in others if name not in MODULATIONS)]


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
