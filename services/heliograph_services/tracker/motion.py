"""What moves a track between its sightings, besides its own filter: the interface to the flow, and the rule of its use.

`Motion` answers two questions at places and times: how fast does the thing move that is seen here (`velocities`), and
how fast do the surroundings move (`carried`). `NoMotion` knows neither; `network_motion` asks the flow network.

`Steering` sets the velocities after each window, by the setting `prediction`::

    none       v = 0; its uncertainty s is that of a birth
    centroid   v is the filter's own, from the centres of the targets
    flow       v is the flow's where it is known, else the last one known; 0 before
    both       the filter's own; while a row is in birth the flow's v_f is a measurement of v:
                   S = P_vv + r,  x += P_xv / S (v_f - v),  v += P_vv / S (v_f - v)
                   P_xx -= P_xv^2 / S,  P_xv *= r / S,  P_vv *= r / S
               a row that is not seen is carried by what the surroundings' motion c has changed since it was:
                   v += dc,  x += a dc                dc = c(x, now) - c(x, before), a = age of what c says (AGE_US)

The last line holds for whatever moves evenly in the scene while the camera turns, and for all that stands still. Being
a difference, it also takes an error of c out that stays the same. c tells late: a change that a row still showed itself
is not counted again, and one that it did not has moved it for the time a before it was known.
"""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from heliograph.messages import Message
from heliograph.streams import Onsets
from heliograph.units import US_PER_S
from heliograph_services.tracker.config import Prediction, TrackerConfig
from heliograph_services.tracker.tracks import TrackTable

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]

# The flow's samples live for 30 to 150 ms: asked more often, it says the same again.
ASK_US: Final = 20_000
# A fit's samples are held for 6 ticks, and a neuron's synapses lie up to 10 ticks back: on average 8 ticks, which are
# 40, 80 and 200 ms, and half the time between two fits.
AGE_US: Final = 100_000
# Below it noise may have made it (flow/README.md).
CONFIDENCE_LEAST: Final = 0.3
# Texture begins more births than there is time to ask for; the first ones are asked for.
ASKED_LIMIT: Final = 64


