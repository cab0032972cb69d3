"""What a decoder reads of a scene during which its core is slow for two seconds, by what a full queue drops.

    python bench/bench_overload.py [-o bench/results/overload.json]       three minutes of one core

Sixteen lights at 2 kbit/s, six lit at a time (the scene of `heliograph evaluate distribution`, at twice its bit rate;
development seed 5, twelve seconds). The real core is fed through the real `Inbox` by a simulated clock: a message
arrives at its camera time, and keeps the core busy for the CPU time that it took, scaled so that the scene alone keeps
it busy for LOAD of the time. From 3 to 5 s the core is `slow` times as slow; `for good` is slow from 3 s on. The queue
holds a second of events, as a live site's.

    oldest   a full queue drops its oldest message
    all      a full queue drops all that waits (`heliograph.shell.inbox`)

    mar      frames read right / frames sent whole within the view, of the four moving lights; median of RUNS
    dropped  messages of 10 ms of events; of that run

Evidence: simulated.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from heliograph.core import Core
from heliograph.messages import Frames, Message
from heliograph.shell.inbox import Inbox, Sample
from heliograph_services.cli import decode
from heliograph_services.cli.pipeline import Pipeline
from heliograph_services.cli.studies.distribution import blocks
from heliograph_services.cli.studies.distribution_scene import SENSOR, Scene, scene
from heliograph_services.cli.studies.verdicts import verdicts
from heliograph_services.event_source.cameras.formats.npz import write_npz

RESULT: Final = Path(__file__).parent / "results" / "overload.json"
SEED, SECONDS_S, BIT_RATE = 5, 12.0, 2_000
LOAD: Final = 0.75
SLOW_FROM_S, SLOW_TO_S = 3.0, 5.0
# (how many times as slow, for good)
SLOW: Final = ((1.0, False), (2.0, False), (3.0, False), (4.0, False), (1.5, True))
POLICIES: Final = {"oldest": frozenset[str](), "all": frozenset({"events"})}
# Of messages of 10 ms: a second.
QUEUE: Final = 100
RUNS: Final = 3


@dataclass(frozen=True)
class Reading:
    """What came of a case, its median run."""

    slow: float
    for_good: bool
    drops: str
    mar: float
    dropped: int
    runs: list[float]


class Messages:
    """What a decoder is sent of the scene: events from the file, tracks from the tracker's core.

    Args:
        file: the scene.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self.all: list[Message] = []
        core, stream, pipeline = self._built()
        feed = core.feed

        def noted(message: Message) -> list[Message]:
            self.all.append(message)
            return feed(message)

        core.feed = noted  # type: ignore[method-assign]
        for step in stream:
            pipeline.feed(step.messages)
        self.scale = LOAD * SECONDS_S / self.cost_s()

    def _built(self) -> tuple[Core, Any, Pipeline]:
        flags = [str(self._file), "--protocol", "seed11", "--bit-rate", str(BIT_RATE)]
        stream, pipeline, cores = decode.build(decode.parser().parse_args(flags))
        return cores[1], stream, pipeline

    def core(self) -> Core:
        """Return a new decoder."""
        return self._built()[0]

    def cost_s(self) -> float:
        """Return how long a decoder takes for all of it."""
        core, before_s = self.core(), time.process_time()
        for message in self.all:
            core.feed(message)
        return time.process_time() - before_s


def played(messages: Messages, slow: float, for_good: bool, streams: frozenset[str]) -> tuple[list[Frames], int]:
    """Return the frames that a decoder reads behind such a queue, and how many messages it drops."""
    inbox = Inbox({"events": QUEUE, **dict.fromkeys({m.SCHEMA for m in messages.all} - {"events"}, 4096)}, streams)
    core = messages.core()
    frames: list[Frames] = []
    now_s, sent = 0.0, 0
    while True:
        while sent < len(messages.all) and messages.all[sent].time_us / 1e6 <= now_s:
            # The inbox never looks into a payload.
            inbox.put(Sample(messages.all[sent].SCHEMA, "k", sent.to_bytes(4, "big"), 0))
            sent += 1
        sample = inbox.get(0.0)
        if sample is None:
            if sent == len(messages.all):
                return frames, sum(inbox.dropped.values())
            now_s = messages.all[sent].time_us / 1e6
            continue
        before_s = time.process_time()
        out = core.feed(messages.all[int.from_bytes(sample.payload, "big")])
        took_s = (time.process_time() - before_s) * messages.scale
        is_slow = now_s >= SLOW_FROM_S and (for_good or now_s < SLOW_TO_S)
        now_s += took_s * (slow if is_slow else 1.0)
        frames += [message for message in out if isinstance(message, Frames)]


def mar(seen: Scene, frames: list[Frames]) -> float:
    """Return the share of the moving lights' frames that were read right."""
    rows = blocks(seen.sent, verdicts(seen.sent, frames, seen.paths).outcome)
    return sum(row[3] for row in rows) / sum(row[2] for row in rows)


def reading(seen: Scene, messages: Messages, slow: float, for_good: bool, drops: str) -> Reading:
    """Return the median run of a case."""
    runs = []
    for _ in range(RUNS):
        frames, dropped = played(messages, slow, for_good, POLICIES[drops])
        runs.append((round(mar(seen, frames), 4), dropped))
    middle = statistics.median_low([share for share, _ in runs])
    dropped = next(n for share, n in runs if share == middle)
    return Reading(slow, for_good, drops, middle, dropped, [share for share, _ in runs])


def main() -> None:
    """Read all cases, print and store them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=RESULT)
    arguments = parser.parse_args()
    seen = scene(SEED, SECONDS_S, BIT_RATE)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.npz"
        write_npz(file, *SENSOR, [seen.events])
        messages = Messages(file)
        out = []
        for slow, for_good in SLOW:
            for drops in POLICIES:
                one = reading(seen, messages, slow, for_good, drops)
                print(f"{slow:g} times{' for good' if for_good else ''}, {drops}: {one.mar} {one.runs}", flush=True)
                out.append(asdict(one))
    text = json.dumps({"seed": SEED, "load": LOAD, "readings": out}, indent=1)
    arguments.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
