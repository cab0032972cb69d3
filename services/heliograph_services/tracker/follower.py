"""One window after another: predict, associate, update, confirm, initiate, delete.

Published tracks choose their targets first, those in birth among what is left; what then lies on a track's disc is
part of it (the crescents of a moving LED), and only a target with the shape of a light that touches no track is a birth
(`births`). What a track takes in of its targets: `sighting`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal, Refusals
from heliograph.messages import StatusWord
from heliograph.units import US_PER_S
from heliograph_services.tracker import association, births, recovery, shape, turning
from heliograph_services.tracker.association import Candidates, Gate
from heliograph_services.tracker.backends import Backends
from heliograph_services.tracker.clustering import Active, Ints
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.identity import Identities
from heliograph_services.tracker.motion import Motion, Steering
from heliograph_services.tracker.quarantine import Quarantine
from heliograph_services.tracker.shape import ShapeFilter, Targets
from heliograph_services.tracker.sighting import SIZE_RATIO, TURN_US, Rule, Sighting, see, shines
from heliograph_services.tracker.splitting import PASS_S, Followed, carve, split
from heliograph_services.tracker.tracks import INVALID, VALID, Numbers, Snapshot, TrackTable
from heliograph_services.tracker.windows import Window

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# More clusters than this in a window are weather, not beacons; gating all of them would take milliseconds.
TARGETS_LIMIT: Final = 2_000
# A centre this far off the sensor, in radii and pixels, has left.
LEAVE_RADII: Final = 2.0
LEAVE_PX: Final = 8.0
# At 1 kbit/s nine windows of ten show an edge of the code; at 50 bit/s one of three, and what is seen between is where
# a lit LED goes.
BLINKING: Final = 0.7
# That events came at once says something where a window has several ticks and the sensor's instants are finer still:
# then neighbouring ticks have events, now and then. Images, and the scans of a sensor under load, lie apart.
FINE_TICKS: Final = 4
FINE_US: Final = 500_000

_REFUSED: Final = (
    (shape.TOO_FEW, Refusal.TOO_FEW_PIXELS),
    (shape.TOO_MANY, Refusal.TOO_MANY_PIXELS),
    (shape.NOT_ROUND, Refusal.NOT_ROUND),
)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The k targets of a window, and who passes whom; see `splitting`.

    Args:
        targets: of the window.
        held: (k,) bool: for nobody: of tracks that pass each other, or what a light was cut out of.
        passing: (n,) bool, rows of the table that go on without a target.
    """

    targets: Targets
    held: Flags
    passing: Flags


class Follower(Protocol):
    """What the core drives: windows in, instants out."""

    def step(self, window: Window) -> bool:
        """Take the next window that has entries; return whether a track was born."""
        ...

    def judge(self, words: dict[int, StatusWord], tokens: dict[int, str | None], at_us: int) -> bool:
        """Take the decoder's words and tokens, by the tracks' numbers; return whether names have changed."""
        ...

    def expire(self, at_us: int) -> None:
        """End the tracks whose time is up."""
        ...

    def snapshot(self, at_us: int) -> Snapshot:
        """Return what is published at this time; changes nothing."""
        ...


