"""DBSCAN as its definition reads, in quadratic time: the witness of the tracker's grid."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def labels(
    x: npt.NDArray[np.int64], y: npt.NDArray[np.int64], weight: npt.NDArray[np.int64], eps: float, min_events: int
) -> list[int]:
    """Return the cluster of each point, -1 for noise; clusters are numbered by their first core point."""
    n = len(x)
    near = [[j for j in range(n) if np.hypot(float(x[i] - x[j]), float(y[i] - y[j])) <= eps] for i in range(n)]
    core = [sum(int(weight[j]) for j in near[i]) >= min_events for i in range(n)]
    cluster = [-1] * n
    count = 0
    for i in range(n):
        if not core[i] or cluster[i] >= 0:
            continue
        reached, fringe = {i}, [i]
        while fringe:
            p = fringe.pop()
            for q in near[p]:
                if core[q] and q not in reached:
                    reached.add(q)
                    fringe.append(q)
        for p in reached:
            cluster[p] = count
        count += 1
    of_core = list(cluster)
    for i in range(n):
        if not core[i]:
            cluster[i] = min((of_core[j] for j in near[i] if core[j]), default=-1)
    return cluster
