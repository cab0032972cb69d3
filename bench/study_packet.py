"""The data link `packet`: delivered, lost and corrupt messages, from soft transitions up to simulated events.

    python bench/study_packet.py soft --dropped 0.05 --n 1000000 -o bench/results/packet.json
    python bench/study_packet.py noise --n 10000000 -o bench/results/packet.json
    python bench/study_packet.py light --dropped 0.05 --n 1000 -o bench/results/packet.json
    python bench/study_packet.py events --n 1000 -o bench/results/packet.json

- `soft`: random packets as likelihoods of slots: each transition makes a burst (Poisson, --burst events on average), or
  none with the chance --dropped; and a background of 0.3 events of each polarity a slot. Delivered: sync and packet
  are read and right. Corrupt: CRC and evidence hold, and a bit is wrong.
- `noise`: slots of background alone, its mean log-uniform in 0.1 to 20 events a polarity; each trial is decided as if
  its sync had been seen, which in the receiver at most one in 55 is.
- `light`: events of one track (bursts of --burst events, tails of 30 us, late by 40 and 60 us) through the receiver.
- `events`: simulated scenes (an IMX636 5 m from a still beacon of 5 kbit/s, indoors) through source, tracker and
  decoder in one process, cold start; random lines of 16 letters; those that end .5 s or more after the start count.

It works in chunks with seeds of their own and stores after each, so it may be stopped and goes on where it was; looks
at a stored setting are counted. Cost on one core: `soft` and `noise` .4 ms a trial (a million in 7 min, ten in 70),
`light` 1 ms, `events` .1 s a message (1000 in 2 min). Evidence: simulated.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np

from heliograph.link.contract import Text, edges_of
from heliograph.link.modulations.packet import Packet as PacketModulation
from heliograph.link.packet_demodulator import SYNC_LEAST
from heliograph.link.packet_layout import Packet, layout_of
from heliograph.link.packet_soft import EVIDENCE_LEAST, checks, decide, evidence, temper
from heliograph.link.viterbi import SIGNS

NAME = "packet/1"
CHUNK = {"soft": 20_000, "noise": 50_000, "light": 200, "events": 25}
COUNTS = ("trials", "delivered", "sync_missed", "corrupt", "crc_right_evidence_low")


@numba.njit
def _soft_trials(seed, packets, n, dropped, burst, noise_only, sync, mother, flip, signs, steps, counts):  # type: ignore[no-untyped-def]
    np.random.seed(seed)  # noqa: NPY002 - numba's own generator
    bits = packets.shape[1]
    ring, logs = np.ones((bits + 1, 8)), np.empty(8)
    data, sent = np.empty(steps, np.uint8), np.empty(bits, np.uint8)
    whole = np.empty(steps // 8, np.uint8)
    for trial in range(n):
        packet = packets[trial % len(packets)]
        b = np.random.randint(2)  # noqa: NPY002
        background = np.exp(np.random.uniform(np.log(0.1), np.log(20.0))) if noise_only else 0.3  # noqa: NPY002
        for i in range(bits + 1):
            c = packet[i] if i < bits else np.random.randint(2)  # noqa: NPY002
            seen = b != c and not noise_only and np.random.random() >= dropped  # noqa: NPY002
            on = np.random.poisson(background + (burst if seen and c == 1 else 0.0))  # noqa: NPY002
            off = np.random.poisson(background + (burst if seen and c == 0 else 0.0))  # noqa: NPY002
            stray = 0.02 * burst
            for x in range(8):
                before, after = x >> 1 & 1, x & 1
                rate_on = 0.3 + stray + (burst if after > before else 0.0)
                rate_off = 0.3 + stray + (burst if after < before else 0.0)
                logs[x] = on * np.log(rate_on) - rate_on + off * np.log(rate_off) - rate_off
            logs /= max(1.0, burst / 10.0)
            temper(logs, ring[i])
            b = c
        synced = evidence(ring, 0, sync) >= SYNC_LEAST
        found = decide(ring, 0, sync, mother, flip, signs, data, sent)
        passes = checks(data, len(whole), whole)
        right = not noise_only
        for i in range(bits):
            if sent[i] != packet[i]:
                right = False
        counts[0] += 1
        counts[1] += 1 if synced and passes and right and found >= EVIDENCE_LEAST else 0
        counts[2] += 0 if synced else 1
        counts[3] += 1 if passes and not right and found >= EVIDENCE_LEAST else 0
        counts[4] += 1 if passes and found < EVIDENCE_LEAST else 0


def soft(arguments: argparse.Namespace, seed: int, n: int) -> dict[str, int]:
    """Return the counts of n packets, or of n trials of noise."""
    layout = layout_of(16, arguments.rate)
    tables = layout.tables()
    rng = np.random.default_rng(seed)
    packets = [
        layout.encode(Packet(int(rng.integers(256)), False, i % 16, 0, False, rng.bytes(16))) for i in range(500)
    ]
    counts = np.zeros(len(COUNTS), np.int64)
    _soft_trials(
        seed, np.array(packets, np.uint8), n, arguments.dropped, arguments.burst, arguments.mode == "noise",
        tables.sync, tables.mother, tables.flip, SIGNS, tables.steps, counts,
    )  # fmt: skip
    return dict(zip(COUNTS, counts.tolist(), strict=True))


def light(arguments: argparse.Namespace, seed: int, n: int) -> dict[str, int]:
    """Return what the receiver says of n messages sent one after another, from a cold start."""
    rng = np.random.default_rng(seed)
    kind = PacketModulation(rate=arguments.rate)
    messages = [rng.bytes(16) for _ in range(n)]
    bits = [bit for number, data in enumerate(messages) for bit in kind.message(data, 7, number)]
    edge_us, levels = edges_of([*bits, 0, 0, 0, 0], 1000.0, 200.0)
    kept = rng.random(len(edge_us)) >= arguments.dropped
    many = rng.poisson(arguments.burst, int(kept.sum()))
    on = np.repeat(levels[kept], many)
    t_us = np.repeat(edge_us[kept], many) + np.where(on, 40.0, 60.0) + rng.exponential(30.0, len(on))
    order = np.argsort(t_us, kind="stable")
    receiver = kind.receiver(5000.0)
    until_us = int(t_us.max()) + 1000
    out = receiver.feed(np.floor(t_us[order]).astype(np.int64), on[order], until_us) + receiver.flush()
    said = [item.data for item in out if isinstance(item, Text)]
    wanted = set(messages)
    return {"trials": n, "delivered": sum(d in wanted for d in said), "corrupt": sum(d not in wanted for d in said)}


SCENARIO = """
about = "a still data beacon"
irradiance_w_m2 = 2.0
[camera]
sensor = "imx636"
path = {{ kind = "still", at_m = [0.0, 0.0, 5.0] }}
lens = {{ focal_mm = 3.6, f_number = 2.0 }}
[[beacon]]
name = "a"
protocol = "packet"
options = {{ rate = "{rate}" }}
payload = 7
text = "{text}"
bit_rate = 5000
path = {{ kind = "still", at_m = [0.0, 0.0, 0.0] }}
"""


def events(arguments: argparse.Namespace, seed: int, n: int) -> dict[str, int]:
    """Return what source, tracker and decoder make of n messages."""
    from heliograph.messages import Data  # noqa: PLC0415 - heavy, and of this mode alone
    from heliograph.site import Beacon  # noqa: PLC0415
    from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline  # noqa: PLC0415
    from heliograph_services.decoder.config import DecoderConfig  # noqa: PLC0415
    from heliograph_services.decoder.core import make_core as make_decoder  # noqa: PLC0415
    from heliograph_services.event_source.config import EventSourceConfig  # noqa: PLC0415
    from heliograph_services.event_source.stream import open_stream  # noqa: PLC0415
    from heliograph_services.tracker.config import TrackerConfig  # noqa: PLC0415
    from heliograph_services.tracker.core import make_core as make_tracker  # noqa: PLC0415

    rng = np.random.default_rng(seed)
    lines = ["".join(chr(c) for c in rng.integers(97, 123, 16)) for _ in range(64)]
    packet_us = layout_of(16, arguments.rate).bits * 200.0
    first = int(500_000 / packet_us) + 1
    site = Beacon(name="a", protocol="packet", payload=7, bit_rate=5000, options={"rate": arguments.rate})
    pipeline = Pipeline(
        make_tracker(TrackerConfig(), ONE_PROCESS), make_decoder(DecoderConfig(beacons=(site,)), ONE_PROCESS)
    )
    said: list[Data] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.toml"
        path.write_text(SCENARIO.format(rate=arguments.rate, text="\\n".join(lines)))
        seconds = ((first + n) * packet_us + 2_000.0) / 1e6
        settings = EventSourceConfig(backend="simulated", scenario=str(path), duration_s=seconds, seed=seed % 100)
        for step in open_stream(settings, ONE_PROCESS):
            said += [message for message in pipeline.feed(step.messages) if isinstance(message, Data)]
    right = 0
    for k in range(first, first + n):
        end_us = (k + 1) * packet_us
        right += any(m.text == lines[k % len(lines)] and abs(m.t_us - end_us) < packet_us / 2 for m in said)
    corrupt = sum(message.text not in lines for message in said)
    return {"trials": n, "delivered": right, "corrupt": corrupt}


def interval(right: int, n: int) -> tuple[float, float]:
    """Return Wilson's interval of 95 %."""
    z = 1.959964
    middle = (right + z * z / 2) / (n + z * z)
    half = z * np.sqrt(right * (n - right) / n + z * z / 4) / (n + z * z)
    return float(middle - half), float(middle + half)


