"""Tracks against the truth of a scene: instants to score, time to acquire, and how late tracks are.

The truth tells where beacons are at the ends of its windows. Between them a place is the cubic through the four nearest
ends if the beacon is in view at all of them, else the line between two; where tracks and truth share their times
(both at multiples of 50 ms) nothing is interpolated. In view or visible is what is so at both ends.

Scored is one of two sets of beacons. `visible`: those that can be seen; tracks of others in view (coasting through an
occlusion, as they should) are neither right nor false, and left out. `in_view`: all, so that coasting is scored too.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from heliograph.messages import Tracks
from heliograph.truth import Truth
from heliograph.units import US_PER_S
from heliograph_services.cli.studies.tracking import (
    GOSPA_C_PX,
    GOSPA_P,
    Clear,
    Floats,
    Identity,
    Instant,
    Match,
    clear,
    gospa,
    identity,
    paired,
)

Scored = Literal["visible", "in_view"]

# The match distance of all metrics here: max(5 px, the blob's radius).
GATE_PX: Final = 5.0
# A beacon that no track has matched in this time is not acquired.
ACQUIRED_WITHIN_US: Final = US_PER_S


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Tracks at an instant.

    Args:
        t_us: the camera time for which they hold.
        track: n names, distinct.
        xy_px: (n, 2) float64.
        published_us: camera time at which they became known, if that is known.
    """

    t_us: int
    track: tuple[str, ...]
    xy_px: Floats
    published_us: int | None = None


@dataclass(frozen=True, slots=True)
class Acquisition:
    """A visible interval of a beacon and how long it took to a track; `after_us` None: none before it ended."""

    beacon: str
    start_us: int
    end_us: int
    after_us: int | None

    @property
    def counts(self) -> bool:
        """Whether the interval was long enough to be acquired, or was."""
        return self.after_us is not None or self.end_us - self.start_us >= ACQUIRED_WITHIN_US


@dataclass(frozen=True, slots=True)
class Score:
    """The tracker's figures of one run.

    Args:
        scored: which beacons.
        instants: scored.
        clear: MOTA, switches, RMSE.
        identity: IDF1.
        gospa_px: mean over the instants, of GOSPA with p = 2, c = 5 px, alpha = 2.
        acquisitions: of visible intervals.
        latency_us: publication after the instant for which tracks hold, where known.
        lag_us: how far tracks are behind on their beacons' paths; nan if nothing moves.
    """

    scored: Scored
    instants: int
    clear: Clear
    identity: Identity
    gospa_px: float
    acquisitions: tuple[Acquisition, ...]
    latency_us: tuple[int, ...]
    lag_us: float

    def row(self) -> dict[str, Any]:
        """Return the figures by name, for a table or JSON; what is unknown is None."""
        waits = [math.inf if a.after_us is None else a.after_us for a in self.acquisitions if a.counts]
        late = sum(wait > ACQUIRED_WITHIN_US for wait in waits)
        figures: dict[str, Any] = {
            "scored": self.scored,
            "instants": self.instants,
            "objects": self.clear.objects,
            "mota": self.clear.mota,
            "idf1": self.identity.idf1,
            "misses": self.clear.misses,
            "false": self.clear.false,
            "switches": self.clear.switches,
            "transfers": self.clear.transfers,
            "rmse_px": self.clear.rmse_px,
            "gospa_px": self.gospa_px,
            "gospa_p": GOSPA_P,
            "gospa_c_px": GOSPA_C_PX,
            "gospa_alpha": 2,
            "acquisitions": len(waits),
            "acquisition_median_us": quantile(waits, 0.5),
            "acquisition_p95_us": quantile(waits, 0.95),
            "never_acquired_in_1_s": late / len(waits) if waits else math.nan,
            "latency_median_us": quantile(self.latency_us, 0.5),
            "latency_p95_us": quantile(self.latency_us, 0.95),
            "lag_us": self.lag_us,
        }
        unknown = {name for name, value in figures.items() if isinstance(value, float) and not math.isfinite(value)}
        return {name: None if name in unknown else value for name, value in figures.items()}


