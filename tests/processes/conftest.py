"""The scene that the process tests share, made once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from support.scene import Scene, listed_beacons

SITES = Path(__file__).parents[2] / "deploy" / "sites"


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return three seconds of the scene "five"."""
    path = tmp_path_factory.mktemp("scene") / "five.npz"
    command = [sys.executable, "-m", "heliograph_services.cli", "simulate", "five", "-o", str(path), "--duration", "3"]
    subprocess.run(command, check=True, timeout=110)
    return Scene(path, *listed_beacons(SITES / "laptop.toml"))
