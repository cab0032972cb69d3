# ruff: noqa: SLF001 - the stages are timed where they are called
"""What the tracker costs: kernels beside other people's, whole scenes in one process, and as real processes.

Kernels (one thread, medians, all of one run): a tick of the flow network on 10k and 100k clustered active pixels beside
a dense torch convolution (`bench_flow`), 1M events clustered beside scikit-learn (once, to the same labels), 1000
tracks updated beside a loop over filterpy's objects (`bench_backends`).

Scenes, a camera second each, by the thread's processor time around the calls (median of the last seconds):

    site        construction_site, full fidelity          site-live   the same, live
    busy        5 Mev/s at the sensor: half noise, moving texture, 20 beacons at 2 kbit/s

`gating` is the source's count, gate and budget of onsets (also with the ticks of deploy/sites/onboard.toml), `source`
all of its core, `packing` what making the onsets' records for the wire takes besides; the tracker is timed as shipped
and with the flow network (`network`: all calls of its motion). It is live and without a decoder: nothing is ever
called valid. `stages` are the shares of the tracker's time by file (cProfile: kernels count where they are called
from; with its own overhead).

Processes: the busy scene's recording and the site's, played at real time by a source, with router and tracker; their
processor time from /proc over the seconds after the first.

Run: OMP_NUM_THREADS=1 python bench/bench_tracker.py [kernels] [scenes] [processes] [--seconds 4]
"""

from __future__ import annotations

import argparse
import cProfile
import dataclasses
import json
import os
import platform
import pstats
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

import live_scenes  # noqa: E402

from heliograph.core import Context  # noqa: E402
from heliograph.onsets import warm as warm_onsets  # noqa: E402
from heliograph.streams import Onsets  # noqa: E402
from heliograph.wire import pack_body  # noqa: E402
from heliograph_services.event_source.cameras.contract import Window  # noqa: E402
from heliograph_services.event_source.config import EventSourceConfig  # noqa: E402
from heliograph_services.event_source.core import CameraInfo, SourceCore  # noqa: E402
from heliograph_services.tracker.config import TrackerConfig  # noqa: E402
from heliograph_services.tracker.core import make_core, warm  # noqa: E402

RESULT = Path(__file__).parent / "results" / "tracker_cost.json"
SEED = 1
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "site": ("construction_site", {}),
    "site-live": ("construction_site", {"fidelity": "live"}),
    "busy": (live_scenes.busy(), {}),
}
# As shipped, and with all that the flow network can do for it.
TRACKERS = {
    "tracker": TrackerConfig(),
    "tracker_with_network": TrackerConfig(flow="numba", prediction="both"),
}
# The first second warms caches, gates and births.
SKIPPED_S = 1.0
LIVE = Context(instance="bench", boot="bench", lockstep=False)


# ---- kernels ---------------------------------------------------------------------------------------------------------


def kernels() -> dict[str, Any]:
    """Return medians and ratios of the three kernels."""
    return {"flow_tick": flow_ticks(), "clustering": clustering(), "tracks": thousand_tracks()}


def flow_ticks(ticks: int = 30) -> list[dict[str, Any]]:
    """Return a row for each number of active pixels: the network's tick beside a dense convolution."""
    import bench_flow  # noqa: PLC0415 - imports torch where it runs

    network = bench_flow.paper_network()
    rows = []
    for n in (10_000, 100_000):
        frames = list(bench_flow.blobs(n, ticks, SEED))
        row: dict[str, Any] = {"active_pixels": round(statistics.mean(len(x) for x, _ in frames))}
        runtimes = {
            "network": bench_flow.WordRuntime(network, bench_flow.WIDTH, bench_flow.HEIGHT),
            "dense_torch": bench_flow.Dense(network),
        }
        spikes = {}
        for name, runtime in runtimes.items():
            took, counts = [], []
            for x, y in frames:
                start = time.perf_counter()
                out = runtime.step(x, y)
                took.append(time.perf_counter() - start)
                counts.append(out if isinstance(out, int) else len(out))
            # The network's memory is full after twelve ticks.
            row[f"{name}_ms"] = round(1e3 * statistics.median(took[12:]), 3)
            spikes[name] = counts
        if spikes["network"] != spikes["dense_torch"]:
            raise SystemExit(f"spikes differ at {n} active pixels")
        row |= {"n": ticks - 12, "ratio": round(row["dense_torch_ms"] / row["network_ms"], 1)}
        rows.append(row)
    return rows