def sample(tracks: Tracks, published_us: int | None = None) -> Sample:
    """Return the positions of a message."""
    return Sample(
        tracks.as_of_us, tuple(tracks.track), _places(zip(tracks.x_px, tracks.y_px, strict=True)), published_us
    )


def score(truths: Sequence[Truth], samples: Sequence[Sample], scored: Scored = "visible") -> Score:
    """Return the figures of one run.

    Args:
        truths: of one camera, in order, without gaps.
        samples: in order; those outside the truth's time are left out.
        scored: which beacons; see the module.

    Raises:
        ValueError: the truths leave a gap, overlap, or name other beacons than the first.
    """
    known = _Known(truths)
    inside = [each for each in samples if known.start_us <= each.t_us <= known.end_us]
    instants = [known.instant(each, scored) for each in inside]
    counts, matches = clear(instants)
    published = {each.t_us: each.t_us if each.published_us is None else each.published_us for each in inside}
    # A track that coasted through the darkness has the beacon at once, that is at the next publication.
    seen = clear([known.instant(each, "in_view") for each in inside])[1]
    return Score(
        scored=scored,
        instants=len(instants),
        clear=counts,
        identity=identity(instants),
        gospa_px=float(np.mean([gospa(instant).distance_px for instant in instants])) if instants else math.nan,
        acquisitions=tuple(_acquisitions(known, seen, published)),
        latency_us=tuple(each.published_us - each.t_us for each in inside if each.published_us is not None),
        lag_us=_lag_us(known, instants, matches),
    )


def quantile(values: Sequence[float], share: float) -> float:
    """Return the smallest value that at least this share of all does not exceed; nan of none."""
    if not values:
        return math.nan
    return float(sorted(values)[max(0, math.ceil(share * len(values)) - 1)])


