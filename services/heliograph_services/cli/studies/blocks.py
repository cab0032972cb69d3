"""Shares with intervals and differences of paired shares: a bootstrap over blocks of run x beacon x 1 s.

A block is a tuple of counts of one beacon in one second of one run. Counts are added, then divided. Where all blocks
agree (docs/metrics.md) the bound is what k blocks without the opposite can exclude, 1 - 0.05^(1/k).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

RESAMPLES: Final = 2000
SEED: Final = 1


@dataclass(frozen=True, slots=True)
class Share:
    """A share of n with its 95 % interval; nan where n is 0."""

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


def share(part: npt.ArrayLike, whole: npt.ArrayLike) -> Share:
    """Return sum(part) / sum(whole) over (k,) blocks."""
    a, n = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    if n.sum() <= 0:
        return Share(math.nan, math.nan, math.nan, 0)
    sums, sizes = _resampled(a, n)
    low, high = np.quantile(sums / sizes, [0.025, 0.975])
    value, slack = float(a.sum() / n.sum()), 1.0 - 0.05 ** (1.0 / np.count_nonzero(n))
    if a.sum() == n.sum():
        low = min(low, 1.0 - slack)
    if a.sum() == 0:
        high = max(high, slack)
    return Share(value, float(low), float(high), int(n.sum()))


def difference(one: npt.ArrayLike, other: npt.ArrayLike, whole: npt.ArrayLike) -> Share:
    """Return (sum(one) - sum(other)) / sum(whole) over the same (k,) blocks, -1 to 1."""
    d, n = np.asarray(one, np.float64) - np.asarray(other, np.float64), np.asarray(whole, np.float64)
    if n.sum() <= 0:
        return Share(math.nan, math.nan, math.nan, 0)
    sums, sizes = _resampled(d, n)
    low, high = np.quantile(sums / sizes, [0.025, 0.975])
    return Share(float(d.sum() / n.sum()), float(low), float(high), int(n.sum()))


def lower_bound(k: int, n: int) -> float:
    """Return the p at which k of n or more independent successes have a probability of .05 (Clopper and Pearson)."""
    low, high = 0.0, 1.0
    for _ in range(60):
        p = (low + high) / 2
        tail = sum(math.comb(n, i) * p**i * (1 - p) ** (n - i) for i in range(k, n + 1))
        low, high = (p, high) if tail < 0.05 else (low, p)
    return low


def _resampled(
    part: npt.NDArray[np.float64], whole: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the sums of both over RESAMPLES draws of as many blocks, those with a whole of 0 left out."""
    kept = whole > 0
    part, whole = part[kept], whole[kept]
    generator = np.random.Generator(np.random.Philox(SEED))
    k = len(whole)
    sums, sizes = np.empty(RESAMPLES), np.empty(RESAMPLES)
    for i in range(RESAMPLES):
        times = np.bincount(generator.integers(0, k, k), minlength=k)
        sums[i], sizes[i] = times @ part, times @ whole
    return sums, sizes
