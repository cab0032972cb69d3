# ruff: noqa: SLF001, ARG002 - the plane takes the network's place inside the pyramid
"""Others' ways to optical flow, on the input that the network gets, for `bench_flow.py`.

**Plane** (Benosman et al. 2014, "Event-based visual flow"): around every input, a plane is fitted to the arrival times
of all inputs of late, points off the plane are rejected, and the fit is repeated. It gets our pooling, our noise gate,
our three scales and our fit of places: what differs is that no network says where to fit, and to what.

**Orchard** (Orchard et al. 2013, "A spiking neural network architecture for visual motion estimation"): neurons with
synaptic delays, eight directions, leaky; a place has the velocity of its neurons. It is our network with memory, read
by its neurons alone, without what we add (arrival times); whether it gets our gate and our onsets is tuned.

**Centroid**: the mean place of the events on the disc, centred on itself tick by tick, and the slope of a line through
the last of them. It is told where the disc is at first, and again whenever it has lost it (discs leave and come back),
so it is a bound on what following can do; of textures it says nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from heliograph.streams import Onsets
from heliograph_services.tracker.flow import readout
from heliograph_services.tracker.flow.network import REACH
from heliograph_services.tracker.flow.pyramid import FlowPyramid
from heliograph_services.tracker.flow.settings import FlowSettings
from heliograph_services.tracker.flow.spikes import NO_SPIKES
from heliograph_services.tracker.jit import kernel


@kernel
def _planes(x: Any, y: Any, arrival: Any, now: float, reach: int, ticks: float, off: float, out: Any) -> int:
    kept = 0
    for i in range(len(x)):
        c = np.zeros(3)
        ok = False
        for turn in range(3):
            m = np.zeros((3, 3))
            v = np.zeros(3)
            n = 0
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    py = y[i] + dy
                    px = x[i] + dx
                    if py < 0 or px < 0 or py >= arrival.shape[0] - 2 * REACH or px >= arrival.shape[1] - 2 * REACH:
                        continue
                    age = now - arrival[py + REACH, px + REACH]
                    if age > ticks or (turn > 0 and abs(c[0] * dx + c[1] * dy + c[2] - age) > off):
                        continue
                    row = np.array([float(dx), float(dy), 1.0])
                    for a in range(3):
                        v[a] += row[a] * age
                        for b in range(3):
                            m[a, b] += row[a] * row[b]
                    n += 1
            if n < 5 or abs(np.linalg.det(m)) < 1e-6:
                ok = False
                break
            c = np.linalg.solve(m, v)
            ok = True
        g = np.sqrt(c[0] ** 2 + c[1] ** 2)
        if not ok or g < 1e-3:
            continue
        out[kept, 0] = x[i]
        out[kept, 1] = y[i]
        # Ages fall along the motion.
        out[kept, 2] = -c[0]
        out[kept, 3] = -c[1]
        out[kept, 4] = 0.1
        kept += 1
    return kept


@dataclass(frozen=True)
class PlaneSettings:
    """Reach in pixels, ages in ticks, and how far off the plane a point may lie, in ticks."""

    reach: int = 2
    ticks: float = 10.0
    off: float = 1.0


class PlaneFlow(FlowPyramid):
    """The pyramid with planes at every input in the place of the network."""

    def __init__(self, plane: PlaneSettings, **geometry: Any) -> None:
        super().__init__(FlowSettings(), **geometry)
        for run in self._scales:
            size = run._reader._slot.shape
            run._runtime = _Nothing()
            run._reader = _PlaneReader(plane, size, run._reader._slowest, run._reader._fastest, run._runtime)


class _Nothing:
    def __init__(self) -> None:
        self.x: Any = np.empty(0, np.int64)
        self.y: Any = np.empty(0, np.int64)

    def step(self, x: Any, y: Any, wanted: Any = None) -> Any:
        self.x, self.y = x.astype(np.int64), y.astype(np.int64)
        return NO_SPIKES

    def skip(self, ticks: int) -> list[Any]:
        return []


class _PlaneReader:
    def __init__(
        self, plane: PlaneSettings, size: tuple[int, ...], slowest: float, fastest: float, inputs: _Nothing
    ) -> None:
        self._plane, self._slot, self._inputs = plane, np.empty(size, np.int8), inputs
        self._slowest, self._fastest = slowest, fastest

    def read(self, spikes: Any, arrival: Any, tick: int) -> readout.Samples:
        out = np.empty((len(self._inputs.x), 5))
        p = self._plane
        n = _planes(self._inputs.x, self._inputs.y, arrival, tick + 0.5, p.reach, p.ticks, p.off, out)
        out = out[:n]
        g = np.hypot(out[:, 2], out[:, 3])
        out = out[(g * self._slowest <= 1) & (g * self._fastest >= 1)]
        return readout.Samples(*out.T.copy())


class CentroidFlow:
    """Follows discs from where they were at first.

    Args:
        places: the (n, 2) true centres of a time in s.
        radius_px: events this near count.
        ticks: of the line.
    """

    def __init__(self, places: Callable[[float], Any], radius_px: float, ticks: int) -> None:
        self._places, self._radius, self._ticks = places, radius_px, ticks
        self._paths: list[list[tuple[float, float, float]]] = [[(0.0, x, y)] for x, y in places(0.0)]

    def feed(self, onsets: Onsets) -> None:
        t_s = (onsets.t0_us + onsets.t1_us) / 2e6
        x, y = onsets.x_px.astype(np.float64), onsets.y_px.astype(np.float64)
        weight = onsets.on_count.astype(np.float64) + onsets.off_count
        for path, (tx, ty) in zip(self._paths, self._places(t_s), strict=True):
            if np.hypot(path[-1][1] - tx, path[-1][2] - ty) > 3 * self._radius:
                path[:] = [(t_s, tx, ty)]
                continue
            vx, vy = _slope(path[-self._ticks :])
            last_s, cx, cy = path[-1]
            cx, cy = cx + vx * (t_s - last_s), cy + vy * (t_s - last_s)
            near = (x - cx) ** 2 + (y - cy) ** 2 <= self._radius**2
            if weight[near].sum() > 0:
                path.append((t_s, float(np.average(x[near], weights=weight[near])),
                             float(np.average(y[near], weights=weight[near]))))  # fmt: skip

    def at(self, x_px: float, y_px: float, radius_px: float) -> tuple[float, float, float]:
        for path in self._paths:
            if len(path) > 2 and np.hypot(path[-1][1] - x_px, path[-1][2] - y_px) <= radius_px:
                return (*_slope(path[-self._ticks :]), 1.0)
        return 0.0, 0.0, 0.0


def _slope(path: list[tuple[float, float, float]]) -> tuple[float, float]:
    if len(path) < 2:
        return 0.0, 0.0
    t, x, y = np.array(path).T
    t = t - t.mean()
    return float(t @ x / (t @ t)), float(t @ y / (t @ t))
