"""What the pixels' kernels hand to each other: one row of state a pixel, the law's numbers, the events made so far."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from heliograph.errors import ConfigError
from heliograph_services.event_source.simulation import random
from heliograph_services.event_source.simulation.contract import BACKGROUND, Floats, PixelNumbers, View

Floats32 = npt.NDArray[np.float32]
Tables = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int32]

# Columns of a pixel's state: sixteen float64, two lines of cache; a sleeping pixel that is looked at and does nothing
# needs the first alone.
V: Final = 0  # photoreceptor's output at T
REF: Final = 1  # reference at T plus drift T: constant between events, however the reference drifts
U: Final = 2  # input just after T
T: Final = 3  # us
LIGHT: Final = 4  # exp(U), W/m2, just after T
ON: Final = 5  # threshold
OFF: Final = 6  # threshold
DEAD: Final = 7  # refractory until then, us
SENT: Final = 8  # time of the pixel's last event as it left, us
COUNT: Final = 9  # events made: a counter of random numbers
EXTRA: Final = 10  # the lights' part of LIGHT
OWNER: Final = 11  # the light that was last seen to change here, else BACKGROUND
TOUCHED: Final = 12  # when, us
CLAIMED: Final = 13  # 1 while lights rule the pixel
VIEW: Final = 14  # of the surroundings, when SKY was computed
SKY: Final = 15  # exp(VIEW)
COLUMNS: Final = 16

# Entries of the law.
TAU_LIGHT: Final = 0  # tau_ref I_ref, us W/m2
TAU_MIN: Final = 1
DRIFT: Final = 2  # of the reference, per us
REFRACTORY: Final = 3
LATENCY: Final = 4
LATENCY_OFF: Final = 5
JITTER: Final = 6
BASE: Final = 7  # time to which `low` and `high` refer, us
LAW: Final = 8

# A threshold is never below a tenth of the mean: the normal distribution of the mismatch has no floor of its own.
LEAST_THRESHOLD: Final = 0.1
NEVER: Final = -1e18


class Pixels(NamedTuple):
    """n pixels.

    Args:
        state: (n, COLUMNS) float64.
        low: (n,) float32; while ``low < u + drift (t - BASE) < high``, nothing can happen; both are infinite while
            claimed.
        high: (n,) float32.
        law: (LAW,) float64.
        seed: of the random numbers.
    """

    state: Floats
    low: Floats32
    high: Floats32
    law: Floats
    seed: int


def signed(seed: int) -> int:
    """Return a seed's lowest 64 bits as one type for numba."""
    return (int(seed) + (1 << 63)) % (1 << 64) - (1 << 63)


def checked(numbers: PixelNumbers) -> PixelNumbers:
    """Return the numbers.

    Raises:
        ConfigError: one of them is out of its range.
    """
    # Below 0.01 a pixel of the darkest threshold could make more events at one edge than a read-out ever passes.
    for name, least in (("threshold_on", 0.01), ("threshold_off", 0.01), ("irradiance_ref_w_m2", 1e-9)):
        if not least <= getattr(numbers, name) <= 1e6:
            raise ConfigError(f"pixel.{name} must be in [{least:g}, 1e6], not {getattr(numbers, name)}")
    if not 0.01 <= numbers.tau_min_us <= 1e6:
        raise ConfigError(f"pixel.tau_min_us must be in [0.01, 1e6], not {numbers.tau_min_us}")
    for name, most in (
        ("threshold_sd", 10.0), ("tau_ref_us", 1e9), ("dark_w_m2", 1e6), ("refractory_us", 1e6), ("leak_hz", 50.0),
        ("shot_noise_hz", 1e4), ("hot_pixels", 1.0), ("hot_pixel_hz", 1e5), ("latency_us", 1e6),
        ("latency_off_extra_us", 1e6), ("jitter_us", 1e6),
    ):  # fmt: skip
        if not 0.0 <= getattr(numbers, name) <= most:
            raise ConfigError(f"pixel.{name} must be in [0, {most:g}], not {getattr(numbers, name)}")
    return numbers


def thresholds(mean: float, sd: float, n: int, seed: int, which: int) -> Floats:
    """Return (n,) float64, normal about the mean, never below LEAST_THRESHOLD of it."""
    z = random.normals(seed, random.THRESHOLD, np.arange(n), which)
    return np.maximum(mean + sd * z, LEAST_THRESHOLD * mean)


def _aligned(n: int) -> Floats:
    """Return (n, COLUMNS) zeros whose rows begin with a line of cache (64 bytes)."""
    room = np.zeros(n * COLUMNS + 8)
    skip = -(room.ctypes.data // 8) % 8
    return room[skip : skip + n * COLUMNS].reshape(n, COLUMNS)


def fresh(numbers: PixelNumbers, seed: int, first: View) -> Pixels:
    """Return pixels that have looked at the view forever.

    The reference drifts the same in all pixels, so fast that on the average over them leak_hz ON events a second come;
    where it drifts, it is found anywhere on its way to the next event, else where the photoreceptor is.
    """
    n = first.size
    on = thresholds(numbers.threshold_on, numbers.threshold_sd, n, seed, 0)
    off = thresholds(numbers.threshold_off, numbers.threshold_sd, n, seed, 1)
    law = np.zeros(LAW)
    law[TAU_LIGHT] = numbers.tau_ref_us * numbers.irradiance_ref_w_m2
    law[TAU_MIN] = numbers.tau_min_us
    law[DRIFT] = numbers.leak_hz * 1e-6 / float(np.mean(1.0 / on))
    law[REFRACTORY] = numbers.refractory_us
    law[LATENCY], law[LATENCY_OFF] = numbers.latency_us, numbers.latency_off_extra_us
    law[JITTER] = numbers.jitter_us
    state = _aligned(n)
    state[:, U] = state[:, V] = state[:, REF] = first.reshape(-1)
    state[:, VIEW] = state[:, U]
    state[:, SKY] = state[:, LIGHT] = np.exp(state[:, U])
    state[:, ON], state[:, OFF] = on, off
    if numbers.leak_hz > 0.0:
        state[:, REF] -= on * random.uniforms(seed, random.LEAK, np.arange(n))
    state[:, SENT] = state[:, DEAD] = state[:, TOUCHED] = NEVER
    state[:, OWNER] = BACKGROUND
    return Pixels(state, np.full(n, -np.inf, np.float32), np.full(n, np.inf, np.float32), law, signed(seed))
