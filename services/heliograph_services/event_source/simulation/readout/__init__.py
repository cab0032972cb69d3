"""The read-outs: what the sensor's scan, bus or image clock leaves of the pixels' events; presets of sensors."""

from __future__ import annotations


def warm() -> None:
    """Compile the kernels, or load them from numba's cache."""
    import numpy as np  # noqa: PLC0415  (a service's --help must not wait for numba)

    from heliograph_services.event_source.simulation.contract import PixelEvents  # noqa: PLC0415
    from heliograph_services.event_source.simulation.readout.presets import load_preset, readout_of  # noqa: PLC0415

    none = PixelEvents(np.empty(0), np.empty(0, np.int64), np.empty(0, np.bool_), np.empty(0, np.int16))
    for name in ("dvxplorer_mini", "davis346"):
        readout_of(load_preset(name), 0).feed(none, 1.0)
