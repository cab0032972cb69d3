"""What a Tracks message says, as columns: a tracker may speak of a thousand tracks ten times a second.

Of every row a region is made: its reach is scale * radius + margin, at most region_max_px, and one covariance serves
both axes, the larger doubt, but no less than LEAST_PX2 and (LEAST_PX_S + LEAST_SHARE |v|)^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.messages import Tracks
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.region_state import PLACE_LIMIT_PX, SPEED_LIMIT_PX_S, Floats, Ints
from heliograph_services.decoder.regions import Doubt, Place, column, doubt

# Where the tracker has been silent for so long, only what is read goes on (paper: a valid track's delay_max).
SILENCE_US: Final = 2_000_000
# No tracker is surer than that, whatever it says: half a pixel; 50 px/s and a tenth of the speed. Own edges, which come
# every few milliseconds, soon know better.
LEAST_PX2: Final = 0.25
LEAST_PX_S: Final = 50.0
LEAST_SHARE: Final = 0.1
NUMBERS: Final = (
    "x_px", "y_px", "vx_px_s", "vy_px_s", "radius_px", "x_var_px2", "x_vx_cov_px2_s", "vx_var_px2_s2",
    "y_var_px2", "y_vy_cov_px2_s", "vy_var_px2_s2",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Telling:
    """What a Tracks message says of its tracks, at its instant, row by row.

    Args:
        names: (n,) of the tracks; no name twice.
        born_us: (n,).
        places: (5, n) x, y (px), vx, vy (px/s), reach (px) of its region; brought into what a sensor can show.
        radius_px: (n,).
        doubt: how sure that is, (n,) each.
        unseen_us: (n,) for how long it had not been seen at the message's instant.
    """

    names: list[str]
    born_us: Ints
    places: Floats
    radius_px: Floats
    doubt: Doubt
    unseen_us: Ints

    def column(self, row: int, sure: Doubt | None = None) -> Floats:
        """Return the state (ROWS,) of a region that begins as a row says; as sure as given, or as told."""
        told = self.doubt
        its = sure or Doubt(told.xx[row], told.xv[row], told.vv[row])
        return column(Place(*self.places[:, row].tolist()), float(self.radius_px[row]), its)


def finite(message: Tracks) -> bool:
    """Return whether all numbers of a message are numbers: one that is not would spread to all that it is added to."""
    return all(math.isfinite(sum(getattr(message, column))) for column in NUMBERS)


def telling_of(message: Tracks, followed: set[str], config: DecoderConfig) -> tuple[Telling, int]:
    """Return the rows of a message with their regions, and how many rows were left out.

    A track that is born after the message's own instant counts as born at it. Of names that are not followed, the first
    max_tracks are taken: a damaged message may have a million.
    """
    names = message.track
    unknown = [row for row, name in enumerate(names) if name not in followed]
    left_out = set(unknown[config.max_tracks :])
    rows = [row for row in range(len(names)) if row not in left_out] if left_out else slice(None)
    x, y, vx, vy, radius, x_var, x_cov, vx_var, y_var, y_cov, vy_var = (
        np.array(getattr(message, name), np.float64)[rows] for name in NUMBERS
    )
    radius = np.minimum(radius, PLACE_LIMIT_PX)  # so that what is absurd does not overflow
    vx, vy = _within(vx, SPEED_LIMIT_PX_S), _within(vy, SPEED_LIMIT_PX_S)
    reach = np.minimum(config.region_max_px, config.region_scale * radius + config.region_margin_px)
    least_vv = np.square(LEAST_PX_S + LEAST_SHARE * np.hypot(vx, vy))
    sure = doubt(
        np.maximum(np.maximum(x_var, y_var), LEAST_PX2),
        np.where(np.abs(y_cov) > np.abs(x_cov), y_cov, x_cov),
        np.maximum(np.maximum(vx_var, vy_var), least_vv),
    )
    born_us, seen_us = (np.array(column, np.int64)[rows] for column in (message.born_us, message.seen_us))
    return Telling(
        [name for row, name in enumerate(names) if row not in left_out],
        np.minimum(born_us, message.as_of_us),
        np.stack([_within(x, PLACE_LIMIT_PX), _within(y, PLACE_LIMIT_PX), vx, vy, reach]),
        np.minimum(radius, config.region_max_px),
        sure,
        np.clip(message.as_of_us - seen_us, 0, SILENCE_US),
    ), len(left_out)


def _within(values: Floats, limit: float) -> Floats:
    return np.clip(values, -limit, limit)
