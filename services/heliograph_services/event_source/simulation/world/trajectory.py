"""Where things are and where the camera looks, as functions of time: nothing is stepped, any time may be asked.

A path's equations, t in s (the tables of `spec.py` name the symbols)::

    still      x = at
    sine       x = at + A sin(2 pi t / T + phase), each axis its own A, T, phase
    circle     x = centre + r (sin a, cos a, 0), a = phase + 2 pi n(t)
               n(t) = f0 t + (f1 - f0) t^2 / (2 R) for t < R = ramp, mirrored for R <= t < 2 R, f = 1 / turn, begun anew
    shuttle    h = turn / 2, a = v / h, T = L / v + h from one end to the other; in 0 <= u < T:
               s = a u^2 / 2 (u < h),  v (u - h / 2) (u < T - h),  L - a (T - u)^2 / 2;  back as s(2 T - u)
    waypoints  moving average over w = smooth of the straight lines p(t) with period T:
               x = (P(t + w / 2) - P(t - w / 2)) / w, P the antiderivative of p: a parabola between two points

The moving average leaves straight lines as they are but within w / 2 of a corner, where the thing turns with constant
acceleration (v1 - v0) / w. Many paths of one kind are computed together: 200 lights cost one call, not 200.

Shake: each angle is a sum of K = 16 sinusoids, one in each K-th of the band [low, high], at a random place of it and
with a random phase; amplitudes rms sqrt(2 / K), so that the mean square over time is that of the file. Sums of so few
are already close to Gaussian noise (Rice, "Mathematical analysis of random noise", 1944, represents it just so).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, cast

import numpy as np

from heliograph.units import US_PER_S
from heliograph_services.event_source.simulation.contract import Floats, Ints
from heliograph_services.event_source.simulation.world.spec import (
    Attitude,
    Circle,
    Path,
    Shake,
    Shuttle,
    Sine,
    Still,
    Waypoints,
)

# Rounding over less than a node of motion (1 ms) is none; a thousandth of a second keeps ten digits of the average.
_SMOOTH_MIN_S: Final = 1e-3
# Times of all paths of a group lie in one sorted array, each path's shifted by this: more than any period of a file.
_APART_S: Final = 1e6
_SHAKE_TONES: Final = 16

# (n,) times in s to (k, n, 3) positions.
_Group = Callable[[Floats], Floats]


class Paths:
    """Many paths, computed kind by kind.

    Args:
        paths: k of them; the order of the results.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._count = len(paths)
        self._still = all(isinstance(path, Still) for path in paths)
        self._groups: list[tuple[Ints, _Group]] = []
        for kind, make in _KINDS:
            which = [i for i, path in enumerate(paths) if isinstance(path, kind)]
            if which:
                self._groups.append((np.array(which, np.int64), make([paths[i] for i in which])))

    @property
    def still(self) -> bool:
        """Nothing moves."""
        return self._still

    def at(self, t_us: Floats) -> Floats:
        """Return (k, n, 3) float64 positions in m at (n,) times."""
        t_s = np.asarray(t_us, np.float64) / US_PER_S
        if len(self._groups) == 1:
            return self._groups[0][1](t_s)
        places = np.empty((self._count, len(t_s), 3))
        for which, group in self._groups:
            places[which] = group(t_s)
        return places


def positions(path: Path, t_us: Floats) -> Floats:
    """Return (n, 3) float64 positions in m of one path at (n,) times."""
    places: Floats = Paths([path]).at(t_us)[0]
    return places


class Angles:
    """The camera's yaw, pitch and roll.

    Args:
        attitude: where it looks.
        shake: tremor on top; None for none.
        seed: of the tremor.
    """

    def __init__(self, attitude: Attitude, shake: Shake | None, seed: int) -> None:
        self._attitude = attitude
        self._lines = _Lines([attitude.points], [attitude.smooth_s], turn=360.0) if attitude.points else None
        self._shake = _Tremor(shake, seed) if shake is not None and shake.rms_deg > 0.0 else None

    @property
    def still(self) -> bool:
        """Nothing turns."""
        a = self._attitude
        return self._lines is None and self._shake is None and a.yaw_rate_deg_s == 0.0 and a.yaw_swing_deg == 0.0

    def at(self, t_us: Floats) -> Floats:
        """Return (n, 3) float64: yaw, pitch, roll in rad at (n,) times."""
        t_s = np.asarray(t_us, np.float64) / US_PER_S
        a = self._attitude
        if self._lines is not None:
            deg = self._lines(t_s)[0]
        else:
            deg = np.empty((len(t_s), 3))
            deg[:, 0] = a.yaw_deg + np.remainder(a.yaw_rate_deg_s * t_s, 360.0)
            deg[:, 0] += a.yaw_swing_deg * np.sin(2.0 * np.pi * t_s / a.yaw_swing_s)
            deg[:, 1:] = a.pitch_deg, a.roll_deg
        if self._shake is not None:
            deg = deg + self._shake(t_s)
        angles: Floats = np.radians(deg)
        return angles


