"""What simulating costs: processor seconds a simulated second on one core, memory, and the time to the first event.

    python bench/bench_simulation.py [-o bench/results/simulation.json]

Corpora (seed 11; each in a process of its own, kernels in the cache; medians of 3 stretches of 1 s after a first .2 s):

    moving      10 beacons at 2 kbit/s, DVXplorer Mini (VARIABLE_5000), 3.6 mm, 28 m above the ground of the
                construction site, to and fro at 10 m/s: it moves at 143 px/s                     goal: at most 0.8
    moving-live the same at fidelity "live"
    rough       as moving, over ground of finer grain and more contrast: 4 million crossings a second
    aer         20 beacons at 5 kbit/s, IMX636, plain ground                                      goal: at most 1.0
    crowd-N     N = 10, 20, 50, 100, 200 beacons at 2 kbit/s, IMX636, plain ground                goal: linear in N
    empty       still textured ground with its noise, DVXplorer Mini
    night       the shipped scenario

`first_event_s` is from the start of the process to the first piece of the stream (goal: under 3 s), `memory_mb` the
process's largest resident size (goal: under 500 MB).
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

SEED = 11
STRETCHES = 3
SKIP_US = 200_000
GROUND = """
[ground]
texture = "site"
contrast = 1.25
grain_m = 3.0
"""
ROUGH = """
[ground]
texture = "site"
contrast = 1.5
grain_m = 1.0
"""
MOVING = """
irradiance_w_m2 = 100.0
[camera]
sensor = "dvxplorer_mini"
path = { kind = "shuttle", from_m = [-6.0, 0.0, 28.0], to_m = [6.0, 0.0, 28.0], speed_m_s = 10.0, turn_s = 0.1 }
[[crowd]]
count = 10
protocol = "seed11"
bit_rate = 2000
area_m = [-14.0, -14.0, 14.0, 14.0]
"""
STILL = """
irradiance_w_m2 = 100.0
[camera]
sensor = "dvxplorer_mini"
path = { kind = "still", at_m = [0.0, 0.0, 28.0] }
"""
CROWD = """
irradiance_w_m2 = 2.0
[camera]
sensor = "imx636"
path = {{ kind = "still", at_m = [0.0, 0.0, 8.0] }}
[[crowd]]
count = {count}
protocol = "{protocol}"
bit_rate = {bit_rate}
area_m = [-6.0, -3.2, 6.0, 3.2]
speed_m_s = 0.3
options = {options}
"""


def corpora() -> dict[str, tuple[str, str]]:
    """Return scenario (text or name) and fidelity of each corpus."""
    found = {
        "moving": (MOVING + GROUND, "full"),
        "moving-live": (MOVING + GROUND, "live"),
        "rough": (MOVING + ROUGH, "full"),
        "aer": (CROWD.format(count=20, protocol="seed11", bit_rate=5000, options="{}"), "full"),
        "empty": (STILL + GROUND, "full"),
        "night": ("night", "full"),
    }
    for count in (10, 20, 50, 100, 200):
        text = CROWD.format(count=count, protocol="code", bit_rate=2000, options='{ codebook = "code20d4" }')
        found[f"crowd-{count}"] = (text, "full")
    return found


def one(name: str) -> dict[str, Any]:
    """Measure a corpus in this process."""
    start = time.perf_counter()
    from heliograph_services.event_source.simulation.stream import SceneStream  # noqa: PLC0415 - its time counts
    from heliograph_services.event_source.simulation.world.load import load_scenario, parse_scenario  # noqa: PLC0415

    text, fidelity = corpora()[name]
    scenario = parse_scenario(text, name) if "\n" in text else load_scenario(text)
    stream = SceneStream(scenario, SEED, fidelity)  # type: ignore[arg-type]
    first_s, until_us, events, took = None, SKIP_US, 0, []
    counted, begun = 0, 0.0
    for piece in stream:
        if first_s is None:
            first_s = time.perf_counter() - start
        events += len(piece.batch)
        if piece.until_us >= until_us:
            now = time.process_time()
            if until_us > SKIP_US:
                took.append(now - begun)
            if len(took) == STRETCHES:
                break
            counted, begun = (counted or events), now
            until_us += 1_000_000
    return {
        "corpus": name,
        "cpu_s_a_s": round(statistics.median(took), 3),
        "events_s": round((events - counted) / STRETCHES),
        "lights": len(stream.world.lights),
        "first_event_s": round(first_s or 0.0, 2),
        "memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path)
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--only", nargs="*", default=list(corpora()))
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(one(arguments.one)))
        return
    rows = []
    for name in arguments.only:
        said = subprocess.run([sys.executable, __file__, "--one", name], check=True, capture_output=True, text=True)
        rows.append(json.loads(said.stdout))
        print(*(f"{key} {value}" for key, value in rows[-1].items()), sep="  ", flush=True)
    if arguments.o is not None:
        result = {"seed": SEED, "evidence": "simulated", "rows": rows}
        arguments.o.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
