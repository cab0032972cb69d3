"""The tracker's fast backends beside the reference ones, in one run, on the same input and to the same answer.

Clustering: 640 x 480 pixels; five discs of radius 3 px that hold a tenth of the events, the rest uniform noise. The
grid is timed from raw events (one entry each) to labels of distinct pixels; scikit-learn gets the distinct pixels with
weights, without the time to count them, and must give the same labels. Its run of 1M events is one, after none.

Filters: 1000 tracks predicted by 5 ms and updated, each with a position of its own. Beside the batched filters: a loop
over 1000 `filterpy.kalman.KalmanFilter` objects that keep their matrices from call to call, as filterpy is meant to be
used, and the reference backend, which takes the tracker's table apart and puts it together again. All three must agree
to 1e-9 after the runs.

A window: 1000 blinking discs of radius 2 px on 1280 x 720 pixels, all of them published tracks; one call of the
follower from entries to updated tracks, with predictions, clustering, shapes, gates, assignment and life; the batched
parts of it, "assign + update", from targets to updated tracks.

The flow network: a tick of the same 1000 discs, all pixels active, which move on by a pixel each tick; every spike is
asked for. Beside the kernel: the torch backend, which must give the same spikes.

numpy's PCG64 with the printed seed; median of the runs after one that is not counted; one thread.

Run: OMP_NUM_THREADS=1 python bench/bench_backends.py [--seed 1] [--runs 15]
"""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from filterpy.kalman import KalmanFilter

from heliograph_services.tracker import association, backends, kalman
from heliograph_services.tracker.association import Candidates, Gate
from heliograph_services.tracker.clustering import Active
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import COUNTERS, warm
from heliograph_services.tracker.flow.kernel import make_runtime
from heliograph_services.tracker.flow.network import DELAY_LIMIT, paper_network
from heliograph_services.tracker.flow.spikes import Runtime
from heliograph_services.tracker.follower import GridFollower, Numbers
from heliograph_services.tracker.motion import NoMotion
from heliograph_services.tracker.reference import flow as torch_flow
from heliograph_services.tracker.reference import kalman as reference
from heliograph_services.tracker.windows import Window

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]

FAST = TrackerConfig()
SLOW = TrackerConfig(clustering="scikit-learn", kalman="filterpy")
SIZES = (10_000, 100_000, 1_000_000)
TRACKS = 1_000
DT_S, Q, NO_LIMIT_PX_S = 0.005, 9_000.0, 1e30
WINDOW_US = 5_000
# Rows and columns of the discs, and their spacing: none touches another.
COLUMNS, SPACING_PX = 40, 28
# Windows until all discs have names, blinking from one to the next.
NAMED_AFTER = 8


def median_ms(run: Callable[[], object], runs: int) -> float:
    """Return the median of some runs, one more not counted unless there is only one."""
    took = []
    for _ in range(runs + (runs > 1)):
        start = time.perf_counter()
        run()
        took.append(time.perf_counter() - start)
    return 1e3 * statistics.median(took[runs > 1 :])


def row(what: str, ours_ms: float, theirs_ms: float, note: str = "") -> None:
    """Print a line of the table."""
    print(f"{what:<47} {ours_ms:>9.3f} {theirs_ms:>12.2f} {theirs_ms / ours_ms:>6.0f}  {note}".rstrip())


def corpus(n: int, rng: np.random.Generator) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint16]]:
    """Return x, y of n events, shuffled."""
    n_disc = n // 10
    centre = np.array([[100, 100], [300, 80], [500, 200], [200, 350], [450, 400]])[rng.integers(0, 5, n_disc)]
    angle, radius = rng.uniform(0, 2 * np.pi, n_disc), 3 * np.sqrt(rng.random(n_disc))
    x = np.concatenate([centre[:, 0] + radius * np.cos(angle), rng.integers(0, 640, n - n_disc)])
    y = np.concatenate([centre[:, 1] + radius * np.sin(angle), rng.integers(0, 480, n - n_disc)])
    order = rng.permutation(n)
    return np.rint(x[order]).astype(np.uint16), np.rint(y[order]).astype(np.uint16)


