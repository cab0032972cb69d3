"""Who is whose: gate first, then a global assignment within each group that the gates join.

A target belongs to a track's *disc* if it lies within its radius and a little more of the predicted centre: so do the
crescents at the edges of a lit LED that moves, and the half of a disc that the noise gate left. Farther away only
a whole target counts, within the chi-squared gate and the gate in pixels::

    d^2 = dx^2 / S_x + dy^2 / S_y < gate_chi2,   S = P_xx + 2 t P_xv + t^2 P_vv + r

where the track is expected at the mean time t of the target's own events, from the middle of the window: x + t v.

Cost, to be minimised over all pairs of a group, with as many pairs as possible: `l2` is d^2, with S at most R^2 / 4 + r
for a track of the radius R; `l1` is |dx| + |dy| in pixels, the paper's; to both is added what keeps a scrap of a target
from beating the whole one.

The variance of a measured centre, for a target that shows the share c of its track's pixels, with the track's radius
R, its speed v and the tick T (the events' time within it is not known)::

    r = noise^2 + (1 - c) R^2 / 4 + (v T)^2 / 12

R^2 / 4 is the variance of one random pixel of the disc: pessimistic where many random pixels are seen, about right for
a crescent, whose pixels are not random.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import lap
import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.config import Cost
from heliograph_services.tracker.jit import kernel

Floats = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

# A centre this far outside the covering radius is still on the disc: the outermost tenth of the pixels, and the
# motion within half a window at 700 px/s.
DISC_SLACK_PX: Final = 2.0
# Less than this share of the track's pixels is a scrap: noise, or a part of the edge. It counts on the disc only.
WHOLE_SHARE: Final = 0.3
# A target of more pixels than this many times the track's, and a few, is another thing, or two that have merged.
GROWTH: Final = 3.0
GROWTH_PX: Final = 12.0
# Two sigma: a scrap at the very centre costs as much as the whole disc two sigma off.
SCRAP_COST: Final = 4.0
# Of R^2: where a track is known worse than by half its radius R, near is still likelier than far. Fast tracks, believed
# to turn at any moment, would else choose by the scraps.
COST_VARIANCE: Final = 0.25
# Dense assignment takes cubic time (1000 x 1000: 147 ms); a larger group than this is a flood, and goes cheapest
# pair first.
DENSE_LIMIT: Final = 200


@dataclass(frozen=True, slots=True)
class Gate:
    """What may be paired; see `TrackerConfig`."""

    chi2: float
    px: float
    noise_px: float
    tick_s: float
    cost: Cost


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Targets that may be paired, n of them.

    Args:
        x_px: (n,) float64.
        y_px: (n,) float64.
        size_px: (n,) float64, sensor pixels seen.
        lag_s: (n,) float64, when, from the time of the tracks' state.
        free: (n,) bool: not taken, not too large.
    """

    x_px: Floats
    y_px: Floats
    size_px: Floats
    lag_s: Floats
    free: npt.NDArray[np.bool_]


@kernel
def variance(
    size_px: float, track_size_px: float, radius_px: float, v_px_s: float, noise_px: float, tick_s: float
) -> float:
    """Return the variance of a centre on one axis, px^2; see the module."""
    share = min(1.0, size_px / track_size_px)
    return noise_px * noise_px + (1 - share) * radius_px * radius_px / 4 + (v_px_s * tick_s) ** 2 / 12


