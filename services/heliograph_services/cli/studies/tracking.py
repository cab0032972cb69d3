"""How well beacons are tracked: CLEAR MOT, identity scores and GOSPA over instants; pure functions.

At each instant there are beacons (the truth) and named tracks. A pair may match within the beacon's gate g, here
max(5 px, its radius) as everywhere in this project.

CLEAR MOT (Bernardin and Stiefelhagen 2008): a beacon keeps the track of its last match while that lies within its gate,
beacons in their order; then the rest is matched one to one, as many pairs as possible, at the least total distance::

    MOTA = 1 - (misses + false + switches) / objects

objects: beacons, summed over the instants; misses: those without a match; false: tracks without one; switches: matches
with another track than the beacon's last one. Not in MOTA: transfers, matches of a track whose last match was another
beacon. A track that is named anew is a switch; two beacons that swap their names are two switches and two transfers.

Identity (Ristani et al. 2016): beacons and tracks are paired one to one for the whole run, so that IDTP, the instants
in which a pair lies within the gate, is the greatest::

    IDF1 = 2 IDTP / (objects + tracks)        tracks: summed over the instants

GOSPA (Rahmathullah et al. 2017) of order p with cut-off c and alpha = 2, beacons X and tracks Y of an instant::

    d^p = min over assignments A of   sum over (x, y) in A of |x - y|^p  +  c^p / 2 (|X| - |A|)  +  c^p / 2 (|Y| - |A|)
                                      localisation                          missed                  false

Only pairs with |x - y| < c can be worth assigning. Our p = 2 and c = 5 px, the gate of a small beacon.

Counts of several runs are added (`+`), then divided.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import lap
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]

GOSPA_P: Final = 2.0
GOSPA_C_PX: Final = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """What there was and what was published, at one time; k beacons, n tracks, names distinct.

    Args:
        t_us: camera time.
        beacon: k names, in an order that does not change between instants.
        beacon_px: (k, 2) float64, centres x, y.
        gate_px: (k,) float64, greatest distance of a match, itself included.
        track: n names.
        track_px: (n, 2) float64.
    """

    t_us: int
    beacon: tuple[str, ...]
    beacon_px: Floats
    gate_px: Floats
    track: tuple[str, ...]
    track_px: Floats

    def away_px(self) -> Floats:
        """Return the (k, n) distances."""
        offset = self.beacon_px[:, None, :] - self.track_px[None, :, :]
        away: Floats = np.sqrt((offset**2).sum(axis=2))
        return away


@dataclass(frozen=True, slots=True)
class Match:
    """A beacon and the track that is held to be its, at an instant; `away_px` apart."""

    t_us: int
    beacon: str
    track: str
    away_px: float


@dataclass(frozen=True, slots=True)
class Clear:
    """Counts of CLEAR MOT; see the module."""

    objects: int = 0
    misses: int = 0
    false: int = 0
    switches: int = 0
    transfers: int = 0
    square_px2: float = 0.0  # of the matches' distances, summed

    def __add__(self, other: Clear) -> Clear:
        """Return the counts of both runs."""
        return Clear(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def matches(self) -> int:
        """Beacons with a match, summed over the instants."""
        return self.objects - self.misses

    @property
    def mota(self) -> float:
        """1 at best, without a lower bound; nan without objects."""
        errors = self.misses + self.false + self.switches
        return 1 - errors / self.objects if self.objects else float("nan")

    @property
    def rmse_px(self) -> float:
        """Root of the mean square of the matches' distances; nan without any."""
        return float(np.sqrt(self.square_px2 / self.matches)) if self.matches else float("nan")


@dataclass(frozen=True, slots=True)
class Identity:
    """Counts of the identity score; see the module."""

    true: int = 0
    objects: int = 0
    tracks: int = 0

    def __add__(self, other: Identity) -> Identity:
        """Return the counts of both runs, each paired on its own."""
        return Identity(self.true + other.true, self.objects + other.objects, self.tracks + other.tracks)

    @property
    def idf1(self) -> float:
        """0 to 1; nan without objects and tracks."""
        return 2 * self.true / (self.objects + self.tracks) if self.objects + self.tracks else float("nan")


@dataclass(frozen=True, slots=True)
class Gospa:
    """GOSPA of one instant: the distance in pixels, and its three parts in px^p."""

    distance_px: float
    localisation: float
    missed: float
    false: float


