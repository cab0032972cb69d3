"""The built-in scene as a recording, for tests that run real processes on it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Scene:
    """A recording, the site's beacons as TOML, and their names."""

    path: Path
    beacons: str
    names: frozenset[str]


def listed_beacons(site_file: Path) -> tuple[str, frozenset[str]]:
    """Return the `[[beacon]]` tables of a site file as text, and the names in them."""
    text = site_file.read_text()
    beacons = text[text.index("[[beacon]]") :]
    names = (line.split("=", 1)[1] for line in beacons.splitlines() if line.startswith("name"))
    return beacons, frozenset(json.loads(name) for name in names)
