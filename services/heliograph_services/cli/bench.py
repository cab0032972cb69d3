"""`heliograph bench decode`: how many events a second this machine reads, and what each stage takes of a core.

The corpus (bench_corpus.py) is made before the clock starts. Source, tracker and decoder run as `heliograph decode`
runs them: in one process, one thread, in lockstep. Each repeat has fresh cores; kernels are warm. A stage's time is
the processor time of its `feed`, so that other work on the machine does not count; end to end is the whole loop, whose
wall time is told, too. Figures are medians over the repeats; *core share* is processor time over the camera's time:
below 1, one core keeps up with such a camera.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from heliograph.errors import ConfigError
from heliograph.messages import Identification, Message

if TYPE_CHECKING:
    from heliograph.core import Core
    from heliograph_services.cli.bench_corpus import Corpus, Texture

SEED: Final = 11
# Density in Mev/s and texture. The last is there to show what clutter costs: each piece that looks like a beacon is
# followed, and listened to.
CORPORA: Final[tuple[tuple[float, Texture], ...]] = ((1.0, "contours"), (10.0, "contours"), (1.0, "fragments"))
# What the project promises end to end, on the machine that the README names.
GOAL_MEV_S: Final = 5.0
STAGES: Final = ("source", "tracker", "decoder", "end to end")


class Stage(msgspec.Struct, frozen=True):
    """One line of the result.

    Args:
        name: of STAGES.
        seconds: of processor time, median over the repeats.
        mev_s: events of the corpus over it, in millions a second.
        core_share: it over the camera's time.
    """

    name: str
    seconds: float
    mev_s: float
    core_share: float


class Result(msgspec.Struct, frozen=True):
    """One corpus, measured.

    Args:
        rate_mev_s: its density.
        texture: of its background.
        seed: its seed.
        events: how many.
        camera_s: of the camera's time.
        repeats: how often.
        stages: in the order of STAGES.
        wall_s: end to end by the clock on the wall, median.
        identified: names of the beacons that were identified, so that a fast wrong answer is seen.
        tracks: how many tracks there ever were.
    """

    rate_mev_s: float
    texture: str
    seed: int
    events: int
    camera_s: float
    repeats: int
    stages: list[Stage]
    wall_s: float
    identified: list[str]
    tracks: int


class _Timed:
    """A core whose `feed` is timed."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self.refusals = core.refusals
        self.counters = core.counters
        self.gauges = core.gauges
        self.seconds = 0.0

    def feed(self, message: Message) -> list[Message]:
        start = time.thread_time()
        out = self._core.feed(message)
        self.seconds += time.thread_time() - start
        return out

    def ready(self, message: Message) -> bool:
        return self._core.ready(message)

    def tick(self, now_us: int) -> list[Message]:
        return self._core.tick(now_us)


class Once(msgspec.Struct, frozen=True):
    """One repeat: seconds by stage, and what came out."""

    seconds: tuple[float, float, float, float]
    wall_s: float
    identified: tuple[str, ...]
    tracks: tuple[str, ...]


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    if argv and argv[0] == "link":
        from heliograph_services.cli.bench_link import run as run_link  # noqa: PLC0415 - numba, not needed here

        return run_link(argv[1:])
    parser = argparse.ArgumentParser(prog="heliograph bench", description=__doc__)
    parser.add_argument("what", choices=("decode", "link"), help="link: `heliograph bench link --help`")
    parser.add_argument("--json", action="store_true", help="one JSON object a corpus")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="camera time of a corpus (default: 2)")
    parser.add_argument("--repeat", type=int, default=5, metavar="R", help="repeats (default: 5)")
    parser.add_argument("--rate", type=float, metavar="MEV_S", help="one corpus of this density, in Mev/s")
    parser.add_argument("--texture", choices=("contours", "fragments"), default="contours", help="with --rate")
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help=f"of the corpus (default: {SEED})")
    arguments = parser.parse_args(argv)
    corpora = CORPORA if arguments.rate is None else ((arguments.rate, arguments.texture),)
    _check("--seconds", arguments.seconds, 0.1, 60.0)
    _check("--repeat", arguments.repeat, 1, 100)
    _check("--seed", arguments.seed, 0, 2**32 - 1)
    for rate, _ in corpora:
        _check("--rate", rate, 0.5, 50.0)
    _warm()
    machine = this_machine()
    if not arguments.json:
        print(", ".join(f"{name} {value}" for name, value in machine.items()))
    for rate, texture in corpora:
        result = measure(rate, texture, arguments.seconds, arguments.repeat, arguments.seed)
        line = json.dumps({"type": "bench", **msgspec.to_builtins(result), "machine": machine})
        print(line if arguments.json else table(result), flush=True)
    return 0


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ConfigError(f"{name} must be in [{low:g}, {high:g}], not {value:g}")


