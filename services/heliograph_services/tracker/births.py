"""How tracks begin: initiation by the shape of a light, confirmation by further windows that show it blinking.

A birth's velocity is not known; its standard deviation on each axis is `initial_speed_px_s`, and for a disc that swept
over L pixels in the window W also L / W: a fast light is expected anywhere ahead or behind (`shape`).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker import association, recovery, sighting
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.shape import BOTH_SHARE, Targets
from heliograph_services.tracker.sighting import Rule, signs
from heliograph_services.tracker.tracks import UNNAMED, Numbers, TrackTable
from heliograph_services.tracker.windows import Window

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]

# What a light keeps of the lost track that it is (`recovery`).
KEPT: Final = ("number", "born_us", "invalid_us", "status", "read")


def confirm(table: TrackTable, config: TrackerConfig, numbers: Numbers, counters: dict[str, int]) -> None:
    """Name the rows in birth that were seen and blinked often enough, in the order of birth."""
    ripe = np.flatnonzero(~table.named & (table.hits >= config.confirm_hits) & (table.blinks >= config.confirm_blinks))
    if len(ripe) == 0:
        return
    alive = np.ones(len(table), np.bool_)
    for i in ripe:
        named = np.flatnonzero(table.named)
        d = np.hypot(table.state[named, 0] - table.state[i, 0], table.state[named, 1] - table.state[i, 1])
        if (d < np.maximum(table.radius_px[named], table.radius_px[i])).any():
            # Two births of one light: the first one has it.
            alive[i] = False
            counters["births_double"] += 1
        elif (lost := recovery.lost(table, int(i), named[alive[named]], config)) is not None:
            for name in KEPT:
                getattr(table, name)[i] = getattr(table, name)[lost]
            alive[lost] = False
            table.number[lost] = UNNAMED
            counters["tracks_found_again"] += 1
        elif len(named) >= config.max_tracks:
            alive[i] = False
            counters["births_over_limit"] += 1
        else:
            table.number[i] = numbers.take()
            counters["tracks_born"] += 1
    if not alive.all():
        table.keep(alive)


def initiate(
    table: TrackTable,
    targets: Targets,
    new: Longs,
    window: Window,
    closed: Floats,
    config: TrackerConfig,
    rule: Rule,
    counters: dict[str, int],
) -> None:
    """Begin a birth at each of some targets that touch no track and lie in no closed place.

    If there are too many, the largest.

    Args:
        table: gets the new rows.
        targets: of the window.
        new: (k,) int64, targets with the shape of a light that no track has used.
        window: the window.
        closed: (m, 3) float64, x, y, radius of places without births.
        config: settings.
        rule: what sightings are weighed with.
        counters: added to.
    """
    if len(new) == 0:
        return
    x_px, y_px, radius_px = targets.x_px[new], targets.y_px[new], targets.radius_px[new]
    lag_s, nothing = targets.lag_s[new], np.zeros(len(new))
    touched = association.owners(x_px, y_px, lag_s, radius_px, table.state, table.radius_px) >= 0
    still = np.concatenate([closed[:, :2], np.zeros((len(closed), 2))], axis=1)
    barred = association.owners(x_px, y_px, nothing, nothing, still, closed[:, 2]) >= 0
    counters["births_quarantined"] += int(np.count_nonzero(barred & ~touched))
    new = new[~touched & ~barred]
    room = config.max_tracks - int(np.count_nonzero(~table.named))
    if len(new) > room:
        counters["births_over_limit"] += len(new) - room
        new = np.sort(new[np.argsort(-targets.pixels[new], kind="stable")][:room])
    if len(new) == 0:
        return
    counters["births"] += len(new)
    on, off = targets.on[new].astype(np.float64), targets.off[new].astype(np.float64)
    polarity = (on - off) / (on + off)
    swept_px = targets.swept_px[new]
    speed_var = config.initial_speed_px_s**2 + (swept_px / rule.window_s) ** 2
    slope_var = sighting.slope_var(targets, new, np.maximum(1.0, (on + off) / (2 * targets.pixels[new])), rule)[:, None]
    share = speed_var / (speed_var + slope_var)
    v_px_s, speed_var = share * targets.v_px_s[new], (1 - share) * speed_var
    # Each was there at its own time; the table is of the middle of the window.
    lag_s = targets.lag_s[new][:, None]
    var_px2 = rule.noise_px**2 + (swept_px * rule.tick_s / rule.window_s) ** 2 / 12
    table.append(
        xy_px=np.stack([targets.x_px[new], targets.y_px[new]], axis=1) - lag_s * v_px_s,
        v_px_s=v_px_s,
        var_px2=var_px2 + lag_s**2 * speed_var,
        cross=-lag_s * speed_var,
        speed_var=speed_var,
        radius_px=targets.radius_px[new],
        size_px=targets.pixels[new].astype(np.float64) * rule.pool_px**2,
        polarity=polarity,
        blinks=targets.both[new] >= BOTH_SHARE * targets.pixels[new],
        sign=signs(polarity),
        born_us=window.start_us,
        seen_us=window.end_us,
        q=rule.q,
    )