def clear(instants: Sequence[Instant]) -> tuple[Clear, list[Match]]:
    """Return the counts of CLEAR MOT over one run, and its matches by time, then by the beacons' order."""
    found: list[Match] = []
    held: dict[str, str] = {}  # a beacon's last track
    holder: dict[str, str] = {}  # a track's last beacon
    switches = transfers = 0
    for instant in instants:
        away = instant.away_px()
        for i, j in _matched(instant, away, held):
            beacon, track = instant.beacon[i], instant.track[j]
            switches += held.get(beacon, track) != track
            transfers += holder.get(track, beacon) != beacon
            held[beacon], holder[track] = track, beacon
            found.append(Match(instant.t_us, beacon, track, float(away[i, j])))
    objects = sum(len(instant.beacon) for instant in instants)
    counts = Clear(
        objects=objects,
        misses=objects - len(found),
        false=sum(len(instant.track) for instant in instants) - len(found),
        switches=switches,
        transfers=transfers,
        square_px2=sum(match.away_px**2 for match in found),
    )
    return counts, found


def identity(instants: Sequence[Instant]) -> Identity:
    """Return the counts of the identity score over one run."""
    together: dict[tuple[str, str], int] = {}
    for instant in instants:
        for i, j in np.argwhere(instant.away_px() <= instant.gate_px[:, None]):
            pair = instant.beacon[i], instant.track[j]
            together[pair] = together.get(pair, 0) + 1
    beacons = {name: k for k, name in enumerate(sorted({beacon for beacon, _ in together}))}
    tracks = {name: k for k, name in enumerate(sorted({track for _, track in together}))}
    count = np.zeros((len(beacons), len(tracks)))
    for (beacon, track), n in together.items():
        count[beacons[beacon], tracks[track]] = n
    rows, columns = _cheapest(-count)
    return Identity(
        true=round(count[rows, columns].sum()),
        objects=sum(len(instant.beacon) for instant in instants),
        tracks=sum(len(instant.track) for instant in instants),
    )


def gospa(instant: Instant, p: float = GOSPA_P, c_px: float = GOSPA_C_PX) -> Gospa:
    """Return GOSPA with alpha = 2 of one instant; gates play no part.

    Args:
        instant: beacons and tracks.
        p: order, at least 1.
        c_px: cut-off, above 0.

    Raises:
        ValueError: p or c_px is out of range.
    """
    if not (1 <= p < np.inf and 0 < c_px < np.inf):
        raise ValueError(f"p must be at least 1 and c_px above 0, not {p} and {c_px}")
    cost = np.minimum(instant.away_px(), c_px) ** p
    rows, columns = _cheapest(cost)
    paid = cost[rows, columns][cost[rows, columns] < c_px**p]
    half = c_px**p / 2
    localisation = float(paid.sum())
    missed = half * (len(instant.beacon) - len(paid))
    false = half * (len(instant.track) - len(paid))
    return Gospa((localisation + missed + false) ** (1 / p), localisation, missed, false)


def paired(away_px: Floats, allowed: npt.NDArray[np.bool_]) -> tuple[Longs, Longs]:
    """Return rows and columns of as many allowed pairs as possible, at the least total distance, by rising row."""
    if not allowed.any():
        return np.empty(0, np.int64), np.empty(0, np.int64)
    # One pair that is not allowed costs more than all that are.
    dear = 2 * float(away_px[allowed].sum()) + 1
    rows, columns = _cheapest(np.where(allowed, away_px, dear))
    good = allowed[rows, columns]
    return rows[good], columns[good]


def _matched(instant: Instant, away: Floats, held: dict[str, str]) -> list[tuple[int, int]]:
    """Return the matches of an instant, (beacon, track) by rising beacon: those that were held, then the rest."""
    allowed = away <= instant.gate_px[:, None]
    place = {name: j for j, name in enumerate(instant.track)}
    pairs: list[tuple[int, int]] = []
    for i, beacon in enumerate(instant.beacon):
        j = place.get(held.get(beacon, ""), -1)
        if j >= 0 and allowed[i, j]:
            pairs.append((i, j))
            allowed[i, :] = allowed[:, j] = False
    pairs += zip(*(index.tolist() for index in paired(away, allowed)), strict=True)
    return sorted(pairs)


def _cheapest(cost: Floats) -> tuple[Longs, Longs]:
    """Return rows and columns of min(k, n) pairs at the least total cost, by rising row."""
    if cost.size == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    _, of_row, _ = lap.lapjv(np.ascontiguousarray(cost), extend_cost=True)
    column = np.asarray(of_row, np.int64)
    rows = np.flatnonzero(column >= 0)
    return rows, column[rows]
