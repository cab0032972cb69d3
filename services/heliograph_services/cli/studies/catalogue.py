"""The studies of `heliograph evaluate`: a table of modules, each imported only when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import Final

from heliograph.errors import ConfigError
from heliograph_services.cli.studies.study import Study

# In the order of docs/results.md.
STUDIES: Final[dict[str, str]] = {
    "scene": "a picture: a flight, with what was decoded",
    "bit_rate": "MAR at 50 cm over bit rate, in every read-out mode",
    "distance": "MAR over distance, indoors and in the sun; R95",
    "moving": "moving beacons: 2 m/s; a flight, with flow or not",
    "methods": "methods on one scene: throughput, tracking, range",
    "wavelength": "the LED's wavelength and half angle, in the sun",
    "recordings": "characters of real recordings, thinned",
    "false_alarms": "false alarms and confusions: clutter, noise, a room",
    "crowd_size": "1 to 200 beacons at once",
    "distribution": "the tracker behind a slow link, with real processes",
}
# About how many CPU seconds a full and a quick run take on a core of two shared ones (x86, 2026): from whole runs.
COST_S: Final[dict[str, tuple[int, int]]] = {
    "scene": (20, 10),
    "bit_rate": (2050, 20),
    "distance": (2200, 20),
    "moving": (1700, 10),
    "methods": (530, 10),
    "wavelength": (75, 1),
    "recordings": (35, 10),
    "false_alarms": (2700, 20),
    "crowd_size": (850, 20),
    "distribution": (1150, 50),
}
_PACKAGE: Final = "heliograph_services.cli.studies"


def load(name: str) -> Study:
    """Return a study.

    Raises:
        ConfigError: there is none of that name.
    """
    if name not in STUDIES:
        raise ConfigError(f"a study must be one of {', '.join(STUDIES)}, not {name!r}")
    study: Study = import_module(f"{_PACKAGE}.{name}").STUDY
    return study
