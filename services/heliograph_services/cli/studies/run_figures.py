"""Figures of a few runs of real processes, with intervals that reach from run to run.

What is in one run shares that minute's load of the machine, so runs are what is independent (replications; Law and
Kelton, Simulation Modeling and Analysis). Of k runs with values y (of a time: its logarithm), mean m and deviation s:

    [low, high] = m -+ t(.975, k - 1) s / sqrt(k)

and, on each side, no narrower than all runs taken as one would have it: a bootstrap over seconds or blocks, or the
order statistics that a binomial variable bounds. Drawing three runs from three reaches from the least to the most,
which holds the median of all runs 3 times in 4, not 19 in 20. A figure's value is that of all runs taken as one.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.shares import RESAMPLES, SEED, share
from heliograph_services.cli.studies.study import Figure

# second of camera time -> bin -> how many
Histogram = dict[str, dict[str, int]]
LEAST_MS, STEP = 0.1, 1.05
# 95 %
BOUNDS: Final = (0.025, 0.975)
# Student's t, .975, by the number of values.
T_975: Final[Mapping[int, float]] = {
    2: 12.706, 3: 4.303, 4: 3.182, 5: 2.776, 6: 2.571, 7: 2.447, 8: 2.365, 9: 2.306, 10: 2.262,
}  # fmt: skip


def between(values: Sequence[float]) -> tuple[float, float]:
    """Return what the mean of all such runs lies between; nan for fewer than two values.

    Raises:
        KeyError: more than ten values.
    """
    if len(values) < 2:
        return math.nan, math.nan
    half = T_975[len(values)] * statistics.stdev(values) / math.sqrt(len(values))
    mean = statistics.fmean(values)
    return mean - half, mean + half


def histogram(latencies: Sequence[tuple[float, int]]) -> Histogram:
    """Return, by second of camera time, how many of (latency in s, camera time in us) fall in each bin of 5 %."""
    out: Histogram = {}
    for late_s, t_us in latencies:
        number = max(0, math.floor(math.log(max(1e3 * late_s, LEAST_MS) / LEAST_MS) / math.log(STEP)))
        second = out.setdefault(str(t_us // 1_000_000), {})
        second[str(number)] = second.get(str(number), 0) + 1
    return out


def latency(runs: Sequence[Histogram], q: float) -> Figure:
    """Return a quantile of latencies, ms; within its bin by rank, as though the bin were filled evenly."""
    runs = [run for run in runs if run]
    if not runs:
        return Figure(None)
    bins = 1 + max(int(i) for run in runs for second in run.values() for i in second)
    tables = [np.zeros((len(run), bins)) for run in runs]
    for table, run in zip(tables, runs, strict=True):
        for row, second in enumerate(run.values()):
            for i, n in second.items():
                table[row, int(i)] = n

    every = np.vstack(tables)
    k = len(every)
    drawn = np.random.Generator(np.random.Philox(SEED)).multinomial(k, np.full(k, 1.0 / k), RESAMPLES)
    low, high = np.quantile(_quantile(drawn @ every, q), BOUNDS)
    reach = between([math.log(float(_quantile(table.sum(axis=0), q))) for table in tables])
    value = float(_quantile(every.sum(axis=0), q))
    return _figure(value, (float(low), float(high)), (math.exp(reach[0]), math.exp(reach[1])), int(every.sum()), "ms")


def _quantile(counts: npt.NDArray[np.float64], q: float) -> npt.NDArray[np.float64]:
    """Return (...) quantiles, ms, of (..., bins) counts."""
    below = np.cumsum(counts, axis=-1)
    rank = q * below[..., -1:]
    at = (below < rank).sum(axis=-1, keepdims=True)
    inside = np.take_along_axis(counts, at, -1)
    part = 1.0 - (np.take_along_axis(below, at, -1) - rank) / inside
    out: npt.NDArray[np.float64] = LEAST_MS * STEP ** (at + part)[..., 0]
    return out


def acquisition(runs: Sequence[Sequence[float | None]], q: float) -> Figure:
    """Return a quantile of acquisition times, ms; without a bound where that is later than all.

    Args:
        runs: ms of each appearance; None: never.
        q: which.
    """
    times = [np.sort([math.inf if ms is None else ms for ms in run]) for run in runs if run]
    if not times:
        return Figure(None)
    every = np.sort(np.concatenate(times))
    n = len(every)
    value = _order_statistic(every, q)
    if math.isinf(value):
        return Figure(None, n=n)
    shares = np.cumsum([math.comb(n, k) * q**k * (1 - q) ** (n - k) for k in range(n + 1)])
    first, last = (int(np.searchsorted(shares, bound)) for bound in BOUNDS)
    # An order statistic beyond the last is unknown: no bound.
    orders = float(every[max(first - 1, 0)]), float(every[last]) if last < n else math.inf
    of_run = [_order_statistic(one, q) for one in times]
    known = [math.log(ms) for ms in of_run if math.isfinite(ms)]
    reach = between(known)
    if len(known) < len(of_run):
        # A run in which that share was never identified: later than anything.
        reach = (min(known, default=math.nan), math.inf)
    return _figure(value, orders, (math.exp(reach[0]), math.exp(reach[1])), n, "ms")


def _order_statistic(times: npt.NDArray[np.float64], q: float) -> float:
    # The first whose share reaches q, beside rounding.
    return float(times[max(0, math.ceil(q * len(times) - 1e-9) - 1)])


def of_runs(runs: Sequence[npt.NDArray[np.int64]]) -> Figure:
    """Return a share.

    Args:
        runs: (k, 2) of each run: blocks of how many there are, and how many of them count.
    """
    rows = np.vstack([np.zeros((0, 2), np.int64), *runs])
    found = Figure.of(share(rows[:, 1], rows[:, 0]))
    if found.value is None or found.low is None or found.high is None:
        return found
    sums = [run.sum(axis=0) for run in runs]
    low, high = between([right / n for n, right in sums if n])
    low, high = _wider((found.low, found.high), (max(0.0, low), min(1.0, high)))
    return Figure(found.value, round(low, 5), round(high, 5), found.n)


def quotient(part: Sequence[float], whole: Sequence[float], digits: int, unit: str = "") -> Figure:
    """Return sum(part) / sum(whole), not below 0, of (k,) runs each; n is their number.

    Args:
        part: of each run.
        whole: of each run, none 0.
        digits: behind the point.
        unit: of the quotient.
    """
    if not part:
        return Figure(None, unit=unit)
    value = round(sum(part) / sum(whole), digits)
    low, high = between([one / n for one, n in zip(part, whole, strict=True)])
    if math.isnan(low):
        return Figure(value, n=len(part), unit=unit)
    return Figure(value, round(max(0.0, low), digits), round(high, digits), len(part), unit)


def _wider(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    """Return the lower low and the higher high; nan counts as none."""
    return float(np.fmin(one[0], other[0])), float(np.fmax(one[1], other[1]))


def _figure(value: float, one: tuple[float, float], other: tuple[float, float], n: int, unit: str) -> Figure:
    low, high = _wider(one, other)
    return Figure(_short(value), _short(low), None if math.isinf(high) else _short(high), n, unit)


def _short(value: float) -> float:
    return float(f"{value:.3g}")
