"""How long from a beacon's appearance to its first right identification: real processes, at real time, on this host.

The scene (simulated before, DVXplorer Mini in VARIABLE_15000, from 5 m, `live_scenes`' sensor; `recording` to the
source): 24 beacons of `seed11` at 2 kbit/s are switched on for 0.8 s at random instants, dark for 3 to 4.2 s between
(longer than any track coasts or any identity is held); 12 more send all the time and come out from under two boards
that pass over them. Each sends a payload of its own.

An appearance begins with the first edge of a switched beacon, and with the first millisecond in which an uncovered one
is in clear sight (truth: the simulation's world; no service sees it). Its latency ends when a client of the bus on the
camera's host receives the first `ids` message that is right: accepted after the appearance, this payload, within
MATCH_PX of its place. Camera time is mapped to the host's clock by the source itself: it sends no batch before the wall
clock has come to the batch's end, so the least difference between a message's `mono_ns` and its `t_us` is where camera
time 0 lies, to a fraction of a millisecond. Processes, client and proxy share this host's processors.

Arms:

    host    source, tracker and decoder on one host, shared memory
    link    tracker behind a link of 2 Mbit/s and 50 ms each way, shared memory off; a router on each side
    link25  the same with 25 ms each way (50 ms there and back)

Parts, medians: `light` appearance to the end of the last frame that the identity rests on (no receiver could be
quicker with these frames); `born` to the track's birth; `track` to the arrival of the first Tracks message that has it,
on board; `id` to the arrival of the identification.

Run: OMP_NUM_THREADS=1 python bench/study_acquisition.py [host] [link] [link25] [--seeds 1000,1001] [--seconds 60]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

import live_scenes  # noqa: E402
from shaped_link import ShapedLink  # noqa: E402

from heliograph.link.modulations import modulation  # noqa: E402
from heliograph.messages import Health, Identification, Message, Tracks  # noqa: E402
from heliograph.shell.bus import Bus, connected  # noqa: E402
from heliograph.shell.links import client_config  # noqa: E402
from heliograph.shell.process import Stop  # noqa: E402
from heliograph.shell.site import BusLinks  # noqa: E402
from heliograph.wire import SCHEMAS, Header  # noqa: E402
from heliograph_services.event_source.simulation.world.crowd import sendable  # noqa: E402
from heliograph_services.event_source.simulation.world.load import load_scenario  # noqa: E402
from support.processes import Host, free_port  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "acquisition.json"
BIT_RATE: Final = 2_000
SWITCHED, COVERED = 24, 12
ON_S, DARK_S = 0.8, (3.0, 4.2)
BOARD_SPEED_M_S: Final = 2.5
# A region's centre is within a pixel or two; the next beacon is 70 px away.
MATCH_PX: Final = 10.0
# Before and after, processes warm up, or an appearance has no time.
FIRST_S, LAST_S = 2.0, 1.2
GOAL_MS = {"host": 60.0, "link": 200.0, "link25": 200.0}

# A field of 7 x 6 places 0.9 m (72 px) apart, under boards 7 m long that run along two of its rows.
BOARD: Final = """
[[asset]]
name = "board{i}"
size_m = [7.0, 0.5]
path = {{ kind = "shuttle", from_m = [{begin}, {y}, 0.3], to_m = [{end}, {y}, 0.3], speed_m_s = {speed}, turn_s = 0.1 }}
"""
CAMERA: Final = """
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
mode = "VARIABLE_15000"
path = { kind = "still", at_m = [0.0, 0.0, 5.0] }
"""
BEACON: Final = """
[[beacon]]
name = "b{i:02d}"
protocol = "seed11"
bit_rate = {rate}
{sends}
intensity_w_sr = 0.1
diameter_m = 0.01
path = {{ kind = "still", at_m = [{x:.3f}, {y:.3f}, 0.02] }}
"""


@dataclass(frozen=True, slots=True)
class Appearance:
    """A beacon comes into view at t_us of the camera, for so long."""

    payload: int
    kind: str
    t_us: float
    until_us: float
    x_px: float
    y_px: float


@dataclass(frozen=True, slots=True)
class Heard:
    """A message at a client: when it arrived, by the host's monotonic clock."""

    arrived_s: float
    message: Message


# ---- the scene -------------------------------------------------------------------------------------------------------


