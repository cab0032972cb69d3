"""Random numbers without a state: each is a hash of what it is for.

``(seed, purpose, a, b, c) -> 64 bits``. So a number is the same whoever asks, when, and how often: in one process or
many, over any cut of time. The hash is a chain of SplitMix64 finalisers (Steele, Lea and Flood, "Fast splittable
pseudorandom number generators", OOPSLA 2014; constants of Stafford's mix 13)::

    h <- mix(seed + purpose G);  h <- mix(h + a G);  h <- mix(h + b G);  h <- mix(h + c G),  G golden, odd

Over its last counter it is SplitMix64 itself, which passes BigCrush; every step is a bijection of what is mixed in.

    uniform       (top 52 bits + 1/2) / 2^52, never 0 or 1
    normal        inverse of the normal distribution (Wichura, algorithm AS 241, PPND16: relative error 1e-16)
    exponential   -ln(uniform), mean 1
    poisson_count inversion, outwards from the mode

A function of one number is called by kernels; the one in the plural takes and returns arrays, with the same bits. A
kernel that calls them must name this module in its stamp (`heliograph.link.stamp`).
"""

from __future__ import annotations

import math
from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Counter = int | npt.NDArray[np.integer[Any]]

# What a number is for: two uses of the same counters share no bits. New ones are added at the end; changing one
# changes every scene that was ever made.
THRESHOLD: Final = 1
JITTER: Final = 2
SHOT: Final = 3
HOT: Final = 4
LEAK: Final = 5
PATH: Final = 6
DRIVE: Final = 7
TEXTURE: Final = 8
SCAN: Final = 9
SHAKE: Final = 10
PAYLOAD: Final = 11
CLOCK: Final = 12
READOUT: Final = 13
GLINT: Final = 14
HOT_EVENT: Final = 15

_G: Final = 0x9E3779B97F4A7C15
_M1: Final = 0xBF58476D1CE4E5B9
_M2: Final = 0x94D049BB133111EB
# Above this mean, the normal approximation (skewness below 0.001): the search would take about sqrt(mean) steps.
_POISSON_NORMAL: Final = 1e6
# Coefficients of AS 241, highest power first: numerators and denominators for |p - 1/2| <= .425, then for
# sqrt(-ln(min(p, 1 - p))) up to 5, then beyond.
_CENTRE_N: Final = (
    2509.0809287301226727, 33430.575583588128105, 67265.770927008700853, 45921.953931549871457,
    13731.693765509461125, 1971.5909503065514427, 133.14166789178437745, 3.387132872796366608,
)  # fmt: skip
_CENTRE_D: Final = (
    5226.495278852545925, 28729.085735721942674, 39307.89580009271061, 21213.794301586595867,
    5394.1960214247511077, 687.1870074920579083, 42.313330701600911252, 1.0,
)  # fmt: skip
_MIDDLE_N: Final = (
    7.7454501427834140764e-4, 0.0227238449892691845833, 0.24178072517745061177, 1.27045825245236838258,
    3.64784832476320460504, 5.7694972214606914055, 4.6303378461565452959, 1.42343711074968357734,
)  # fmt: skip
_MIDDLE_D: Final = (
    1.05075007164441684324e-9, 5.475938084995344946e-4, 0.0151986665636164571966, 0.14810397642748007459,
    0.68976733498510000455, 1.6763848301838038494, 2.05319162663775882187, 1.0,
)  # fmt: skip
_TAIL_N: Final = (
    2.01033439929228813265e-7, 2.71155556874348757815e-5, 0.0012426609473880784386, 0.026532189526576123093,
    0.29656057182850489123, 1.7848265399172913358, 5.4637849111641143699, 6.6579046435011037772,
)  # fmt: skip
_TAIL_D: Final = (
    2.04426310338993978564e-15, 1.4215117583164458887e-7, 1.8463183175100546818e-5, 7.868691311456132591e-4,
    0.0148753612908506148525, 0.13692988092273580531, 0.59983220655588793769, 1.0,
)  # fmt: skip


@numba.njit(nogil=True)
def _mix(h: np.uint64) -> np.uint64:
    h = (h ^ (h >> np.uint64(30))) * np.uint64(_M1)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(_M2)
    return h ^ (h >> np.uint64(31))


@numba.njit(nogil=True)
def bits(seed: int, purpose: int, a: int, b: int, c: int) -> np.uint64:
    """Return 64 bits; all arguments are integers, negative ones too."""
    g = np.uint64(_G)
    h = _mix(np.uint64(seed) + np.uint64(purpose) * g)
    h = _mix(h + np.uint64(a) * g)
    h = _mix(h + np.uint64(b) * g)
    return _mix(h + np.uint64(c) * g)


@numba.njit(nogil=True)
def uniform(seed: int, purpose: int, a: int, b: int, c: int) -> float:
    """Return a float64 in (0, 1)."""
    return (np.float64(bits(seed, purpose, a, b, c) >> np.uint64(12)) + 0.5) * 2.0**-52


@numba.njit(nogil=True)
def _horner(coefficients: tuple[float, ...], r: float) -> float:
    value = coefficients[0]
    for k in range(1, len(coefficients)):
        value = value * r + coefficients[k]
    return value


