"""Who clusters, who filters and who runs the flow network: tables of (module, attribute), imported only when chosen.

The fast ones are the default. The reference ones are other people's libraries behind the same interface: they are
witnesses, and what a tracker runs on where the card's own stack is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, Protocol, cast

import numpy as np
import numpy.typing as npt

from heliograph.errors import ConfigError
from heliograph.streams import Onsets
from heliograph_services.tracker.clustering import Active, Ints
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.motion import Motion

Floats = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

_HERE: Final = "heliograph_services.tracker"
CLUSTERINGS: Final[dict[str, tuple[str, str]]] = {
    "grid": (f"{_HERE}.clustering", "Clusterer"),
    "scikit-learn": (f"{_HERE}.reference.dbscan", "ScikitClusterer"),
}
FILTERS: Final[dict[str, str]] = {
    "batched": f"{_HERE}.kalman",
    "filterpy": f"{_HERE}.reference.kalman",
}

# Who runs the flow network; its module's `make` returns the motion of a stream.
FLOWS: Final[dict[str, str]] = {
    "none": f"{_HERE}.motion",
    "numba": f"{_HERE}.network_motion",
    "torch": f"{_HERE}.reference.flow",
}


class Clustering(Protocol):
    """DBSCAN for windows of one sensor; see `clustering.Clusterer`."""

    def distinct(
        self,
        x_px: npt.NDArray[Any],
        y_px: npt.NDArray[Any],
        on: npt.NDArray[Any],
        off: npt.NDArray[Any],
        tick: npt.NDArray[Any],
    ) -> Active:
        """Return the pixels with events."""
        ...

    def labels(self, active: Active) -> tuple[Ints, int]:
        """Return (n,) int32 labels, -1 for noise, and the number of clusters."""
        ...


class MakesClustering(Protocol):
    """The class of a clustering."""

    def __call__(self, width: int, height: int, eps_px: float, min_events: int) -> Clustering:
        """Return the clustering of one sensor."""
        ...


class Filters(Protocol):
    """Constant-velocity Kalman filters of a table of tracks; see `kalman`."""

    def predict(self, state: Floats, cov: Floats, dt_s: float, q: float | Floats) -> None:
        """Move all filters forward in place."""
        ...

    def update(
        self,
        state: Floats,
        cov: Floats,
        rows: Rows,
        z: Floats,
        r: Floats,
        max_speed_px_s: float,
        dt_s: Floats | None = None,
        v: Floats | None = None,
        v_var: Floats | None = None,
    ) -> None:
        """Correct the filters of some rows in place."""
        ...


class MakesMotion(Protocol):
    """Returns what is known of velocities in a stream."""

    def __call__(self, config: TrackerConfig, first: Onsets) -> Motion:
        """Return it for the stream that these onsets are the first of."""
        ...


@dataclass(frozen=True, slots=True)
class Backends:
    """What a tracker computes with."""

    clustering: MakesClustering
    filters: Filters
    motion: MakesMotion


def chosen(config: TrackerConfig) -> Backends:
    """Return the backends of a configuration.

    Raises:
        ConfigError: a package that the choice needs is not installed.
    """
    module, attribute = CLUSTERINGS[config.clustering]
    clustering = getattr(_module(module, f"clustering = {config.clustering!r}"), attribute)
    filters = _module(FILTERS[config.kalman], f"kalman = {config.kalman!r}")
    motion = getattr(_module(FLOWS[config.flow], f"flow = {config.flow!r}"), "make")  # noqa: B009 - of any module
    return Backends(cast("MakesClustering", clustering), cast("Filters", filters), cast("MakesMotion", motion))


def _module(name: str, setting: str) -> object:
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigError(
            f"{setting} needs a package that is not installed ({error}): pip install 'heliograph[reference]'"
        ) from None