def scene(seed: int, seconds: float, folder: Path) -> Path:
    """Write the scenario and the switched beacons' edges; return its file."""
    rng = np.random.default_rng([seed, 2_000])
    payloads = rng.permutation(sendable("seed11", {}))[: SWITCHED + COVERED]
    text = [CAMERA]
    for i, y in enumerate((-1.35, 1.35)):
        # Each begins beside the field, at either end.
        text.append(BOARD.format(i=i, y=y, begin=-8.0 + 16.0 * i, end=8.0 - 16.0 * i, speed=BOARD_SPEED_M_S))
    rows = {"switched": (-2.25, -0.45, 0.45, 2.25), "covered": (-1.35, 1.35)}
    places = [(kind, x, y) for kind, ys in rows.items() for y in ys for x in (np.arange(6) - 2.5) * 1.2]
    for i, ((kind, x, y), payload) in enumerate(zip(places, payloads, strict=True)):
        sends = f"payload = {payload}\nstart_us = {rng.integers(0, 5_500)}"
        if kind == "switched":
            file = folder / f"b{i:02d}.csv"
            file.write_text(edges(int(payload), seconds, rng))
            sends = f'edges = "{file}"'
        jitter = rng.uniform(-0.1, 0.1, 2) * (kind == "switched", kind == "switched")
        text.append(BEACON.format(i=i, rate=BIT_RATE, sends=sends, x=x + jitter[0], y=y + jitter[1]))
    path = folder / "scene.toml"
    path.write_text("".join(text))
    (folder / "payloads.json").write_text(json.dumps([int(p) for p in payloads]))
    return path


def edges(payload: int, seconds: float, rng: np.random.Generator) -> str:
    """Return a beacon's edges: off, then frames for ON_S from a random instant on, again and again."""
    bits = np.array(modulation("seed11").encode(payload))
    frames = round(ON_S * BIT_RATE / len(bits))
    level = np.concatenate([[0], np.tile(bits, frames), [0]])
    change = np.flatnonzero(np.diff(level)) + 1
    lines, t_s = ["t_ns,level"], float(rng.uniform(0.5, 4.5))
    while t_s < seconds:
        lines += [f"{round(1e9 * (t_s + (k - 1) / BIT_RATE))},{level[k]}" for k in change]
        t_s += ON_S + float(rng.uniform(*DARK_S))
    return "\n".join(lines)


def appearances(path: Path, seed: int, seconds: float) -> list[Appearance]:
    """Return the appearances that a run is scored by, from the simulation's own world."""
    world = _world(path, seed)
    payloads = json.loads((path.parent / "payloads.json").read_text())
    t_us = np.arange(0.0, seconds * 1e6, 1_000.0)
    seen = world.seen_all(t_us)
    found: list[Appearance] = []
    for i, payload in enumerate(payloads):
        x, y = float(seen.x_px[i, 0]), float(seen.y_px[i, 0])
        if i < SWITCHED:
            lines = (path.parent / f"b{i:02d}.csv").read_text().splitlines()[1:]
            edge_us = np.array([float(line.partition(",")[0]) for line in lines]) / 1e3
            first = np.flatnonzero(np.diff(edge_us, prepend=-1e9) > 1e6)
            last = np.append(first[1:], len(edge_us)) - 1
            found += [
                Appearance(payload, "switched", a, b, x, y) for a, b in zip(edge_us[first], edge_us[last], strict=True)
            ]
        else:
            clear = np.asarray(seen.visible[i]).astype(np.int8)
            step = np.diff(clear, prepend=1, append=0)
            begins, ends = np.flatnonzero(step == 1), np.flatnonzero(step == -1)
            found += [
                Appearance(payload, "uncovered", float(t_us[a]), float(t_us[ends[ends > a][0] - 1]), x, y)
                for a in begins
            ]
    chosen = [a for a in found if FIRST_S * 1e6 <= a.t_us <= (seconds - LAST_S) * 1e6]
    return sorted(chosen, key=lambda a: a.t_us)


def _world(path: Path, seed: int) -> Any:
    from heliograph_services.event_source.simulation.stream import SceneStream  # noqa: PLC0415 - compiles

    return SceneStream(load_scenario(str(path)), seed, "full", 0.0, lambda _: None).world


# ---- the processes ---------------------------------------------------------------------------------------------------

BUS: Final = """
site = "acquisition"
host = "{host}"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
shared_memory = {shared}
[router]
listen = ["tcp/127.0.0.1:{port}"]
"""
SOURCE: Final = """
[[service]]
kind = "event_source"
backend = "recording"
file = "{file}"
await_s = 60
{settings}
[[service]]
kind = "decoder"
protocol = "seed11"
bit_rate = 2000
{decoder}
"""
TRACKER: Final = """
[[service]]
kind = "tracker"
{tracker}
"""


