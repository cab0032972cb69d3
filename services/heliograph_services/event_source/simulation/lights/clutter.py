"""Lights that are no beacons: blinkers, lamps, reflections.

- `BitsDrive`: random bits on a clock; bit k is one hash, the clock's phase another.
- `TelegraphDrive`: on and off for exponentially distributed times. With rates a (dark to lit) and b (lit to dark) the
  process is that of a *refresh clock*: a Poisson process of rate a + b, each of whose ticks sets the light, whatever it
  was, to lit with probability a / (a + b). For the light then goes on at rate (a + b) a / (a + b) = a, and off at b,
  without memory, which defines the telegraph. A Poisson process can be told block by block (a Poisson number of ticks,
  each anywhere in the block), and the light depends on the last tick alone: so any time can be asked without history.
  Sun glints are the same: flashes of exponential length, which begin in the dark at `rate_hz`.
- `pwm`, `lamp`, `steady`: periodic; their phases come from the seed.
"""

from __future__ import annotations

from math import asin, ceil, log, log1p, pi
from typing import Final

import numpy as np

from heliograph.units import US_PER_S
from heliograph_services.event_source.simulation.contract import Floats, Ints
from heliograph_services.event_source.simulation.lights.draws import Use, even, phase, poisson
from heliograph_services.event_source.simulation.lights.train import Periodic, Train

# A stair's step is so much of the lamp's present light: a tenth of a pixel's threshold, so that the stair makes the
# events of the sine, each in its time.
LAMP_STEP: Final = 0.02
# But no less than this share of its full light: a lamp that goes fully dark would need steps without end.
LAMP_STEP_LEAST: Final = 0.005
# Faster ticks than the fastest beacon's bits are flicker that no pixel follows, and cost as much as all the rest.
TICKS_LIMIT_HZ: Final = 200_000.0
# Of a block of the refresh clock: an empty block (which asks for the one before) happens once in e^16.
_TICKS_A_BLOCK: Final = 16.0
_TICKS_MOST: Final = 96  # P(more | mean 16) < 1e-40
_BLOCKS_BACK: Final = 64


