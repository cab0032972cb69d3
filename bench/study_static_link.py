"""MAR of a still beacon at 50 cm behind the scans of a DVXplorer Mini, with a payload of its own in every frame.

    python bench/study_static_link.py [--seeds 1000 12] [--budget 50] [-o bench/results/static_link.jsonl]
    python bench/study_static_link.py --page [-o bench/results/static_link.jsonl]

The paper's "Static OCC performance": 3.6 mm, indoors (2 W/m2), `seed11`; K = 1. Each run has a seed, and from it a
phase of the beacon against the scans, a clock within 100 ppm of the nominal, and a place in the image. The same
events go to the whole system (tracker and decoder, default settings) and to the genie (`cli/studies/genie.py`: true
path and bit rate; the receiver is ours). 5 s a run, 12 runs a condition: 199 us scans (VARIABLE_5000) at .1 to 2.5
kbit/s, 65 us (VARIABLE_15000) at 5 kbit/s; 4 to 7 CPU s a run up to 1 kbit/s, 11 to 20 above: 16 minutes in all.
One JSON line a run; what is there is skipped; after `--budget` CPU seconds it stops: start it again.
Development seeds are 0 to 99. Evidence: simulated; nothing is fitted. The paper's receiver there, and ideal edges:
`study_static.py`.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.shares import share
from heliograph_services.cli.studies.running import Reader, Setting, episode
from heliograph_services.cli.studies.verdicts import RIGHT, WRONG, sent_frames, verdicts

RESULTS = Path(__file__).parent / "results" / "static_link.jsonl"
CONDITIONS = (
    *(("VARIABLE_5000", rate) for rate in (100, 250, 500, 1000, 2000, 2250, 2500)),
    ("VARIABLE_15000", 5000),
)
SECONDS_S = 5.0
READERS: tuple[Reader, ...] = ("ours", "genie")
SCENARIO = """
about = "a still beacon at 50 cm, indoors"
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
mode = "{mode}"
path = {{ kind = "still", at_m = [0.0, 0.0, 0.5] }}
lens = {{ focal_mm = 3.6, f_number = 2.0 }}
[[beacon]]
name = "a"
protocol = "seed11"
fresh = true
bit_rate = {rate}
clock_ppm = {ppm}
start_us = {start_us}
path = {{ kind = "still", at_m = [{x_m}, {y_m}, 0.0] }}
"""


def row(mode: str, rate: int, seed: int) -> dict[str, Any]:
    """Return the counts of a run, a second a block."""
    rng = np.random.default_rng([seed, rate])
    x_m, y_m = rng.uniform(-0.02, 0.02, 2)
    text = SCENARIO.format(
        mode=mode,
        rate=float(rate),
        ppm=float(rng.uniform(-100.0, 100.0)),
        start_us=float(rng.uniform(0.0, 11e6 / rate)),
        x_m=float(x_m),
        y_m=float(y_m),
    )
    began_s = time.process_time()
    decoder = {"protocol": "seed11", "bit_rate": float(rate)}
    run = episode(Setting(text, seed, SECONDS_S, decoder), READERS)
    sent = sent_frames(run.truths, run.paths)
    counted = sent.visible
    second = sent.t1_us[counted] // 1_000_000
    out: dict[str, Any] = {"mode": mode, "rate": rate, "seed": seed, "sent": np.bincount(second).tolist()}
    for name in READERS:
        told = verdicts(sent, run.said[name].frames, run.paths)
        right = (told.outcome == RIGHT)[counted]
        wrong = int((told.outcome == WRONG)[counted].sum()) + told.insertions
        out[name] = {"right": np.bincount(second, right).astype(int).tolist(), "wrong": wrong}
    return out | {"cpu_s": round(time.process_time() - began_s, 1)}


def page(rows: list[dict[str, Any]]) -> str:
    """Return the section for docs/results.md."""
    seeds = sorted({one["seed"] for one in rows})
    out = [
        "## A still beacon at 50 cm",
        "",
        "DVXplorer Mini, 3.6 mm, `seed11`, a new payload for every frame, K = 1; random phase between bits and scans,",
        f"clocks within 100 ppm; seeds {seeds[0]} to {seeds[-1]}, {SECONDS_S:.0f} s each. 95 % intervals over blocks",
        "of 1 s. `wrong`: wrong and inserted frames, of those published. Evidence: simulated",
        "(`bench/study_static_link.py`).",
        "",
        "| bit/s | scan | frames | MAR_sent, ours | wrong, ours | MAR_sent, genie | wrong, genie |",
        "|---|---|---|---|---|---|---|",
    ]
    for mode, rate in CONDITIONS:
        of = [one for one in rows if (one["mode"], one["rate"]) == (mode, rate)]
        if not of:
            continue
        sent = [n for one in of for n in one["sent"]]
        cells = [str(rate), "199 us" if mode == "VARIABLE_5000" else "65 us", str(sum(sent))]
        for name in READERS:
            right = [n for one in of for n in one[name]["right"]]
            wrong = sum(one[name]["wrong"] for one in of)
            cells += [str(share(right, sent)), f"{wrong} of {sum(right) + wrong}"]
        out.append(f"| {' | '.join(cells)} |")
    return "\n".join(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 12), metavar=("FIRST", "RUNS"))
    parser.add_argument("--budget", type=float, default=50.0, help="CPU seconds")
    parser.add_argument("--page", action="store_true")
    parser.add_argument("-o", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    rows = [json.loads(line) for line in arguments.o.read_text().splitlines()] if arguments.o.exists() else []
    if arguments.page:
        print(page(rows))
        return
    done = {(one["mode"], one["rate"], one["seed"]) for one in rows}
    first, runs = arguments.seeds
    for seed in range(first, first + runs):
        for mode, rate in CONDITIONS:
            if (mode, rate, seed) in done:
                continue
            if time.process_time() > arguments.budget:
                print("more to do: start it again")
                return
            one = row(mode, rate, seed)
            print({name: one[name] for name in ("rate", "seed", *READERS, "cpu_s")}, flush=True)
            with arguments.o.open("a") as file:
                file.write(json.dumps(one) + "\n")


if __name__ == "__main__":
    main()