class Client:
    """A client of the bus that notes what arrives, and where camera time 0 lies on the host's clock."""

    def __init__(self, bus: Bus, names: list[str]) -> None:
        self.heard: list[Heard] = []
        self.health: dict[str, Health] = {}
        self.origin_s = math.inf
        self.origins: list[float] = []
        self.last_us = 0
        self._end = threading.Event()
        inbox = bus.subscribe({name: SCHEMAS[name] for name in names})

        def run() -> None:
            while not self._end.is_set():
                sample = inbox.get(0.05)
                opened = bus.open(sample) if sample else None
                if sample is not None and opened is not None:
                    self._take(sample.arrived_ns / 1e9, *opened)

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()

    def _take(self, arrived_s: float, header: Header, message: Message) -> None:
        if message.SCHEMA == "onsets":
            self.origins.append(header.mono_ns / 1e9 - header.t_us / 1e6)
            self.origin_s = min(self.origin_s, self.origins[-1])
            self.last_us = header.t_us
        elif isinstance(message, Health):
            self.health[message.service] = message
        else:
            self.heard.append(Heard(arrived_s, message))

    def close(self) -> None:
        """Stop listening."""
        self._end.set()
        self._thread.join()


def run(arm: str, folder: Path, file: Path, seconds: float, settings: dict[str, str]) -> dict[str, Any]:
    """Play the recording through real processes; return what the clients heard."""
    board_port, ground_port = free_port(), free_port()
    shared = "true" if arm == "host" else "false"
    text = BUS.format(host="board", port=board_port, shared=shared)
    source = SOURCE.format(file=file, settings=settings.get("source", ""), decoder=settings.get("decoder", ""))
    tracker = TRACKER.format(tracker=settings.get("tracker", ""))
    link = None
    hosts: list[Host] = []
    try:
        if arm == "host":
            hosts.append(Host(folder, "board", text + source + tracker, ["tracker", "decoder"]))
        else:
            link = ShapedLink(ground_port, 2e6, 0.05 if arm == "link" else 0.025)
            ground = BUS.format(host="ground", port=ground_port, shared="false") + 'id = "67726f756e64"\n' + tracker
            dial = f'connect = ["tcp/127.0.0.1:{link.port}"]\nkeep = ["events"]\npeers = ["67726f756e64"]\n'
            hosts.append(Host(folder, "ground", ground, ["tracker"]))
            hosts.append(Host(folder, "board", text + dial + source, ["decoder"]))
        board = hosts[-1]
        links = BusLinks(connect=(f"tcp/127.0.0.1:{board_port}",), shared_memory=False)
        with connected(client_config(links), "acquisition", "client/board", Stop()) as bus:
            assert bus is not None
            client = Client(bus, ["ids", "tracks", "onsets", "health"])
            board.start("event_source")
            board.wait("event_source", 120 + 2 * seconds)
            time.sleep(0.5)
            client.close()
        cpu = {service: round(health.cpu_share, 3) for service, health in client.health.items()}
        dropped = {
            f"{service}: {name}": n
            for service, health in client.health.items()
            for name, n in health.counters.items()
            if n and name.startswith(("dropped", "missing", "pace"))
        }
        passed = None if link is None else [round(8 * b / seconds / 1e6, 3) for b in link.bytes_passed]
        waited = None if link is None else [round(1e3 * s, 1) for s in link.worst_s]
    finally:
        for host in hosts:
            host.close()
        if link is not None:
            link.close()
    return {
        "client": client,
        "counted": dropped,
        "cpu_last_second": cpu,
        "link_mbit_s": passed,
        "link_waited_ms": waited,
    }


# ---- scoring ---------------------------------------------------------------------------------------------------------


def scored(wanted: list[Appearance], client: Client) -> tuple[list[dict[str, Any]], int]:
    """Return a row an appearance, and how many acceptances fit none."""
    zero_s = client.origin_s
    accepted = [
        (h.arrived_s, m)
        for h in client.heard
        if isinstance(m := h.message, Identification) and m.change in ("accepted", "changed") and not m.lost
    ]
    tracks = [(h.arrived_s, h.message) for h in client.heard if isinstance(h.message, Tracks)]
    rows, used = [], set[int]()
    for a in wanted:
        row: dict[str, Any] = {"kind": a.kind, "t_us": round(a.t_us), "payload": a.payload, "id_ms": None}
        for number, (arrived_s, m) in enumerate(accepted):
            right = m.payload == a.payload and math.hypot(m.x_px - a.x_px, m.y_px - a.y_px) <= MATCH_PX
            if right and m.since_us > a.t_us and m.t_us <= a.until_us + 1e6 and (arrived_s - zero_s) * 1e6 > a.t_us:
                used.add(number)
                if row["id_ms"] is None:
                    row["id_ms"] = round(1e3 * (arrived_s - zero_s) - a.t_us / 1e3, 2)
                    row["light_ms"] = round((m.since_us - a.t_us) / 1e3, 2)
        first = next(((s, m, i) for s, m in tracks if (i := _of(m, a)) is not None), None)
        if first is not None:
            arrived_s, m, i = first
            row["born_ms"] = round((m.born_us[i] - a.t_us) / 1e3, 2)
            row["track_ms"] = round(1e3 * (arrived_s - zero_s) - a.t_us / 1e3, 2)
        rows.append(row)
    places = {a.payload: (a.x_px, a.y_px) for a in wanted}
    wrong = 0
    for number, (_, m) in enumerate(accepted):
        x, y = places.get(m.payload or -1, (-1e9, -1e9))
        wrong += number not in used and math.hypot(m.x_px - x, m.y_px - y) > MATCH_PX
    return rows, wrong


