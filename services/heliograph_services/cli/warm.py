"""Compiles all kernels into numba's cache: ``python -m heliograph_services.cli.warm``.

Each process warms its own kernels before it says that it is there; done once beforehand, they load in a moment.
"""

from __future__ import annotations

import sys
import time
from importlib import import_module
from typing import Final

# Modules that have a `warm()`.
_MODULES: Final = (
    "heliograph.onsets",
    "heliograph.onset_dipoles",
    "heliograph_services.tracker.core",
    "heliograph_services.decoder.core",
    "heliograph_services.event_source.simulation",
)
# Below it the cache was there already, and nobody needs to know.
_QUICK_S: Final = 3.0


def main() -> int:
    """Compile what is not in the cache yet; return the exit status."""
    start = time.monotonic()
    if sys.stderr.isatty():
        sys.stderr.write("compiling kernels (once) ...\n")
    for name in _MODULES:
        import_module(name).warm()
    took_s = time.monotonic() - start
    if took_s > _QUICK_S:
        sys.stderr.write(f"kernels compiled in {took_s:.0f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