@kernel
def _pairs(
    state: Floats,
    cov: Floats,
    radius_px: Floats,
    size_px: Floats,
    rows: Rows,
    x_px: Floats,
    y_px: Floats,
    seen_px: Floats,
    lag_s: Floats,
    free: npt.NDArray[np.bool_],
    limits: tuple[float, float, float, float, bool],
    out: Floats,
) -> int:
    """Write (row's place, target, cost) of the gated pairs to out while they fit; return how many there are."""
    chi2, gate_px, noise_px, tick_s, l1 = limits
    n = 0
    for k in range(len(rows)):
        i = rows[k]
        disc = radius_px[i] + DISC_SLACK_PX
        reach = radius_px[i] + gate_px
        for j in range(len(x_px)):
            t = lag_s[j]
            dx = x_px[j] - state[i, 0] - t * state[i, 2]
            dy = y_px[j] - state[i, 1] - t * state[i, 3]
            if not free[j] or abs(dx) > reach or abs(dy) > reach or seen_px[j] > GROWTH * size_px[i] + GROWTH_PX:
                continue
            share = min(1.0, seen_px[j] / size_px[i])
            d = np.sqrt(dx * dx + dy * dy)
            rx = variance(seen_px[j], size_px[i], radius_px[i], state[i, 2], noise_px, tick_s)
            ry = variance(seen_px[j], size_px[i], radius_px[i], state[i, 3], noise_px, tick_s)
            sx = cov[i, 0] + t * (2 * cov[i, 1] + t * cov[i, 2]) + rx
            sy = cov[i, 3] + t * (2 * cov[i, 4] + t * cov[i, 5]) + ry
            d2 = dx * dx / sx + dy * dy / sy
            if d > disc and (share < WHOLE_SHARE or d > reach or d2 > chi2):
                continue
            if n < out.shape[1]:
                out[0, n] = k
                out[1, n] = j
                most = COST_VARIANCE * radius_px[i] * radius_px[i]
                near2 = dx * dx / min(sx, most + rx) + dy * dy / min(sy, most + ry)
                out[2, n] = (abs(dx) + abs(dy) if l1 else near2) + SCRAP_COST * (1 - share)
            n += 1
    return n


@kernel
def _groups(row: Rows, target: Rows, n_rows: int, n_targets: int) -> Rows:
    """Return (p,) int64, the group of each pair: pairs that share a row or a target are in one."""
    parent = np.arange(n_rows + n_targets)
    for p in range(len(row)):
        a = row[p]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        b = n_rows + target[p]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        parent[max(a, b)] = min(a, b)
    group = np.empty(len(row), np.int64)
    for p in range(len(row)):
        a = row[p]
        while parent[a] != a:
            a = parent[a]
        group[p] = a
    return group


@kernel
def _greedy(order: Rows, row: Rows, target: Rows, chosen: Rows, taken: npt.NDArray[np.bool_]) -> None:
    """Take the pairs in the given order while both ends are free. By rising cost it is exact for a star."""
    for p in order:
        if chosen[row[p]] < 0 and not taken[target[p]]:
            chosen[row[p]] = target[p]
            taken[target[p]] = True


@kernel
def _places(value: Rows) -> tuple[Rows, Rows]:
    """Return the distinct values, rising, and the place of each value among them."""
    order = np.argsort(value, kind="mergesort")
    distinct = np.empty(len(value), np.int64)
    place = np.empty(len(value), np.int64)
    n = 0
    for i in order:
        if n == 0 or value[i] != distinct[n - 1]:
            distinct[n] = value[i]
            n += 1
        place[i] = n - 1
    return distinct[:n], place


def _optimal(row: Rows, target: Rows, cost: Floats, chosen: Rows) -> None:
    """Assign one group at the least total cost, with as many pairs as possible."""
    rows, r = _places(row)
    targets, t = _places(target)
    # Leaving a row and a target alone costs more than all pairs together, a pair outside the gate more than that.
    alone = 2.0 * float(cost.sum()) + 1.0
    dense = np.full((len(rows), len(targets)), 4.0 * alone)
    dense[r, t] = cost
    _, of_row, _ = lap.lapjv(dense, extend_cost=True, cost_limit=alone)
    for k, j in enumerate(of_row):
        if j >= 0 and dense[k, j] < alone:
            chosen[rows[k]] = targets[j]


