"""Quotients of counts with their 95 % intervals, and bounds of rare events: the one home of our statistics.

Errors come in bursts, so the unit is a block: the counts of one beacon in one second of one run (docs/metrics.md).
Counts are added, then divided; the interval is the percentile bootstrap over k blocks::

    value = sum(part) / sum(whole)        [low, high] = quantiles .025 and .975 of RESAMPLES draws of k blocks

Where all blocks agree the bootstrap has no width; then the bound is what k blocks without the opposite can exclude,
1 - 0.05^(1/k). Single trials have the bounds of Clopper and Pearson, events in time those of Garwood (Poisson); both
one-sided, .05.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

RESAMPLES: Final = 2000
SEED: Final = 1
# The draws of so many blocks are kept for the next quotient: 16 MB. Longer ones are drawn anew, line by line.
_KEPT_BLOCKS: Final = 1024
_MISS: Final = 0.05


@dataclass(frozen=True, slots=True)
class Share:
    """A quotient over a sum of n, with its 95 % interval; nan where n is 0."""

    value: float
    low: float
    high: float
    n: int

    def __str__(self) -> str:
        return f"{self.value:.4f} [{self.low:.4f} {self.high:.4f}]" if self.n else "-"

    def row(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        if not self.n:
            return {"n": 0}
        return {"value": round(self.value, 5), "low": round(self.low, 5), "high": round(self.high, 5), "n": self.n}


def quotient(part: npt.ArrayLike, whole: npt.ArrayLike) -> Share:
    """Return sum(part) / sum(whole), of whatever size, over (k,) blocks; blocks with a whole of 0 are left out."""
    a, n = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    if n.sum() <= 0:
        return Share(math.nan, math.nan, math.nan, 0)
    sums, sizes = _resampled(a, n)
    low, high = np.quantile(sums / sizes, [0.025, 0.975])
    return Share(float(a.sum() / n.sum()), float(low), float(high), int(n.sum()))


def share(part: npt.ArrayLike, whole: npt.ArrayLike) -> Share:
    """Return sum(part) / sum(whole), 0 to 1, over (k,) blocks, with the bound of blocks that all agree."""
    found = quotient(part, whole)
    if not found.n:
        return found
    a, n = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    slack = 1.0 - _MISS ** (1.0 / np.count_nonzero(n))
    low = min(found.low, 1.0 - slack) if a.sum() == n.sum() else found.low
    high = max(found.high, slack) if a.sum() == 0 else found.high
    return Share(found.value, float(low), float(high), found.n)


def difference(one: npt.ArrayLike, other: npt.ArrayLike, whole: npt.ArrayLike) -> Share:
    """Return (sum(one) - sum(other)) / sum(whole) over the same (k,) blocks, -1 to 1."""
    return quotient(np.asarray(one, np.float64) - np.asarray(other, np.float64), whole)


def merged(blocks: npt.NDArray[Any], most: int) -> npt.NDArray[Any]:
    """Return at most so many blocks: neighbours are added, none is lost; the interval then errs to the wide side.

    Args:
        blocks: (columns, k) counts; neighbours in time beside each other.
        most: at least 1.
    """
    k = blocks.shape[1]
    if k <= most:
        return blocks
    starts = np.unique(np.linspace(0, k, most, endpoint=False).astype(np.int64))
    added: npt.NDArray[Any] = np.add.reduceat(blocks, starts, axis=1)
    return added


def lower_bound(k: int, n: int) -> float:
    """Return the p at which k of n or more independent successes have a probability of .05 (Clopper and Pearson)."""
    low, high = 0.0, 1.0
    for _ in range(60):
        p = (low + high) / 2
        tail = sum(math.comb(n, i) * p**i * (1 - p) ** (n - i) for i in range(k, n + 1))
        low, high = (p, high) if tail < _MISS else (low, p)
    return low


def upper_bound(k: int, n: int) -> float:
    """Return the p at which k of n or fewer independent failures have a probability of .05; 1 where n is 0."""
    if n == 0 or k >= n:
        return 1.0
    if k == 0:
        return float(1.0 - _MISS ** (1.0 / n))
    low, high = k / n, 1.0
    for _ in range(60):
        p = (low + high) / 2
        tail = math.fsum(_binomial(n, i, p) for i in range(k + 1))
        low, high = (p, high) if tail > _MISS else (low, p)
    return high


def most_events(seen: int) -> float:
    """Return the mean at which so many or fewer events have a probability of .05 (Garwood): 3.0 where none was seen."""
    low, high = float(seen), 2.0 * seen + 10.0
    for _ in range(60):
        mean = (low + high) / 2
        below = math.fsum(math.exp(i * math.log(mean) - mean - math.lgamma(i + 1)) for i in range(seen + 1))
        low, high = (mean, high) if below > _MISS else (low, mean)
    return high


def _binomial(n: int, k: int, p: float) -> float:
    """Return the probability of k of n; by logarithms, since n may be millions."""
    ways = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
    return math.exp(ways + k * math.log(p) + (n - k) * math.log1p(-p))


def _resampled(
    part: npt.NDArray[np.float64], whole: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the sums of both over RESAMPLES draws of as many blocks, those with a whole of 0 left out."""
    kept = whole > 0
    part, whole = part[kept], whole[kept]
    k = len(whole)
    if k <= _KEPT_BLOCKS:
        times = _draws(k)
        return times @ part, times @ whole
    generator = np.random.Generator(np.random.Philox(SEED))
    sums, sizes = np.empty(RESAMPLES), np.empty(RESAMPLES)
    for i in range(RESAMPLES):
        drawn = np.bincount(generator.integers(0, k, k), minlength=k)
        sums[i], sizes[i] = drawn @ part, drawn @ whole
    return sums, sizes


@lru_cache(maxsize=2)
def _draws(k: int) -> npt.NDArray[np.float64]:
    """Return (RESAMPLES, k): how often each block is drawn."""
    generator = np.random.Generator(np.random.Philox(SEED))
    return np.stack([np.bincount(generator.integers(0, k, k), minlength=k) for _ in range(RESAMPLES)]).astype(
        np.float64
    )
