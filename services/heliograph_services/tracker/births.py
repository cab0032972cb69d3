"""How tracks begin: initiation by the shape of a light, confirmation by further windows that show it blinking.

A birth's velocity is not known; its standard deviation on each axis is `initial_speed_px_s`, and for a disc that swept
over L pixels in the window W also L / W: a fast light is expected anywhere ahead or behind (`shape`).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker import association, recovery
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
    touched = association.owners(x_px, y_px, radius_px, table.state[:, 0], table.state[:, 1], table.radius_px) >= 0
    barred = association.owners(x_px, y_px, np.zeros(len(new)), closed[:, 0], closed[:, 1], closed[:, 2]) >= 0
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
    table.append(
        xy_px=np.stack([targets.x_px[new], targets.y_px[new]], axis=1),
        var_px2=rule.noise_px**2 + targets.swept_px[new] ** 2 / 12,
        speed_var=config.initial_speed_px_s**2 + (targets.swept_px[new] / rule.window_s) ** 2,
        radius_px=targets.radius_px[new],
        size_px=targets.pixels[new].astype(np.float64) * rule.pool_px**2,
        polarity=polarity,
        blinks=targets.both[new] >= BOTH_SHARE * targets.pixels[new],
        sign=signs(polarity),
        born_us=window.start_us,
        seen_us=window.end_us,
        q=rule.q,
    )
