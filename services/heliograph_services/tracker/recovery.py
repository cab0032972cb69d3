"""A light is found again where a track has lost it.

A track that is not seen goes straight on; its light may turn meanwhile. Lost at the time t_0, with the radius R and an
acceleration up to a, it may at t lie as far from where the filter expects it as::

    R + min(a (t - t_0)^2 / 2, gate_px)

Two ways lead back. A track with the habit of blinking takes the nearest target in reach that blinks, has about its size
and is no other track's; its filter is told that it may have turned. And a birth that is confirmed in reach of a track
not seen since the birth began is that track's light.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.units import US_PER_S
from heliograph_services.tracker import association
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.shape import Targets
from heliograph_services.tracker.sighting import Sighting
from heliograph_services.tracker.tracks import TrackTable

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]

# 2,000 px/s on a circle of 200 px, and twice to four times what a hand's tremor of 1.7 px at 8 to 12 Hz does.
ACCELERATION_PX_S2: Final = 20_000.0
# A window shows at least half of a disc that blinks, unless another light touches it.
SIZE_RATIO: Final = 2.0


def reach_px(table: TrackTable, rows: Longs, at_us: int, config: TrackerConfig) -> Floats:
    """Return (k,) how far from its expected place the light of each row may be; see the module."""
    unseen_s = (at_us - table.seen_us[rows]) / US_PER_S
    return np.asarray(table.radius_px[rows] + np.minimum(ACCELERATION_PX_S2 * unseen_s**2 / 2, config.gate_px))


def lost(table: TrackTable, birth: int, named: Longs, config: TrackerConfig) -> int | None:
    """Return the nearest of the named rows whose light this birth may be, or None."""
    away = np.hypot(*(table.state[named, :2] - table.state[birth, :2]).T)
    reach = reach_px(table, named, int(table.seen_us[birth]), config)
    away[(away > reach) | (table.seen_us[named] > table.born_us[birth])] = np.inf
    return int(named[np.argmin(away)]) if np.isfinite(away).any() else None


def found(
    table: TrackTable, rows: Longs, targets: Targets, used: Longs, seen_px: Floats, at_us: int, config: TrackerConfig
) -> Sighting:
    """Pair rows that are not seen with targets in their reach, each target with the row it lies nearest to.

    Args:
        table: predicted.
        rows: (k,) int64.
        targets: of the window.
        used: (m,) int64, targets that may be lights.
        seen_px: (n,) float64, sensor pixels of all targets.
        at_us: end of the window.
        config: settings.
    """
    nothing = np.zeros(len(used))
    owner = association.owners(
        targets.x_px[used],
        targets.y_px[used],
        targets.lag_s[used],
        nothing,
        table.state[rows],
        reach_px(table, rows, at_us, config),
    )
    ratio = seen_px[used] / table.size_px[rows[owner]]
    fit = np.flatnonzero((owner >= 0) & (ratio < SIZE_RATIO) & (ratio > 1 / SIZE_RATIO))
    state, t_s = table.state[rows[owner[fit]]], targets.lag_s[used[fit]]
    away = np.hypot(
        targets.x_px[used[fit]] - state[:, 0] - t_s * state[:, 2],
        targets.y_px[used[fit]] - state[:, 1] - t_s * state[:, 3],
    )
    fit = fit[np.argsort(away, kind="stable")]
    mine, first = np.unique(owner[fit], return_index=True)
    return Sighting(rows[mine], np.arange(len(mine)), used[fit[first]])


def loosen(table: TrackTable, rows: Longs, at_us: int) -> None:
    """Tell the filters that the rows may have turned while they were not seen, by a third of the most as one sigma."""
    t = (at_us - table.seen_us[rows]) / US_PER_S
    a2 = (ACCELERATION_PX_S2 / 3) ** 2
    for first in (0, 3):
        table.cov[rows, first] += a2 * t**4 / 4
        table.cov[rows, first + 1] += a2 * t**3 / 2
        table.cov[rows, first + 2] += a2 * t**2