# ---- the kinds: each makes a function of many paths at once ----------------------------------------------------------


def _stills(paths: Sequence[Path]) -> _Group:
    at = np.array([cast("Still", path).at_m for path in paths], np.float64)
    return lambda t_s: np.repeat(at[:, None, :], len(t_s), axis=1)


def _sines(paths: Sequence[Path]) -> _Group:
    sines = cast("Sequence[Sine]", paths)
    at = np.array([p.at_m for p in sines], np.float64)[:, None, :]
    amplitude = np.array([p.amplitude_m for p in sines], np.float64)[:, None, :]
    rate = 2.0 * np.pi / np.array([p.period_s for p in sines], np.float64)[:, None, :]
    phase = np.radians(np.array([p.phase_deg for p in sines], np.float64))[:, None, :]
    return lambda t_s: at + amplitude * np.sin(rate * t_s[None, :, None] + phase)


def _circles(paths: Sequence[Path]) -> _Group:
    circles = cast("Sequence[Circle]", paths)
    centre = np.array([p.centre_m for p in circles], np.float64)[:, None, :]
    radius, phase, f0, f1, ramp = (
        np.array(column, np.float64)[:, None]
        for column in zip(
            *(
                (p.radius_m, np.radians(p.phase_deg), 1 / p.turn_s, 1 / (p.fastest_turn_s or p.turn_s), p.ramp_s)
                for p in circles
            ),
            strict=True,
        )
    )
    whole = ramp * (f0 + f1)  # turns from one slowest moment to the next

    def at(t_s: Floats) -> Floats:
        rounds = np.floor(t_s / (2.0 * ramp))
        u = t_s - rounds * 2.0 * ramp
        rising = u < ramp
        w = np.where(rising, u, 2.0 * ramp - u)
        n = f0 * w + (f1 - f0) * w * w / (2.0 * ramp)
        turns = np.where(rising, n, whole - n) + rounds * whole
        angle = phase + 2.0 * np.pi * np.remainder(turns, 1.0)
        places = np.repeat(centre, len(t_s), axis=1)
        places[..., 0] += radius * np.sin(angle)
        places[..., 1] += radius * np.cos(angle)
        return places

    return at


def _shuttles(paths: Sequence[Path]) -> _Group:
    shuttles = cast("Sequence[Shuttle]", paths)
    begin = np.array([p.from_m for p in shuttles], np.float64)
    way = np.array([p.to_m for p in shuttles], np.float64) - begin
    length = np.linalg.norm(way, axis=1)[:, None]
    unit = way / length
    v, turn, start = (
        np.array(column, np.float64)[:, None]
        for column in zip(*((p.speed_m_s, p.turn_s, p.start_s) for p in shuttles), strict=True)
    )
    h = turn / 2.0
    a = np.divide(v, h, out=np.zeros_like(v), where=h > 0.0)
    one_way = length / v + h

    def at(t_s: Floats) -> Floats:
        u = np.remainder(np.maximum(t_s - start, 0.0), 2.0 * one_way)
        u = np.minimum(u, 2.0 * one_way - u)
        s = v * (u - h / 2.0)
        s = np.where(u < h, a * u * u / 2.0, s)
        s = np.where(u > one_way - h, length - a * (one_way - u) ** 2 / 2.0, s)
        return cast("Floats", begin[:, None, :] + s[:, :, None] * unit[:, None, :])

    return at


def _waypoints(paths: Sequence[Path]) -> _Group:
    points = cast("Sequence[Waypoints]", paths)
    return _Lines([p.points for p in points], [p.smooth_s for p in points])


