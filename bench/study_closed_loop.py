"""The closed loop, whole: the decoder's `link` chooses the bit rate of a beacon whose light is its own firmware's.

    python bench/study_closed_loop.py [--seed N] [--open] [--far-m M] [--seconds S]

Everything in one process and in the scene's time: the firmware's core, compiled by the C compiler, makes the edges; the
simulator sees them from a camera that goes away and comes back; tracker and decoder read the events; the controller's
core hears `ids` and `link` as they are published, and talks to the beacon over its serial protocol. Printed each
second: distance, bit rate, and the frames sent and read in it. `--open` leaves the rate at the highest: what the loop
is to be compared with.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from heliograph.messages import Frames, Identification, Link  # noqa: E402 - `support` is found by the line above
from heliograph.site import Beacon  # noqa: E402
from heliograph_services.beacon_controller.config import BeaconControllerConfig  # noqa: E402
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline  # noqa: E402
from heliograph_services.decoder.config import DecoderConfig  # noqa: E402
from heliograph_services.decoder.core import make_core as make_decoder  # noqa: E402
from heliograph_services.event_source.config import EventSourceConfig  # noqa: E402
from heliograph_services.event_source.stream import open_stream  # noqa: E402
from heliograph_services.tracker.config import TrackerConfig  # noqa: E402
from heliograph_services.tracker.core import make_core as make_tracker  # noqa: E402
from support.lossy_line import UID, World, command, crane  # noqa: E402
from support.virtual_beacon import VirtualBeacon  # noqa: E402

LADDER = (250.0, 500.0, 1000.0, 2000.0)
BITS = 11
PAYLOAD = 42
# The light must be known ahead of the camera: by a chunk of the rendering and a window, at first by a second more.
AHEAD_S = 0.1
FIRST_S = 1.2
# Near, away, far, back, near: shares of the run at which each of them ends.
TURNS = (0.2, 0.35, 0.6, 0.75, 1.0)
SCENE = """
irradiance_w_m2 = 2.0
[camera]
sensor = "{sensor}"
path = {{ kind = "waypoints", points = [{points}], smooth_s = 1.0 }}
[[beacon]]
name = "crane"
protocol = "seed11"
bit_rate = 500
intensity_w_sr = {intensity}
edges = "{edges}"
path = {{ kind = "still", at_m = [0.05, 0.1, 0.0] }}
"""


def beacons() -> tuple[Beacon, ...]:
    """Return the site's list: the beacon, and once more for each other rung of the ladder."""
    others = (rate for rate in LADDER if rate != 500.0)
    seeds = [Beacon(name=f"crane.{r:g}", protocol="seed11", payload=PAYLOAD, bit_rate=r) for r in others]
    return (crane(bit_rate=500.0), *seeds)


class Loop:
    """Scene, receiver, controller and beacon, joined.

    Args:
        arguments: of the command line.
        folder: for the scene and the light's edges.
    """

    def __init__(self, arguments: argparse.Namespace, folder: Path) -> None:
        self.beacon = VirtualBeacon(folder, UID, 5)
        limits = {"adapt_min": LADDER[0], "adapt_max": LADDER[-1]}
        wanted = beacons() if not arguments.open else (crane(bit_rate=LADDER[-1]),)
        self.world = World(BeaconControllerConfig(beacons=wanted, adapt=not arguments.open, **limits))
        self.world.plug("a", self.beacon)
        self.world.ask(command("arm", lease_s=3600.0))
        edges = folder / "edges"
        os.mkfifo(edges)
        # Both ends are held by one process: it never writes more than a chunk's edges before they are read.
        self._fifo = os.open(edges, os.O_RDWR)
        self._pass(FIRST_S)
        scene = folder / "scene.toml"
        path = ", ".join(f"[{t}, 0, 0, {z}]" for t, z in journey(arguments))
        scene.write_text(SCENE.format(sensor=arguments.sensor, points=path, intensity=arguments.intensity, edges=edges))
        source = EventSourceConfig(
            backend="simulated", scenario=str(scene), duration_s=arguments.seconds, seed=arguments.seed, fidelity="live"
        )
        self.stream = open_stream(source, ONE_PROCESS)
        decoder = make_decoder(DecoderConfig(beacons=beacons()), ONE_PROCESS)
        self._pipeline = Pipeline(make_tracker(TrackerConfig(), ONE_PROCESS), decoder)

    def run(self) -> Any:
        """Yield (t_s, messages of the receiver) of each step."""
        for step in self.stream:
            heard = self._pipeline.feed(step.messages)
            for message in heard:
                if isinstance(message, Identification | Link):
                    self.world.core.feed(message, self.world.now_s)
            yield step.t1_us / 1e6, heard
            self._pass(step.t1_us / 1e6 + AHEAD_S)

    def _pass(self, until_s: float) -> None:
        """Let the controller and the beacon go on, and tell its light."""
        if until_s <= self.world.now_s:
            return
        self.world.run(until_s)
        lines = [f"{t_ns},{level}" for t_ns, level in self.beacon.edges()]
        os.write(self._fifo, "\n".join([*lines, f"# until {round(until_s * 1e9)}", ""]).encode())


def journey(arguments: argparse.Namespace) -> list[tuple[float, float]]:
    """Return the camera's distance at the turns: (s, m)."""
    near, far = arguments.near_m, arguments.far_m
    ends = (t * arguments.seconds for t in TURNS)
    return [(0.0, near), *zip(ends, (near, far, far, near, near), strict=True)]


def main() -> None:
    """Run the loop; print a line a second, and a summary as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=100.0)
    parser.add_argument("--near-m", type=float, default=4.0)
    parser.add_argument("--far-m", type=float, default=30.0)
    parser.add_argument("--intensity", type=float, default=0.01, help="of the LED, W/sr")
    parser.add_argument("--sensor", default="dvxplorer_mini")
    parser.add_argument("--open", action="store_true", help="the highest rate, whatever the link")
    arguments = parser.parse_args()
    times, distances = zip(*journey(arguments), strict=True)
    right = wrong = 0
    sent = 0.0
    rows: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        loop = Loop(arguments, Path(folder))
        for t_s, messages in loop.run():
            frames = [p for m in messages if isinstance(m, Frames) for p in m.payload]
            right += frames.count(PAYLOAD)
            wrong += len(frames) - frames.count(PAYLOAD)
            rate = loop.beacon.look().millirate / 1000
            sent += rate / BITS * 0.01
            if t_s - len(rows) >= 1.0 - 1e-9:
                distance_m = round(float(np.interp(t_s, times, distances)), 1)
                row = {"t_s": round(t_s), "distance_m": distance_m, "bit_rate": rate}
                row |= {"sent": round(sent), "right": right, "wrong": wrong}
                rows.append(row)
                print(json.dumps(row), flush=True)
                right = wrong = 0
                sent = 0.0
    total = {name: sum(row[name] for row in rows) for name in ("sent", "right", "wrong")}
    rates = [row["bit_rate"] for row in rows]
    print(json.dumps({"seed": arguments.seed, "open": arguments.open, "rates": rates, **total}))


if __name__ == "__main__":
    main()