def clustering(runs: int = 15) -> dict[str, Any]:
    """Return how long 1M events take from entries to labels, beside scikit-learn on the distinct pixels."""
    import bench_backends as peers  # noqa: PLC0415 - imports filterpy

    x, y = peers.corpus(1_000_000, np.random.default_rng(SEED))
    on, off = np.ones(len(x), np.uint8), np.zeros(len(x), np.uint8)
    tick = np.zeros(len(x), np.int64)
    size = {"width": 640, "height": 480, "eps_px": peers.FAST.eps_px, "min_events": peers.FAST.min_events}
    ours, theirs = (peers.backends.chosen(config).clustering(**size) for config in (peers.FAST, peers.SLOW))
    ours_ms = peers.median_ms(lambda: ours.labels(ours.distinct(x, y, on, off, tick)), runs)
    active = ours.distinct(x, y, on, off, tick)
    start = time.perf_counter()
    labels = theirs.labels(active)[0]
    theirs_ms = 1e3 * (time.perf_counter() - start)
    if (labels != ours.labels(active)[0]).any():
        raise SystemExit("labels differ")
    return {
        "events": len(x), "pixels": len(active), "grid_ms": round(ours_ms, 2), "n": runs,
        "sklearn_ms": round(theirs_ms, 1), "sklearn_n": 1, "ratio": round(theirs_ms / ours_ms, 1),
    }  # fmt: skip


def thousand_tracks(runs: int = 15) -> dict[str, Any]:
    """Return a whole window of 1000 beacons, and what the filters alone take, beside filterpy's objects."""
    import bench_backends as peers  # noqa: PLC0415

    rows: dict[str, tuple[float, float]] = {}

    def keep(what: str, ours_ms: float, theirs_ms: float, note: str = "") -> None:  # noqa: ARG001 - as peers.row
        rows[what.strip()] = ours_ms, theirs_ms

    shown, peers.row = peers.row, keep
    try:
        rng = np.random.default_rng(SEED)
        peers.filters(rng, runs)
        peers.windows(rng, runs)
    finally:
        peers.row = shown
    return {
        what: {"ours_ms": round(a, 3), "theirs_ms": round(b, 2), "ratio": round(b / a, 1), "n": runs}
        for what, (a, b) in rows.items()
    }


# ---- whole scenes in one process -------------------------------------------------------------------------------------


class Timed:
    """Stands before an object and adds up the thread's processor time of its methods, calls within calls once."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner
        self._depth = 0
        self.took_s = 0.0

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._inner, name)
        if not callable(found):
            return found

        def call(*given: Any, **named: Any) -> Any:
            start, self._depth = time.thread_time(), self._depth + 1
            try:
                return found(*given, **named)
            finally:
                self._depth -= 1
                if self._depth == 0:
                    self.took_s += time.thread_time() - start

        return call


# deploy/sites/onboard.toml: where a radio follows, and the source has the smaller computer.
ONBOARD_TICK_US: Final = 5_000


def recorded(name: str, seconds: float, **given: Any) -> tuple[list[Onsets], dict[str, Any]]:
    """Return a scene's onsets as its source, with the given settings, sends them, and what making them cost."""
    scenario, settings = SCENES[name]
    batches = live_scenes.events_of(scenario, SEED, seconds, **settings)
    config = EventSourceConfig(backend="simulated", window_us=20_000, max_events=1_000_000, **given)
    source = SourceCore(config, CameraInfo(640, 480))
    counter, budget = Timed(source._counter), Timed(source._budget)
    source._counter, source._budget = counter, budget
    warm_onsets()
    onsets: list[Onsets] = []
    whole_s, packing_s, packed = 0.0, 0.0, 0
    skipped = round(SKIPPED_S / 0.02)
    for i, batch in enumerate(batches):
        if i == skipped:
            whole_s = packing_s = counter.took_s = budget.took_s = 0.0
        t0_us, t1_us = i * 20_000, (i + 1) * 20_000
        start = time.thread_time()
        made = [m for m in source.feed(Window(t0_us, t1_us, batch, "bench")) if isinstance(m, Onsets)]
        middle = time.thread_time()
        packed += sum(len(pack_body(message)) for message in made)
        whole_s += middle - start
        packing_s += time.thread_time() - middle
        onsets += made
    per_s = 1.0 / (0.02 * max(1, len(batches) - skipped))
    return onsets, {
        "events_s": round(sum(map(len, batches)) / seconds),
        "entries_s": round(sum(len(m.tick) for m in onsets) / seconds),
        "packed_bytes_s": round(packed / seconds),
        "gating_core": round((counter.took_s + budget.took_s) * per_s, 3),
        "source_core": round(whole_s * per_s, 3),
        "packing_core": round(packing_s * per_s, 3),
        "source_counters": {name: n for name, n in source.counters.items() if n},
    }


