"""Ten thousand frames a second into the metrics sink: what was published is what is in the file, or it is told.

Real processes: router, sink, and who publishes. Three ways:

    decoder   the decoder's own process. Events of 23 beacons at 5 kbit/s (10,450 frames a second; `decoder_corpus`)
              and their tracks are sent to it at the pace of a camera by a process that knows them. What it published is
              what it says itself in its last health report: messages on `frames/cam0`, and frames in them.
    stand_in  a process that publishes what that decoder would, by the same bus and so with the same numbering and
              counters, at exactly --frames-s: a message each --window-us, `ids` at 10 Hz, `link` at 1 Hz, 20 tracks.
              For machines on which a decoder does not come to that rate beside everything else that runs.
    killed    a stand-in at 1,000 frames a second, and the sink killed (kill -9) after 3 to 5 s, KILLS times, seed by
              seed: `lost_s` is what was published until then and is not in the file, as a time at that rate; it holds
              what was still on its way, too. Nothing of it counts as lost below.

Nobody is faster than a live camera; what could not be sent in time is sent at once. After the publisher has ended and
then the sink, the file must hold as many frames::

    lost = published - counted in the file        missing, dropped: what the sink itself reported

Frames that came later than the sink waits for (`settle_us`) are counted apart, and told: `late_frames`.

`load_1m` is the machine's: where it is above the number of cores, others took what these processes wanted.
`frames_s` is frames over the time from the publisher's first to its last message; `cpu_share` the sink's, from its own
reports; `behind_s` the most that the sender was late; `decoder_dropped` what the decoder's queues gave up.

Run: OMP_NUM_THREADS=1 python bench/bench_sink.py [decoder] [stand_in] [killed] [--seconds 60] [-o FILE]
(about 1.3 cores, .5 with the stand-in alone)
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import platform
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

import decoder_corpus  # noqa: E402

from heliograph.messages import Frames, Health, Link  # noqa: E402
from heliograph.shell.bus import Bus, connected  # noqa: E402
from heliograph.shell.links import client_config  # noqa: E402
from heliograph.shell.process import Stop  # noqa: E402
from heliograph.shell.site import BusLinks  # noqa: E402
from heliograph_services.metrics_sink.summary import summarise  # noqa: E402
from support.processes import Collector, Host, collecting, free_port  # noqa: E402
from support.truth_scenes import state  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "sink.json"
WAYS: Final = ("decoder", "stand_in", "killed")
KILLS: Final = 10
TRACKS: Final = 20
WINDOW_US: Final = 1_000
SEED, BEACONS, BIT_RATE, EVENTS_HZ, INSIDE = 1, 23, 5_000.0, 6e5, 0.9
# 5000 frames of 11 bits: at the seam of the loop nothing jumps.
LOOP_US: Final = 11_000_000
# Of frames by the decoder, before the minute that counts: to acquire 23 tracks, and a few seams.
ACQUISITION_S: Final = 3.0
PATIENCE_S: Final = 300.0
SITE: Final = """
site = "sink"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "metrics_sink"
file = "metrics.sqlite"
[[service]]
kind = "decoder"
{beacons}
"""
BEACON: Final = """
[[beacon]]
name = "{name}"
protocol = "seed11"
payload = {payload}
bit_rate = {bit_rate}
"""


def frames_of(window: int, each: int, window_us: int = WINDOW_US) -> Frames:
    """Return a window's message, with so many frames."""
    tracks = [(window * each + i) % TRACKS for i in range(each)]
    t1_us = (window + 1) * window_us
    return Frames(
        camera="cam0",
        t0_us=t1_us - window_us,
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


def paced(seconds: float, send: Callable[[int], None], window_us: int = WINDOW_US) -> float:
    """Call `send` of each window of so many seconds when it is over; return the most that it was late, s."""
    began_s, behind_s = time.monotonic(), 0.0
    for window in range(1, round(seconds * 1e6 / window_us) + 1):
        ahead_s = began_s + window * window_us / 1e6 - time.monotonic()
        behind_s = max(behind_s, -ahead_s)
        if ahead_s > 0:
            time.sleep(ahead_s)
        send(window)
    return behind_s


def stand_in(bus: Bus, seconds: float, frames_s: float, window_us: int) -> dict[str, Any]:
    """Publish in the decoder's place; return what was published."""
    each = round(frames_s * window_us / 1e6)

    def send(window: int) -> None:
        bus.publish(frames_of(window, each, window_us))
        t_us = window * window_us
        for track in range(TRACKS) if t_us % 100_000 == 0 else ():
            change = "accepted" if t_us == 100_000 else "refreshed"
            bus.publish(state(t_us, change, f"beacon{track}", f"t-{track}", 100_000, track, x_px=30.0 * track))
        for track in range(TRACKS) if t_us % 1_000_000 == 0 else ():
            bus.publish(
                Link(camera="cam0", track=f"t-{track}", t_us=t_us, protocol="seed11", bit_rate=5e3, snr_db=20.0,
                     jitter_us=10.0, clock_ppm=0.0, events_per_transition=30.0, mar_estimate=0.99)
            )  # fmt: skip

    # Zenoh tells a router of a new key a moment after it is declared.
    bus.publish(frames_of(0, 0, window_us))
    time.sleep(1.0)
    began_s = time.monotonic()
    behind_s = paced(seconds, send, window_us)
    took_s = time.monotonic() - began_s
    n = round(seconds * 1e6 / window_us) * each
    return {"frames": n, "messages": bus.published["frames"], "took_s": round(took_s, 2),
            "frames_s": round(n / took_s, 1), "behind_s": round(behind_s, 3)}  # fmt: skip


def scene(bus: Bus, seconds: float) -> dict[str, Any]:
    """Send events and tracks, as source and tracker would; return how it went."""
    corpus = made()

    def send(window: int) -> None:
        at_us = (window - 1) * WINDOW_US
        if at_us % decoder_corpus.PERIOD_US == 0:
            bus.publish(corpus.tracks(at_us))
        t0_us = at_us % LOOP_US
        bus.publish(corpus.events(t0_us, t0_us + WINDOW_US, at_us - t0_us))

    behind_s = paced(seconds + ACQUISITION_S, send)
    return {"behind_s": round(behind_s, 3), "events": bus.published["events"]}


def made() -> decoder_corpus.Corpus:
    """Return the events of the loop."""
    seconds = LOOP_US / 1e6
    return decoder_corpus.corpus(SEED, seconds, EVENTS_HZ, INSIDE, beacons=BEACONS, bit_rate=BIT_RATE)


def publish(way: str, port: int, seconds: float, frames_s: float, window_us: int) -> None:
    """Be the process that publishes; print what was published as JSON."""
    links = BusLinks(connect=(f"tcp/127.0.0.1:{port}",))
    name = "decoder/decoder" if way == "stand_in" else f"client/{os.getpid()}"
    with connected(client_config(links), "sink", name, Stop()) as bus:
        assert bus is not None
        told = stand_in(bus, seconds, frames_s, window_us) if way == "stand_in" else scene(bus, seconds)
        # What is on its way must leave before the session does.
        time.sleep(1.0)
        print(json.dumps(told))


def reports(heard: Collector, service: str) -> list[Health]:
    """Return what a process has said of itself."""
    return [m for m in heard.messages["health"] if isinstance(m, Health) and m.service == service]


def at_rest(heard: Collector, service: str) -> None:
    """Wait until the last three reports of a process say that nothing waits for it and nothing new has come."""

    def rests(h: Collector) -> bool:
        last = reports(h, service)[-3:]
        received = {tuple(sorted((k, v) for k, v in m.counters.items() if _is_input(k))) for m in last}
        return len(last) == 3 and len(received) == 1 and not any(m.gauges.get("queue", 0.0) for m in last)

    heard.until(rests, f"the end of the {service}'s queue", PATIENCE_S)


def _is_input(counter: str) -> bool:
    return counter.startswith("received: ") and counter not in {"received: health", "received: ids"}


def run(way: str, seconds: float, frames_s: float, window_us: int) -> dict[str, Any]:
    """Return what was published, what was kept, and what the sink said of itself."""
    with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as name:
        folder, port = Path(name), free_port()
        listed = made().beacons if way == "decoder" else ()
        beacons = "".join(BEACON.format(name=b.name, payload=b.payload, bit_rate=b.bit_rate) for b in listed)
        kinds = ["metrics_sink", "decoder"] if way == "decoder" else ["metrics_sink"]
        host = Host(folder, "sink", SITE.format(port=port, beacons=beacons), kinds)
        try:
            with collecting(port, "sink", ["health"]) as heard:
                for kind in kinds:
                    heard.until(lambda h, kind=kind: bool(reports(h, kind)), f"the {kind}", PATIENCE_S)  # type: ignore[misc]
                command = [sys.executable, __file__, "--publish", way, str(port), "--seconds", str(seconds)]
                command += ["--frames-s", str(frames_s), "--window-us", str(window_us)]
                told = subprocess.run(
                    command, check=True, capture_output=True, text=True,
                    timeout=seconds + 3 * PATIENCE_S,
                )  # fmt: skip
                published = json.loads(told.stdout.splitlines()[-1])
                if way == "decoder":
                    at_rest(heard, "decoder")
                    host.processes["decoder"].terminate()
                    host.wait("decoder")
                    heard.until(lambda h: reports(h, "decoder")[-1].state == "stopping", "the decoder's last report")
                    published |= said(reports(heard, "decoder"))
                at_rest(heard, "metrics_sink")
            host.close()
        finally:
            host.close()
        return {
            "seconds": seconds,
            "window_us": window_us,
            "load_1m": os.getloadavg()[0],
            "published": published,
        } | kept(folder / "metrics.sqlite", heard, published)


def lost_by_a_kill(seed: int) -> float:
    """Return what a sink that is killed has lost, s."""
    n = random.Random(seed).randrange(3_000, 5_000)
    with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as name:
        folder, port = Path(name), free_port()
        host = Host(folder, "sink", SITE.format(port=port, beacons=""), ["metrics_sink"])
        try:
            with collecting(port, "sink", ["health"]) as heard:
                heard.until(lambda h: bool(reports(h, "metrics_sink")), "the sink", PATIENCE_S)
                paced(n * WINDOW_US / 1e6, lambda window: heard.bus.publish(frames_of(window, 1)))
                host.kill("metrics_sink")
        finally:
            host.close()
        return round((n - summarise(folder / "metrics.sqlite").frames) * WINDOW_US / 1e6, 3)


def killed(*_: float) -> dict[str, Any]:
    """Return how much a sink that is killed has lost, time after time."""
    lost_s = [lost_by_a_kill(seed) for seed in range(KILLS)]
    return {"kills": KILLS, "lost_s": {"median": statistics.median(lost_s), "most": max(lost_s), "each": lost_s}}


def said(of: list[Health]) -> dict[str, Any]:
    """Return what the decoder has published, by its own count; the rate is that between two reports with frames."""
    busy = [m for before, m in itertools.pairwise(of) if m.counters["frames"] > before.counters["frames"]]
    last = of[-1].counters
    took_s = busy[-1].uptime_s - busy[0].uptime_s
    return {
        "frames": last["frames"],
        "messages": last["published: frames"],
        "took_s": round(took_s, 2),
        "frames_s": round((busy[-1].counters["frames"] - busy[0].counters["frames"]) / took_s, 1),
        "decoder_dropped": {k: v for k, v in last.items() if k.startswith("dropped") and v},
        "decoder_cpu_share": sorted(m.cpu_share for m in busy)[len(busy) // 2],
    }


def kept(path: Path, heard: Collector, published: dict[str, Any]) -> dict[str, Any]:
    """Return what the sink has kept and said of itself."""
    of = reports(heard, "metrics_sink")
    last, found = of[-1].counters, summarise(path)
    busy = sorted(m.cpu_share for m in of if m.cpu_share > 0)
    return {
        "kept_frames": found.frames,
        "late_frames": found.late_frames,
        "lost": published["frames"] - found.frames - found.late_frames,
        "received": last.get("received: frames", 0),
        "messages_lost": published["messages"] - last.get("received: frames", 0),
        "late": found.late,
        "missing": last.get("missing: frames", 0),
        "dropped": {k: v for k, v in last.items() if k.startswith("dropped") and v},
        "kept_seconds": found.seconds,
        "refused": found.refused,
        "sightings": len(found.sightings),
        "cpu_share": {"median": busy[len(busy) // 2], "most": busy[-1]},
        "queue_most": max(int(m.gauges.get("queue", 0)) for m in of),
        "latency_ms": {
            hop.hop: [hop.p50_ms, hop.p95_ms, hop.p99_ms] for hop in found.hops if hop.process.startswith("metrics")
        },
        "file_kb": round(path.stat().st_size / 1e3),
    }


def main() -> int:
    """Measure, print and store; return 1 where a frame was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ways", nargs="*", metavar="|".join(WAYS), help="all by default")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--frames-s", type=float, default=10_000.0, help="of the stand-in")
    parser.add_argument("--window-us", type=int, default=WINDOW_US, help="of the stand-in: 1000 to 5000")
    parser.add_argument("--publish", nargs=2, metavar=("WAY", "PORT"), help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    if args.publish:
        publish(args.publish[0], int(args.publish[1]), args.seconds, args.frames_s, args.window_us)
        return 0
    if unknown := set(args.ways) - set(WAYS):
        parser.error(f"must be of {', '.join(WAYS)}, not {', '.join(sorted(unknown))}")
    result: dict[str, Any] = json.loads(args.output.read_text()) if args.output.exists() else {}
    result |= {"evidence": "simulated", "machine": platform.machine(), "python": platform.python_version()}
    lost = 0
    for way in args.ways or WAYS:
        result[way] = (killed if way == "killed" else partial(run, way))(args.seconds, args.frames_s, args.window_us)
        lost += result[way].get("lost", 0) + result[way].get("messages_lost", 0)
        print(way, *(f"  {key}: {value}" for key, value in result[way].items()), sep="\n", flush=True)
        args.output.write_text(json.dumps(result, indent=1) + "\n")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
