"""Noise alone, for longer than a test may take: what becomes of it, and what it costs, in one process in lockstep.

Uniform noise of both polarities on 640 x 480 pixels, gated as a source does by default. Counted: tracks that were born,
tracks that were valid at any time, identifications; the processor time of source, tracker and decoder a camera second.
Zero identifications in T hours bound their rate at 3 / T an hour (95 %).

Run: OMP_NUM_THREADS=1 python bench/bench_noise.py [--seconds 30] [--rates 1e6,3e6,5e6,1e7]
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections import Counter
from itertools import takewhile
from pathlib import Path
from typing import Any, Final

sys.path[:0] = [str(Path(__file__).parents[1] / "tests")]

from heliograph.core import Core  # noqa: E402
from heliograph.messages import Identification, Message, Tracks  # noqa: E402
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline  # noqa: E402
from heliograph_services.decoder.config import DecoderConfig  # noqa: E402
from heliograph_services.decoder.core import make_core as make_decoder  # noqa: E402
from heliograph_services.decoder.core import warm as warm_decoder  # noqa: E402
from heliograph_services.tracker.config import TrackerConfig  # noqa: E402
from heliograph_services.tracker.core import make_core as make_tracker  # noqa: E402
from heliograph_services.tracker.core import warm as warm_tracker  # noqa: E402
from support.noise import noise  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "noise.json"


class Timed:
    """A core whose processor time is added up."""

    def __init__(self, core: Core) -> None:
        self.core = core
        self.took_s = 0.0
        self.ready = core.ready

    def feed(self, message: Message) -> list[Message]:
        """Feed the core."""
        start = time.thread_time()
        out = self.core.feed(message)
        self.took_s += time.thread_time() - start
        return out


def run(events_hz: float, seconds: float, seed: int) -> dict[str, Any]:
    """Return what came of so much noise."""
    tracker = Timed(make_tracker(TrackerConfig(), ONE_PROCESS))
    decoder = Timed(make_decoder(DecoderConfig(bit_rate=2000.0), ONE_PROCESS))
    pipeline = Pipeline(tracker, decoder)  # type: ignore[arg-type]
    found: Counter[str] = Counter()
    valid: set[str] = set()
    for step in takewhile(lambda step: step.t1_us <= seconds * 1e6, noise(events_hz, seed)):
        for message in pipeline.feed(step.messages):
            if isinstance(message, Tracks):
                valid.update(n for n, word in zip(message.track, message.status, strict=True) if word == "valid")
                found["most_tracks"] = max(found["most_tracks"], len(message.track))
            found["identifications"] += isinstance(message, Identification)
    counters = tracker.core.counters
    return {
        "events_hz": events_hz,
        "camera_s": seconds,
        "seed": seed,
        "entries_s": round(counters["active_pixels"] / seconds),
        "windows": counters["windows"],
        "windows_flooded": counters["windows_flooded"],
        "tracks_born": counters["tracks_born"],
        "tracks_valid": len(valid),
        "identifications": found["identifications"],
        "most_tracks_at_once": found["most_tracks"],
        "tracker_core": round(tracker.took_s / seconds, 3),
        "decoder_core": round(decoder.took_s / seconds, 3),
    }


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rates", default="1e6,3e6,5e6,1e7")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    warm_tracker()
    warm_decoder()
    rows = []
    for rate in args.rates.split(","):
        rows.append(run(float(rate), args.seconds, args.seed))
        print(rows[-1], flush=True)
    result = {"evidence": "simulated", "machine": platform.machine(), "python": platform.python_version()}
    args.output.write_text(json.dumps(result | {"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
