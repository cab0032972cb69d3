"""Character errors on the two outdoor recordings of Wang et al. 2022, whole and with a tenth of their events.

    python bench/bench_recordings.py [FOLDER] [-o bench/results/recordings.json]       two minutes of one core

FOLDER holds `504hz_100m.mat`, `3125hz_30m.mat` and `sonnet.txt` (for academic use only, not part of this project;
see github.com/ziweiWWANG/Event-Beacon-Communication). Each recording begins within an earlier pass of the text,
pauses, and holds one whole pass: a cold start in the middle of a pass. All goes through the services' cores, causally,
as `heliograph decode` and as the processes of a site in lockstep do (tests/processes/test_lockstep.py compares them).

What the receiver is told: protocol and nominal bit rate; the protocol alone; nothing. Of each recording all events are
read, and a tenth of them, drawn at random three times.

    cer            (S + D + I) / characters sent, by edit distance, from the first whole character in the recording on
    whole_pass_cer the same of the whole pass alone, whatever stands before it
    wrong          (S + I) / characters printed: what is read and was not sent

Evidence: recording; development data; n = 1 pass each.
"""

from __future__ import annotations

import argparse
import io
import json
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from heliograph.core import Context
from heliograph.edits import edits
from heliograph.events import EventBatch
from heliograph.streams import Events
from heliograph_services.cli.decode import run
from heliograph_services.event_source.cameras.formats.npz import write_npz
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import open_stream

# File, nominal bit rate, whole characters of the earlier pass in it.
RECORDINGS = [("504hz_100m.mat", "504", 104), ("3125hz_30m.mat", "3125", 302)]
TOLD = ["protocol and bit rate", "protocol", "nothing"]
SHARE = 0.1
SEEDS = (0, 1, 2)
SIZE = (1, 1)  # the recordings hold times and polarities of one light; their reader calls that one pixel


@dataclass(frozen=True)
class Reading:
    """One recording read once."""

    recording: str
    told: str
    events_kept: float
    seed: int | None
    printed: int
    cer: float
    whole_pass_cer: float
    wrong: float
    first_text_s: float | None
    identified: list[str]
    times_real_time: float


def in_whole_pass(sonnet: str, text: str) -> int:
    """Return the errors of the last pass: the edit distance of the sonnet to the best of all ends of the text."""
    read = np.frombuffer(text.encode("utf-32-le"), np.uint32)
    column = np.arange(len(read) + 1)
    row = np.zeros(len(read) + 1, np.int64)
    for i, letter in enumerate(sonnet, 1):
        changed = np.minimum(row[:-1] + (read != ord(letter)), row[1:] + 1)
        row = np.minimum.accumulate(np.concatenate([[i], changed]) - column) + column
    return int(row[-1])


def reading(file: Path, name: str, told: str, sent: tuple[str, str], kept: float, seed: int | None) -> Reading:
    """Return what is read of a file; sent is the sonnet, and all that is in the recording."""
    rate = next(rate for recording, rate, _ in RECORDINGS if recording == name)
    protocol = "auto" if told == "nothing" else "uart"
    out = io.StringIO()
    start = time.perf_counter()
    with redirect_stdout(out):
        bit_rate = rate if told == TOLD[0] else "auto"
        assert run([str(file), "--protocol", protocol, "--bit-rate", bit_rate, "--json"]) == 0
    took_s = time.perf_counter() - start
    lines = [json.loads(line) for line in out.getvalue().splitlines()]
    messages = [line for line in lines if line["type"] == "message"]
    text = "".join(line.get("text") or "" for line in messages)
    found = edits(sent[1], text)
    return Reading(
        recording=name,
        told=told,
        events_kept=kept,
        seed=seed,
        printed=len(text),
        cer=round(found.errors / found.sent, 4),
        whole_pass_cer=round(in_whole_pass(sent[0], text) / len(sent[0]), 4),
        wrong=round((found.replaced + found.inserted) / max(len(text), 1), 4),
        first_text_s=(messages[0]["t_us"] - beginning_us(file)) / 1e6 if messages else None,
        identified=sorted(lines[-1]["identifications"]),
        times_real_time=round(lines[-1]["duration_us"] / 1e6 / took_s, 1),
    )


def stream_of(file: Path) -> Iterator[EventBatch]:
    """Yield the events of a recording."""
    config = EventSourceConfig(backend="recording", file=str(file), window_us=100_000, loop=False)
    for step in open_stream(config, Context(instance="bench", boot="0", lockstep=True)):
        yield from (message.batch for message in step.messages if isinstance(message, Events))


def beginning_us(file: Path) -> int:
    """Return the time of the first event of a recording."""
    return int(next(batch for batch in stream_of(file) if len(batch)).t_us[0])


def thinned(file: Path, out: Path, seed: int) -> Path:
    """Write a tenth of the events of a recording, and return the new file."""
    rng = np.random.default_rng(seed)

    def some() -> Iterator[EventBatch]:
        for batch in stream_of(file):
            kept = rng.random(len(batch)) < SHARE
            yield EventBatch(batch.t_us[kept], batch.x_px[kept], batch.y_px[kept], batch.on[kept])

    write_npz(out, *SIZE, some())
    return out


def readings(folder: Path) -> Iterator[Reading]:
    """Yield all of them."""
    sonnet = (folder / "sonnet.txt").read_text()
    with tempfile.TemporaryDirectory() as room:
        for name, _, earlier in RECORDINGS:
            sent = sonnet, sonnet[-earlier:] + sonnet
            files: list[tuple[Path, float, int | None]] = [(folder / name, 1.0, None)]
            files += [(thinned(folder / name, Path(room) / f"{seed}.npz", seed), SHARE, seed) for seed in SEEDS]
            for told in TOLD:
                for file, kept, seed in files:
                    yield reading(file, name, told, sent, kept, seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "beacon"
    parser.add_argument("folder", nargs="?", type=Path, default=beside)
    parser.add_argument("-o", "--out", type=Path)
    arguments = parser.parse_args()
    results: list[Reading] = []
    for one in readings(arguments.folder):
        results.append(one)
        print(
            f"{one.recording:<15} told {one.told:<21} {one.events_kept:>4.0%} of the events, seed {one.seed}:"
            f" CER {one.cer:.4f}, whole pass {one.whole_pass_cer:.4f}, wrong {one.wrong:.4f} of {one.printed},"
            f" first text at {one.first_text_s} s, {', '.join(one.identified)}",
            flush=True,
        )
    for told in TOLD:
        for name, _, _ in RECORDINGS:
            some = [one for one in results if (one.told, one.recording, one.events_kept) == (told, name, SHARE)]
            cer = [one.cer for one in some]
            print(f"{name:<15} told {told:<21} a tenth: mean CER {statistics.mean(cer):.4f} of {cer}")
    if arguments.out:
        arguments.out.write_text(json.dumps([asdict(one) for one in results], indent=1) + "\n")


if __name__ == "__main__":
    main()
