"""DBSCAN by scikit-learn (Ester et al. 1996; the paper, "Clustering"), in the place of `tracker.clustering`.

Asked for distinct pixels with their events as weights, it numbers clusters by their first core pixel and gives a
border pixel to the lowest of its clusters: the labels of the grid, one for one.
"""

from __future__ import annotations

import numpy as np
from sklearn.cluster import DBSCAN

from heliograph_services.tracker.clustering import Active, Clusterer, Ints


class ScikitClusterer(Clusterer):
    """`tracker.clustering.Clusterer` with scikit-learn's labels; which pixels are distinct, the grid still tells.

    Args:
        width: columns, onset pixels.
        height: rows.
        eps_px: radius, onset pixels; a neighbour at exactly this distance counts.
        min_events: events within the radius that make a pixel core, its own included.
    """

    def __init__(self, width: int, height: int, eps_px: float, min_events: int) -> None:
        super().__init__(width, height, eps_px, min_events)
        self._model = DBSCAN(eps=eps_px, min_samples=min_events)

    def labels(self, active: Active) -> tuple[Ints, int]:
        """Return (n,) int32 labels, -1 for noise, and the number of clusters."""
        if len(active) == 0:  # which scikit-learn refuses
            return np.empty(0, np.int32), 0
        xy_px = np.stack([active.x_px, active.y_px], axis=1).astype(np.float64)
        labels = self._model.fit(xy_px, sample_weight=active.on + active.off).labels_.astype(np.int32)
        return labels, int(labels.max()) + 1
