"""Fast links on asynchronous sensors: bit errors of toggle OOK, and whether anybody is named where nobody is.

    python bench/study_fast.py bits   [--budget 50] [-o bench/results/fast_bits.jsonl]
    python bench/study_fast.py trials [--budget 50] [-o bench/results/fast_trials.jsonl]
    python bench/study_fast.py page   [--plot docs/plots/fast_bits.png]

`bits`: random bits of a light whose pixels obey `heliograph_services.cli.studies.asynchronous` (jitter, refractory time
and number of pixels are the axes; no noise), +100 ppm, through the clock search, the PLL and the decisions of
`ook_fast`, from a cold start. Counted from bit 600 on (two windows of the search); a bit that was not decided is wrong.
Grid: 3, 10, 30, 60 kbit/s x jitter 1 to 100 us x refractory 1 to 100 us x 9 to 200 pixels, 980 cells, 20,000 bits and a
seed each a run; `--runs` says how many (default 1). About .2 CPU s a cell and run.

`trials`: for each of the four protocols at several bit rates lights that are nobody (noise, lamps, random bits at the
right rate, random telegraphs) and all other protocols, 2 s each a run. Told are identifications and texts, by stranger.

Both append one JSON line a run and skip what is there; after `--budget` CPU seconds they stop: start them again. Seeds
are 0 to runs - 1 (development). Evidence: simulated, at the level of events; nothing is fitted. Blocks of 64 bits,
longer than the memory of the decisions, are the units of the bootstrap.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.errors import Refusals
from heliograph.link.contract import LinkFrame, Text, edges_of
from heliograph.link.modulations import MODULATIONS, modulation
from heliograph.link.ook_bits import OokBits
from heliograph.units import bit_us
from heliograph_services.cli.studies.asynchronous import AsyncPixels, events
from heliograph_services.cli.studies.blocks import share
from heliograph_services.cli.studies.strangers import nobody, others

RESULTS = Path(__file__).parent / "results"
RATES = (60_000, 30_000, 10_000, 3_000)
TIMES_US = (1, 2, 5, 10, 20, 50, 100)
PIXELS = (50, 200, 100, 20, 9)
BITS, FIRST, BLOCK = 20_000, 600, 64
PPM = 100.0
# The protocols on trial, and the bit rates at which they listen.
LISTENERS = {
    "pulse_interval": (5_000.0,),
    "frequency": (260.0, 3_000.0, 16_400.0),
    "ook_fast": (5_000.0, 60_000.0),
    "event_interval": (5_000.0, 100_000.0),
}
TRIAL_S = 2.0


def bit_errors(rate: float, jitter_us: float, refractory_us: float, pixels: int, seed: int) -> list[int]:
    """Return the wrong bits of each block."""
    rng = np.random.default_rng([seed, int(rate), int(jitter_us), int(refractory_us), pixels])
    bits = rng.integers(0, 2, BITS)
    length_us = bit_us(rate) / (1.0 + PPM * 1e-6)
    at_us, levels = edges_of(bits, 100.0, length_us)
    t_us, on = events(at_us, levels, AsyncPixels(pixels, jitter_us, refractory_us), rng)
    wrong = np.ones(BITS, np.bool_)
    for piece in OokBits(rate, Refusals()).feed(t_us, on, int(at_us[-1] + 100.0 * length_us)):
        k = np.round((piece.end_us - 100.0) / length_us).astype(np.int64) - 1
        inside = (k >= 0) & (k < BITS)
        wrong[k[inside]] = bits[k[inside]] != piece.bits[inside]
    whole = (BITS - FIRST) // BLOCK * BLOCK
    counted: list[int] = wrong[FIRST : FIRST + whole].reshape(-1, BLOCK).sum(axis=1).tolist()
    return counted


def bit_cells(runs: int) -> Iterator[dict[str, Any]]:
    """Yield the cells; the fastest and the middle of the images come first."""
    for seed, rate, pixels, jitter_us, refractory_us in product(range(runs), RATES, PIXELS, TIMES_US, TIMES_US):
        yield {"rate": rate, "jitter_us": jitter_us, "refractory_us": refractory_us, "pixels": pixels, "seed": seed}


def bit_row(cell: dict[str, Any]) -> dict[str, Any]:
    wrong = bit_errors(cell["rate"], cell["jitter_us"], cell["refractory_us"], cell["pixels"], cell["seed"])
    # Blocks by how many wrong bits they have.
    return cell | {"blocks": {str(n): wrong.count(n) for n in sorted(set(wrong))}}


def trial_cells(runs: int) -> Iterator[dict[str, Any]]:
    for seed, (protocol, rates) in product(range(runs), LISTENERS.items()):
        for rate in rates:
            yield {"protocol": protocol, "rate": rate, "seed": seed}


def trial_row(cell: dict[str, Any]) -> dict[str, Any]:
    """Let one receiver hear each stranger; return the seconds heard and what it told of them."""
    protocol, rate, seed = cell["protocol"], cell["rate"], cell["seed"]
    kind = modulation(protocol)
    heard_s, told = 0.0, []
    strangers = [*nobody(rate, TRIAL_S, seed), *others(protocol, MODULATIONS, rate, TRIAL_S, seed)]
    for label, t_us, on in strangers:
        if protocol == "frequency" and label == "lamp of bit rate / 2":
            continue  # a lamp of this very frequency, which the protocol cannot tell from a beacon
        receiver = kind.receiver(rate)
        said, start = "", 0
        for until_us in range(10_000, int(TRIAL_S * 1e6) + 10_000, 10_000):
            stop = int(np.searchsorted(t_us, until_us))
            out = receiver.feed(t_us[start:stop], on[start:stop], until_us)
            start = stop
            said += "".join(
                item.text or "" for item in out if isinstance(item, Text) and not isinstance(item, LinkFrame)
            )
            if receiver.identity() is not None or said:
                told.append(label)
                break
        heard_s += TRIAL_S
    return cell | {"heard_s": heard_s, "strangers": len(strangers), "told": told}


def append(path: Path, cells: Iterator[dict[str, Any]], row: Any, budget_s: float) -> None:
    """Run what is not in the file yet, until the budget of CPU time is used up."""
    known = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {json.dumps({k: v for k, v in one.items() if k not in _FIGURES}, sort_keys=True) for one in known}
    left = [cell for cell in cells if json.dumps(cell, sort_keys=True) not in done]
    with path.open("a") as out:
        for i, cell in enumerate(left):
            if time.process_time() > budget_s:
                print(f"{len(left) - i} of {len(left)} left: start again")
                return
            out.write(json.dumps(row(cell)) + "\n")
            out.flush()
    print("complete")


_FIGURES = {"blocks", "heard_s", "strangers", "told"}


def page(plot: str | None) -> None:
    """Print the tables of what has been run."""
    rows = [json.loads(line) for line in (RESULTS / "fast_bits.jsonl").read_text().splitlines()]
    cells: dict[tuple[int, int, int, int], dict[int, int]] = defaultdict(lambda: defaultdict(int))
    for row in rows:
        key = (row["rate"], row["pixels"], row["jitter_us"], row["refractory_us"])
        for wrong, n in row["blocks"].items():
            cells[key][int(wrong)] += n
    for rate, pixels in product(RATES, sorted(PIXELS)):
        if not any(key[:2] == (rate, pixels) for key in cells):
            continue
        print(f"\n{rate} bit/s, {pixels} pixels; BER; columns: refractory time {' '.join(map(str, TIMES_US))} us")
        for jitter_us in TIMES_US:
            texts = [_text(cells.get((rate, pixels, jitter_us, r))) for r in TIMES_US]
            print(f"  jitter {jitter_us:4d} us  " + " ".join(f"{text:>8}" for text in texts))
    asked = {k: v for k, v in cells.items() if k[0] == 60_000 and k[1] >= 50 and k[2] <= 5 and k[3] <= 2}
    print(f"\n60 kbit/s, jitter <= 5 us, refractory <= 2 us, >= 50 pixels: {len(asked)} cells")
    for key, blocks in sorted(asked.items()):
        wrong = np.repeat(list(blocks), list(blocks.values()))
        got = share(wrong, np.full(len(wrong), BLOCK))
        # Without a wrong bit: as if the next block had the 4 that a missed edge costs at most (both its neighbours).
        bound = got.high if wrong.sum() else (1.0 - 0.05 ** (1.0 / len(wrong))) * 4.0 / BLOCK
        print(
            f"  {key[1]:3d} px, jitter {key[2]}, refractory {key[3]}: {wrong.sum()} of {got.n}, 95 % below {bound:.1e}"
        )
    trials = RESULTS / "fast_trials.jsonl"
    if trials.exists():
        heard: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
        for line in trials.read_text().splitlines():
            row = json.loads(line)
            heard[row["protocol"]][0] += row["heard_s"]
            heard[row["protocol"]][1] += len(row["told"])
        print("\nstrangers: camera-track-seconds heard, told, 95 % bound an hour")
        for protocol, (heard_s, told) in heard.items():
            bound_text = f"{3.0 / heard_s * 3600.0:.1f}" if not told else "-"
            print(f"  {protocol:<15} {heard_s:8.0f} s  {told:.0f}  {bound_text}")
    if plot:
        _plot(cells, plot)


def _text(blocks: dict[int, int] | None) -> str:
    if not blocks:
        return "."
    n = sum(blocks.values()) * BLOCK
    wrong = sum(k * v for k, v in blocks.items())
    if wrong > 0.45 * n:
        return "-"
    return "0" if not wrong else f"{wrong / n:.1e}"


def _plot(cells: Any, path: str) -> None:
    import matplotlib as mpl  # noqa: PLC0415 - only where a picture is asked for

    mpl.use("Agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(1, len(RATES), figsize=(14, 3.6), sharey=True, layout="constrained")
    for axis, rate in zip(axes, RATES, strict=True):
        table = np.full((len(TIMES_US), len(TIMES_US)), np.nan)
        for i, jitter_us in enumerate(TIMES_US):
            for k, refractory_us in enumerate(TIMES_US):
                blocks = cells.get((rate, 50, jitter_us, refractory_us))
                if blocks:
                    n = sum(blocks.values()) * BLOCK
                    wrong = sum(w * m for w, m in blocks.items())
                    table[i, k] = np.log10(max(wrong, 0.5) / n)
        image = axis.imshow(table, origin="lower", vmin=-5, vmax=-0.3, cmap="viridis")
        if np.isfinite(table).all():
            axis.contour(table, levels=[-3.0], colors="white")
        axis.set_xticks(range(len(TIMES_US)), TIMES_US)
        axis.set_yticks(range(len(TIMES_US)), TIMES_US)
        axis.set_xlabel("refractory time, us")
        axis.set_title(f"{rate / 1000:g} kbit/s, 50 pixels")
    axes[0].set_ylabel("jitter, us")
    figure.colorbar(image, ax=axes, label="log10 BER (white: 1e-3)")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("bits", "trials", "page"))
    parser.add_argument("--budget", type=float, default=50.0, help="CPU seconds")
    parser.add_argument("--runs", type=int, default=1, help="seeds a cell")
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--plot")
    arguments = parser.parse_args()
    if arguments.what == "bits":
        append(arguments.output or RESULTS / "fast_bits.jsonl", bit_cells(arguments.runs), bit_row, arguments.budget)
    elif arguments.what == "trials":
        path = arguments.output or RESULTS / "fast_trials.jsonl"
        append(path, trial_cells(arguments.runs), trial_row, arguments.budget)
    else:
        page(arguments.plot)


if __name__ == "__main__":
    main()