def measure(rate_mev_s: float, texture: Texture, seconds: float, repeats: int, seed: int) -> Result:
    """Return the medians of a corpus."""
    from heliograph_services.cli.bench_corpus import make_corpus  # noqa: PLC0415 - numpy, not needed for --help

    corpus = make_corpus(rate_mev_s * 1e6, seconds, seed, texture)
    runs = [once(corpus) for _ in range(repeats)]
    stages = []
    for i, name in enumerate(STAGES):
        median_s = statistics.median(each.seconds[i] for each in runs)
        rate = corpus.events / median_s / 1e6
        stages.append(Stage(name, round(median_s, 4), round(rate, 2), round(median_s / corpus.seconds, 4)))
    return Result(
        rate_mev_s=rate_mev_s,
        texture=texture,
        seed=seed,
        events=corpus.events,
        camera_s=corpus.seconds,
        repeats=repeats,
        stages=stages,
        wall_s=round(statistics.median(each.wall_s for each in runs), 4),
        identified=sorted(set(runs[0].identified)),
        tracks=len(set(runs[0].tracks)),
    )


def once(corpus: Corpus) -> Once:
    """Return the times of one pass with fresh cores."""
    from heliograph_services.cli.bench_corpus import BEACONS, HEIGHT, WIDTH  # noqa: PLC0415
    from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline  # noqa: PLC0415
    from heliograph_services.decoder.config import DecoderConfig  # noqa: PLC0415
    from heliograph_services.decoder.core import make_core as make_decoder  # noqa: PLC0415
    from heliograph_services.event_source.config import EventSourceConfig  # noqa: PLC0415
    from heliograph_services.event_source.core import CameraInfo, SourceCore  # noqa: PLC0415
    from heliograph_services.tracker.config import TrackerConfig  # noqa: PLC0415
    from heliograph_services.tracker.core import make_core as make_tracker  # noqa: PLC0415

    source = SourceCore(EventSourceConfig(), CameraInfo(WIDTH, HEIGHT))
    tracker = _Timed(make_tracker(TrackerConfig(), ONE_PROCESS))
    decoder = _Timed(make_decoder(DecoderConfig(beacons=BEACONS), ONE_PROCESS))
    pipeline = Pipeline(tracker, decoder)
    out: list[Message] = []
    source_s = 0.0
    wall, start = time.perf_counter(), time.thread_time()
    for window in corpus.windows:
        before = time.thread_time()
        messages = source.feed(window)
        source_s += time.thread_time() - before
        out += pipeline.feed(messages)
    whole_s, wall_s = time.thread_time() - start, time.perf_counter() - wall
    names = tuple(m.beacon for m in out if isinstance(m, Identification) and m.change == "accepted")
    tracks = tuple(name for m in out if m.SCHEMA == "tracks" for name in getattr(m, "track", ()))
    return Once((source_s, tracker.seconds, decoder.seconds, whole_s), wall_s, names, tracks)


def _warm() -> None:
    from heliograph import onsets  # noqa: PLC0415 - numba, not needed for --help
    from heliograph_services.decoder import core as decoder  # noqa: PLC0415
    from heliograph_services.tracker import core as tracker  # noqa: PLC0415

    for module in (onsets, tracker, decoder):
        module.warm()
    # The first pass through fresh kernels loads caches that no warm() knows of.
    measure(1.0, "contours", 0.3, 1, SEED)


def this_machine() -> dict[str, Any]:
    """Return what a figure depends on."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{name: _version(name) for name in ("heliograph", "numpy", "numba")},
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    found = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return found[0] if found else platform.machine()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def table(result: Result) -> str:
    """Return a result for people, at most 80 columns wide."""
    head = (
        f"\n{result.rate_mev_s:g} Mev/s, {result.texture}: {result.events} events in {result.camera_s:g} s"
        f" (camera), seed {result.seed}, median of {result.repeats}"
    )
    lines = [head, f"  {'stage':<12}{'seconds':>10}{'Mev/s':>10}{'core share':>12}"]
    lines += [f"  {s.name:<12}{s.seconds:>10.3f}{s.mev_s:>10.2f}{s.core_share:>12.3f}" for s in result.stages]
    lines.append(f"  end to end by the wall clock: {result.wall_s:.3f} s")
    lines.append(f"  identified: {', '.join(result.identified) or 'none'} (of 5); tracks: {result.tracks}")
    verdict = "reached" if result.stages[-1].mev_s >= GOAL_MEV_S else "missed"
    # With few events the beacons' own decoding is the load, and events a second say little.
    if result.rate_mev_s >= GOAL_MEV_S:
        lines.append(f"  goal of {GOAL_MEV_S:g} Mev/s end to end: {verdict}")
    return "\n".join(lines)