def _of(message: Tracks, a: Appearance) -> int | None:
    """Return the row of a track that was born of an appearance."""
    if not a.t_us < message.as_of_us < a.t_us + 1.5e6:
        return None
    for i, (x, y, born_us) in enumerate(zip(message.x_px, message.y_px, message.born_us, strict=True)):
        # A window that begins before the first edge may hold it.
        if born_us >= a.t_us - 20_000 and math.hypot(x - a.x_px, y - a.y_px) <= MATCH_PX:
            return i
    return None


def quantile_bound(values: list[float], q: float) -> float | None:
    """Return the upper 95 % bound of a quantile: the order statistic that a binomial variable passes in 5 %."""
    n, below, k = len(values), 0.0, 0
    while k <= n and below < 0.95:
        below += math.comb(n, k) * q**k * (1 - q) ** (n - k)
        k += 1
    ordered = sorted(values)
    return ordered[k - 1] if k - 1 < n and math.isfinite(ordered[k - 1]) else None


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return n, quantiles and parts; what was never identified counts as later than all."""
    out: dict[str, Any] = {}
    for kind in ("all", "switched", "uncovered"):
        chosen = [row for row in rows if kind in ("all", row["kind"])]
        latency = [math.inf if row["id_ms"] is None else row["id_ms"] for row in chosen]
        if not latency:
            continue
        q = [np.quantile(latency, p, method="higher") for p in (0.5, 0.95)]
        parts = {}
        for name in ("light_ms", "born_ms", "track_ms", "id_ms"):
            known = [row[name] for row in chosen if row.get(name) is not None]
            parts[name] = [round(float(np.quantile(known, p)), 1) for p in (0.05, 0.5, 0.95)] if known else None
        bound = quantile_bound(latency, 0.95)
        out[kind] = {
            "n": len(latency),
            "never": sum(map(math.isinf, latency)),
            "median_ms": None if math.isinf(q[0]) else round(float(q[0]), 1),
            "p95_ms": None if math.isinf(q[1]) else round(float(q[1]), 1),
            "p95_upper_bound_ms": bound,
            "parts_p5_p50_p95": parts,
        }
    return out


def study(arm: str, seeds: list[int], seconds: float, settings: dict[str, str]) -> dict[str, Any]:
    """Return the summary of an arm over its seeds."""
    rows: list[dict[str, Any]] = []
    runs = []
    for seed in seeds:
        with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as name:
            folder = Path(name)
            path = scene(seed, seconds, folder)
            wanted = appearances(path, seed, seconds)
            file = folder / "scene.npz"
            live_scenes.write_recording(file, live_scenes.events_of(str(path), seed, seconds), 640, 480)
            heard = run(arm, folder, file, seconds, settings)
        client: Client = heard.pop("client")
        found, wrong = scored(wanted, client)
        rows += found
        late = np.array(client.origins) - client.origin_s
        # What else the host had to do: latencies are those of a shared machine.
        runs.append({"seed": seed, "n": len(found), "wrong": wrong, **heard, "load_1min": round(os.getloadavg()[0], 1),
                     "source_late_ms_p99": round(1e3 * float(np.quantile(late, 0.99)), 2)})  # fmt: skip
        print(arm, runs[-1], json.dumps(summary(found)), flush=True)
    return {"goal_p95_ms": GOAL_MS[arm], "seconds": seconds, "runs": runs, "settings": settings, **summary(rows),
            "latencies_ms": [row["id_ms"] for row in rows]}  # fmt: skip


def main() -> None:
    """Run the arms that are asked for; keep the others' stored results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("arm", nargs="*", choices=[*GOAL_MS, []], default=[])
    parser.add_argument("--seeds", default="1000")
    parser.add_argument("--seconds", type=float, default=60.0, help="of camera time, of each seed")
    parser.add_argument("--source", default="", help="lines of the source's settings, separated by ';'")
    parser.add_argument("--tracker", default="", help="likewise")
    parser.add_argument("--decoder", default="", help="likewise")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    result = json.loads(args.output.read_text()) if args.output.exists() else {}
    settings = {name: getattr(args, name).replace(";", "\n") for name in ("source", "tracker", "decoder")}
    for arm in args.arm or list(GOAL_MS):
        result[arm] = {
            "evidence": "simulated", "machine": platform.machine(), "python": platform.python_version(),
            **study(arm, [int(seed) for seed in args.seeds.split(",")], args.seconds, settings),
        }  # fmt: skip
        args.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
