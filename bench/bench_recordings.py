"""Character errors on the two outdoor recordings of Wang et al. 2022, and what decoding them costs.

    python bench/bench_recordings.py [FOLDER] [-o bench/results/recordings.json]

FOLDER holds `504hz_100m.mat`, `3125hz_30m.mat` and `sonnet.txt` (for academic use only, not part of this project;
see github.com/ziweiWWANG/Event-Beacon-Communication). Each recording begins within an earlier pass of the text,
pauses, and holds one whole pass. CER = (S + D + I) / characters sent, by edit distance: of the whole pass, and of all
that was read, against as many last characters of an earlier pass as were read of it, and the whole one.
The receiver is given the nominal bit rate and nothing else. Evidence: recording; development data.
"""

from __future__ import annotations

import argparse
import io
import json
import statistics
import time
from contextlib import redirect_stdout
from pathlib import Path

from heliograph.edits import edits
from heliograph_services.cli.decode import run

RECORDINGS = {"504hz_100m.mat": "504", "3125hz_30m.mat": "3125"}
REPEATS = 3


def decoded(file: Path, rate: str) -> tuple[str, dict[str, object], float]:
    """Return the joined texts, the summary, and the seconds it took."""
    out = io.StringIO()
    start = time.perf_counter()
    with redirect_stdout(out):
        assert run([str(file), "--protocol", "uart", "--bit-rate", rate, "--json"]) == 0
    took_s = time.perf_counter() - start
    lines = [json.loads(line) for line in out.getvalue().splitlines()]
    return "".join(line["text"] for line in lines if line["type"] == "message"), lines[-1], took_s


def measured(folder: Path, name: str, rate: str) -> dict[str, object]:
    """Return the figures of one recording."""
    sonnet = (folder / "sonnet.txt").read_text()
    runs = [decoded(folder / name, rate) for _ in range(REPEATS)]
    text, summary, _ = runs[0]
    assert all(again == text for again, _, _ in runs)
    earlier = max(0, len(text) - len(sonnet))
    whole = edits(sonnet, text[earlier:]).errors
    everything = edits(sonnet[-earlier:] + sonnet, text).errors
    duration_s = float(str(summary["duration_us"])) / 1e6
    return {
        "recording": name,
        "bit_rate": float(rate),
        "characters_read": len(text),
        "whole_pass_in_it": sonnet in text,
        "whole_pass_cer": whole / len(sonnet),
        "cer": everything / (earlier + len(sonnet)),
        "refused": summary["refused"],
        "times_real_time": round(duration_s / statistics.median(took for _, _, took in runs), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "beacon"
    parser.add_argument("folder", nargs="?", type=Path, default=beside)
    parser.add_argument("-o", "--out", type=Path)
    arguments = parser.parse_args()
    results = [measured(arguments.folder, name, rate) for name, rate in RECORDINGS.items()]
    text = json.dumps(results, indent=1)
    print(text)
    if arguments.out:
        arguments.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
