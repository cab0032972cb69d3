"""A track is seen: its filter, its looks and its signs of blinking take in the targets of a window.

The centre of what was seen has on each axis the variance, with the share c of the track's pixels, its radius R, its
speed v, the tick T and the number n of flips that the light showed::

    r = noise^2 + (1 - c) R^2 / 4 + (v T)^2 / (12 n)            n = max(1, events / (2 size))

since the mean time of its events is known but for where in their ticks they lie. The filter is told the centre at that
time. The slope of the events' places over their times is a measurement of the velocity, of the variance ::

    r_v = 2 noise^2 / (n s^2)

with s^2 the variance of the times: a flip's trailing half comes later than its leading one, hence the 2. Where the
events do not spread over the window (s^2 < W^2 / 24) they are one flip's, and the slope is that of its latency.

What turns is followed by more noise of acceleration. The filter lags behind a turn, so that the innovations nu of many
windows point one way; noise alone makes them point any way. With means that forget (share a of the newest)::

    b = <nu>,  p = <|nu|^2>,  rho = |b|^2 / p                   a / (2 - a) = .14 for white nu, 1 for a lag
    q *= UP if rho > LAGS,  q /= DOWN if rho < WHITE            within [max(q_0, q_v), q_max]

A light that shines and moves is seen as a dipole (`shape.DIPOLE_SHARE`) in nearly every window, and when it is dark as
nothing at all. One of that habit that is gone for `DARK_WINDOWS` and comes back as a rise of its own size has blinked,
however few events it put into a pixel.

Being a ratio, rho needs no true r. What is fast must turn to stay in the image, within a radius R_v: q_v = 2 s^2 tau,
s = v^2 / R_v, tau = .1 s, the time constant of q_0. Where two beacons touch, their pieces are biased: there q does not
rise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.units import US_PER_S
from heliograph_services.tracker import turning
from heliograph_services.tracker.backends import Filters
from heliograph_services.tracker.shape import BOTH_SHARE, CLEAR, DIPOLE_SHARE, Targets, is_switched
from heliograph_services.tracker.tracks import TrackTable

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# The disc of a nearing beacon is followed in a few windows; a window that shows little of it must not shrink it.
GROW: Final = 0.2
SHRINK: Final = 0.1
# From nothing to .7, which makes a habit, in 24 windows. Windows in which it was not seen count as well, up to two in a
# row: a beacon at 50 bit/s comes to a third at most, and what is hidden keeps its habit.
HABIT: Final = 0.05
HABIT_WINDOWS: Final = 3.0
# A rise and a fall among the dipoles of one lit bit of 20 ms leave the mean above SHINES; after 12 windows of nothing
# else it is above .7.
SHINE: Final = 0.1
SHINES: Final = 0.5
# Half a bit at 50 bit/s. An edge that trembles does not vanish for so long.
DARK_WINDOWS: Final = 2.0
SIZE_RATIO: Final = 2.0
# A share of 1/4 remembers 35 ms at 5 ms a window: a turn of 100 ms is noticed while it lasts.
NEWEST: Final = 0.25
# From q_0 to a thousand times as much in 7 windows that lag, and back in 38 that do not: a turn lasts for .1 s.
LAGS: Final = 0.5
WHITE: Final = 0.3
UP: Final = 3.0
DOWN: Final = 1.2
# A sixth of the width of a small sensor. 160 px/s then ask for no more than q_0, 2,000 px/s for 3.2e8 px2/s3. With
# centres good to .2 px and the time of each known, that much costs little accuracy; 600 px lost what turns.
TURN_RADIUS_PX: Final = 100.0
TURN_S: Final = 0.1
# What has not been seen for longer than a code's dark run at 1 kbit/s did not turn all that time.
TURN_US: Final = 10_000
# Even times have W^2 / 12.
SPREAD: Final = 24.0
# Of a track's pixels, for a target's slope to be its.
WHOLE: Final = 0.5


@dataclass(frozen=True, slots=True)
class Rule:
    """What a sighting is weighed with; see `TrackerConfig` and the module.

    Args:
        noise_px: standard error of a whole target's centre.
        window_s: length of a window.
        tick_s: length of a tick.
        pool_px: side of an onset pixel.
        max_speed_px_s: velocities are cut to it.
        q: least density of the acceleration, px^2/s^3, with which the filters predict.
        q_max: largest.
    """

    noise_px: float
    window_s: float
    tick_s: float
    pool_px: int
    max_speed_px_s: float
    q: float
    q_max: float


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What k tracks are seen as: the target chosen by each, and further ones that lie on their discs.

    Args:
        rows: (k,) int64, of the table.
        owner: (m,) int64: whose each used target is, an index into rows; the first k are 0 to k - 1.
        used: (m,) int64, targets; the first k are the chosen ones.
    """

    rows: Longs
    owner: Longs
    used: Longs

    def sum(self, values: npt.NDArray[Any]) -> Floats:
        """Return (k,) float64, a value of each target added up by track; values: (n,) of all targets."""
        return np.asarray(np.bincount(self.owner, values[self.used], len(self.rows)), np.float64)


