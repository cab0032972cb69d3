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
    link    tracker behind a link of 2 Mbit/s and 50 ms each way, shared memory off; a router on each side; ticks and
            the onsets' rate as deploy/sites/onboard.toml has them, unless --source says otherwise
    link25  the same with 25 ms each way (50 ms there and back)
    cores, cores-link   the same cores in one process, live but without a clock: every message is there at once, or
            after 50 ms each way; what the algorithms take, on a host of any speed and with any load

Parts, medians: `light` appearance to the end of the last frame that the identity rests on (no receiver could be
quicker with these frames); `born` to the track's birth; `track` to the arrival of the first Tracks message that has it,
on board; `id` to the arrival of the identification.

Run: OMP_NUM_THREADS=1 python bench/study_acquisition.py [host] [link] [link25] [--seeds 1000,1001] [--seconds 60]
"""

from __future__ import annotations

import argparse
import heapq
import json
import math
import os
import platform
import sys
import tempfile
import threading
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

import live_scenes  # noqa: E402

from heliograph.core import Context  # noqa: E402
from heliograph.messages import Health, Identification, Message, Status, Tracks  # noqa: E402
from heliograph.shell.bus import Bus, connected  # noqa: E402
from heliograph.shell.links import client_config  # noqa: E402
from heliograph.shell.process import Stop  # noqa: E402
from heliograph.shell.site import BusLinks  # noqa: E402
from heliograph.streams import Events, Onsets  # noqa: E402
from heliograph.wire import SCHEMAS, Header  # noqa: E402
from heliograph_services.cli.studies.appearances import Appearance, appearances, scene  # noqa: E402
from heliograph_services.cli.studies.radio import ShapedLink  # noqa: E402
from heliograph_services.decoder.config import DecoderConfig  # noqa: E402
from heliograph_services.decoder.core import make_core as make_decoder  # noqa: E402
from heliograph_services.event_source.config import EventSourceConfig  # noqa: E402
from heliograph_services.event_source.stream import open_stream  # noqa: E402
from heliograph_services.tracker.config import TrackerConfig  # noqa: E402
from heliograph_services.tracker.core import make_core as make_tracker  # noqa: E402
from support.processes import Host, free_port  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "acquisition.json"
# A region's centre is within a pixel or two; the next beacon is 70 px away.
MATCH_PX: Final = 10.0
GOAL_MS = {"host": 60.0, "link": 200.0, "link25": 200.0, "cores": 60.0, "cores-link": 200.0}
LIVE: Final = Context(instance="bench", boot="bench", lockstep=False)


@dataclass(frozen=True, slots=True)
class Heard:
    """A message at a client: when it arrived, by the host's monotonic clock."""

    arrived_s: float
    message: Message


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
ONBOARD: Final = Path(__file__).parents[1] / "deploy" / "sites" / "onboard.toml"
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


def radio() -> str:
    """Return what onboard.toml says to its source about onsets, as lines of a site file."""
    (source,) = (s for s in tomllib.loads(ONBOARD.read_text())["service"] if s["kind"] == "event_source")
    return "\n".join(f"{name} = {source[name]}" for name in ("tick_us", "onsets_bit_rate_max"))


def run(arm: str, folder: Path, file: Path, seconds: float, settings: dict[str, str]) -> dict[str, Any]:
    """Play the recording through real processes; return what the clients heard."""
    board_port, ground_port = free_port(), free_port()
    shared = "true" if arm == "host" else "false"
    text = BUS.format(host="board", port=board_port, shared=shared)
    given = settings.get("source", "") or ("" if arm == "host" else radio())
    source = SOURCE.format(file=file, settings=given, decoder=settings.get("decoder", ""))
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
        passed = None if link is None else [round(8 * b / seconds / 1e6, 3) for b in link.passed]
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


class Unclocked:
    """What a client hears of the same cores in one process, by camera time.

    Args:
        file: the recording.
        delay_s: from source to tracker, and from the tracker to the decoder and back.
        settings: of the services, as for `run`.
    """

    def __init__(self, file: Path, delay_s: float, settings: dict[str, str]) -> None:
        self.heard: list[Heard] = []
        self.origin_s, self.origins = 0.0, [0.0]
        given = {name: tomllib.loads(settings.get(name, "")) for name in ("source", "tracker", "decoder")}
        source = {"backend": "recording", "file": str(file)} | given["source"]
        decoder = {"protocol": "seed11", "bit_rate": 2000.0} | given["decoder"]
        self._tracker = make_tracker(msgspec.convert(given["tracker"], TrackerConfig), LIVE)
        self._decoder = make_decoder(msgspec.convert(decoder, DecoderConfig), LIVE)
        self._delay_us = round(1e6 * delay_s)
        self._under_way: list[tuple[int, int, Message]] = []
        self._sent = 0
        for step in open_stream(msgspec.convert(source, EventSourceConfig), LIVE):
            for message in step.messages:
                if isinstance(message, Onsets):
                    self._send(message, step.t1_us)
            self._deliver(step.t1_us)
            for message in step.messages:
                if isinstance(message, Events):
                    self._publish(self._decoder.feed(message), step.t1_us)
            self._deliver(step.t1_us)

    def _send(self, message: Message, now_us: int) -> None:
        heapq.heappush(self._under_way, (now_us + self._delay_us, self._sent, message))
        self._sent += 1

    def _deliver(self, until_us: int) -> None:
        while self._under_way and self._under_way[0][0] <= until_us:
            now_us, _, message = heapq.heappop(self._under_way)
            core = self._decoder if isinstance(message, Tracks) else self._tracker
            if isinstance(message, Tracks):
                self.heard.append(Heard(now_us / 1e6, message))
            self._publish(core.feed(message), now_us)

    def _publish(self, messages: list[Message], now_us: int) -> None:
        for message in messages:
            if isinstance(message, (Tracks, Status)):
                self._send(message, now_us)
            elif isinstance(message, Identification):
                self.heard.append(Heard(now_us / 1e6, message))


# ---- scoring ---------------------------------------------------------------------------------------------------------


def scored(wanted: list[Appearance], client: Client | Unclocked) -> tuple[list[dict[str, Any]], int]:
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
            heard: dict[str, Any] = {}
            if arm.startswith("cores"):
                client: Client | Unclocked = Unclocked(file, 0.05 if arm == "cores-link" else 0.0, settings)
            else:
                heard = run(arm, folder, file, seconds, settings)
                client = heard.pop("client")
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
