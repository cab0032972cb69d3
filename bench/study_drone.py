"""The paper's drone study: what is read from the air, by whom, and what the optical flow is worth.

    python bench/study_drone.py [--scene NAME ...] [--first 1000] [--n 3] [--seconds 20] [--arms NAME ...]
        [-o bench/results/drone.json] [--summary]

`construction_site` with the paper's numbers: seed11 at 50 bit/s, a camera 28 m high that flies a rectangle at 10 m/s
and turns by 0.5 rad/s all the while, f = 3.6 mm; eight assets, six noise beacons and what hides them are the built-in
scenario's. Scenes: `drone`; `sun`, the same from `construction_site_sun_moving`; `handheld`, the built-in one. All
beacons send seed11, a new payload for every frame (docs/metrics.md), so no track is ever confirmed by a second frame.

Who reads (the same events for all):

    both, centroid, none     our tracker, its `prediction`; `both` with our network, l_tau 0
    flow_0, flow_5, flow_9   the flow's velocity alone: our network without memory, and with l_tau .5 and .9
    literal                  the same with the network as the paper says it: 10 executions at 10 Hz, l_tau .5
    paper                    the whole of the paper's way: windows of one bit (in 100 ms no light that moves is
                             round), its shape ratio and L1 cost, the literal flow, the receiver `paper`
    paper_receiver           our tracker (`centroid`) before the paper's receiver
    genie                    our receiver along the true paths

MAR_sent, visible and in view, with 95 % intervals: bootstrap over run x beacon x 1 s; and the paired difference to
`centroid`. K = 1. A run is stored as soon as it is done, and a study goes on where it was broken off, unless the code
has changed. Evidence: simulated (`live`). The paper's own figures are from another simulator: quoted, not ranked.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heliograph.core import Core
from heliograph.messages import Frames
from heliograph.shares import difference, share
from heliograph.truth import Truth
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.genie import Genie
from heliograph_services.cli.studies.paths import true_paths
from heliograph_services.cli.studies.running import Setting, opened
from heliograph_services.cli.studies.verdicts import RIGHT, WRONG, sent_frames, verdicts
from heliograph_services.decoder.__main__ import SERVICE as DECODER
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core, warm

STUDY = "drone/1"
ROOT = Path(__file__).parents[1]
SCENARIOS = ROOT / "services/heliograph_services/event_source/simulation/world/scenarios"
BIT_RATE = 50.0
FLOW: dict[str, Any] = {"flow": "numba", "prediction": "flow"}
PAPER: dict[str, Any] = {**FLOW, "flow_reading": "paper", "flow_l_tau": 0.5}
TRACKERS: dict[str, dict[str, Any]] = {
    "both": {"flow": "numba", "prediction": "both"},
    "centroid": {"prediction": "centroid"},
    "none": {"prediction": "none"},
    "flow_0": FLOW,
    "flow_5": {**FLOW, "flow_l_tau": 0.5},
    "flow_9": {**FLOW, "flow_l_tau": 0.9},
    "literal": PAPER,
    "paper": {**PAPER, "cluster_window_us": 20_000, "shape": "paper", "cost": "l1"},
    "paper_receiver": {"prediction": "centroid"},
}
RECEIVERS = {"paper": "paper", "paper_receiver": "paper"}
ARMS = (*TRACKERS, "genie")
QUOTED = {
    "with optical flow, 28 m, 50 bit/s": {"MAR": 0.74, "BAR": 0.75},
    "without optical flow, 28 m, 50 bit/s": {"MAR": 0.71, "BAR": 0.72},
}
# Four sides of 24 and 12 m at 10 m/s; a turn at 0.5 rad/s takes 12.566 s.
FLIGHT = """[camera.path]
kind = "waypoints"
smooth_s = 0.5
points = [[0, -12, -6, 28], [2.4, 12, -6, 28], [3.6, 12, 6, 28], [6.0, -12, 6, 28], [7.2, -12, -6, 28]]
[camera.attitude]
points = [[0, 0, -90, 0], [12.566, 360, -90, 0]]
"""


def scenario(scene: str) -> str:
    """Return the text of a scene, every beacon with seed11 at 50 bit/s (`handheld`: its own rate), payloads fresh."""
    name = {"drone": "construction_site", "sun": "construction_site_sun_moving", "handheld": "handheld"}[scene]
    text = (SCENARIOS / f"{name}.toml").read_text()
    if scene != "handheld":
        old = re.compile(r"\[camera\.path\].*?(?=^\[(?!camera\.path|camera\.attitude))", re.DOTALL | re.MULTILINE)
        text = old.sub(FLIGHT, text)
    head, *beacons = text.split("[[beacon]]")
    last, *after = beacons[-1].split("[[clutter]]")
    beacons[-1] = last
    for i, beacon in enumerate(beacons):
        kept = [
            line
            for line in beacon.splitlines()
            if not re.match(r"(protocol|options|payload|text|gap_bits|fresh|bit_rate) *=", line)
        ]
        rate = 1000.0 if scene == "handheld" else BIT_RATE
        beacons[i] = "\n".join([*kept, 'protocol = "seed11"', f"bit_rate = {rate:g}", "fresh = true", ""])
    return "".join([head, *("[[beacon]]" + one for one in beacons), *("[[clutter]]" + one for one in after)])


def run(scene: str, seed: int, seconds: float, arms: tuple[str, ...]) -> dict[str, Any]:
    """Run a scene before all arms; return the counts of frames by beacon and second."""
    rate = 1000.0 if scene == "handheld" else BIT_RATE
    setting = Setting(scenario(scene), seed, seconds, source={"fidelity": "live"})
    said: dict[str, list[Frames]] = {arm: [] for arm in arms}
    cpu_s = dict.fromkeys(("source", *arms), 0.0)
    truths: list[Truth] = []
    with tempfile.TemporaryDirectory() as folder, opened(setting, Path(folder)) as stream:
        camera = stream.camera
        if not isinstance(camera, SimulatedCamera):
            raise TypeError("the camera must be simulated")
        paths = true_paths(camera.scene, round((seconds + 0.01) * 1e6))
        systems: dict[str, Any] = {}
        for arm in arms:
            if arm == "genie":
                systems[arm] = Genie(paths)
                continue
            decoder = DecoderConfig(protocol="seed11", bit_rate=rate, receiver=RECEIVERS.get(arm, "default"))
            tracker: Core = make_core(TrackerConfig(**TRACKERS[arm]), ONE_PROCESS)
            systems[arm] = Pipeline(tracker, DECODER.make(decoder, ONE_PROCESS))
        began_s = time.process_time()
        for step in stream:
            cpu_s["source"] += time.process_time() - began_s
            truths += [message for message in step.messages if isinstance(message, Truth)]
            for arm, system in systems.items():
                began_s = time.process_time()
                whole = [step.messages] if isinstance(system, Pipeline) else step.messages
                said[arm] += [out for part in whole for out in system.feed(part) if isinstance(out, Frames)]
                cpu_s[arm] += time.process_time() - began_s
            began_s = time.process_time()
    sent = sent_frames(truths, paths)
    row: dict[str, Any] = {"scene": scene, "seed": seed, "seconds": seconds, "arms": list(arms)}
    found = {arm: verdicts(sent, frames, paths) for arm, frames in said.items()}
    for name, of in (("visible", sent.visible), ("in_view", sent.in_view)):
        row[name] = blocks(sent.beacon[of], sent.t1_us[of], [found[arm].outcome[of] for arm in arms])
    row["published"] = {arm: [one.published, one.insertions] for arm, one in found.items()}
    return row | {"cpu_s": {name: round(took, 1) for name, took in cpu_s.items()}}


def blocks(beacon: Any, t1_us: Any, outcomes: list[npt.NDArray[np.int8]]) -> list[list[int]]:
    """Return, by beacon and second: both, frames sent, and right and wrong ones of each arm."""
    key, at = np.unique(np.stack([beacon, t1_us // 1_000_000], axis=1), axis=0, return_inverse=True)
    columns = [np.bincount(at.reshape(-1), minlength=len(key))]
    for outcome in outcomes:
        columns += [np.bincount(at.reshape(-1)[outcome == what], minlength=len(key)) for what in (RIGHT, WRONG)]
    return [[*map(int, name), *map(int, counts)] for name, *counts in zip(key, *columns, strict=True)]


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of each scene."""
    out: dict[str, Any] = {}
    for scene in dict.fromkeys(row["scene"] for row in rows):
        mine = [row for row in rows if row["scene"] == scene]
        arms = [arm for arm in mine[0]["arms"] if all(arm in row["arms"] for row in mine)]
        told: dict[str, Any] = {"runs": len(mine), "seeds": [row["seed"] for row in mine]}
        for arm in arms:
            told[arm] = {}
            for name in ("visible", "in_view"):
                whole = [block[2] for row in mine for block in row[name]]
                right, wrong, base = (
                    [block[3 + 2 * row["arms"].index(one) + what] for row in mine for block in row[name]]
                    for one, what in ((arm, 0), (arm, 1), ("centroid", 0))
                )
                told[arm][name] = share(right, whole).row()
                told[arm][name + "_wrong"] = int(sum(wrong))
                told[arm][name + "_beside_centroid"] = difference(right, base, whole).row()
            seconds = sum(row["seconds"] for row in mine)
            told[arm]["cores"] = round(sum(row["cpu_s"][arm] for row in mine) / seconds, 2)
        out[scene] = told
    return out


