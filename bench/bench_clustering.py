"""Clustering of one window: the grid against scikit-learn, on the same events.

Corpus: 640 x 480 pixels; five discs of radius 3 px that hold a tenth of the events, the rest uniform noise; numpy's
PCG64 with the printed seed. Timed: from raw events (one entry each) to labels of distinct pixels, median of the runs
after one that is not counted; scikit-learn gets the distinct pixels with weights, as fast as it can be asked, without
the time to count them, and must give the same labels. Its larger runs are left out where they would take minutes.

Run: python bench/bench_clustering.py [--seed 1] [--runs 15]
"""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt
from sklearn.cluster import DBSCAN

from heliograph_services.tracker.clustering import Active, Clusterer

Pixels = npt.NDArray[np.uint16]
Counts = npt.NDArray[np.uint8]

WIDTH, HEIGHT = 640, 480
EPS_PX, MIN_EVENTS = 2.0, 5
SIZES = (1_000, 10_000, 100_000, 1_000_000)
# Every pixel of the sensor is active at 1M events, and scikit-learn's neighbour lists fill gigabytes.
SKLEARN_LIMIT = 100_000


def corpus(n: int, rng: np.random.Generator) -> tuple[Pixels, Pixels]:
    """Return x, y of n events, shuffled."""
    n_disc = n // 10
    centre = np.array([[100, 100], [300, 80], [500, 200], [200, 350], [450, 400]])[rng.integers(0, 5, n_disc)]
    angle, radius = rng.uniform(0, 2 * np.pi, n_disc), 3 * np.sqrt(rng.random(n_disc))
    x = np.concatenate([centre[:, 0] + radius * np.cos(angle), rng.integers(0, WIDTH, n - n_disc)])
    y = np.concatenate([centre[:, 1] + radius * np.sin(angle), rng.integers(0, HEIGHT, n - n_disc)])
    order = rng.permutation(n)
    return np.rint(x[order]).astype(np.uint16), np.rint(y[order]).astype(np.uint16)


def median_ms(run: Callable[[], object], runs: int) -> float:
    """Return the median of some runs, the first not counted."""
    run()
    took = []
    for _ in range(runs):
        start = time.perf_counter()
        run()
        took.append(time.perf_counter() - start)
    return 1e3 * statistics.median(took)


def by_grid(
    clusterer: Clusterer, x: Pixels, y: Pixels, on: Counts, off: Counts
) -> tuple[Active, npt.NDArray[np.int32]]:
    """Return the distinct pixels and their labels."""
    active = clusterer.distinct(x, y, on, off, np.zeros(len(x), np.int64))
    return active, clusterer.labels(active)[0]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=15)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    print(f"{platform.machine()}, Python {platform.python_version()}, seed {args.seed}, median of {args.runs} runs")
    print(f"{'events':>8} {'pixels':>7} {'grid ms':>8} {'sklearn ms':>11} {'ratio':>6}")
    clusterer = Clusterer(WIDTH, HEIGHT, EPS_PX, MIN_EVENTS)
    for n in SIZES:
        x, y = corpus(n, rng)
        on, off = np.ones(n, np.uint8), np.zeros(n, np.uint8)
        ours = median_ms(partial(by_grid, clusterer, x, y, on, off), args.runs)
        active, labels = by_grid(clusterer, x, y, on, off)
        theirs, ratio = "", ""
        if n <= SKLEARN_LIMIT:
            xy = np.stack([active.x_px, active.y_px], axis=1).astype(np.float64)
            model = DBSCAN(eps=EPS_PX, min_samples=MIN_EVENTS)
            took = median_ms(partial(model.fit, xy, sample_weight=active.on), args.runs)
            if (model.labels_ != labels).any():
                raise SystemExit(f"labels differ for {n} events")
            theirs, ratio = f"{took:.2f}", f"{took / ours:.0f}"
        print(f"{n:>8} {len(active):>7} {ours:>8.2f} {theirs:>11} {ratio:>6}")


if __name__ == "__main__":
    main()
