"""A scene made from physics: lights and surroundings (`world`, `lights`, `ground`), pixels, read-out; and its truth.

`contract.py` says what the parts tell each other, `stream.py` ties them together. docs/simulation.md has the laws and
their sources, docs/trust.md what they have been tested against.
"""

from __future__ import annotations

from importlib import import_module

_WITH_KERNELS = ("random", "pixel", "readout", "ground")


def warm() -> None:
    """Compile all kernels of the simulation, or load them from the cache."""
    for name in _WITH_KERNELS:
        import_module(f"{__name__}.{name}").warm()