class Motion(Protocol):
    """A source of velocities other than the tracks' own filters."""

    def feed(self, onsets: Onsets) -> None:
        """Take the stream's next onsets, before the windows that they complete are followed."""
        ...

    def velocities(self, x_px: Floats, y_px: Floats, radius_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return how fast what is seen at n places moves, known from what came before t_us.

        Args:
            x_px: (n,) float64.
            y_px: (n,) float64.
            radius_px: (n,) float64, of the thing at each place.
            t_us: within the last message.

        Returns:
            (n, 2) float64 px/s, (n,) float64 variance of each axis, (px/s)^2; inf where unknown.
        """
        ...

    def carried(self, x_px: Floats, y_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return how fast the surroundings of n places move: (n, 2) float64 px/s, (n,) float64 confidence, 0 to 1.

        Args:
            x_px: (n,) float64.
            y_px: (n,) float64.
            t_us: not after the end of the last message; what came after t_us changes nothing.
        """
        ...

    def take(self) -> list[Message]:
        """Return the records to publish that were made since the last call."""
        ...


class NoMotion:
    """Knows nothing; the filters are alone."""

    def feed(self, onsets: Onsets) -> None:
        """Take no note."""

    def velocities(self, x_px: Floats, y_px: Floats, radius_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return zeros of unknown variance."""
        del y_px, radius_px, t_us
        return np.zeros((len(x_px), 2)), np.full(len(x_px), np.inf)

    def carried(self, x_px: Floats, y_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return zeros of no confidence."""
        del y_px, t_us
        return np.zeros((len(x_px), 2)), np.zeros(len(x_px))

    def take(self) -> list[Message]:
        """Return nothing."""
        return []


class Steering:
    """Sets the velocities of a table's rows after each window.

    Args:
        motion: of the stream that the table follows.
        prediction: see the module.
        speed_px_s: standard deviation of an unknown speed on each axis.
    """

    def __init__(self, motion: Motion, prediction: Prediction, speed_px_s: float) -> None:
        self._motion = motion
        self._prediction = prediction
        self._speed_var = speed_px_s**2
        self._at_us: int | None = None

    def apply(self, table: TrackTable, at_us: int) -> None:
        """Set the velocities for what follows a window, in place.

        Args:
            table: state, covariance and `flow_px_s` change; `seen_us` of the rows seen in the window is at_us.
            at_us: the window's end; the motion has been fed with the window, windows in order.
        """
        before_us = at_us if self._at_us is None else self._at_us
        self._at_us = at_us
        if len(table) == 0:
            return
        due = before_us // ASK_US != at_us // ASK_US
        if self._prediction == "none":
            table.state[:, 2:] = 0.0
            table.cov[:, [2, 5]] = self._speed_var
        elif self._prediction == "flow":
            self._replace(table, due, at_us)
        elif self._prediction == "both":
            if due:
                self._fuse(table, at_us)
            self._carry(table, before_us, at_us)

    def _replace(self, table: TrackTable, due: bool, at_us: int) -> None:
        """The flow's velocity alone, as it was last known."""
        known = np.zeros(len(table), np.bool_)
        if due:
            velocity, variance = self._asked(table, np.arange(len(table)), at_us)
            known = np.isfinite(variance)
            table.flow_px_s[known] = velocity[known]
            for axis in range(2):
                table.cov[known, 3 * axis + 1] = 0.0
                table.cov[known, 3 * axis + 2] = variance[known]
        table.state[:, 2:] = np.nan_to_num(table.flow_px_s, nan=0.0)
        # What nothing has measured since grows as uncertain as a birth.
        for column in (2, 5):
            table.cov[~known, column] = np.maximum(table.cov[~known, column], self._speed_var)

    def _fuse(self, table: TrackTable, at_us: int) -> None:
        """The flow as a measurement of the velocity of what was seen just now, and is in birth."""
        rows = np.flatnonzero(~table.named & (table.seen_us == at_us))[:ASKED_LIMIT]
        if len(rows) == 0:
            return
        velocity, variance = self._asked(table, rows, at_us)
        known = np.isfinite(variance)
        rows, velocity, r = rows[known], velocity[known], variance[known]
        for axis in range(2):
            xx, xv, vv = (table.cov[rows, 3 * axis + i] for i in range(3))
            s = vv + r
            innovation = velocity[:, axis] - table.state[rows, 2 + axis]
            table.state[rows, axis] += xv / s * innovation
            table.state[rows, 2 + axis] += vv / s * innovation
            table.cov[rows, 3 * axis] = xx - xv**2 / s
            table.cov[rows, 3 * axis + 1] = xv * r / s
            table.cov[rows, 3 * axis + 2] = vv * r / s
        table.flow_px_s[rows] = velocity

    def _asked(self, table: TrackTable, rows: Longs, at_us: int) -> tuple[Floats, Floats]:
        return self._motion.velocities(table.state[rows, 0], table.state[rows, 1], table.radius_px[rows], at_us)

    def _carry(self, table: TrackTable, before_us: int, at_us: int) -> None:
        """Rows that are not seen take part in the changes of the surroundings' motion."""
        rows = np.flatnonzero(table.seen_us <= before_us - AGE_US)
        if len(rows) == 0:
            return
        x_px, y_px = table.state[rows, 0], table.state[rows, 1]
        before, sure_before = self._motion.carried(x_px, y_px, before_us)
        now, sure = self._motion.carried(x_px, y_px, at_us)
        sure_enough = np.minimum(sure_before, sure) >= CONFIDENCE_LEAST
        change = np.where(sure_enough[:, None], now - before, 0.0)
        table.state[rows, 2:] += change
        table.state[rows, :2] += AGE_US / US_PER_S * change


def make(config: TrackerConfig, first: Onsets) -> Motion:
    """Return no motion, for any stream."""
    del config, first
    return NoMotion()