class _Lines:
    """Straight lines between points, rounded, periodic, of k things at once.

    Args:
        points: of each thing, (t_s, a, b, c).
        smooth_s: of each.
        turn: a difference of whole turns between the last point and the first is no jump (angles); 0: every one is.
    """

    def __init__(
        self,
        points: Sequence[Sequence[tuple[float, float, float, float]]],
        smooth_s: Sequence[float],
        turn: float = 0.0,
    ) -> None:
        tables = [np.array(p, np.float64) for p in points]
        self._first = np.array([table[0, 1:] for table in tables])
        gain = np.array([table[-1, 1:] - table[0, 1:] for table in tables])
        self._gain = np.round(gain / turn) * turn if turn else np.zeros_like(gain)
        self._period = np.array([table[-1, 0] for table in tables])
        self._smooth = np.array(smooth_s, np.float64)
        self._smooth[self._smooth < _SMOOTH_MIN_S] = 0.0
        # All segments of all things in one row; the key of a time is its segment's place in it.
        self._begin = np.concatenate([table[:-1, 0] for table in tables])
        self._key = np.concatenate([i * _APART_S + table[:-1, 0] for i, table in enumerate(tables)])
        self._value = np.concatenate([table[:-1, 1:] - table[0, 1:] for table in tables])
        dt = [np.diff(table[:, 0])[:, None] for table in tables]
        self._slope = np.concatenate([np.diff(t[:, 1:], axis=0) / d for t, d in zip(tables, dt, strict=True)])
        areas = [
            np.cumsum((t[:-1, 1:] + t[1:, 1:] - 2.0 * t[0, 1:]) / 2.0 * d, axis=0)
            for t, d in zip(tables, dt, strict=True)
        ]
        self._area = np.concatenate([np.vstack([np.zeros((1, 3)), area[:-1]]) for area in areas])
        self._whole = np.array([area[-1] for area in areas])
        self._shift = (np.arange(len(tables)) * _APART_S)[:, None]

    def __call__(self, t_s: Floats) -> Floats:
        t = np.remainder(t_s[None, :], self._period[:, None])
        if not self._smooth.any():
            j, d = self._segment(t)
            return cast("Floats", self._first[:, None, :] + self._value[j] + self._slope[j] * d)
        half = np.maximum(self._smooth, _SMOOTH_MIN_S)[:, None] / 2.0
        mean = (self._antiderivative(t + half) - self._antiderivative(t - half)) / (2.0 * half)[:, :, None]
        if not self._smooth.all():
            j, d = self._segment(t)
            mean = np.where(self._smooth[:, None, None] > 0.0, mean, self._value[j] + self._slope[j] * d)
        return cast("Floats", self._first[:, None, :] + mean)

    def _segment(self, t: Floats) -> tuple[Ints, Floats]:
        """Return the segment of (k, n) times within the period, and the (k, n, 1) time since it began."""
        j = np.searchsorted(self._key, t + self._shift, side="right") - 1
        return j, (t - self._begin[j])[:, :, None]

    def _antiderivative(self, t: Floats) -> Floats:
        """Return (k, n, 3) P(t), less the first point, at (k, n) times of any round."""
        period = self._period[:, None]
        rounds = np.floor(t / period)
        r = np.clip(t - rounds * period, 0.0, period)
        j, d = self._segment(r)
        area = self._area[j] + d * (self._value[j] + self._slope[j] * (d / 2.0))
        n, r = rounds[:, :, None], r[:, :, None]
        gain = self._gain[:, None, :]
        past = n * self._whole[:, None, :] + gain * (period[:, :, None] * n * (n - 1.0) / 2.0 + n * r)
        return cast("Floats", area + past)


class _Tremor:
    """Shake of three angles in degrees: see the module's equations."""

    def __init__(self, shake: Shake, seed: int) -> None:
        # Numba, only where something shakes.
        from heliograph_services.event_source.simulation.random import SHAKE, uniforms  # noqa: PLC0415

        tones = _SHAKE_TONES if shake.high_hz > shake.low_hz else 1
        axis, tone, what = np.indices((3, tones, 2))
        draw = uniforms(seed, SHAKE, axis, tone, what)
        hz = shake.low_hz + (np.arange(tones) + draw[:, :, 0]) / tones * (shake.high_hz - shake.low_hz)
        self._rate = 2.0 * np.pi * hz
        self._phase = 2.0 * np.pi * draw[:, :, 1]
        self._amplitude = shake.rms_deg * np.sqrt(2.0 / tones)

    def __call__(self, t_s: Floats) -> Floats:
        angle = self._rate[None] * t_s[:, None, None] + self._phase[None]
        return cast("Floats", self._amplitude * np.sin(angle).sum(axis=2))


_KINDS: Final[tuple[tuple[type[Path], Callable[[Sequence[Path]], _Group]], ...]] = (
    (Still, _stills),
    (Sine, _sines),
    (Circle, _circles),
    (Shuttle, _shuttles),
    (Waypoints, _waypoints),
)
