"""The compiled parts: loaded only where something is received, and never older than their sources."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

from heliograph.link.stamp import stamp


def module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("made", path)
    assert spec is not None
    return importlib.util.module_from_spec(spec)


def test_the_stamp_changes_with_any_source(tmp_path: Path) -> None:
    one, two = tmp_path / "one.py", tmp_path / "two.py"
    one.write_text("a = 1\n", "utf-8")
    two.write_text("b = 2\n", "utf-8")
    before = stamp(module(one), module(two))
    assert before == stamp(module(one), module(two)) > 0
    two.write_text("b = 3\n", "utf-8")
    assert stamp(module(one), module(two)) != before
    two.unlink()
    made = module(one)
    made.__file__ = str(two)
    assert stamp(made) == 0
    made.__file__ = None
    assert stamp(made) == 0


def test_sending_needs_no_compiler() -> None:
    told = (
        "import sys; from heliograph.link.modulations import modulation;"
        "modulation('seed11').encode(42); modulation('code').encode(7); modulation('seed11').receiver(1000.0, 'paper');"
        "print('numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
