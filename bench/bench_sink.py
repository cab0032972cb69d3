"""Ten thousand frames a second into the metrics sink: what was published is what is in the file, or it is told.

Real processes: router, sink, and one that stands in the decoder's place and publishes `frames/cam0` as a decoder of
20 tracks would, a window a millisecond, 20 `ids` at 10 Hz each and `link` at 1 Hz, at the pace of a live camera (never
faster; what it could not send in time it sends at once). It counts what it published, and so does its numbering on
the bus. After it has ended and the sink has been stopped, the file must hold as many frames::

    lost = published - counted in the file        missing, dropped: what the sink itself reported

`cpu_share` is the sink's, from its own reports; `behind_s` the most that the publisher was late.

Run: OMP_NUM_THREADS=1 python bench/bench_sink.py [--seconds 60] [--frames-s 10000] [-o FILE] (about .6 cores)
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

sys.path[:0] = [str(Path(__file__).parents[1] / "tests")]

from heliograph.messages import Frames, Health, Link  # noqa: E402
from heliograph.shell.bus import connected  # noqa: E402
from heliograph.shell.links import client_config  # noqa: E402
from heliograph.shell.process import Stop  # noqa: E402
from heliograph.shell.site import BusLinks  # noqa: E402
from heliograph_services.metrics_sink.summary import summarise  # noqa: E402
from support.processes import Collector, Host, collecting, free_port  # noqa: E402
from support.truth_scenes import state  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "sink.json"
TRACKS: Final = 20
WINDOW_US: Final = 1_000
SITE: Final = """
site = "sink"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "metrics_sink"
file = "metrics.sqlite"
"""


def frames_of(window: int, each: int) -> Frames:
    """Return a window's message, with so many frames."""
    tracks = [(window * each + i) % TRACKS for i in range(each)]
    t1_us = (window + 1) * WINDOW_US
    return Frames(
        camera="cam0",
        t0_us=t1_us - WINDOW_US,
        t1_us=t1_us,
        t_us=[t1_us - 500] * each,
        track=[f"t-{track}" for track in tracks],
        protocol=["seed11"] * each,
        beacon=[f"beacon{track}" for track in tracks],
        payload=tracks,
        x_px=[30.0 * track for track in tracks],
        y_px=[100.0] * each,
        score=[0.99] * each,
        refused={"parity": 1} if window % 10 == 0 else {},
    )


def publish(port: int, seconds: float, frames_s: float) -> None:
    """Stand in the decoder's place; print what was published as JSON."""
    links = BusLinks(connect=(f"tcp/127.0.0.1:{port}",), shared_memory=False)
    each = round(frames_s * WINDOW_US / 1e6)
    windows, behind_s = round(seconds * 1e6 / WINDOW_US), 0.0
    with connected(client_config(links), "sink", "decoder/decoder", Stop()) as bus:
        assert bus is not None
        # Zenoh tells a router of a new key a moment after it is declared.
        bus.publish(frames_of(0, 0))
        time.sleep(1.0)
        began_s = time.monotonic()
        for window in range(1, windows + 1):
            ahead_s = began_s + window * WINDOW_US / 1e6 - time.monotonic()
            behind_s = max(behind_s, -ahead_s)
            if ahead_s > 0:
                time.sleep(ahead_s)
            bus.publish(frames_of(window, each))
            t_us = window * WINDOW_US
            for track in range(TRACKS) if window % 100 == 0 else ():
                change = "accepted" if window == 100 else "refreshed"
                bus.publish(state(t_us, change, f"beacon{track}", f"t-{track}", 100_000, track, x_px=30.0 * track))
            for track in range(TRACKS) if window % 1000 == 0 else ():
                bus.publish(
                    Link(camera="cam0", track=f"t-{track}", t_us=t_us, protocol="seed11", bit_rate=5e3, snr_db=20.0,
                         jitter_us=10.0, clock_ppm=0.0, events_per_transition=30.0, mar_estimate=0.99)
                )  # fmt: skip
        # What is on its way must leave before the session does.
        time.sleep(1.0)
        print(json.dumps({"frames": windows * each, "messages": bus.published["frames"], "behind_s": round(behind_s, 3),
                          "took_s": round(time.monotonic() - began_s - 1.0, 2)}))  # fmt: skip


def waits(heard: Collector) -> float:
    """Return how many messages wait in the sink's queues, as it last said."""
    reports = [m for m in heard.messages["health"] if isinstance(m, Health) and m.service == "metrics_sink"]
    return reports[-1].gauges.get("queue", 0.0)


def run(seconds: float, frames_s: float) -> dict[str, Any]:
    """Return what was published, what was kept, and what the sink said of itself."""
    with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as name:
        folder, port = Path(name), free_port()
        host = Host(folder, "sink", SITE.format(port=port), ["metrics_sink"])
        try:
            with collecting(port, "sink", ["health"]) as heard:
                heard.until(lambda h: len(h.messages["health"]) > 0, "the sink")
                command = [sys.executable, __file__, "--publish", str(port)]
                command += ["--seconds", str(seconds), "--frames-s", str(frames_s)]
                told = subprocess.run(command, check=True, capture_output=True, text=True, timeout=seconds + 120)
                n = len(heard.messages["health"])
                heard.until(lambda h: len(h.messages["health"]) > n + 4 and waits(h) == 0, "the end of its queue")
            statuses = host.close()
        finally:
            host.close()
        published = json.loads(told.stdout.splitlines()[-1])
        reports = [m for m in heard.messages["health"] if isinstance(m, Health) and m.service == "metrics_sink"]
        kept = summarise(folder / "metrics.sqlite")
        busy = [m.cpu_share for m in reports if m.cpu_share > 0]
        return {
            "seconds": seconds,
            "frames_s": frames_s,
            "published": published,
            "kept_frames": kept.frames,
            "kept_seconds": kept.seconds,
            "lost": published["frames"] - kept.frames,
            "late": kept.late,
            "missing": reports[-1].counters.get("missing: frames", 0),
            "dropped": {k: v for k, v in reports[-1].counters.items() if k.startswith("dropped") and v},
            "received": reports[-1].counters.get("received: frames", 0),
            "refused": kept.refused,
            "sightings": len(kept.sightings),
            "cpu_share": {"median": sorted(busy)[len(busy) // 2], "most": max(busy)},
            "queue_most": max(int(m.gauges.get("queue", 0)) for m in reports),
            "latency_ms": {hop.hop: [hop.p50_ms, hop.p95_ms, hop.p99_ms] for hop in kept.hops},
            "file_kb": round((folder / "metrics.sqlite").stat().st_size / 1e3),
            "exit": statuses["metrics_sink"],
        }


def main() -> int:
    """Measure, print and store; return 1 where a frame was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--frames-s", type=float, default=10_000.0)
    parser.add_argument("--publish", type=int, metavar="PORT", help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    if args.publish:
        publish(args.publish, args.seconds, args.frames_s)
        return 0
    result = {"evidence": "simulated", "machine": platform.machine(), "python": platform.python_version()}
    result |= run(args.seconds, args.frames_s)
    args.output.write_text(json.dumps(result, indent=1) + "\n")
    print("\n".join(f"{name}: {value}" for name, value in result.items()))
    return 1 if result["lost"] else 0


if __name__ == "__main__":
    sys.exit(main())
