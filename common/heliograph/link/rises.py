"""When a light goes on: the rising edges in the events of an asynchronous sensor, for codes whose gaps carry the data.

With a decaying sum of the ON events, t_i being their times::

    y(t) = sum_{t_i <= t} exp(-(t - t_i) / tau)

a rise is told at the event with which y reaches theta while the detector is armed; it is armed again once y has fallen
below theta / 2. theta follows the light: of the peaks P_j that y reaches after rises, the large ones count most::

    theta = max(1, A / 3),   A = E[P^2] / E[P]        running means over 32 rises, at first over those there are

so that lone events of noise (P = 1) do not lower it. After each `silence_us` without a rise A is halved: a light that
has gone away, or a glare, does not deafen the detector. All rises of one light are told at the same share of their
burst, hence the detector's delay does not show in the gaps between them.
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times

Floats = npt.NDArray[np.float64]

# A third of the usual peak: half of it fails where a pixel's share of the burst is late, a sixth is one event of a
# light of six pixels.
SHARE: Final = 1.0 / 3.0
# Rises averaged: a beacon that comes nearer at 2 m/s from 5 m changes its size by 1 % in 25 ms.
MEMORY: Final = 32
# State of the kernel.
_Y, _T, _PEAK, _ARMED, _SQUARES, _SUMS, _SEEN, _LAST = range(8)


@numba.njit(cache=True, nogil=True)
def _find(t_us: Times, on: Flags, tau_us: float, silence_us: float, s: Floats, out: Times) -> int:
    """Fill in the times of the rises; return how many."""
    n = 0
    for i in range(len(t_us)):
        if not on[i]:
            continue
        t = float(t_us[i])
        y = s[_Y] * math.exp(-(t - s[_T]) / tau_us)
        halvings = 0
        while t - s[_LAST] > silence_us and halvings < 64:
            # The mean of the squares falls twice as fast: A and, with it, theta are halved.
            s[_SQUARES] *= 0.5
            s[_LAST] += silence_us
            halvings += 1
        if halvings == 64:
            s[_LAST] = t
        theta = 1.0
        if s[_SUMS] > 0.0:
            theta = max(1.0, SHARE * s[_SQUARES] / s[_SUMS])
        if s[_ARMED] == 0.0 and y < 0.5 * theta:
            s[_ARMED] = 1.0
            s[_SEEN] = min(s[_SEEN] + 1.0, float(MEMORY))
            s[_SQUARES] += (s[_PEAK] * s[_PEAK] - s[_SQUARES]) / s[_SEEN]
            s[_SUMS] += (s[_PEAK] - s[_SUMS]) / s[_SEEN]
            s[_PEAK] = 0.0
            theta = max(1.0, SHARE * s[_SQUARES] / s[_SUMS])
        y += 1.0
        s[_Y] = y
        s[_T] = t
        if s[_ARMED] != 0.0 and y >= theta:
            out[n] = t_us[i]
            n += 1
            s[_ARMED] = 0.0
            s[_PEAK] = 0.0
            s[_LAST] = t
        if s[_ARMED] == 0.0:
            s[_PEAK] = max(s[_PEAK], y)
    return n


class Rises:
    """The rising edges of one track's light.

    Args:
        tau_us: decay of the sum; the least gap between two rises is three times as long or more.
        silence_us: without a rise for so long, the threshold is halved.
    """

    def __init__(self, tau_us: float, silence_us: float) -> None:
        self._tau_us = tau_us
        self._silence_us = silence_us
        self._state: Floats = np.zeros(8)
        self._state[_ARMED] = 1.0
        self._begun = False

    def find(self, t_us: Times, on: Flags) -> list[int]:
        """Return the times (us) of the rises among further events, in order.

        Args:
            t_us: (n,) int64, not falling.
            on: (n,) bool.
        """
        if not len(t_us):
            return []
        if not self._begun:
            self._state[_T] = self._state[_LAST] = float(t_us[0])
            self._begun = True
        out = np.empty(len(t_us), np.int64)
        n = _find(t_us, on, self._tau_us, self._silence_us, self._state, out)
        found: list[int] = out[:n].tolist()
        return found

    @property
    def events(self) -> float | None:
        """How many ON events a rise has at most within the decay's time, on average; None before the second."""
        sums = float(self._state[_SUMS])
        return float(self._state[_SQUARES]) / sums if sums > 0.0 else None


def warm() -> None:
    """Compile, or load from the cache, the kernel: for arrays off the wire too, which are read-only."""
    t_us, on = np.arange(4, dtype=np.int64), np.ones(4, np.bool_)
    Rises(1.0, 10.0).find(t_us, on)
    t_us.flags.writeable = on.flags.writeable = False
    Rises(1.0, 10.0).find(t_us, on)