@numba.njit(nogil=True)
def quantile(p: float) -> float:
    """Return z with Phi(z) = p, p in (0, 1)."""
    q = p - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        return q * _horner(_CENTRE_N, r) / _horner(_CENTRE_D, r)
    r = math.sqrt(-math.log(p if q < 0.0 else 1.0 - p))
    if r <= 5.0:
        z = _horner(_MIDDLE_N, r - 1.6) / _horner(_MIDDLE_D, r - 1.6)
    else:
        z = _horner(_TAIL_N, r - 5.0) / _horner(_TAIL_D, r - 5.0)
    return -z if q < 0.0 else z


@numba.njit(nogil=True)
def normal(seed: int, purpose: int, a: int, b: int, c: int) -> float:
    """Return a float64 of mean 0 and variance 1; never beyond 8.3."""
    return quantile(uniform(seed, purpose, a, b, c))


@numba.njit(nogil=True)
def exponential(seed: int, purpose: int, a: int, b: int, c: int) -> float:
    """Return a float64 above 0 of mean 1."""
    return -math.log(uniform(seed, purpose, a, b, c))


@numba.njit(nogil=True)
def poisson_count(seed: int, purpose: int, a: int, b: int, c: int, mean: float) -> int:
    """Return an int64 of Poisson's distribution; 0 for a mean of 0 or less.

    The unit interval is laid out as the probabilities of mode, mode + 1, mode - 1 ...: about sqrt(mean) steps.
    """
    if not mean > 0.0:
        return 0
    u = uniform(seed, purpose, a, b, c)
    if mean > _POISSON_NORMAL:
        return max(0, math.floor(mean + math.sqrt(mean) * quantile(u) + 0.5))
    up = int(mean)
    down = up
    p_up = math.exp(up * math.log(mean) - mean - math.lgamma(up + 1.0))
    p_down = p_up
    u -= p_up
    # Past 12 standard deviations nothing is left but what rounding left of u.
    for _ in range(int(12.0 * math.sqrt(mean)) + 60):
        if u < 0.0:
            return up
        up += 1
        p_up *= mean / up
        u -= p_up
        if u < 0.0:
            return up
        if down > 0:
            p_down *= down / mean
            down -= 1
            u -= p_down
            if u < 0.0:
                return down
    return int(mean)


@numba.njit(cache=True, nogil=True)
def _fill(kind: int, seed: int, purpose: int, a: Ints, b: Ints, c: Ints, mean: Floats, out: Floats) -> None:
    for i in range(len(out)):
        if kind == 0:
            out[i] = uniform(seed, purpose, a[i], b[i], c[i])
        elif kind == 1:
            out[i] = normal(seed, purpose, a[i], b[i], c[i])
        elif kind == 2:
            out[i] = exponential(seed, purpose, a[i], b[i], c[i])
        else:
            out[i] = poisson_count(seed, purpose, a[i], b[i], c[i], mean[i])


def _many(kind: int, seed: int, purpose: int, a: Counter, b: Counter, c: Counter, mean: float | Floats = 0.0) -> Floats:
    counters = (np.asarray(a, np.int64), np.asarray(b, np.int64), np.asarray(c, np.int64))
    fields = np.broadcast_arrays(*counters, np.asarray(mean, np.float64))
    out = np.empty(fields[0].shape, np.float64)
    flat = [np.ascontiguousarray(field).reshape(-1).copy() for field in fields]
    # As a signed number: one type for numba, the same 64 bits.
    signed = (int(seed) + (1 << 63)) % (1 << 64) - (1 << 63)
    _fill(kind, signed, int(purpose), flat[0], flat[1], flat[2], flat[3], out.reshape(-1))
    return out


def uniforms(seed: int, purpose: int, a: Counter, b: Counter = 0, c: Counter = 0) -> Floats:
    """Return float64 in (0, 1), one for each of the counters as they are broadcast.

    Args:
        seed: any integer; its lowest 64 bits count.
        purpose: one of the constants above.
        a: integers, an array or one; as b and c.
        b: 0 if not given, as `uniform` would be given it.
        c: likewise.
    """
    return _many(0, seed, purpose, a, b, c)


def normals(seed: int, purpose: int, a: Counter, b: Counter = 0, c: Counter = 0) -> Floats:
    """Return float64 of mean 0 and variance 1, as `uniforms` does."""
    return _many(1, seed, purpose, a, b, c)


def exponentials(seed: int, purpose: int, a: Counter, b: Counter = 0, c: Counter = 0) -> Floats:
    """Return float64 of mean 1, as `uniforms` does."""
    return _many(2, seed, purpose, a, b, c)


def poisson_counts(
    seed: int, purpose: int, a: Counter, b: Counter = 0, c: Counter = 0, *, mean: float | Floats
) -> Ints:
    """Return int64 of Poisson's distribution about mean (broadcast too), as `uniforms` does."""
    return _many(3, seed, purpose, a, b, c, mean).astype(np.int64)


def warm() -> None:
    """Compile, or load from the cache, what the functions of arrays need."""
    uniforms(0, THRESHOLD, 0)
