"""The kernels that sort what regions have heard by track, and gather what one has heard."""

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


@kernel
def gather(
    t_us: Times, on: Flags, depth: Depths, starts: Ints, i: int, first: int, behind: int
) -> tuple[Times, Flags, Depths]:
    """Return the events of track i in the windows [first, behind), one after another.

    Args:
        t_us: (m,), as on and depth: of all windows, sorted by track within each.
        on: (m,).
        depth: (m,).
        starts: (windows, tracks + 1): where they begin.
        i: the track.
        first: window.
        behind: the last one.
    """
    n = 0
    for w in range(first, behind):
        n += starts[w, i + 1] - starts[w, i]
    times = np.empty(n, np.int64)
    levels = np.empty(n, np.bool_)
    depths = np.empty(n, np.uint8)
    k = 0
    for w in range(first, behind):
        for j in range(starts[w, i], starts[w, i + 1]):
            times[k], levels[k], depths[k] = t_us[j], on[j], depth[j]
            k += 1
    return times, levels, depths
