"""The firmware, built once for a run of the tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from support.firmware import Script, build


@pytest.fixture(scope="session")
def script_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the core on a clock of the tests' own, warning-free or not at all."""
    return build("script", tmp_path_factory.mktemp("script")) / "beacon-script"


@pytest.fixture
def beacon(script_program: Path) -> Iterator[Script]:
    """Return a beacon, greeted."""
    with Script(script_program) as script:
        script.host.hello()
        yield script


@pytest.fixture(scope="session")
def avr_machine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the program that runs simavr, and the AVR port's firmware."""
    folder = build("avr", tmp_path_factory.mktemp("avr"))
    return folder / "simavr_run", folder / "beacon-avr.elf"
