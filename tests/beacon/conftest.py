"""Where the firmware of these tests is built, once."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of what is built."""
    return tmp_path_factory.mktemp("firmware")