class BitsDrive(Train):
    """Random bits on a clock.

    Args:
        bit_rate: bits a second.
        seed: of the simulation.
        index: of the light's emitter.
    """

    def __init__(self, bit_rate: float, seed: int, index: int) -> None:
        super().__init__(bit_rate / 2.0, index)
        self._bit_us = US_PER_S / bit_rate
        self._phase_us = self._bit_us * phase(seed, index)
        self._seed = seed
        self._index = index

    def edges(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and new levels of the changes in [t0_us, t1_us)."""
        k, lit = self._bits(t0_us, t1_us)
        changed = np.flatnonzero(lit[1:] != lit[:-1]) + 1
        t_us = self._phase_us + k[changed].astype(np.float64) * self._bit_us
        inside = (t_us >= t0_us) & (t_us < t1_us)
        return t_us[inside], lit[changed][inside]

    def level_before(self, t_us: float) -> float:
        """Return the level just before t_us."""
        k, lit = self._bits(t_us, t_us)
        return float(lit[np.flatnonzero(self._phase_us + k * self._bit_us < t_us)[-1]])

    def _bits(self, t0_us: float, t1_us: float) -> tuple[Ints, Floats]:
        first = int((t0_us - self._phase_us) // self._bit_us) - 1
        k = np.arange(first, int((t1_us - self._phase_us) // self._bit_us) + 2, dtype=np.int64)
        return k, (even(self._seed, self._index, Use.BIT, k) < 0.5).astype(np.float64)


class TelegraphDrive(Train):
    """On and off for exponentially distributed times; see the module.

    Args:
        mean_on_us: mean time that it is lit.
        mean_off_us: mean time that it is dark.
        seed: of the simulation.
        index: of the light's emitter.

    Raises:
        ValueError: 1 / mean_on + 1 / mean_off exceeds TICKS_LIMIT_HZ.
    """

    def __init__(self, mean_on_us: float, mean_off_us: float, seed: int, index: int) -> None:
        ticks_hz = US_PER_S / mean_on_us + US_PER_S / mean_off_us
        if not ticks_hz <= TICKS_LIMIT_HZ:
            raise ValueError(
                f"1/mean on + 1/mean off must be at most {TICKS_LIMIT_HZ:g} Hz, not {ticks_hz:g}"
                f" ({mean_on_us:g} and {mean_off_us:g} us)"
            )
        super().__init__(ticks_hz, index)  # its ticks are what a block costs
        self._share_on = mean_on_us / (mean_on_us + mean_off_us)
        self._clock_us = _TICKS_A_BLOCK * US_PER_S / ticks_hz
        self._seed = seed
        self._index = index

    def edges(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times and new levels of the changes in [t0_us, t1_us)."""
        first = int(t0_us // self._clock_us)
        t_us, lit = self._ticks(np.arange(first, int(t1_us // self._clock_us) + 1, dtype=np.int64))
        inside = (t_us >= t0_us) & (t_us < t1_us)
        t_us, lit = t_us[inside], lit[inside]
        before = np.concatenate([[self.level_before(t0_us)], lit[:-1]]) if len(lit) else lit
        changed = lit != before
        return t_us[changed], lit[changed]

    def level_before(self, t_us: float) -> float:
        """Return the level just before t_us: what the last tick has made it."""
        last = int(t_us // self._clock_us)
        for block in range(last, last - _BLOCKS_BACK, -1):
            tick_us, lit = self._ticks(np.array([block], np.int64))
            i = int(np.searchsorted(tick_us, t_us))
            if i:
                return float(lit[i - 1])
        return 0.0

    def _ticks(self, block: Ints) -> tuple[Floats, Floats]:
        """Return the times and states of the refresh clock's ticks in the blocks, in order of time."""
        n = poisson(self._seed, self._index, Use.CLOCK_COUNT, block, _TICKS_A_BLOCK)
        n = np.minimum(n, _TICKS_MOST)
        each = np.repeat(block, n)
        within = np.arange(len(each)) - np.repeat(np.cumsum(n) - n, n)
        counter = each * _TICKS_MOST + within
        t_us = (each + even(self._seed, self._index, Use.CLOCK_TIME, counter)) * self._clock_us
        lit = even(self._seed, self._index, Use.CLOCK_STATE, counter) < self._share_on
        order = np.argsort(t_us, kind="stable")
        return t_us[order], lit[order].astype(np.float64)


def pwm(frequency_hz: float, duty: float, seed: int, index: int) -> Periodic:
    """Return a light that is lit for the share `duty` of each period."""
    period_us = US_PER_S / frequency_hz
    offset_us, level = np.array([0.0, duty * period_us]), np.array([1.0, 0.0])
    return Periodic(period_us, offset_us, level, 0.0, period_us * phase(seed, index), index)


def lamp(frequency_hz: float, depth: float, seed: int, index: int) -> Periodic:
    """Return a lamp, ``(1 + depth sin(2 pi f t)) / (1 + depth)``, as a stair (LAMP_STEP).

    The stair changes from one of its levels to the next where the sine passes the middle between them.
    """
    period_us = US_PER_S / frequency_hz
    phase_us = period_us * phase(seed, index)
    stair = _stair((1.0 - depth) / (1.0 + depth))
    if depth == 0.0:
        return Periodic(period_us, np.empty(0), np.empty(0), 1.0, phase_us, index)
    middle = (stair[1:] + stair[:-1]) / 2.0
    # Between its minimum, at -period/4, and its maximum the sine rises; falling is its mirror image about +period/4.
    sine = ((1.0 + depth) * middle - 1.0) / depth
    rising_us = np.array([asin(min(1.0, max(-1.0, s))) for s in sine]) * period_us / (2.0 * pi)
    falling_us = period_us / 2.0 - rising_us
    offset_us = np.concatenate([rising_us, falling_us[::-1]]) + period_us / 4.0
    return Periodic(period_us, offset_us, np.concatenate([stair[1:], stair[-2::-1]]), 1.0, phase_us, index)


def steady(index: int) -> Periodic:
    """Return a light that is always lit."""
    return Periodic(float(US_PER_S), np.empty(0), np.empty(0), 1.0, 0.0, index)


def _stair(least: float) -> Floats:
    """Return rising levels from `least` to 1: steps of LAMP_STEP of the light, at least LAMP_STEP_LEAST."""
    knee = min(1.0, max(least, LAMP_STEP_LEAST / LAMP_STEP))
    low = np.linspace(least, knee, ceil((knee - least) / LAMP_STEP_LEAST) + 1)
    steps = ceil(-log(knee) / log1p(LAMP_STEP) - 1e-9)
    high = np.exp(np.linspace(log(knee), 0.0, steps + 1))
    return np.concatenate([low[:-1], high]) if len(low) > 1 else high