def table(told: dict[str, Any]) -> str:
    """Return the figures of a scene as lines."""

    def words(one: dict[str, Any]) -> str:
        return f"{one['value']:.3f} [{one['low']:.3f} {one['high']:.3f}]" if one["n"] else "-"

    lines = [f"{'':15}{'visible':24}{'in view':24}{'in view, minus centroid':28}wrong cores"]
    for arm, one in told.items():
        if isinstance(one, dict):
            cells = "".join(f"{words(one[name]):24}" for name in ("visible", "in_view"))
            beside = f"{words(one['in_view_beside_centroid']):28}"
            lines.append(f"{arm:15}{cells}{beside}{one['in_view_wrong']:5} {one['cores']:5.2f}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path, default=ROOT / "bench/results/drone.json")
    parser.add_argument("--scene", nargs="+", default=["drone"], choices=["drone", "sun", "handheld"])
    parser.add_argument("--arms", nargs="+", default=list(ARMS), choices=ARMS)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--n", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--summary", action="store_true")
    args = parser.parse_args()
    asked = ["git", "-C", str(ROOT), "rev-parse", "HEAD", "HEAD:services", "HEAD:common"]
    at, *code = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()
    stored = json.loads(args.o.read_text()) if args.o.exists() else {}
    rows = stored.get("rows", []) if args.summary or stored.get("code") == code else []
    if not args.summary:
        warm(flow="numba")
        arms = tuple(dict.fromkeys(("centroid", *args.arms)))
        done = {(row["scene"], row["seed"], row["seconds"], tuple(row["arms"])) for row in rows}
        for scene in args.scene:
            for seed in range(args.first, args.first + args.n):
                if (scene, seed, args.seconds, arms) in done:
                    continue
                began_s = time.monotonic()
                rows.append(run(scene, seed, args.seconds, arms))
                print(f"{scene} {seed}: {time.monotonic() - began_s:.0f} s, {rows[-1]['cpu_s']}", flush=True)
                save(args.o, at, code, rows)
    for scene, told in summary(rows).items():
        print(f"\n{scene}: runs {told['runs']}, seeds {told['seeds']}\n{table(told)}")


def save(path: Path, commit: str, code: list[str], rows: list[dict[str, Any]]) -> None:
    """Write what there is."""
    result = {
        "study": STUDY, "evidence": "simulated", "fidelity": "live", "commit": commit, "code": code,
        "hardware or other simulators (published)": QUOTED, "figures": summary(rows), "rows": rows,
    }  # fmt: skip
    path.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
