"""Scripted crossings: two beacons whose images pass over each other, and who is who afterwards."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from heliograph.core import Context
from heliograph.messages import Status, Tracks
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core
from support.onset_scenes import CODE_42, Disc, Scene, bits

WIDTH, HEIGHT = 640, 480
# Payloads 21, 37 and 51, even parity.
WORDS = (CODE_42, bits("1110 010101 1"), bits("1110 100101 1"), bits("1110 110011 0"))
# Before and after they cross, at least; longer if they are then less than this apart.
HALF_S = 0.6
APART_PX = 40.0
# How near a track must be to be a beacon's.
NEAR_PX = 6.0


Pair = tuple[float, float]


@dataclass(frozen=True)
class Crossing:
    """Two beacons on straight lines that are nearest to each other in the middle of the sensor.

    Args:
        angle_deg: between their directions: 0 one overtakes the other, 180 head on.
        speeds_px_s: of the two.
        miss_px: how near their centres come.
        half_s: when they cross.
        scene: what the camera sees, for twice as long.
    """

    angle_deg: float
    speeds_px_s: tuple[float, float]
    miss_px: float
    half_s: float
    scene: Scene

    @property
    def overlap_s(self) -> float:
        """For how long the discs touch."""
        a, b = self.scene.discs
        t_s = np.arange(0, 2 * self.half_s, 0.001)
        away = np.hypot(*(np.array([a.path(t) for t in t_s]) - np.array([b.path(t) for t in t_s])).T)
        return 0.001 * int(np.count_nonzero(away < a.radius_px + b.radius_px))


def _at(t_s: float, half_s: float, at: Pair, v: Pair, a: Pair) -> Pair:
    """Return the place of a beacon that is at `at` with velocity v and acceleration a when they cross."""
    dt = t_s - half_s
    return at[0] + (v[0] + a[0] * dt / 2) * dt, at[1] + (v[1] + a[1] * dt / 2) * dt


@dataclass(frozen=True)
class Kind:
    """What crossings are drawn from, each uniformly between two values."""

    angle_deg: Pair = (20.0, 180.0)
    speed_px_s: Pair = (50.0, 400.0)
    acceleration_px_s2: Pair = (0.0, 0.0)  # of each, in any direction
    bit_rates: tuple[float, ...] = (200.0, 500.0, 1000.0, 2000.0)
    noise_hz: float = 2e4


def crossing(seed: int, kind: Kind) -> Crossing:
    """Return a crossing at random; discs of 2 to 4 px pass at 0 to 2 px."""
    rng = np.random.default_rng([seed, 7])
    angle = rng.uniform(*kind.angle_deg)
    speeds = rng.uniform(*kind.speed_px_s, 2)
    miss = rng.uniform(0, 2)
    heading = rng.uniform(0, 360)
    directions = np.deg2rad([heading, heading + angle])
    v = speeds[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=1)
    bend, whither = rng.uniform(*kind.acceleration_px_s2, 2), rng.uniform(0, 2 * np.pi, 2)
    a = bend[:, None] * np.stack([np.cos(whither), np.sin(whither)], axis=1)
    away = v[0] - v[1]
    half_s = max(HALF_S, APART_PX / float(np.hypot(*away)))
    side = np.array([-away[1], away[0]]) / np.hypot(*away) * miss / 2
    middle = np.array([WIDTH / 2, HEIGHT / 2]) + rng.uniform(-1, 1, 2)
    discs = tuple(
        Disc(
            partial(_at, half_s=half_s, at=tuple(at.tolist()), v=tuple(v[k].tolist()), a=tuple(a[k].tolist())),
            radius_px=float(rng.uniform(2, 4)),
            bit_rate=float(rng.choice(kind.bit_rates)),
            word=WORDS[rng.integers(len(WORDS))],
        )
        for k, at in enumerate((middle + side, middle - side))
    )
    scene = Scene(discs, WIDTH, HEIGHT, noise_hz=kind.noise_hz, seed=seed)
    return Crossing(float(angle), (float(speeds[0]), float(speeds[1])), float(miss), half_s, scene)


def outcome(each: Crossing, **settings: object) -> str:
    """Follow a crossing with all tracks judged valid; return what became of the names.

    `kept`, `swapped`, `renamed` (one has a third name), `lost` (one has no track at the end), or `late` (one had none
    before they met).
    """
    core = make_core(TrackerConfig(**settings), Context("0", "b00t", False))  # type: ignore[arg-type]
    published: list[Tracks] = []
    for onsets in each.scene.onsets(2 * each.half_s):
        for m in core.feed(onsets):
            assert isinstance(m, Tracks)
            published.append(m)
            words = ["valid"] * len(m.track)
            core.feed(
                Status(
                    camera="cam0",
                    as_of_us=m.as_of_us,
                    track=m.track,
                    status=words,  # type: ignore[arg-type]
                    accepted_us=[0] * len(words),
                    identity=[None] * len(words),
                )
            )
    return verdict(each, published)


def verdict(each: Crossing, published: list[Tracks]) -> str:
    """Return what became of the names, see `outcome`."""
    apart = [m for m in published if abs(m.as_of_us / 1e6 - each.half_s) > each.overlap_s / 2 + 0.05]
    before = [m for m in apart if m.as_of_us / 1e6 < each.half_s]
    was = names(each.scene, before[-1]) if before else {}
    now = names(each.scene, published[-1])
    if len(was) < 2:
        return "late"
    if len(now) < 2:
        return "lost"
    if now == was:
        return "kept"
    return "swapped" if now == {0: was[1], 1: was[0]} else "renamed"


def names(scene: Scene, tracks: Tracks) -> dict[int, str]:
    """Return the nearest track of each beacon that has one near, the nearest pairs first."""
    t_s = tracks.as_of_us / 1e6
    pairs = sorted(
        (float(np.hypot(x - disc.path(t_s)[0], y - disc.path(t_s)[1])), d, name)
        for d, disc in enumerate(scene.discs)
        for name, x, y in zip(tracks.track, tracks.x_px, tracks.y_px, strict=True)
    )
    found: dict[int, str] = {}
    for away, d, name in pairs:
        if away <= NEAR_PX and d not in found and name not in found.values():
            found[d] = name
    return found


def outcomes(seeds: Iterable[int], kind: Kind, **settings: object) -> Counter[str]:
    """Return how many crossings ended in which way."""
    return Counter(outcome(crossing(seed, kind), **settings) for seed in seeds)
