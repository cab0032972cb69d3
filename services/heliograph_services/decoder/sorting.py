"""The kernels that sort what regions have heard by track, keep it, and gather what some have heard."""

from __future__ import annotations

import numpy as np

from heliograph.events import Flags, Times
from heliograph_services.decoder.region_state import Depths, Ints, Labels, kernel


def sort_by_track(
    t_us: Times, on: Flags, n: int, hits: int, hit: Ints, hit_label: Labels, hit_depth: Depths
) -> tuple[Ints, Times, Flags, Depths]:
    """Return (starts, t_us, on, depth): the hits of track i are [starts[i], starts[i + 1]), in their order."""
    # Made here: an array that a kernel returns costs a microsecond.
    starts, times = np.zeros(n + 1, np.int64), np.empty(hits, np.int64)
    levels, depth = np.empty(hits, np.bool_), np.empty(hits, np.uint8)
    _sort(t_us, on, hit, hit_label, hit_depth, starts, times, levels, depth)
    return starts, times, levels, depth


@kernel
def _sort(
    t_us: Times,
    on: Flags,
    hit: Ints,
    hit_label: Labels,
    hit_depth: Depths,
    starts: Ints,
    times: Times,
    levels: Flags,
    depth: Depths,
) -> None:
    n, hits = len(starts) - 1, len(times)
    for j in range(hits):
        starts[hit_label[j]] += 1
    for i in range(n):
        starts[i + 1] += starts[i]
    at = starts[:n].copy()
    for j in range(hits):
        i = hit_label[j] - 1
        times[at[i]] = t_us[hit[j]]
        levels[at[i]] = on[hit[j]]
        depth[at[i]] = hit_depth[j]
        at[i] += 1


@kernel
def keep(
    t_us: Times,
    on: Flags,
    depth: Depths,
    starts: Ints,
    t1_us: int,
    events: int,
    kept_t_us: Times,
    kept_on: Flags,
    kept_depth: Depths,
    kept_starts: Ints,
    heard_us: Ints,
) -> None:
    """Append what a window holds to what is kept of the windows before it.

    Args:
        t_us: (m,), as on and depth: of the window, sorted by track.
        on: (m,).
        depth: (m,).
        starts: (n + 1,): where the tracks' begin.
        t1_us: the window's end.
        events: how many are kept already.
        kept_t_us: (events + m or more,), as kept_on and kept_depth.
        kept_on: as above.
        kept_depth: as above.
        kept_starts: (n + 1 or more,) out: where the tracks' begin among all that is kept.
        heard_us: (n or more,) out: t1_us for the tracks that have heard something.
    """
    n = len(starts) - 1
    for j in range(len(t_us)):
        kept_t_us[events + j], kept_on[events + j], kept_depth[events + j] = t_us[j], on[j], depth[j]
    for i in range(n):
        kept_starts[i] = starts[i] + events
        if starts[i + 1] > starts[i]:
            heard_us[i] = t1_us
    kept_starts[n] = starts[n] + events


@kernel
def gather(
    t_us: Times,
    on: Flags,
    depth: Depths,
    starts: Ints,
    windows: int,
    which: Ints,
    least: Ints,
    taken: Ints,
    out_t_us: Times,
    out_on: Flags,
    out_depth: Depths,
    out_starts: Ints,
) -> None:
    """Gather the events of some tracks, track after track, in the windows that each has not taken yet.

    Args:
        t_us: (m,), as on and depth: of all windows, sorted by track within each.
        on: (m,).
        depth: (m,).
        starts: (windows or more, tracks + 1): where they begin.
        windows: how many there are.
        which: (k,) the tracks.
        least: (k,) depth of the events that are wanted of each.
        taken: (tracks or more,) how many windows each has taken; noted.
        out_t_us: (m or more,) out, as out_on and out_depth.
        out_on: as above.
        out_depth: as above.
        out_starts: (k + 1,) out: where the tracks' begin.
    """
    n = 0
    for k in range(len(which)):
        i = which[k]
        out_starts[k] = n
        for w in range(taken[i], windows):
            for j in range(starts[w, i], starts[w, i + 1]):
                if depth[j] >= least[k]:
                    out_t_us[n], out_on[n], out_depth[n] = t_us[j], on[j], depth[j]
                    n += 1
        taken[i] = windows
    out_starts[len(which)] = n
