"""What the decoder costs from bus bytes: flat out, beside a plain one, by windows, by events, by tracks that are idle.

All of it in one thread and one process: the thread's processor time from the bytes of an `events` record (msgpack) to
the records that the decoder would send (not packed). Twenty beacons at 2 kbit/s, 35 % of the events in their images
(`decoder_corpus`), records of 1 ms; a tracker's message every 100 ms. The first half second warms and acquires.

    flat out    scenes of 5 and of 20 Mev/s: events a second of processor time, and the share of a core at real time
    plain       the same records through a lookup image in numpy, a loop over the tracks and the paper's receiver: where
                nothing moves, and nothing is said but frames
    windows     the decoder's windows of 1, 2 and 5 ms
    events      1 to 20 Mev/s: shares of a core, and a straight line through them
    scans       of 5, 10 and 20 beacons behind scans of 199 us, and without scans: 1 Mev/s, .9 of them in the images
    idle        with 0 to 1000 more tracks that hear nothing; `tracks` is what the tracker's own messages take of it

Each row is the least of `--repeats`: others on the machine only add.

Run: OMP_NUM_THREADS=1 python bench/bench_decoder.py [flat] [windows] [events] [scans] [idle] [--repeats 3]
(about 4 minutes)
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path[:0] = [str(Path(__file__).parent)]

import decoder_corpus  # noqa: E402
from decoder_corpus import HEIGHT, PERIOD_US, RADIUS_PX, WIDTH, Corpus  # noqa: E402

from heliograph.core import Context  # noqa: E402
from heliograph.link.modulations import modulation  # noqa: E402
from heliograph.messages import Frames, Identification  # noqa: E402
from heliograph.streams import Events  # noqa: E402
from heliograph.wire import unpack  # noqa: E402
from heliograph_services.decoder.config import DecoderConfig  # noqa: E402
from heliograph_services.decoder.core import DecoderCore, warm  # noqa: E402

RESULT: Final = Path(__file__).parent / "results" / "decoder_cost.json"
SEED, INSIDE, BATCH_US = 1, 0.35, 1_000
# VARIABLE_5000 of the DVXplorer Mini; and a scene that holds little but beacons, as its simulated ones do.
SCAN_US, SCANNED_INSIDE, SCANNED_HZ = 199.0, 0.9, 1e6
SECONDS: Final = 1.5
SKIPPED_US: Final = 500_000
LIVE: Final = Context(instance="bench", boot="bench", lockstep=False)
Row = dict[str, Any]


def opened(payload: bytes) -> Events:
    """Return the record in a payload."""
    outcome = unpack(payload)
    if not isinstance(outcome, tuple) or not isinstance(outcome[1], Events):
        raise SystemExit(f"not a record of events: {outcome}")
    return outcome[1]


def ours(corpus: Corpus, messages: list[bytes], **settings: Any) -> Row:
    """Return what the decoder takes."""
    core = DecoderCore(DecoderConfig(beacons=corpus.beacons, max_tracks=2_048, **settings), LIVE)
    took = wire = tracks = 0.0
    events = frames = 0
    named: set[str] = set()
    for k, payload in enumerate(messages):
        t_us = k * BATCH_US
        told = t_us > 0 and t_us % PERIOD_US == 0
        if told:
            core.feed(corpus.tracks(t_us))
        start = time.thread_time()
        record = opened(payload)
        middle = time.thread_time()
        out = core.feed(record)
        end = time.thread_time()
        if t_us >= SKIPPED_US:
            took, wire, events = took + end - start, wire + middle - start, events + len(record.batch)
            # The window after a tracker's message, more than the others, is the tracks'.
            tracks += end - start if told else 0.0
            frames += sum(len(one.t_us) for one in out if isinstance(one, Frames))
        named |= {one.beacon for one in out if isinstance(one, Identification)}
    seconds = (len(messages) * BATCH_US - SKIPPED_US) / 1e6
    return {
        "core": took / seconds, "wire": wire / seconds, "tracks": tracks / seconds, "events_s": events / seconds,
        "mev_s_flat_out": events / took / 1e6, "frames_s": frames / seconds,
        "routed": core.counters["events_routed"] / core.counters["events"], "identified": len(named),
    }  # fmt: skip


def plain(corpus: Corpus, messages: list[bytes]) -> Row:
    """Return what the plain decoder takes: numpy, a loop over the tracks, the paper's receiver."""
    labels = np.zeros((HEIGHT, WIDTH), np.uint16)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for i, (cx, cy) in enumerate(corpus.places):
        labels[(x - cx) ** 2 + (y - cy) ** 2 <= (1.5 * RADIUS_PX + 2.5) ** 2] = i + 1
    rates = {beacon.bit_rate for beacon in corpus.beacons}
    receivers = [modulation("seed11").receiver(rates.copy().pop(), "paper") for _ in corpus.places]
    took = 0.0
    events = frames = 0
    for k, payload in enumerate(messages):
        start = time.thread_time()
        batch = opened(payload).batch
        label = labels[batch.y_px, batch.x_px]
        decided = 0
        for i, receiver in enumerate(receivers):
            heard = label == i + 1
            decided += len(receiver.feed(batch.t_us[heard], batch.on[heard], (k + 1) * BATCH_US))
        end = time.thread_time()
        if k * BATCH_US >= SKIPPED_US:
            took, events, frames = took + end - start, events + len(batch), frames + decided
    seconds = (len(messages) * BATCH_US - SKIPPED_US) / 1e6
    return {
        "core": took / seconds, "events_s": events / seconds, "mev_s_flat_out": events / took / 1e6,
        "frames_s": frames / seconds,
    }  # fmt: skip


