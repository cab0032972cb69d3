"""From the end of a frame to a subscriber in another process: a distribution for every hop.

A recording of beacons at 2 kbit/s (`decoder_corpus`; twenty of them and 1 Mev/s, or as `--beacons` and `--mev-s` say:
five and .25 are as many events a beacon) is played at real time in batches of 1 ms by the source's process; router,
tracker and decoder run beside it, and this process subscribes to `frames`. Of nothing else it asks. All clocks are the
host's monotonic one; camera time is mapped to it by the batch that left earliest: ideal(t) = t + min(sent - t1). A
batch ends at its watermark t1, so a source that is on time sends it at ideal(t1). ::

    half bit     ideal(frame's end) -> the end of the slot that shows how the last bit ended: T / 2
    batch        -> ideal(t1) of the batch that holds it, up to 1 ms
    source       -> sent (its being late)            bus      -> arrived in the decoder's process
    wait         -> taken by its loop                decode   -> the core is through
    publish      -> the last message is out          subscriber -> read and unpacked here, from the decoder's sending

A second counts where the source was on time: 99 in 100 of its batches left no more than `LATE_US` late. That is one
batch: a source that is later sends two where a camera sends one, and what follows waits for it, not for the system.
--late-us says another bound; `by_bound` has the whole for each of `BOUNDS_US`, with the share of the seconds, the last
for all of them. `cores` is processor time a second of each process, all its threads: where they add up to what the
machine has, what is measured is the queue for it.
The first `SKIPPED_S` are the acquisition's, and a frame that ended more than `BACKLOG_US` ago came from it.

Run: OMP_NUM_THREADS=1 python bench/bench_latency.py [--seconds 60] [--beacons 20 5] [--mev-s 1 .25] [-o FILE]
(about 1.3 cores for that long with twenty beacons, half of that with five)
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

import decoder_corpus  # noqa: E402
import live_scenes  # noqa: E402

from heliograph.messages import Frames  # noqa: E402
from support.processes import Host, collecting, free_port  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "latency.json"
SEED, INSIDE = 1, 0.6
BIT_RATE: Final = 2_000.0
# 2000 frames of 11 bits: at the seam of the loop nothing jumps.
RECORDING_S: Final = 11.0
SKIPPED_S: Final = 3.0
LATE_US: Final = 1_000.0
BOUNDS_US: Final = (500.0, 1_000.0, 2_000.0, float("inf"))
BACKLOG_US: Final = 100_000.0
HOPS: Final = (
    "half bit",
    "batch",
    "source",
    "bus",
    "wait",
    "decode",
    "publish",
    "subscriber",
    "whole",
    "source, all",
    "core",
)
SITE: Final = """
site = "latency"
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
window_us = {batch_us}
await_s = 60.0
wait_for = ["tracker", "decoder"]
[[service]]
kind = "tracker"
[[service]]
kind = "decoder"
window_us = {window_us}
{beacons}
"""
BEACON: Final = """
[[beacon]]
name = "{name}"
protocol = "seed11"
payload = {payload}
bit_rate = 2000
"""


def played(
    seconds: float, beacons: int, events_hz: float, batch_us: int, window_us: int
) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """Return the decoder's rows (`timed_decoder`), rows of frames heard here, and the processes' shares of a core.

    A frame's row: its end (camera us), its window's end (camera us), when it was read here (monotonic ns).
    """
    corpus = decoder_corpus.corpus(SEED, RECORDING_S, events_hz, INSIDE, beacons=beacons, bit_rate=BIT_RATE)
    listed = "".join(BEACON.format(name=b.name, payload=b.payload) for b in corpus.beacons)
    with tempfile.TemporaryDirectory(prefix="heliograph-bench-") as name:
        folder = Path(name)
        live_scenes.write_recording(folder / "scene.npz", [corpus.batch], decoder_corpus.WIDTH, decoder_corpus.HEIGHT)
        del corpus
        port = free_port()
        site = SITE.format(
            port=port, file=folder / "scene.npz", seconds=seconds + SKIPPED_S, batch_us=batch_us, window_us=window_us,
            beacons=listed,
        )  # fmt: skip
        host = Host(folder, "latency", site, [])
        rows = folder / "rows.npy"
        try:
            with collecting(port, "latency", ["frames"]) as heard:
                _start_timed(host, rows)
                host.start("tracker")
                host.start("event_source")
                heard.until(lambda h: len(h.messages["frames"]) > 0, "the first frame", 180)
                ended = resource.getrusage(resource.RUSAGE_CHILDREN)
                before_s = ended.ru_utime + ended.ru_stime
                before = _cpu_s(host, before_s), time.monotonic()
                host.wait("event_source", seconds + 120)
                after = _cpu_s(host, before_s), time.monotonic()
        finally:
            host.close()
        share = {kind: round((s - before[0][kind]) / (after[1] - before[1]), 3) for kind, s in after[0].items()}
        frames = [
            (t_us, message.t1_us, round(when * 1e9))
            for message, when in zip(heard.messages["frames"], heard.when["frames"], strict=True)
            if isinstance(message, Frames)
            for t_us in message.t_us
        ]
        return np.load(rows), np.array(frames, np.int64), share


def _start_timed(host: Host, rows: Path) -> None:
    log = (host.folder / "latency-decoder.log").open("ab")
    command = [sys.executable, str(Path(__file__).parent / "timed_decoder.py"), "--site", str(host.path)]
    host.processes["decoder"] = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=host.folder,
        env=os.environ | {"HELIOGRAPH_PARENT": "1", "TIMED_DECODER": str(rows)},
    )  # fmt: skip


def _cpu_s(host: Host, before_s: float) -> dict[str, float]:
    """Return the processor time of each process so far; before_s is that of children that ended earlier."""
    tick = os.sysconf("SC_CLK_TCK")
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    out = {"subscriber": time.process_time()}
    for kind, process in host.processes.items():
        try:
            fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
            out[kind] = (int(fields[11]) + int(fields[12])) / tick
        except OSError:
            # The source, whose recording is over: nobody else ends before.
            out[kind] = ended.ru_utime + ended.ru_stime - before_s
    return out


def hops(
    rows: np.ndarray, frames: np.ndarray, half_bit_us: float, most_late_us: float
) -> tuple[dict[str, np.ndarray], float]:
    """Return each hop's times (us) of the frames that count, and the share of the seconds in which they do.

    `source, all` is of all batches; so is `core`, what a batch takes the decoder whether it holds a frame or not.
    """
    t1_us, sent, arrived, took, through, out = (rows[:, k].astype(np.float64) for k in range(6))
    offset_ns = float(np.min(sent - 1e3 * t1_us))
    late_us = (sent - offset_ns) / 1e3 - t1_us
    second = (t1_us // 1e6).astype(np.int64)
    begun = int(t1_us[0] / 1e6 + SKIPPED_S)
    counted = [s for s in np.unique(second) if s > begun and np.sum(second == s) > 900]
    on_time = [s for s in counted if np.percentile(late_us[second == s], 99) <= most_late_us]
    end_us, window_us, read_ns = (frames[:, k].astype(np.float64) for k in range(3))
    batch = np.searchsorted(t1_us, window_us)
    whole = (read_ns - offset_ns) / 1e3 - end_us
    kept = (batch < len(t1_us)) & np.isin(end_us // 1e6, on_time) & (window_us - end_us < BACKLOG_US)
    batch, end_us, whole, read_ns = batch[kept], end_us[kept], whole[kept], read_ns[kept]
    found = {
        "half bit": np.full(len(batch), half_bit_us),
        "batch": t1_us[batch] - end_us - half_bit_us,
        "source": late_us[batch],
        "bus": (arrived - sent)[batch] / 1e3,
        "wait": (took - arrived)[batch] / 1e3,
        "decode": (through - took)[batch] / 1e3,
        "publish": (out - through)[batch] / 1e3,
        "subscriber": (read_ns - out[batch]) / 1e3,
        "whole": whole,
        "source, all": late_us[np.isin(second, counted)],
        "core": (out - took)[np.isin(second, counted)] / 1e3,
    }
    return found, len(on_time) / max(1, len(counted))


def run(
    seconds: float,
    most_late_us: float,
    beacons: int = 20,
    events_hz: float = 1e6,
    batch_us: int = 1_000,
    window_us: int = 1_000,
) -> dict[str, Any]:
    """Return what was measured."""
    rows, frames, share = played(seconds, beacons, events_hz, batch_us, window_us)
    found, on_time = hops(rows, frames, 0.5e6 / BIT_RATE, most_late_us)
    result: dict[str, Any] = {
        "beacons": beacons, "mev_s": events_hz / 1e6, "most_late_us": most_late_us, "batch_us": batch_us,
        "window_us": window_us, "seconds": seconds, "frames": len(found["whole"]),
        "share_of_seconds_on_time": round(on_time, 3), "cores": share,
    }  # fmt: skip
    for hop in HOPS:
        at = np.percentile(found[hop], [1, 50, 90, 99, 100]) if len(found[hop]) else np.full(5, np.nan)
        result[hop] = dict(zip(("p1", "p50", "p90", "p99", "max"), np.round(at / 1e3, 3).tolist(), strict=True))
    result["by_bound"] = [_whole(rows, frames, bound_us) for bound_us in sorted({*BOUNDS_US, most_late_us})]
    return result


def _whole(rows: np.ndarray, frames: np.ndarray, most_late_us: float) -> dict[str, Any]:
    """Return the whole (ms) over the seconds that keep to a bound, and their share."""
    found, on_time = hops(rows, frames, 0.5e6 / BIT_RATE, most_late_us)
    whole = found["whole"]
    at = np.round(np.percentile(whole, [50, 99]) / 1e3, 3).tolist() if len(whole) else [None, None]
    bound = most_late_us if np.isfinite(most_late_us) else None
    return {"most_late_us": bound, "share": round(on_time, 3), "n": len(whole), "p50": at[0], "p99": at[1]}


def main() -> None:
    """Measure, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--late-us", type=float, default=LATE_US)
    parser.add_argument("--beacons", type=int, nargs="+", default=[20], help="numbers of beacons to measure")
    parser.add_argument("--mev-s", type=float, nargs="+", default=[1.0], help="events of each, Mev/s; the last goes on")
    parser.add_argument("--windows", type=int, nargs="+", default=[1_000], help="decoder windows to measure, us")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    rows = []
    for k, beacons in enumerate(args.beacons):
        events_hz = 1e6 * args.mev_s[min(k, len(args.mev_s) - 1)]
        for window_us in args.windows:
            rows.append(run(args.seconds, args.late_us, beacons, events_hz, window_us=window_us))
            print("\n".join(f"{name}: {value}" for name, value in rows[-1].items()), flush=True)
    about = {"evidence": "simulated", "machine": platform.machine(), "python": platform.python_version(), "unit": "ms"}
    args.output.write_text(json.dumps(about | {"seed": SEED, "runs": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
