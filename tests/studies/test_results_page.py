"""docs/results.md against what is stored."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_page_of_results_says_what_the_stored_results_give() -> None:
    done = subprocess.run([sys.executable, ROOT / "bench/make_results.py", "--check"], check=False, cwd=ROOT)
    assert done.returncode == 0, "write it anew: python bench/make_results.py"