def clustering(rng: np.random.Generator, runs: int) -> None:
    """Time DBSCAN."""
    size = {"width": 640, "height": 480, "eps_px": FAST.eps_px, "min_events": FAST.min_events}
    ours, theirs = (backends.chosen(config).clustering(**size) for config in (FAST, SLOW))
    for n in SIZES:
        x, y = corpus(n, rng)
        on, off = np.ones(n, np.uint8), np.zeros(n, np.uint8)

        def whole(x: Any = x, y: Any = y, on: Any = on, off: Any = off) -> tuple[Active, npt.NDArray[np.int32]]:
            active = ours.distinct(x, y, on, off, np.zeros(len(x), np.int64))
            return active, ours.labels(active)[0]

        took = median_ms(whole, runs)
        active, labels = whole()
        reference_runs = runs if n < SIZES[-1] else 1
        beside = median_ms(partial(theirs.labels, active), reference_runs)
        if (theirs.labels(active)[0] != labels).any():
            raise SystemExit(f"labels differ for {n} events")
        row(f"cluster {n} events, {len(active)} pixels", took, beside, f"n = {runs} | {reference_runs}")


def filters(rng: np.random.Generator, runs: int) -> None:
    """Time the prediction and update of many tracks."""
    state = rng.normal(300, 100, (TRACKS, 4))
    cov = np.tile([1.0, 0.0, 1e4, 1.0, 0.0, 1e4], (TRACKS, 1))
    z, r = state[:, :2] + rng.normal(0, 1, (TRACKS, 2)), rng.uniform(0.1, 2.0, (TRACKS, 2))
    rows = np.arange(TRACKS)
    objects = []
    for i in range(TRACKS):
        f = KalmanFilter(dim_x=4, dim_z=2)
        f.x, f.P, f.H, f.R = state[i].reshape(4, 1).copy(), reference.matrix(cov[i]), np.eye(2, 4), np.diag(r[i])
        f.F = np.eye(4) + DT_S * np.eye(4, k=2)
        f.Q = Q * reference.matrix(np.tile([DT_S**3 / 3, DT_S**2 / 2, DT_S], 2))
        objects.append(f)
    column = z[:, :, None]

    def step(module: Any, x: Floats, p: Floats) -> None:
        module.predict(x, p, DT_S, Q)
        module.update(x, p, rows, z, r, NO_LIMIT_PX_S)

    def loop() -> None:
        for i, f in enumerate(objects):
            f.predict()
            f.update(column[i])

    theirs, their_cov = state.copy(), cov.copy()
    took = median_ms(partial(step, kalman, state, cov), runs)
    row(f"predict, update {TRACKS} tracks: filterpy's objects", took, median_ms(loop, runs), f"n = {runs}")
    backend = median_ms(partial(step, reference, theirs, their_cov), runs)
    row(f"predict, update {TRACKS} tracks: our backend of it", took, backend, f"n = {runs}")
    by_objects = np.stack([f.x[:, 0] for f in objects])
    for found in (theirs, by_objects):
        np.testing.assert_allclose(found, state, rtol=1e-9, atol=1e-9)