class _Known:
    """The truth of a run as columns: m ends of windows by k beacons."""

    def __init__(self, truths: Sequence[Truth]) -> None:
        if not truths:
            raise ValueError("truths must not be empty")
        first = truths[0]
        for before, truth in pairwise(truths):
            if truth.t0_us != before.t1_us or truth.beacon != first.beacon or truth.t1_us <= truth.t0_us:
                raise ValueError(f"truths must follow each other and name the same beacons, not so at {truth.t0_us} us")
        self.beacon = tuple(first.beacon)
        self.start_us, self.end_us = first.t1_us, truths[-1].t1_us
        self.begin_us = [truth.t0_us for truth in truths]
        self.at_us = [truth.t1_us for truth in truths]
        self.xy_px = np.stack([_places(zip(truth.x_px, truth.y_px, strict=True)) for truth in truths])
        self.radius_px = np.array([truth.radius_px for truth in truths], np.float64)
        self.in_view = np.array([truth.in_view for truth in truths], np.bool_)
        self.visible = np.array([truth.visible for truth in truths], np.bool_)

    def flag(self, flags: npt.NDArray[np.bool_], t_us: int) -> npt.NDArray[np.bool_]:
        """Return (k,) bool: whether a flag holds at both ends around a time."""
        after = bisect_left(self.at_us, t_us)
        before = after if self.at_us[after] == t_us else after - 1
        both: npt.NDArray[np.bool_] = flags[before] & flags[after]
        return both

    def place_px(self, t_us: int) -> Floats:
        """Return (k, 2) centres at a time between the first end and the last."""
        after = bisect_left(self.at_us, t_us)
        if self.at_us[after] == t_us:
            exact: Floats = self.xy_px[after]
            return exact
        out = self._through([after - 1, after], t_us)
        if 2 <= after <= len(self.at_us) - 2:
            four = list(range(after - 2, after + 2))
            cubic = self.in_view[four].all(axis=0)
            out[cubic] = self._through(four, t_us)[cubic]
        return out

    def velocity_px_s(self, t_us: int) -> Floats:
        """Return (k, 2) velocities, over the neighbouring ends."""
        after = min(max(bisect_left(self.at_us, t_us), 1), len(self.at_us) - 1)
        last = min(after + 1, len(self.at_us) - 1) if self.at_us[after] == t_us else after
        step: Floats = (self.xy_px[last] - self.xy_px[after - 1]) / (self.at_us[last] - self.at_us[after - 1])
        return step * US_PER_S

    def instant(self, of: Sample, scored: Scored) -> Instant:
        """Return what is scored at a sample's time."""
        place, in_view = self.place_px(of.t_us), self.flag(self.in_view, of.t_us)
        after = bisect_left(self.at_us, of.t_us)
        gate = np.maximum(GATE_PX, self.radius_px[after])
        wanted = np.flatnonzero(in_view & self.flag(self.visible, of.t_us) if scored == "visible" else in_view)
        tracks = np.arange(len(of.track))
        if scored == "visible":
            seen = np.flatnonzero(in_view)
            away = np.hypot(*(place[seen, None, :] - of.xy_px[None, :, :]).transpose(2, 0, 1))
            rows, columns = paired(away, away <= gate[seen, None])
            hidden = columns[~np.isin(seen[rows], wanted)]
            tracks = np.setdiff1d(tracks, hidden)
        return Instant(
            t_us=of.t_us,
            beacon=tuple(self.beacon[i] for i in wanted),
            beacon_px=place[wanted],
            gate_px=gate[wanted],
            track=tuple(of.track[j] for j in tracks),
            track_px=of.xy_px[tracks],
        )

    def _through(self, ends: list[int], t_us: int) -> Floats:
        """Return the polynomial through some ends, by Lagrange."""
        times = [self.at_us[end] for end in ends]
        out: Floats = np.zeros_like(self.xy_px[0])
        for i, end in enumerate(ends):
            others = [t for k, t in enumerate(times) if k != i]
            out += self.xy_px[end] * math.prod((t_us - t) / (times[i] - t) for t in others)
        return out


def _acquisitions(known: _Known, matches: Iterable[Match], published: dict[int, int]) -> Iterable[Acquisition]:
    """Yield each visible interval: from the begin of its first window, which is early by up to that window."""
    of_beacon: dict[str, list[int]] = {name: [] for name in known.beacon}
    for match in matches:
        of_beacon[match.beacon].append(match.t_us)
    for k, name in enumerate(known.beacon):
        visible = np.concatenate([[False], known.visible[:, k], [False]])
        for start, stop in np.flatnonzero(visible[1:] != visible[:-1]).reshape(-1, 2).tolist():
            start_us, end_us = known.begin_us[start], known.at_us[stop - 1]
            first = next((t for t in of_beacon[name] if start_us <= t <= end_us), None)
            yield Acquisition(name, start_us, end_us, None if first is None else published[first] - start_us)


def _lag_us(known: _Known, instants: Sequence[Instant], matches: Iterable[Match]) -> float:
    """Return the shift in time that leaves the least square of what tracks are off: sum(v . off) / sum(v . v)."""
    along = speed = 0.0
    by_time = {instant.t_us: instant for instant in instants}
    for match in matches:
        instant = by_time[match.t_us]
        off = instant.beacon_px[instant.beacon.index(match.beacon)] - instant.track_px[instant.track.index(match.track)]
        v = known.velocity_px_s(match.t_us)[known.beacon.index(match.beacon)]
        along += float(v @ off)
        speed += float(v @ v)
    return along / speed * US_PER_S if speed > 0 else math.nan


def _places(pairs: Iterable[tuple[float, float]]) -> Floats:
    return np.array(list(pairs), np.float64).reshape(-1, 2)