class GridFollower:
    """Follows the targets of one stream.

    Args:
        config: settings.
        backends: who clusters and who filters.
        motion: what else is known of velocities, of this stream.
        width: sensor columns.
        height: sensor rows.
        pool_px: side of an onset pixel.
        window_us: length of a window.
        tick_us: length of a tick.
        numbers: names the tracks.
        counters: added to; see `COUNTERS`.
        refusals: targets that no track used and that may not be one, by reason.
    """

    def __init__(
        self,
        config: TrackerConfig,
        backends: Backends,
        motion: Motion,
        *,
        width: int,
        height: int,
        pool_px: int,
        window_us: int,
        tick_us: int,
        numbers: Numbers,
        counters: dict[str, int],
        refusals: Refusals,
    ) -> None:
        self._config = config
        self._size = (width, height)
        self._pool_px = pool_px
        self._numbers = numbers
        self._counters = counters
        self._refusals = refusals
        self._filters = backends.filters
        self._clusterer = backends.clustering(
            -(-width // pool_px), -(-height // pool_px), config.eps_px, config.min_events
        )
        self._rule = ShapeFilter(config.min_pixels, config.max_pixels, config.min_roundness, config.shape)
        # A pooled entry lies anywhere in its square.
        noise_px = float(np.sqrt(config.measurement_noise_px**2 + (pool_px**2 - 1) / 12))
        window_s, tick_s, q = window_us / US_PER_S, tick_us / US_PER_S, config.process_noise_px2_s3
        self._gate = Gate(config.gate_chi2, config.gate_px, noise_px, tick_s, config.cost)
        self._weights = Rule(
            noise_px, window_s, tick_s, pool_px, config.max_speed_px_s, q, max(q, config.process_noise_max_px2_s3)
        )
        self._quarantine = Quarantine(config.quarantine_us, config.quarantine_max_us)
        self._steering = Steering(motion, config.prediction, config.initial_speed_px_s)
        self._identities = Identities()
        self._at_us = 0
        # End of the last window that had events in neighbouring ticks.
        self._fine_us = -FINE_US - 1
        self.table = TrackTable()

    def step(self, window: Window) -> bool:
        """Take the next window, later than the one before; return whether a track was born."""
        born = self._born()
        self._track(window)
        self._steering.apply(self.table, window.end_us)
        return self._born() > born

    def _born(self) -> int:
        return self._counters["tracks_born"] + self._counters["tracks_found_again"]

    def _track(self, window: Window) -> None:
        """Predict, associate, update, confirm, initiate."""
        self.expire(window.start_us)
        # Targets have times of their own, from here.
        self._predict((window.start_us + window.end_us) // 2)
        found = self._targets(window)
        if found is None or len(found.targets) == 0:
            return
        targets = found.targets
        self._counters["targets"] += len(targets)
        free = (targets.verdict != shape.TOO_MANY) & ~found.held
        named, blinking = self.table.named & ~found.passing, self._blinking()
        self._follow(np.flatnonzero(named), targets, free, window.end_us)
        self._find(np.flatnonzero(named & blinking), targets, free, window.end_us)
        self._follow(np.flatnonzero(~self.table.named), targets, free, window.end_us)
        births.confirm(self.table, self._config, self._numbers, self._counters)
        # Too large to be used, so not taken by a track.
        left = (free | (targets.verdict == shape.TOO_MANY)) & ~found.held
        for verdict, reason in _REFUSED:
            refused = int(np.count_nonzero(left & (targets.verdict == verdict)))
            if refused:
                self._refusals[reason] += refused
        new = np.flatnonzero(free & targets.light)
        closed = self._quarantine.closed(window.start_us)
        births.initiate(self.table, targets, new, window, closed, self._config, self._weights, self._counters)

    def judge(self, words: dict[int, StatusWord], tokens: dict[int, str | None], at_us: int) -> bool:
        """Take the decoder's words and tokens, by the tracks' numbers; return whether names have changed."""
        table = self.table
        table.judge(words, at_us)
        named = table.named
        since_us = table.blink_us if self._config.confirm_blinks else table.seen_us
        numbers, seen_us = table.number[named].tolist(), since_us[named].tolist()
        unseen_us = {number: at_us - us for number, us in zip(numbers, seen_us, strict=True)}
        renaming = self._identities.judge(tokens, unseen_us, at_us)
        if not renaming.number:
            return False
        gone = np.isin(table.number, list(renaming.ended))
        table.rename(renaming.number)
        table.keep(~gone)
        self._counters["tracks_taken_over"] += len(renaming.ended)
        self._counters["tracks_renamed"] += len(renaming.number) - 2 * len(renaming.ended)
        return True

    def expire(self, at_us: int) -> None:
        """End the tracks whose time is up; where one was invalid, close the place for births."""
        table = self.table
        if len(table) == 0:
            return
        alive = self._alive(at_us)
        if alive.all():
            return
        ended = np.flatnonzero(~alive & table.named)
        x_px, y_px = self._extrapolated(at_us)[0][:, :2].T
        for i in ended:
            self._counters["tracks_ended"] += 1
            if table.status[i] == INVALID:
                self._counters["tracks_ended_invalid"] += 1
                # What was read once is a beacon that fell silent, not a lamp: it may shine again here.
                if table.read[i]:
                    continue
                radius = float(table.radius_px[i]) + association.DISC_SLACK_PX
                self._quarantine.close(float(x_px[i]), float(y_px[i]), radius, at_us)
        table.keep(alive)

    def snapshot(self, at_us: int) -> Snapshot:
        """Return the published tracks, extrapolated; changes nothing."""
        rows = np.flatnonzero(self._alive(at_us) & self.table.named)
        state, cov = self._extrapolated(at_us)
        return self.table.snapshot(rows, state[rows], cov[rows])

    @property
    def quarantined(self) -> int:
        """The number of places that are remembered."""
        return len(self._quarantine)

    def _alive(self, at_us: int) -> Flags:
        config, table = self._config, self.table
        coast = np.where(table.status == VALID, config.coast_valid_us, config.coast_new_us)
        # What is seen and does not blink any more is something else that has come in its way.
        since_us = table.blink_us if config.confirm_blinks else table.seen_us
        alive = at_us - np.where(table.named, since_us, table.seen_us) <= coast
        alive &= (table.status != INVALID) | (at_us - table.invalid_us < config.invalid_us)
        alive &= table.named | (at_us - table.born_us <= config.confirm_us)
        state = self.table.state.copy()
        state[:, :2] += (at_us - self._at_us) / US_PER_S * state[:, 2:]
        turning.turn(self.table, state, self._at_us, at_us)
        margin = LEAVE_RADII * table.radius_px + LEAVE_PX
        for axis, side in enumerate(self._size):
            alive &= (state[:, axis] >= -margin) & (state[:, axis] <= side - 1 + margin)
        return alive

    def _extrapolated(self, at_us: int) -> tuple[Floats, Floats]:
        """Return (n, 4) states and (n, 6) covariances at a time after the last window."""
        state, cov = self.table.state.copy(), self.table.cov.copy()
        self._filters.predict(state, cov, (at_us - self._at_us) / US_PER_S, self._density(at_us))
        turning.turn(self.table, state, self._at_us, at_us)
        return state, cov

    def _density(self, to_us: int) -> Floats:
        """Return (n,) the acceleration from now until to_us: a row's own while it has been out of sight for little.

        What is in birth has none of its own: fragments of edges would jump from one to the next, and be confirmed.
        """
        q, dt_us = self._config.process_noise_px2_s3, max(1, to_us - self._at_us)
        turning_us = np.minimum(np.maximum(self.table.seen_us + TURN_US - self._at_us, 0), dt_us) * self.table.named
        return np.asarray(q + (np.maximum(self.table.q, q) - q) * (turning_us / dt_us))

    def _predict(self, to_us: int) -> None:
        if len(self.table):
            dt_s = (to_us - self._at_us) / US_PER_S
            self._filters.predict(self.table.state, self.table.cov, dt_s, self._density(to_us))
            turning.turn(self.table, self.table.state, self._at_us, to_us)
        self._at_us = to_us

    def _targets(self, window: Window) -> Found | None:
        if window.flooded:
            self._counters["windows_flooded"] += 1
            return None
        active = self._clusterer.distinct(window.x_px, window.y_px, window.on, window.off, window.tick)
        self._counters["active_pixels"] += len(active)
        if len(active) > self._config.max_active_pixels:
            self._counters["windows_flooded"] += 1
            return None
        labels, count = self._clusterer.labels(active)
        if count > TARGETS_LIMIT:
            self._counters["windows_flooded"] += 1
            return None
        if np.any(np.diff(window.tick) == 1):
            self._fine_us = window.end_us
        targets = self._measured(window, active, labels, np.zeros(count, np.bool_))
        carved = carve(active, labels, targets, self._clusterer.labels, self._config.min_pixels)
        around = np.zeros(count, np.bool_)
        if carved is not None:
            self._counters["targets_carved"] += carved[1] - count
            labels, count, around = carved
            targets = self._measured(window, active, labels, np.zeros(count, np.bool_))
        table, named = self.table, np.flatnonzero(self.table.named)
        fresh = window.end_us - table.seen_us[named] <= PASS_S * US_PER_S
        tracks = Followed(table.state[named], table.radius_px[named], table.size_px[named], fresh)
        cut = split(active, labels, targets, tracks, self._pool_px)
        passing = np.zeros(len(table), np.bool_)
        if cut is None:
            return Found(targets, around, passing)
        self._counters["targets_split"] += 1
        passing[named] = cut.passing
        held = cut.held.copy()
        # What is cut along tracks is theirs.
        held[:count] |= around & ~cut.piece[:count]
        return Found(self._measured(window, active, cut.labels, cut.piece), held, passing)

    def _measured(self, window: Window, active: Active, labels: Ints, piece: Flags) -> Targets:
        ticks = (window.end_us - window.start_us) // window.tick_us
        is_fine = ticks >= FINE_TICKS and window.end_us - self._fine_us <= FINE_US
        tick_s = window.tick_us / US_PER_S
        return shape.measure(active, labels, piece, self._pool_px, self._rule, ticks, tick_s, is_fine=is_fine)

    def _blinking(self) -> Flags:
        """Return (n,) bool: the rows that are seen as a light that is switched, and by what else passes, not at all."""
        return np.asarray((self.table.habit > BLINKING) & (self._config.confirm_blinks > 0))

    def _follow(self, rows: Longs, targets: Targets, free: Flags, end_us: int) -> None:
        """Give the rows their targets, update them, and take what they use out of `free`."""
        if len(rows) == 0 or not free.any():
            return
        table = self.table
        seen_px = self._seen_px(targets.pixels)
        offered = Candidates(targets.x_px, targets.y_px, seen_px, targets.lag_s, free)
        chosen = association.assign(table.state, table.cov, table.radius_px, table.size_px, rows, offered, self._gate)
        # A merely passing edge at a blinking light's place is not the light.
        strict, switched = self._blinking()[rows], targets.switched
        place = np.flatnonzero((chosen >= 0) & (~strict | switched[chosen]) & self._shine_fits(rows, chosen, targets))
        if len(place) == 0:
            return
        free[chosen[place]] = False
        part_of, parts = self._parts(rows[place], targets, seen_px, free)
        lights = ~strict[place][part_of] | switched[parts]
        part_of, parts = part_of[lights], parts[lights]
        free[parts] = False
        owner, used = np.concatenate([np.arange(len(place)), part_of]), np.concatenate([chosen[place], parts])
        see(table, self._filters, Sighting(rows[place], owner, used), targets, end_us, self._weights)

    def _shine_fits(self, rows: Longs, chosen: Longs, targets: Targets) -> Flags:
        """Return (k,) bool: a light that shines and moves takes no edge beside its disc, and nothing larger there."""
        table = self.table
        away = np.hypot(targets.x_px[chosen] - table.state[rows, 0], targets.y_px[chosen] - table.state[rows, 1])
        radius = table.radius_px[rows]
        fits = self._seen_px(targets.pixels[chosen]) <= SIZE_RATIO * table.size_px[rows]
        fits &= (targets.rise & targets.light)[chosen] | (away <= radius + association.DISC_SLACK_PX)
        # Known by its crescents, it is larger when it is switched.
        fits |= away <= radius
        return np.asarray(~shines(table)[rows] | targets.dipole[chosen] | fits)

    def _find(self, rows: Longs, targets: Targets, free: Flags, end_us: int) -> None:
        """Give rows that lost their light because it turned the nearest free one that blinks; see `recovery`."""
        rows = rows[self.table.seen_us[rows] < end_us]
        used = np.flatnonzero(free & targets.light & targets.blinking)
        if len(rows) == 0 or len(used) == 0:
            return
        found = recovery.found(self.table, rows, targets, used, self._seen_px(targets.pixels), end_us, self._config)
        if len(found.rows):
            free[found.used] = False
            recovery.loosen(self.table, found.rows, end_us)
            see(self.table, self._filters, found, targets, end_us, self._weights)
            self._counters["tracks_found_again"] += len(found.rows)

    def _parts(self, rows: Longs, targets: Targets, seen_px: Floats, free: Flags) -> tuple[Longs, Longs]:
        """Return which further targets lie on the discs of the rows: the row's place, the target."""
        table = self.table
        others = np.flatnonzero(free)
        owner = association.owners(
            targets.x_px[others],
            targets.y_px[others],
            targets.lag_s[others],
            np.zeros(len(others)),
            table.state[rows],
            table.radius_px[rows] + association.DISC_SLACK_PX,
        )
        limit = association.GROWTH * table.size_px[rows] + association.GROWTH_PX
        fits = (owner >= 0) & (seen_px[others] <= limit[owner])
        return owner[fits], others[fits]

    def _seen_px(self, pixels: npt.NDArray[Any]) -> Floats:
        return pixels.astype(np.float64) * self._pool_px**2