def discs(rng: np.random.Generator) -> tuple[Longs, Longs, Floats]:
    """Return x, y of all pixels of the discs, and the (n, 2) centres."""
    at = np.arange(TRACKS)
    centre = np.stack([at % COLUMNS, at // COLUMNS], axis=1) * SPACING_PX + 20.0 + rng.uniform(-4, 4, (TRACKS, 2))
    yy, xx = np.mgrid[0:720, 0:1280]
    pixel_x, pixel_y = [], []
    for cx, cy in centre:
        part = (slice(int(cy) - 4, int(cy) + 6), slice(int(cx) - 4, int(cx) + 6))
        inside = (xx[part] - cx) ** 2 + (yy[part] - cy) ** 2 <= 4.0
        pixel_x.append(xx[part][inside])
        pixel_y.append(yy[part][inside])
    return np.concatenate(pixel_x), np.concatenate(pixel_y), centre


def window_of(x: Longs, y: Longs, index: int) -> Window:
    """Return the window in which all discs go on (even) or off (odd)."""
    # A switched light passes two thresholds in a pixel, at least: one that passes a single one may be an edge.
    count = np.full(len(x), 2, np.uint8)
    none = np.zeros(len(x), np.uint8)
    on, off = (count, none) if index % 2 == 0 else (none, count)
    start_us = index * WINDOW_US
    places = x.astype(np.uint16), y.astype(np.uint16)
    return Window(start_us, start_us + WINDOW_US, *places, on, off, np.zeros(len(x), np.int64), WINDOW_US)


def windows(rng: np.random.Generator, runs: int) -> None:
    """Time a whole window of many beacons, and the assignment and update within it."""
    x, y, centre = discs(rng)
    took = []
    for config in (FAST, SLOW):
        many = TrackerConfig(clustering=config.clustering, kalman=config.kalman, max_tracks=2 * TRACKS)
        follower = GridFollower(
            many, backends.chosen(many), NoMotion(), width=1280, height=720, pool_px=1, window_us=WINDOW_US,
            tick_us=WINDOW_US, numbers=Numbers(), counters=dict.fromkeys(COUNTERS, 0), refusals=Counter(),
        )  # fmt: skip
        for index in range(NAMED_AFTER):
            follower.step(window_of(x, y, index))
        named = int(follower.table.named.sum())
        if named != TRACKS or len(follower.table) != TRACKS:
            raise SystemExit(f"{named} tracks of {TRACKS} discs")
        coming = iter([window_of(x, y, index) for index in range(NAMED_AFTER, NAMED_AFTER + runs + 1)])
        took.append(median_ms(lambda follower=follower, coming=coming: follower.step(next(coming)), runs))
    row(f"a window of {TRACKS} beacons, {len(x)} pixels", *took, f"n = {runs}")
    state = np.concatenate([centre, np.zeros((TRACKS, 2))], axis=1)
    cov = np.tile([1.0, 0.0, 1e4, 1.0, 0.0, 1e4], (TRACKS, 1))
    full = np.full(TRACKS, 13.0)
    rows = np.arange(TRACKS)
    gate = Gate(FAST.gate_chi2, FAST.gate_px, FAST.measurement_noise_px, WINDOW_US * 1e-6, "l2")
    z = centre + rng.normal(0, 0.3, (TRACKS, 2))
    r = np.full((TRACKS, 2), 0.09)

    def whole(module: Any) -> None:
        xs, ps = state.copy(), cov.copy()
        module.predict(xs, ps, DT_S, Q)
        targets = Candidates(z[:, 0].copy(), z[:, 1].copy(), full, np.zeros(TRACKS), np.ones(TRACKS, np.bool_))
        chosen = association.assign(xs, ps, np.full(TRACKS, 2.0), full, rows, targets, gate)
        module.update(xs, ps, rows, z[chosen], r, NO_LIMIT_PX_S)

    parts = [median_ms(partial(whole, module), runs) for module in (kalman, reference)]
    row(f"  predict, assign, update {TRACKS} tracks", *parts, f"n = {runs}")


def network(rng: np.random.Generator, runs: int) -> None:
    """Time a tick of the flow network."""
    x, y, _ = discs(rng)
    took: list[float] = []
    fired: list[list[tuple[Longs, ...]]] = []
    for make in (make_runtime, torch_flow.runtime):
        runtime: Runtime = make(paper_network(), 1280, 720)
        spikes: list[tuple[Longs, ...]] = []
        each = []
        for tick in range(DELAY_LIMIT + 1 + runs):
            start = time.perf_counter()
            found = runtime.step((x + tick) % 1280, y)
            # Histories are full by then.
            if tick > DELAY_LIMIT:
                each.append(time.perf_counter() - start)
            spikes.append((found.x.copy(), found.y.copy(), found.k.copy()))
        took.append(1e3 * statistics.median(each))
        fired.append(spikes)
    for ours, theirs in zip(*fired, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a, b)
    row(f"a tick of the flow network, {len(x)} pixels", *took, f"n = {runs}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=15)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    warm(FAST.clustering, FAST.kalman)
    warm(SLOW.clustering, SLOW.kalman)
    print(f"{platform.machine()}, Python {platform.python_version()}, seed {args.seed}, median of n runs")
    print(f"{'':<47} {'fast ms':>9} {'reference ms':>12} {'ratio':>6}")
    clustering(rng, args.runs)
    filters(rng, args.runs)
    windows(rng, args.runs)
    network(rng, args.runs)


if __name__ == "__main__":
    main()
