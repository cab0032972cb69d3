"""What goes round a curve is expected on the curve: a turn rate beside the filters, which know straight lines only.

A filter's corrections of a velocity v on a circle all point to its middle. Their part across the course is summed up
to the turn rate w, a share g of each, with the time dt since the last sighting::

    w += g (v x v') / (|v|^2 dt)                        v before the correction, v' after
    v  turns by w t while the filter predicts by t      x moves along the chord of that arc

so that what is left of the corrections is noise: w then stays as it is. A track that is not seen turns on for `ON_US`,
then goes straight.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.units import US_PER_S
from heliograph_services.tracker.jit import kernel
from heliograph_services.tracker.tracks import TrackTable

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]

GAIN: Final = 0.2
# Of slower ones the filter's own noise of 20 px/s would make turns that are not there.
LEAST_PX_S: Final = 300.0
# 2,000 px/s on a circle of 40 px.
MOST_RAD_S: Final = 50.0
ON_US: Final = 30_000


def learn(table: TrackTable, rows: Longs, before_px_s: Floats, end_us: int, window_s: float) -> None:
    """Correct the turn rates of the rows that were seen.

    Args:
        table: after its filters' update, `seen_us` not yet.
        rows: (k,) int64.
        before_px_s: (k, 2) float64, velocities before the update.
        end_us: end of the window.
        window_s: its length.
    """
    after = table.state[rows, 2:]
    cross = before_px_s[:, 0] * after[:, 1] - before_px_s[:, 1] * after[:, 0]
    speed2 = (before_px_s**2).sum(axis=1)
    dt_s = np.maximum((end_us - table.seen_us[rows]) / US_PER_S, window_s)
    change = GAIN * cross / (np.maximum(speed2, LEAST_PX_S**2) * dt_s)
    rate = np.minimum(np.maximum(table.turn_rad_s[rows] + change, -MOST_RAD_S), MOST_RAD_S)
    table.turn_rad_s[rows] = np.where(speed2 > LEAST_PX_S**2, rate, 0.0)


def turn(table: TrackTable, state: Floats, from_us: int, to_us: int) -> None:
    """Bend what the filters predicted from one time to another, in place.

    Args:
        table: whose rows they are.
        state: (n, 4) float64, predicted straight on.
        from_us: when it began.
        to_us: when it is.
    """
    _turn(state, table.turn_rad_s, table.seen_us, from_us, to_us)


@kernel
def _turn(state: Floats, turn_rad_s: Floats, seen_us: Longs, from_us: int, to_us: int) -> None:
    whole_s = (to_us - from_us) / US_PER_S
    for i in range(len(state)):
        t_s = min(max(seen_us[i] + ON_US - from_us, 0), to_us - from_us) / US_PER_S
        angle = turn_rad_s[i] * t_s
        if angle == 0.0:
            continue
        vx, vy = state[i, 2], state[i, 3]
        cos, sin = np.cos(angle), np.sin(angle)
        # Along the chord, sin(a/2) / (a/2) as long as the arc and at half the angle; after it straight on.
        half_cos, half_sin = np.cos(angle / 2), np.sin(angle / 2)
        chord_s = half_sin / (angle / 2) * t_s
        rest_s = whole_s - t_s
        state[i, 2] = cos * vx - sin * vy
        state[i, 3] = sin * vx + cos * vy
        state[i, 0] += (half_cos * vx - half_sin * vy) * chord_s + state[i, 2] * rest_s - vx * whole_s
        state[i, 1] += (half_sin * vx + half_cos * vy) * chord_s + state[i, 3] * rest_s - vy * whole_s