def least(rows: list[Row]) -> Row:
    """Return the row of the least processor time, rounded, and how many there were."""
    best = min(rows, key=lambda row: float(row["core"]))
    return {name: round(value, 3) for name, value in best.items()} | {"n": len(rows)}


def flat(repeats: int) -> list[Row]:
    """Return rows of the decoder and of the plain one."""
    out = []
    for events_hz in (5e6, 20e6):
        corpus = decoder_corpus.corpus(SEED, SECONDS, events_hz, INSIDE)
        messages = corpus.messages(BATCH_US)
        for name, run in (("decoder", ours), ("plain", plain)):
            out.append(
                {"what": name, "scene_mev_s": events_hz / 1e6} | least([run(corpus, messages) for _ in range(repeats)])
            )
            print(out[-1], flush=True)
        with_paper = least([ours(corpus, messages, receiver="paper") for _ in range(repeats)])
        out.append({"what": "decoder, the paper's receiver", "scene_mev_s": events_hz / 1e6} | with_paper)
        print(out[-1], flush=True)
    return out


def windows(repeats: int) -> list[Row]:
    """Return a row for each length of the decoder's windows."""
    corpus = decoder_corpus.corpus(SEED, SECONDS, 5e6, INSIDE)
    messages = corpus.messages(BATCH_US)
    out = []
    for window_us in (1_000, 2_000, 5_000):
        out.append(
            {"window_us": window_us} | least([ours(corpus, messages, window_us=window_us) for _ in range(repeats)])
        )
        print(out[-1], flush=True)
    return out


def events(repeats: int) -> dict[str, Any]:
    """Return a row for each number of events a second, and the line through them."""
    rows = []
    for mev_s in (1.0, 2.0, 5.0, 10.0, 20.0):
        corpus = decoder_corpus.corpus(SEED, SECONDS, mev_s * 1e6, INSIDE)
        messages = corpus.messages(BATCH_US)
        rows.append({"scene_mev_s": mev_s} | least([ours(corpus, messages) for _ in range(repeats)]))
        print(rows[-1], flush=True)
    mev, core = (np.array([row[name] for row in rows]) for name in ("scene_mev_s", "core"))
    slope, fixed = np.polyfit(mev, core, 1)
    off = float(np.max(np.abs(core - (fixed + slope * mev)) / core))
    return {
        "rows": rows, "core_fixed": round(float(fixed), 3), "core_a_mev_s": round(float(slope), 4),
        "largest_departure": round(off, 3), "ratio_20_to_1": round(float(core[-1] / core[0]), 2),
    }  # fmt: skip


def scans(repeats: int) -> list[Row]:
    """Return a row for each number of beacons, with and without scans."""
    out = []
    for beacons in (5, 10, 20):
        for scan_us in (0.0, SCAN_US):
            corpus = decoder_corpus.corpus(
                SEED, SECONDS, SCANNED_HZ, SCANNED_INSIDE, beacons=beacons, scan_us=scan_us
            )  # fmt: skip
            messages = corpus.messages(BATCH_US)
            row = least([ours(corpus, messages, window_us=5_000) for _ in range(repeats)])
            out.append({"beacons": beacons, "scan_us": scan_us} | row)
            print(out[-1], flush=True)
    return out


def idle(repeats: int) -> list[Row]:
    """Return a row for each number of tracks that hear nothing."""
    out: list[Row] = []
    for n in (1, 10, 100, 1000):
        corpus = decoder_corpus.corpus(SEED, SECONDS, 5e6, INSIDE, idle=n)
        messages = corpus.messages(BATCH_US)
        row = least([ours(corpus, messages) for _ in range(repeats)])
        row["ratio"] = round(row["core"] / out[0]["core"], 2) if out else 1.0
        out.append({"idle": n} | row)
        print(out[-1], flush=True)
    return out


PARTS: Final = {"flat": flat, "windows": windows, "events": events, "scans": scans, "idle": idle}


def main() -> None:
    """Measure, print and store; parts that are not asked for stay as they are."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="all by default")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    args = parser.parse_args()
    warm()
    result: dict[str, Any] = json.loads(args.output.read_text()) if args.output.exists() else {}
    result |= {"evidence": "simulated", "machine": platform.machine(), "python": platform.python_version()}
    result |= {"seed": SEED, "inside": INSIDE, "batch_us": BATCH_US, "seconds": SECONDS - SKIPPED_US / 1e6}
    for name in args.parts or PARTS:
        result[name] = PARTS[name](args.repeats)
    args.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
