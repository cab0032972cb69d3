"""The kernel that sorts what regions have heard by track."""

from __future__ import annotations

import numpy as np

from heliograph.events import Flags, Times
from heliograph_services.decoder.region_state import Depths, Ints, Labels, kernel


@kernel
def sort_by_track(
    t_us: Times, on: Flags, n: int, hits: int, hit: Ints, hit_label: Labels, hit_depth: Depths
) -> tuple[Ints, Times, Flags, Depths]:
    """Return (starts, t_us, on, depth): the hits of track i are [starts[i], starts[i + 1]), in their order."""
    starts = np.zeros(n + 1, np.int64)
    for j in range(hits):
        starts[hit_label[j]] += 1
    for i in range(n):
        starts[i + 1] += starts[i]
    at = starts[:n].copy()
    times = np.empty(hits, np.int64)
    levels = np.empty(hits, np.bool_)
    depth = np.empty(hits, np.uint8)
    for j in range(hits):
        i = hit_label[j] - 1
        times[at[i]] = t_us[hit[j]]
        levels[at[i]] = on[hit[j]]
        depth[at[i]] = hit_depth[j]
        at[i] += 1
    return starts, times, levels, depth
