r"""From the spikes of a tick to samples of motion: where, how fast, how sure.

At each pixel that fired, the neurons' velocities are averaged with the cubed potential s^3 as weight; the length of
the mean of their directions is the `coherence`, 1 when one neuron fired, about 0 when all did.

"population" stops there. "fit" takes the neuron of the highest potential as the prior, and the true arrival times of
the inputs at its synapses as the data. With o the synapse's place, a its input's age, and g = u / v the slowness::

    minimise over c, g:   sum (a - c + o.g)^2  +  PRIOR |g - g_k|^2      over the j with |a - Delta[k, j]| <= 1.5

It is the local plane of Benosman et al. 2014, fitted where the network fired, to what made it fire. Slowness rather
than velocity is what timing measures, and what may be averaged: for a rigid front of any shape, g.V = 1 all along it.

A front that fires a neuron has reached the far side of its kernel: that is where the sample is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.flow.network import REACH, SIDE, SYNAPSES, FlowNetwork
from heliograph_services.tracker.flow.spikes import Spikes
from heliograph_services.tracker.jit import kernel

Floats = npt.NDArray[np.float64]

# Half a tick of rounding in the delay, one of the input's.
INLIER_TICKS: Final = 1.5
# In synapses at one pixel's distance: enough to hold the direction that a thin front leaves open, too little to count
# where it is seen (25 synapses have 50).
PRIOR: Final = 2.0
# Neurons of two neighbouring directions have .92, of opposite ones 0.
COHERENCE_LEAST: Final = 0.6
# A neuron answers beyond the speeds of its neighbours in the row, the last ones by as much again.
SPEED_SLACK: Final = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """The n samples of motion of one tick of one scale, in the order of first spikes.

    Args:
        x: (n,) float64, where the front is now; network pixels.
        y: (n,) float64.
        gx: (n,) float64, slowness, ticks a pixel, along the motion.
        gy: (n,) float64.
        weight: (n,) float64, the cube of the highest potential over 25, times the coherence: 1 for a perfect front.
    """

    x: Floats
    y: Floats
    gx: Floats
    gy: Floats
    weight: Floats

    def __len__(self) -> int:
        return len(self.x)


@kernel
def _gather(x: Any, y: Any, k: Any, s: Any, tuning: Any, slot: Any, sums: Any, best: Any) -> int:
    """Sum spikes by pixel: sums (n, 5) = s^3, s^3 v (2), s^3 u (2); best (n, 4) = x, y, neuron, s; tuning is v, u."""
    n = 0
    for i in range(len(x)):
        j = slot[y[i], x[i]] - 1
        if j < 0:
            j = n
            n += 1
            slot[y[i], x[i]] = n
            best[j, 0] = x[i]
            best[j, 1] = y[i]
            best[j, 3] = -1.0
            for column in range(5):
                sums[j, column] = 0.0
        potential = np.float64(s[i])
        cube = potential * potential * potential
        sums[j, 0] += cube
        for i_tuning in range(4):
            sums[j, 1 + i_tuning] += cube * tuning[k[i], i_tuning]
        if s[i] > best[j, 3]:
            best[j, 2] = k[i]
            best[j, 3] = s[i]
    for j in range(n):
        slot[int(best[j, 1]), int(best[j, 0])] = 0
    return n


@kernel
def _fit(px: int, py: int, g0x: float, g0y: float, delay: Any, k: int, arrival: Any, now: float) -> Any:
    """Return the slowness by the module's least squares around pixel (px, py), at which neuron k fired most."""
    n = 0.0
    sx = 0.0
    sy = 0.0
    sa = 0.0
    sxx = 0.0
    sxy = 0.0
    syy = 0.0
    sxa = 0.0
    sya = 0.0
    for oy in range(-REACH, REACH + 1):
        for ox in range(-REACH, REACH + 1):
            age = now - arrival[py + oy + REACH, px + ox + REACH]
            # Counted without a branch: which synapses fit is as good as random, and wrong guesses cost more than sums.
            fits = 1.0 if abs(age - delay[k, (oy + REACH) * SIDE + ox + REACH]) <= INLIER_TICKS else 0.0
            n += fits
            sx += fits * ox
            sy += fits * oy
            sa += fits * age
            sxx += fits * (ox * ox)
            sxy += fits * (ox * oy)
            syy += fits * (oy * oy)
            sxa += fits * ox * age
            sya += fits * oy * age
    if n == 0.0:
        return g0x, g0y
    a = sxx - sx * sx / n + PRIOR
    b = sxy - sx * sy / n
    d = syy - sy * sy / n + PRIOR
    e = PRIOR * g0x - (sxa - sx * sa / n)
    f = PRIOR * g0y - (sya - sy * sa / n)
    det = a * d - b * b
    return (d * e - b * f) / det, (a * f - b * e) / det


@kernel
def _read(
    n: int, sums: Any, best: Any, velocity: Any, delay: Any, arrival: Any, now: float, fit: bool, slowest: float,
    fastest: float, out: Any,
) -> int:  # fmt: skip
    """Write rows (x, y, gx, gy, weight) of the samples to out (n, 5); return how many."""
    kept = 0
    for j in range(n):
        cube = sums[j, 0]
        coherence = np.sqrt(sums[j, 3] ** 2 + sums[j, 4] ** 2) / cube
        if coherence < COHERENCE_LEAST:
            continue
        if fit:
            k = int(best[j, 2])
            vx = velocity[k, 0]
            vy = velocity[k, 1]
            v2 = vx * vx + vy * vy
            gx, gy = _fit(int(best[j, 0]), int(best[j, 1]), vx / v2, vy / v2, delay, k, arrival, now)
        else:
            vx = sums[j, 1] / cube
            vy = sums[j, 2] / cube
            v2 = vx * vx + vy * vy
            gx = vx / v2
            gy = vy / v2
        g = np.sqrt(gx * gx + gy * gy)
        if g * slowest > 1.0 or g * fastest < 1.0:
            continue
        out[kept, 0] = best[j, 0] + REACH * gx / g
        out[kept, 1] = best[j, 1] + REACH * gy / g
        out[kept, 2] = gx
        out[kept, 3] = gy
        out[kept, 4] = coherence * (best[j, 3] / SYNAPSES) ** 3
        kept += 1
    return kept


class Reader:
    """Reads one network's spikes.

    Args:
        network: parameters.
        width: columns.
        height: rows.
        fit: or population.
    """

    def __init__(self, network: FlowNetwork, width: int, height: int, fit: bool) -> None:
        self._network = network
        self._slot = np.zeros((height, width), np.int32)
        self._fit = fit
        speed = np.hypot(*network.velocity.T)
        self._slowest = float(speed.min()) / SPEED_SLACK
        self._fastest = float(speed.max()) * SPEED_SLACK
        self._tuning = np.hstack([network.velocity, network.velocity / speed[:, None]])

    def read(self, spikes: Spikes, arrival: Floats, tick: int) -> Samples:
        """Return the samples of a tick; arrival as `Intake.arrival`."""
        net = self._network
        most = min(len(spikes), self._slot.size)
        sums, best = np.empty((most, 5)), np.empty((most, 4))
        n = _gather(spikes.x, spikes.y, spikes.k, spikes.s, self._tuning, self._slot, sums, best)
        out = np.empty((n, 5))
        # An input of this very tick has the age 0 on average: its arrival lies within the tick.
        kept = _read(
            n, sums, best, net.velocity, net.delay, arrival, tick + 0.5, self._fit, self._slowest, self._fastest, out
        )
        return Samples(*out[:kept].T.copy())