MODES: dict[str, Callable[[argparse.Namespace, int, int], dict[str, int]]] = {
    "soft": soft,
    "noise": soft,
    "light": light,
    "events": events,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mode", choices=sorted(MODES))
    parser.add_argument("--n", type=int, required=True)
    parser.add_argument("--dropped", type=float, default=0.0)
    parser.add_argument("--burst", type=float, default=20.0)
    parser.add_argument("--rate", default="2/3")
    parser.add_argument("-o", type=Path)
    arguments = parser.parse_args()
    setting = f"{NAME} {arguments.mode} rate={arguments.rate} dropped={arguments.dropped:g} burst={arguments.burst:g}"
    stored: dict[str, Any] = json.loads(arguments.o.read_text()) if arguments.o and arguments.o.is_file() else {}
    row = stored.setdefault(setting, {"evidence": "simulated", "chunks": 0, "looks": 0, "cpu_s": 0.0, "counts": {}})
    row["looks"] += 1
    while row["counts"].get("trials", 0) < arguments.n:
        n = min(CHUNK[arguments.mode], arguments.n - row["counts"].get("trials", 0))
        began = time.process_time()
        for name, value in MODES[arguments.mode](
            arguments, zlib.crc32(f"{setting} {row['chunks']}".encode()), n
        ).items():
            row["counts"][name] = row["counts"].get(name, 0) + value
        row["chunks"] += 1
        row["cpu_s"] = round(row["cpu_s"] + time.process_time() - began, 2)
        if arguments.o:
            arguments.o.write_text(json.dumps(stored, indent=1) + "\n")
    counts = row["counts"]
    low, high = interval(counts["delivered"], counts["trials"])
    print(f"{setting}: {counts}; delivered {counts['delivered'] / counts['trials']:.5f} [{low:.5f}, {high:.5f}]")
    each_us = row["cpu_s"] / counts["trials"] * 1e6
    print(f"corrupt below {3.0 / counts['trials']:.2g} (95 %) if none; {each_us:.0f} us each")


if __name__ == "__main__":
    main()