def assign(
    state: Floats, cov: Floats, radius_px: Floats, size_px: Floats, rows: Rows, targets: Candidates, gate: Gate
) -> Rows:
    """Pair predicted tracks with targets.

    Args:
        state: (n, 4) float64, predicted, see `kalman`.
        cov: (n, 6) float64.
        radius_px: (n,) float64.
        size_px: (n,) float64, sensor pixels; above 0.
        rows: (k,) int64: the tracks to pair.
        targets: what they may be paired with.
        gate: see the module.

    Returns:
        (k,) int64: each row's target, or -1; no target twice.
    """
    chosen = np.full(len(rows), -1, np.int64)
    limits = (float(gate.chi2), float(gate.px), gate.noise_px, gate.tick_s, gate.cost == "l1")
    out = np.empty((3, 4 * len(rows) + 16))
    while True:
        n = _pairs(
            state,
            cov,
            radius_px,
            size_px,
            rows,
            targets.x_px,
            targets.y_px,
            targets.size_px,
            targets.lag_s,
            targets.free,
            limits,
            out,
        )
        if n <= out.shape[1]:
            break
        out = np.empty((3, n))
    row, target, cost = out[0, :n].astype(np.int64), out[1, :n].astype(np.int64), out[2, :n]
    if n == 0:
        return chosen
    if len(_places(row)[0]) == n == len(_places(target)[0]):
        chosen[row] = target
        return chosen
    group = _groups(row, target, len(rows), len(targets.x_px))
    hard = _needs_solver(row, target, group, len(rows) + len(targets.x_px))
    solved = hard[group]
    order = np.lexsort((target, row, cost, group))
    for which in np.flatnonzero(hard):
        part = order[group[order] == which]
        _optimal(row[part], target[part], cost[part], chosen)
    taken = np.zeros(len(targets.x_px), np.bool_)
    taken[chosen[chosen >= 0]] = True
    _greedy(order[~solved[order]], row, target, chosen, taken)
    return chosen


def _needs_solver(row: Rows, target: Rows, group: Rows, count: int) -> npt.NDArray[np.bool_]:
    """Return (count,) bool: the groups that have several rows and several targets, and few enough of both."""
    members = []
    for end in (row, target):
        # Each row, and each target, lies in one group.
        of_end = np.full(int(end.max()) + 1, -1, np.int64)
        of_end[end] = group
        members.append(np.bincount(of_end[of_end >= 0], minlength=count))
    several = np.minimum(members[0], members[1]) > 1
    return np.asarray(several & (np.maximum(members[0], members[1]) <= DENSE_LIMIT))


@kernel
def _owners(x_px: Floats, y_px: Floats, t_s: Floats, extent_px: Floats, at: Floats, radius_px: Floats) -> Rows:
    owner = np.full(len(x_px), -1, np.int64)
    for j in range(len(x_px)):
        best = np.inf
        for k in range(len(at)):
            dx = x_px[j] - at[k, 0] - t_s[j] * at[k, 2]
            dy = y_px[j] - at[k, 1] - t_s[j] * at[k, 3]
            d = np.sqrt(dx * dx + dy * dy)
            if d <= extent_px[j] + radius_px[k] and d < best:
                best = d
                owner[j] = k
    return owner


def owners(x_px: Floats, y_px: Floats, t_s: Floats, extent_px: Floats, at: Floats, radius_px: Floats) -> Rows:
    """Return (n,) int64: for each thing the nearest place that it lies on, or -1.

    Args:
        x_px: (n,) float64.
        y_px: (n,) float64.
        t_s: (n,) float64, when each is there, from the time of the places.
        extent_px: (n,) float64: the thing's own radius, added to the place's.
        at: (k, 4) float64, x, y, v_x, v_y of the places.
        radius_px: (k,) float64.
    """
    # One layout of arrays, one compilation.
    return _owners(*(np.ascontiguousarray(a) for a in (x_px, y_px, t_s, extent_px, at, radius_px)))