def tracked(onsets: list[Onsets], config: TrackerConfig) -> dict[str, Any]:
    """Return what the tracker takes of a core, its worst second, and the network's part of it."""
    core = make_core(config, LIVE)
    motions: list[Timed] = []

    def motion(*given: Any, make: Any = core._backends.motion) -> Timed:
        motions.append(Timed(make(*given)))
        return motions[-1]

    core._backends = dataclasses.replace(core._backends, motion=motion)
    took: dict[int, list[float]] = {}
    for message in onsets:
        before, start = sum(one.took_s for one in motions), time.thread_time()
        core.feed(message)
        second = took.setdefault(message.t0_us // 1_000_000, [0.0, 0.0])
        second[0] += time.thread_time() - start
        second[1] += sum(one.took_s for one in motions) - before
    rows = [row for second, row in took.items() if second >= SKIPPED_S] or list(took.values())
    return {
        "core": round(statistics.median(row[0] for row in rows), 3),
        "worst_second": round(max(row[0] for row in rows), 3),
        "network_core": round(statistics.median(row[1] for row in rows), 3),
        "n_seconds": len(rows),
        "counters": {name: n for name, n in core.counters.items() if n},
    }


def stages(onsets: list[Onsets], config: TrackerConfig) -> tuple[dict[str, float], str]:
    """Return the shares of the tracker's time by file, and the functions that took most, as a table."""
    core = make_core(config, LIVE)
    profile = cProfile.Profile(time.thread_time)
    for message in onsets:
        profile.enable()
        core.feed(message)
        profile.disable()
    stats = pstats.Stats(profile)
    rows: list[tuple[str, str, int, float, float]] = []
    inside: dict[str, float] = {}
    for (file, _, function), (_, calls, own, total, callers) in stats.stats.items():  # type: ignore[attr-defined]
        place = Path(file).name
        if file.startswith("~") or "heliograph" not in file:
            # numpy's time is that of whoever asked it.
            for (caller, _, _), (_, _, its, _) in callers.items():
                inside[Path(caller).name] = inside.get(Path(caller).name, 0.0) + its
        else:
            inside[place] = inside.get(place, 0.0) + own
        rows.append((place, function, calls, own, total))
    total_s = sum(inside.values()) or 1.0
    shares = {
        name: round(s / total_s, 3) for name, s in sorted(inside.items(), key=lambda kv: -kv[1]) if s > 0.005 * total_s
    }
    camera_s = (onsets[-1].t1_us - onsets[0].t0_us) / 1e6
    lines = [f"{'file':22} {'function':34} {'calls/s':>9} {'own core':>9} {'with calls':>10}"]
    for place, function, calls, own, total in sorted(rows, key=lambda row: -row[3])[:30]:
        lines.append(
            f"{place:22} {function[:34]:34} {calls / camera_s:9.0f} {own / camera_s:9.4f} {total / camera_s:10.4f}"
        )
    return shares, "\n".join(lines)


def scenes(seconds: float, profile_to: Path | None) -> dict[str, Any]:
    """Return a row a scene: the source's part, and the tracker as it is shipped and with the network."""
    found: dict[str, Any] = {}
    text: list[str] = []
    for config in TRACKERS.values():
        warm(config.clustering, config.kalman, config.flow)
    for name in SCENES:
        onsets, row = recorded(name, seconds)
        row["gating_onboard_core"] = recorded(name, seconds, tick_us=ONBOARD_TICK_US)[1]["gating_core"]
        for arm, config in TRACKERS.items():
            row[arm] = tracked(onsets, config)
            row[arm]["stages"], table = stages(onsets, config)
            text += [f"## {name}, {arm}", json.dumps(row), "```", table, "```", ""]
        found[name] = row
        print(name, {k: v for k, v in row.items() if "counters" not in k and k not in TRACKERS}, flush=True)
        for arm in TRACKERS:
            print("   ", arm, {k: v for k, v in row[arm].items() if k not in ("counters", "stages")}, flush=True)
    if profile_to is not None:
        profile_to.write_text("\n".join(text))
    return found


# ---- real processes --------------------------------------------------------------------------------------------------

SITE = """
site = "cost"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
shared_memory = true
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "event_source"
backend = "recording"
file = "{file}"
loop = true
await_s = 60
wait_for = ["tracker"]
[[service]]
kind = "tracker"
"""


def cpu_s(pid: int) -> float:
    """Return the processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def processes(seconds: float) -> dict[str, Any]:
    """Return the cores that source and tracker take at real time, by scene."""
    from support.processes import Host, collecting, free_port  # noqa: PLC0415

    found: dict[str, Any] = {}
    for name in ("site-live", "busy"):
        scenario, settings = SCENES[name]
        with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as folder:
            file = Path(folder) / "scene.npz"
            live_scenes.write_recording(file, live_scenes.events_of(scenario, SEED, seconds, **settings), 640, 480)
            port = free_port()
            host = Host(Path(folder), "cost", SITE.format(port=port, file=file), ["tracker", "event_source"])
            try:
                with collecting(port, "cost", ["tracks", "health"]) as heard:
                    heard.until(lambda h: len(h.messages["tracks"]) > 10, "tracks")
                    before, since = {k: cpu_s(p.pid) for k, p in host.processes.items()}, time.monotonic()
                    at = heard.messages["tracks"][-1].time_us
                    heard.until(
                        lambda h, at=at: h.messages["tracks"][-1].time_us > at + 2e6 * seconds,
                        "two rounds",
                        60 + 6 * seconds,
                    )
                    passed = (heard.messages["tracks"][-1].time_us - at) / 1e6
                    after = {k: cpu_s(p.pid) for k, p in host.processes.items()}
                    late = (time.monotonic() - since) / passed
                    health = {m.service: m for m in heard.messages["health"]}  # type: ignore[attr-defined]
            finally:
                host.close()
        found[name] = {kind: round((after[kind] - before[kind]) / passed, 3) for kind in after} | {
            "camera_s": round(passed, 1),
            "wall_a_camera_s": round(late, 2),
            "dropped": {k: v for k, v in health["tracker"].counters.items() if "dropped" in k or "missing" in k},
        }
        print(name, found[name], flush=True)
    return found


def main() -> None:
    """Run the parts that are asked for, all without any; keep the others' stored results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", choices=["kernels", "scenes", "processes", []], default=[])
    parser.add_argument("--seconds", type=float, default=4.0, help="of camera time, of each scene")
    parser.add_argument("--profile", type=Path, default=None, help="write the scenes' profiles to this file")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    result = json.loads(args.output.read_text()) if args.output.exists() else {}
    parts = args.part or ["kernels", "scenes", "processes"]
    result["machine"] = {
        "machine": platform.machine(),
        "python": platform.python_version(),
        "seed": SEED,
        "threads": 1,
        "load_1min": round(os.getloadavg()[0], 1),
    }
    for part in parts:
        if part == "kernels":
            result[part] = kernels()
            print(json.dumps(result[part], indent=1))
        elif part == "scenes":
            result[part] = scenes(args.seconds, args.profile)
        else:
            result[part] = processes(args.seconds)
    args.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
