"""One window after another: predict, associate, update, confirm, initiate, delete.

Published tracks choose their targets first, those in birth among what is left; what then lies on a track's disc is
part of it (the crescents of a moving LED), and only a round target that touches no track is a birth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal, Refusals
from heliograph.messages import StatusWord
from heliograph.units import US_PER_S
from heliograph_services.tracker import association, shape
from heliograph_services.tracker.association import Candidates, Gate
from heliograph_services.tracker.backends import Backends
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.identity import Identities
from heliograph_services.tracker.motion import Motion, Steering
from heliograph_services.tracker.quarantine import Quarantine
from heliograph_services.tracker.shape import ShapeFilter, Targets
from heliograph_services.tracker.splitting import split
from heliograph_services.tracker.tracks import INVALID, VALID, Snapshot, TrackTable
from heliograph_services.tracker.windows import Window

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# More clusters than this in a window are weather, not beacons; gating all of them would take milliseconds.
TARGETS_LIMIT: Final = 2_000
# The disc of a nearing beacon is followed in a few windows; a window that shows little of it must not shrink it.
GROW: Final = 0.2
SHRINK: Final = 0.1
# A centre this far off the sensor, in radii and pixels, has left.
LEAVE_RADII: Final = 2.0
LEAVE_PX: Final = 8.0
# A blinking light fires all its pixels one way, then all of them the other way; a crossing edge fires each pixel one
# way, and a texture goes on with one polarity or mixes both among different pixels. So a window shows blinking if a
# share of its pixels went both ways within it (fast light), or if its polarity is clear and not the last clear one
# (slow light). Clear is the paper's |P| >= .5. The edges of 5 kbit/s put both into every pixel of a 5 ms window that
# has more than one event; noise on an edge does so in one of twenty.
BOTH_SHARE: Final = 0.25
CLEAR: Final = 0.5

_REFUSED: Final = (
    (shape.TOO_FEW, Refusal.TOO_FEW_PIXELS),
    (shape.TOO_MANY, Refusal.TOO_MANY_PIXELS),
    (shape.NOT_ROUND, Refusal.NOT_ROUND),
)


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


@dataclass(slots=True)
class Numbers:
    """The next track's number, across streams; never falls."""

    next: int = 0

    def take(self) -> int:
        """Return a number and never again the same."""
        self.next += 1
        return self.next - 1


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
        self._noise_px = float(np.sqrt(config.measurement_noise_px**2 + (pool_px**2 - 1) / 12))
        self._gate = Gate(config.gate_chi2, config.gate_px, self._noise_px, window_us / US_PER_S, config.cost)
        self._quarantine = Quarantine(config.quarantine_us, config.quarantine_max_us)
        self._steering = Steering(motion, config.prediction, config.initial_speed_px_s)
        self._identities = Identities()
        self._at_us = 0
        self.table = TrackTable()

    def step(self, window: Window) -> bool:
        """Take the next window, later than the one before; return whether a track was born."""
        born = self._counters["tracks_born"]
        self._track(window)
        self._steering.apply(self.table, window.end_us)
        return self._counters["tracks_born"] > born

    def _track(self, window: Window) -> None:
        """Predict, associate, update, confirm, initiate."""
        self.expire(window.start_us)
        # The events' mean time is not known; the middle is off by W / sqrt(12).
        self._predict((window.start_us + window.end_us) // 2)
        targets = self._targets(window)
        if targets is None or len(targets) == 0:
            return
        self._counters["targets"] += len(targets)
        free = targets.verdict != shape.TOO_MANY
        named = self.table.named
        self._follow(np.flatnonzero(named), targets, free, window.end_us)
        self._follow(np.flatnonzero(~named), targets, free, window.end_us)
        self._confirm()
        # Too large to be used, so not taken by a track.
        left = free | (targets.verdict == shape.TOO_MANY)
        for verdict, reason in _REFUSED:
            refused = int(np.count_nonzero(left & (targets.verdict == verdict)))
            if refused:
                self._refusals[reason] += refused
        self._initiate(targets, np.flatnonzero(free & (targets.verdict == shape.ROUND)), window)

    def judge(self, words: dict[int, StatusWord], tokens: dict[int, str | None], at_us: int) -> bool:
        """Take the decoder's words and tokens, by the tracks' numbers; return whether names have changed."""
        table = self.table
        table.judge(words, at_us)
        named = table.named
        numbers, seen_us = table.number[named].tolist(), table.seen_us[named].tolist()
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
        alive = at_us - table.seen_us <= coast
        alive &= (table.status != INVALID) | (at_us - table.invalid_us < config.invalid_us)
        alive &= table.named | (at_us - table.born_us <= config.confirm_us)
        state, _ = self._extrapolated(at_us)
        margin = LEAVE_RADII * table.radius_px + LEAVE_PX
        for axis, side in enumerate(self._size):
            alive &= (state[:, axis] >= -margin) & (state[:, axis] <= side - 1 + margin)
        return alive

    def _extrapolated(self, at_us: int) -> tuple[Floats, Floats]:
        """Return (n, 4) states and (n, 6) covariances at a time after the last window."""
        state, cov = self.table.state.copy(), self.table.cov.copy()
        self._filters.predict(state, cov, (at_us - self._at_us) / US_PER_S, self._config.process_noise_px2_s3)
        return state, cov

    def _predict(self, to_us: int) -> None:
        if len(self.table):
            dt_s = (to_us - self._at_us) / US_PER_S
            self._filters.predict(self.table.state, self.table.cov, dt_s, self._config.process_noise_px2_s3)
        self._at_us = to_us

    def _targets(self, window: Window) -> Targets | None:
        if window.flooded:
            self._counters["windows_flooded"] += 1
            return None
        active = self._clusterer.distinct(window.x_px, window.y_px, window.on, window.off)
        self._counters["active_pixels"] += len(active)
        if len(active) > self._config.max_active_pixels:
            self._counters["windows_flooded"] += 1
            return None
        labels, count = self._clusterer.labels(active)
        if count > TARGETS_LIMIT:
            self._counters["windows_flooded"] += 1
            return None
        targets = shape.measure(active, labels, np.zeros(count, np.bool_), self._pool_px, self._rule)
        named = self.table.named
        cut = split(active, labels, targets, self.table.state[named, :2], self.table.size_px[named], self._pool_px)
        if cut is None:
            return targets
        self._counters["targets_split"] += 1
        return shape.measure(active, *cut, self._pool_px, self._rule)

    def _follow(self, rows: Longs, targets: Targets, free: Flags, end_us: int) -> None:
        """Give the rows their targets, update them, and take what they use out of `free`."""
        if len(rows) == 0 or not free.any():
            return
        table = self.table
        seen_px = self._seen_px(targets.pixels)
        offered = Candidates(targets.x_px, targets.y_px, seen_px, free)
        chosen = association.assign(table.state, table.cov, table.radius_px, table.size_px, rows, offered, self._gate)
        place = np.flatnonzero(chosen >= 0)
        if len(place) == 0:
            return
        free[chosen[place]] = False
        part_of, parts = self._parts(rows[place], targets, seen_px, free)
        free[parts] = False
        self._update(
            rows[place], np.concatenate([np.arange(len(place)), part_of]), chosen[place], parts, targets, end_us
        )

    def _parts(self, rows: Longs, targets: Targets, seen_px: Floats, free: Flags) -> tuple[Longs, Longs]:
        """Return which further targets lie on the discs of the rows: the row's place, the target."""
        table = self.table
        others = np.flatnonzero(free)
        owner = association.owners(
            targets.x_px[others],
            targets.y_px[others],
            np.zeros(len(others)),
            table.state[rows, 0],
            table.state[rows, 1],
            table.radius_px[rows] + association.DISC_SLACK_PX,
        )
        limit = association.GROWTH * table.size_px[rows] + association.GROWTH_PX
        fits = (owner >= 0) & (seen_px[others] <= limit[owner])
        return owner[fits], others[fits]

    def _update(self, rows: Longs, owner: Longs, chosen: Longs, parts: Longs, targets: Targets, end_us: int) -> None:
        table, k = self.table, len(rows)
        used = np.concatenate([chosen, parts])
        weight = targets.pixels[used].astype(np.float64)
        total = np.bincount(owner, weight, k)
        z = np.stack([np.bincount(owner, weight * at[used], k) / total for at in (targets.x_px, targets.y_px)], axis=1)
        seen_px = total * self._pool_px**2
        share = np.minimum(1.0, seen_px / table.size_px[rows])
        trust = np.where(np.bincount(owner, targets.piece[used], k) > 0, 0.0, share)
        r = np.empty((k, 2))
        r[:] = (self._noise_px**2 + (1 - trust) * table.radius_px[rows] ** 2 / 4)[:, None]
        r += (table.state[rows, 2:] * self._gate.window_s) ** 2 / 12
        self._filters.update(table.state, table.cov, rows, z, r, self._config.max_speed_px_s)
        on = np.bincount(owner, targets.on[used], k)
        off = np.bincount(owner, targets.off[used], k)
        table.polarity[rows] = (on - off) / (on + off)
        both = np.bincount(owner, targets.both[used], k) >= BOTH_SHARE * total
        sign = _sign(table.polarity[rows])
        flipped = sign * table.sign[rows] < 0
        table.blinks[rows] += both | flipped
        table.sign[rows] = np.where(sign == 0, table.sign[rows], sign)
        table.seen_us[rows] = end_us
        table.hits[rows] += targets.verdict[chosen] == shape.ROUND
        rate = np.where(seen_px > table.size_px[rows], GROW, SHRINK * share)
        table.size_px[rows] += rate * (seen_px - table.size_px[rows])
        # The radius of several parts is not theirs; that of the track stays.
        alone = np.bincount(owner, minlength=k) == 1
        table.radius_px[rows] += np.where(alone, rate, 0.0) * (targets.radius_px[chosen] - table.radius_px[rows])

    def _confirm(self) -> None:
        """Name the rows in birth that were seen and blinked often enough, in the order of birth."""
        table, config = self.table, self._config
        ripe = np.flatnonzero(
            ~table.named & (table.hits >= config.confirm_hits) & (table.blinks >= config.confirm_blinks)
        )
        if len(ripe) == 0:
            return
        alive = np.ones(len(table), np.bool_)
        for i in ripe:
            named = np.flatnonzero(table.named)
            d = np.hypot(table.state[named, 0] - table.state[i, 0], table.state[named, 1] - table.state[i, 1])
            if (d < np.maximum(table.radius_px[named], table.radius_px[i])).any():
                # Two births of one light: the first one has it.
                alive[i] = False
                self._counters["births_double"] += 1
            elif len(named) >= config.max_tracks:
                alive[i] = False
                self._counters["births_over_limit"] += 1
            else:
                table.number[i] = self._numbers.take()
                self._counters["tracks_born"] += 1
        if not alive.all():
            table.keep(alive)

    def _initiate(self, targets: Targets, new: Longs, window: Window) -> None:
        """Begin a birth at each of the targets that touch no track and lie in no closed place.

        If there are too many, the largest.
        """
        if len(new) == 0:
            return
        table, config = self.table, self._config
        x_px, y_px, radius_px = targets.x_px[new], targets.y_px[new], targets.radius_px[new]
        touched = association.owners(x_px, y_px, radius_px, table.state[:, 0], table.state[:, 1], table.radius_px) >= 0
        closed = self._quarantine.closed(window.start_us)
        barred = association.owners(x_px, y_px, np.zeros(len(new)), closed[:, 0], closed[:, 1], closed[:, 2]) >= 0
        self._counters["births_quarantined"] += int(np.count_nonzero(barred & ~touched))
        new = new[~touched & ~barred]
        room = config.max_tracks - int(np.count_nonzero(~table.named))
        if len(new) > room:
            self._counters["births_over_limit"] += len(new) - room
            new = np.sort(new[np.argsort(-targets.pixels[new], kind="stable")][:room])
        if len(new) == 0:
            return
        self._counters["births"] += len(new)
        on, off = targets.on[new].astype(np.float64), targets.off[new].astype(np.float64)
        polarity = (on - off) / (on + off)
        table.append(
            xy_px=np.stack([targets.x_px[new], targets.y_px[new]], axis=1),
            var_px2=np.full(len(new), self._noise_px**2),
            radius_px=targets.radius_px[new],
            size_px=self._seen_px(targets.pixels[new]),
            polarity=polarity,
            blinks=targets.both[new] >= BOTH_SHARE * targets.pixels[new],
            sign=_sign(polarity),
            born_us=window.start_us,
            seen_us=window.end_us,
            speed_var=config.initial_speed_px_s**2,
        )

    def _seen_px(self, pixels: npt.NDArray[Any]) -> Floats:
        return pixels.astype(np.float64) * self._pool_px**2


def _sign(polarity: Floats) -> Longs:
    """Return 1 or -1 where the polarity is clear, else 0."""
    return np.where(np.abs(polarity) >= CLEAR, np.sign(polarity), 0.0).astype(np.int64)
