"""Memory of tracker and decoder over ten minutes of camera time, as real processes: in lockstep as fast as it goes, or
live (`--live`, at the camera's pace).

The scene "five", 10 s of it, played again and again: at each seam all beacons leap, so that tracks and receivers are
made and let go of. Resident memory (VmRSS) is read every 30 s of camera time; the slope is that of a least-squares line
through the readings from the second minute on. Flat means: the line rises by less than FLAT_KB_MIN.

Zenoh 1.10 keeps some kB of each key that was ever declared (heliograph.shell.bus): `ids` of each identified track.
So the keys that were seen are counted beside.

Run: OMP_NUM_THREADS=1 python bench/bench_memory.py [--minutes 10] [--live]
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

import live_scenes  # noqa: E402

from heliograph.messages import Health, Identification, Progress  # noqa: E402
from support.processes import Collector, Host, collecting, free_port  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "memory.json"
SEED, SCENE_S, EVERY_S = 1, 10.0, 30.0
# 100 kB a minute are 144 MB a day.
FLAT_KB_MIN: Final = 100.0
WATCHED: Final = ("tracker", "decoder")
SITE: Final = """
site = "memory"
lockstep = {lockstep}
[bus]
connect = ["tcp/127.0.0.1:{port}"]
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "event_source"
backend = "recording"
file = "{file}"
loop = true
duration_s = {seconds}
wait_for = ["tracker", "decoder"]
await_s = 60.0
[[service]]
kind = "tracker"
[[service]]
kind = "decoder"
protocol = "seed11"
bit_rate = 1000
"""


def rss_kb(pid: int) -> int:
    """Return a process's resident memory."""
    found = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) if found else 0


def done_us(heard: Collector) -> int:
    """Return the camera time that both services are through with."""
    last = dict.fromkeys(WATCHED, 0)
    for message in reversed(heard.messages["progress"][-200:]):
        if isinstance(message, Progress) and not last.get(message.service, 1):
            last[message.service] = message.t_us
    return min(last.values())


def run(minutes: float, *, live: bool) -> dict[str, Any]:
    """Return the readings and what they say."""
    seconds = 60.0 * minutes
    readings: list[dict[str, float]] = []
    named: set[str] = set()
    with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as name:
        folder = Path(name)
        file = folder / "scene.npz"
        live_scenes.write_recording(file, live_scenes.events_of("five", SEED, SCENE_S), 640, 480)
        port = free_port()
        site = SITE.format(port=port, file=file, seconds=seconds, lockstep="false" if live else "true")
        host = Host(folder, "memory", site, [*WATCHED, "event_source"])
        try:
            with collecting(port, "memory", ["progress", "health", "ids"]) as heard:
                heard.until(lambda h: len(h.messages["ids"]) > 0, "an identity")
                start_s = time.monotonic()
                for at_s in np.arange(EVERY_S, seconds - 1.0, EVERY_S):
                    if live:
                        time.sleep(max(0.0, start_s + at_s - time.monotonic()))
                    else:
                        heard.until(lambda h, at=at_s: done_us(h) >= at * 1e6, f"{at_s:g} s", 1_800)
                    row = {"camera_s": float(at_s)}
                    row |= {f"{kind}_kb": rss_kb(host.processes[kind].pid) for kind in WATCHED}
                    readings.append(row)
                    named |= {m.track for m in heard.messages["ids"] if isinstance(m, Identification)}
                    row["tracks_identified"] = len(named)
                    # The client's own lists must not grow for ten minutes.
                    for topic in heard.messages:
                        del heard.messages[topic][:-400], heard.when[topic][:-400]
                    print(row, flush=True)
                host.wait("event_source", 300)
                heard.until(lambda h: len(h.messages["health"]) > 0, "health")
                counters = {m.service: m.counters for m in heard.messages["health"] if isinstance(m, Health)}
        finally:
            host.close()
    result: dict[str, Any] = {"seed": SEED, "minutes": minutes, "live": live, "readings": readings}
    result["tracks_born"] = counters.get("tracker", {}).get("tracks_born", 0)
    for kind in WATCHED:
        chosen = [row for row in readings if row["camera_s"] >= 120.0] or readings
        t, kb = (np.array([row[key] for row in chosen]) for key in ("camera_s", f"{kind}_kb"))
        slope = float(np.polyfit(t / 60.0, kb, 1)[0]) if len(t) > 1 else 0.0
        growth = float(kb[-1] / kb[0] - 1.0)
        result[kind] = {
            "first_kb": int(kb[0]),
            "last_kb": int(kb[-1]),
            "slope_kb_a_minute": round(slope, 1),
            "growth": round(growth, 4),
            "flat": slope < FLAT_KB_MIN,
        }
    return result


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--live", action="store_true", help="at the camera's pace, without lockstep")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    result = {"evidence": "simulated", "machine": platform.machine(), "python": platform.python_version()}
    result |= run(args.minutes, live=args.live)
    args.output.write_text(json.dumps(result, indent=1) + "\n")
    print({kind: result[kind] for kind in WATCHED})


if __name__ == "__main__":
    main()