def see(table: TrackTable, filters: Filters, seen: Sighting, targets: Targets, end_us: int, rule: Rule) -> None:
    """Update the rows that were seen, in place.

    Args:
        table: predicted to the middle of the window.
        filters: the backend.
        seen: who was seen as what.
        targets: of the window.
        end_us: end of the window.
        rule: see there.
    """
    rows, k = seen.rows, len(seen.rows)
    chosen = seen.used[:k]
    total = seen.sum(targets.pixels)
    on, off = seen.sum(targets.on), seen.sum(targets.off)
    events = (targets.on + targets.off).astype(np.float64)
    z = np.stack([seen.sum(events * at) / (on + off) for at in (targets.x_px, targets.y_px)], axis=1)
    lag_s = seen.sum(events * targets.lag_s) / (on + off)
    seen_px = total * rule.pool_px**2
    share = np.minimum(1.0, seen_px / table.size_px[rows])
    trust = np.where(seen.sum(targets.piece) > 0, 0.0, share)
    flips = np.maximum(1.0, (on + off) / (2 * table.size_px[rows]))
    r = np.empty((k, 2))
    r[:] = (rule.noise_px**2 + (1 - trust) * table.radius_px[rows] ** 2 / 4)[:, None]
    r += (table.state[rows, 2:] * rule.tick_s) ** 2 / (12 * flips[:, None])
    expected = table.state[rows, :2] + lag_s[:, None] * table.state[rows, 2:]
    _turn(table, rows, z - expected, trust, rule)
    v_var = slope_var(targets, chosen, flips, rule)
    # A part of a light has its own slope.
    v_var[(np.bincount(seen.owner, minlength=k) > 1) | (trust < WHOLE)] = np.inf
    # The slope has a bias, which a track that knows its velocity better would feel.
    v_var[end_us - table.seen_us[rows] <= TURN_US] = np.inf
    before_px_s = table.state[rows, 2:]
    filters.update(table.state, table.cov, rows, z, r, rule.max_speed_px_s, lag_s, targets.v_px_s[chosen], v_var)
    turning.learn(table, rows, before_px_s, end_us, rule.window_s)
    table.polarity[rows] = (on - off) / (on + off)
    sign = signs(table.polarity[rows])
    both = seen.sum(targets.both)
    switched = is_switched(total, on + off, both, seen.sum(~targets.at_once) == 0)
    blinked = (both >= BOTH_SHARE * total) | ((sign * table.sign[rows] < 0) & switched)
    blinked |= _relit(table, rows, (on - off) >= CLEAR * (on + off), seen_px, end_us, rule)
    table.blinks[rows] += blinked
    table.blink_us[rows] = np.where(blinked, end_us, table.blink_us[rows])
    passed = (end_us - table.seen_us[rows]) / (rule.window_s * US_PER_S)
    passed = np.minimum(np.maximum(passed, 1.0), HABIT_WINDOWS)
    table.habit[rows] = np.minimum(table.habit[rows] * (1 - HABIT) ** passed + HABIT * switched, 1.0)
    dipole = np.minimum(on, off) >= DIPOLE_SHARE * (on + off)
    table.shine[rows] += SHINE * (dipole - table.shine[rows])
    table.sign[rows] = np.where(sign == 0, table.sign[rows], sign)
    table.seen_us[rows] = end_us
    table.hits[rows] += targets.light[chosen]
    rate = np.where(seen_px > table.size_px[rows], GROW, SHRINK * share)
    table.size_px[rows] += rate * (seen_px - table.size_px[rows])
    # The radius of several parts is not theirs; that of the track stays.
    alone = np.bincount(seen.owner, minlength=k) == 1
    table.radius_px[rows] += np.where(alone, rate, 0.0) * (targets.radius_px[chosen] - table.radius_px[rows])


def slope_var(targets: Targets, used: Longs, flips: Floats, rule: Rule) -> Floats:
    """Return (k,) float64, variance of the slopes of some targets on each axis, (px/s)^2; inf where there is none.

    Args:
        targets: of the window.
        used: (k,) int64.
        flips: (k,) float64, of the light while they were made, about.
        rule: see there.
    """
    spread_s2 = targets.spread_s2[used]
    known = spread_s2 >= rule.window_s**2 / SPREAD
    out = np.full(len(used), np.inf)
    out[known] = 2 * rule.noise_px**2 / (flips * spread_s2)[known]
    return out


def _turn(table: TrackTable, rows: Longs, innovation: Floats, trust: Floats, rule: Rule) -> None:
    """Raise or lower the acceleration that the rows are believed capable of."""
    table.lag_px[rows] += NEWEST * (innovation - table.lag_px[rows])
    table.power_px2[rows] += NEWEST * ((innovation**2).sum(axis=1) - table.power_px2[rows])
    rho = (table.lag_px[rows] ** 2).sum(axis=1) / np.maximum(table.power_px2[rows], 1e-12)
    factor = np.where(rho > LAGS, np.where(trust > 0, UP, 1.0), np.where(rho < WHITE, 1 / DOWN, 1.0))
    speed2 = (table.state[rows, 2:] ** 2).sum(axis=1)
    least = np.minimum(np.maximum(2 * TURN_S * (speed2 / TURN_RADIUS_PX) ** 2, rule.q), rule.q_max)
    table.q[rows] = np.minimum(np.maximum(table.q[rows] * factor, least), rule.q_max)


def _relit(table: TrackTable, rows: Longs, rise: Flags, seen_px: Floats, end_us: int, rule: Rule) -> Flags:
    """Return (k,) bool: the rows that shone, were dark, and are seen to be switched on again; see the module."""
    dark = end_us - table.seen_us[rows] > DARK_WINDOWS * rule.window_s * US_PER_S
    ratio = seen_px / table.size_px[rows]
    return np.asarray(shines(table)[rows] & dark & rise & (ratio < SIZE_RATIO) & (ratio > 1 / SIZE_RATIO))


def shines(table: TrackTable) -> Flags:
    """Return (n,) bool: the rows that have the habit of a light that shines and moves."""
    return np.asarray(table.shine > SHINES)


def signs(polarity: Floats) -> Longs:
    """Return 1 or -1 where the polarity is clear, else 0."""
    return np.where(np.abs(polarity) >= CLEAR, np.sign(polarity), 0.0).astype(np.int64)
