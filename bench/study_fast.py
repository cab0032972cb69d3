"""Fast links on asynchronous sensors: bit errors of toggle OOK, and whether anybody is named where nobody is.

    python bench/study_fast.py bits   [--first-seed 0] [--runs 1] [--budget 600] [-o bench/results/fast_bits.jsonl]
    python bench/study_fast.py trials [--first-seed 0] [--runs 1] [--budget 600] [-o bench/results/fast_trials.jsonl]
    python bench/study_fast.py page   [--plot docs/plots/fast_bits.png]

`bits`: random bits of a light whose pixels obey `heliograph_services.cli.studies.asynchronous` (jitter, refractory time
and number of pixels are the axes; no noise), +100 ppm, through the clock search, the PLL and the decisions of
`ook_fast`, from a cold start. Counted from bit 600 on. Grid: 3, 10, 30, 60 kbit/s x jitter 1 to 100 us x refractory 1
to 100 us x 9 to 200 pixels, 980 cells; and 18 more along the border, by jitter in bits. 20,000 bits and a seed each a
run. `--runs 1` takes about 6 minutes of one core.

BER: wrong or withheld bits over bits sent; a run in which no clock was found is .5 by convention, and told apart ("-").
Also kept: how many bits were decided at all, and how many of those were wrong. Where anything was wrong, the genie of
`fast_genie.py`, which knows clock and light, reads the same events.

`trials`: for each of the four protocols at several bit rates lights that are nobody (noise, lamps, random bits at the
right rate, random telegraphs) and all other protocols, 2 s each a run. Told are identifications and texts, by stranger.

Both append one JSON line a run and skip what is there; after `--budget` CPU seconds they stop: start them again.
Development seeds are 0 to 99, a study's from 1000 on. Evidence: simulated, at the level of events; nothing is fitted.
Blocks of 64 bits, longer than the memory of the decisions, are the units of the bootstrap.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import fast_genie
import numpy as np

from heliograph.errors import Refusals
from heliograph.link.contract import LinkFrame, Text, edges_of
from heliograph.link.modulations import MODULATIONS, modulation
from heliograph.link.ook_bits import OokBits
from heliograph.shares import share
from heliograph.units import bit_us
from heliograph_services.cli.studies.asynchronous import AsyncPixels, events
from heliograph_services.cli.studies.strangers import nobody, others

RESULTS = Path(__file__).parent / "results"
RATES = (60_000, 30_000, 10_000, 3_000)
TIMES_US = (1, 2, 5, 10, 20, 50, 100)
PIXELS = (50, 200, 100, 20, 9)
# Along the border: jitter in bits at 60 kbit/s, where pixels are blind for 2 us.
BORDER_BITS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
BORDER_PIXELS = (9, 50, 200)
BORDER_RATE, BORDER_REFRACTORY_US = 60_000, 2
BITS, FIRST, BLOCK = 20_000, 600, 64
BEGIN_US = 100.0
PPM = 100.0
# What is asked for: below it wherever jitter, refractory time and pixels are at most, at most, at least these.
BER_MOST = 1e-3
ASKED = {"rate": 60_000, "jitter_us": 5, "refractory_us": 2, "pixels": 50}
# The preset of the simulated sensor (readout/presets/imx636.toml), whose times are assumed.
PRESET_US = {"jitter_us": 20, "refractory_us": 20}
# The protocols on trial, and the bit rates at which they listen.
LISTENERS = {
    "pulse_interval": (5_000.0,),
    "frequency": (260.0, 3_000.0, 16_400.0),
    "ook_fast": (5_000.0, 60_000.0),
    "event_interval": (5_000.0, 100_000.0),
}
TRIAL_S = 2.0


def bit_row(cell: dict[str, Any]) -> dict[str, Any]:
    """Return a cell with its figures: blocks by wrong or withheld bits, bits decided, wrong ones, the genie's."""
    rate, jitter_us, refractory_us, pixels = (cell[k] for k in ("rate", "jitter_us", "refractory_us", "pixels"))
    rng = np.random.default_rng([cell["seed"], round(rate), round(10 * jitter_us), round(refractory_us), pixels])
    bits = rng.integers(0, 2, BITS)
    length_us = bit_us(rate) / (1.0 + PPM * 1e-6)
    at_us, levels = edges_of(bits, BEGIN_US, length_us)
    t_us, on = events(at_us, levels, AsyncPixels(pixels, jitter_us, refractory_us), rng)
    decided, wrong = np.zeros(BITS, np.bool_), np.zeros(BITS, np.bool_)
    for piece in OokBits(rate, Refusals()).feed(t_us, on, int(at_us[-1] + 100.0 * length_us)):
        k = np.round((piece.end_us - BEGIN_US) / length_us).astype(np.int64) - 1
        inside = (k >= 0) & (k < BITS)
        decided[k[inside]] = True
        wrong[k[inside]] = bits[k[inside]] != piece.bits[inside]
    counted = slice(FIRST, FIRST + (BITS - FIRST) // BLOCK * BLOCK)
    blocks = (wrong | ~decided)[counted].reshape(-1, BLOCK).sum(axis=1).tolist()
    row = cell | {
        "blocks": {str(n): blocks.count(n) for n in sorted(set(blocks))},
        "decided": int(decided[counted].sum()),
        "wrong": int(wrong[counted].sum()),
    }
    if sum(blocks):
        read = fast_genie.read(bits, t_us, on, BEGIN_US, length_us, (pixels, jitter_us, refractory_us))
        row["genie"] = int((read != bits)[counted].sum())
    return row


def bit_cells(seeds: range) -> Iterator[dict[str, Any]]:
    """Yield the cells; the fastest and the middle of the images come first."""
    for seed in seeds:
        for jitter_bits, pixels in product(BORDER_BITS, BORDER_PIXELS):
            jitter_us = round(jitter_bits * bit_us(BORDER_RATE), 1)
            if jitter_us in TIMES_US:
                continue  # in the grid
            yield _cell(BORDER_RATE, jitter_us, BORDER_REFRACTORY_US, pixels, seed)
        for rate, pixels, jitter_us, refractory_us in product(RATES, PIXELS, TIMES_US, TIMES_US):
            yield _cell(rate, jitter_us, refractory_us, pixels, seed)


def _cell(rate: int, jitter_us: float, refractory_us: int, pixels: int, seed: int) -> dict[str, Any]:
    return {"rate": rate, "jitter_us": jitter_us, "refractory_us": refractory_us, "pixels": pixels, "seed": seed}


def trial_cells(seeds: range) -> Iterator[dict[str, Any]]:
    for seed, (protocol, rates) in product(seeds, LISTENERS.items()):
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


Row = Callable[[dict[str, Any]], dict[str, Any]]


def append(path: Path, cells: Iterator[dict[str, Any]], row: Row, budget_s: float) -> None:
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


_FIGURES = {"blocks", "decided", "wrong", "genie", "heard_s", "strangers", "told"}


@dataclass
class Cell:
    """What is known of a light at a rate; counts over runs."""

    blocks: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    runs: int = 0
    locked: int = 0  # runs in which anything was decided
    decided: int = 0
    wrong: int = 0
    genie: int = 0

    def add(self, row: dict[str, Any]) -> None:
        self.runs += 1
        self.decided += row["decided"]
        self.wrong += row["wrong"]
        self.genie += row.get("genie", 0)
        if row["decided"] == 0:
            self.blocks[BLOCK // 2] += sum(row["blocks"].values())
            return
        self.locked += 1
        for wrong, n in row["blocks"].items():
            self.blocks[int(wrong)] += n

    @property
    def sent(self) -> int:
        return sum(self.blocks.values()) * BLOCK

    @property
    def ber(self) -> float:
        """Wrong or withheld over sent, .5 for runs without a clock."""
        return sum(wrong * n for wrong, n in self.blocks.items()) / self.sent

    def text(self) -> str:
        if not self.locked:
            return "-"
        return "0" if not self.ber else f"{self.ber:.1e}"


Key = tuple[int, int, float, float]


def cells_of(path: Path) -> dict[Key, Cell]:
    """Return the cells of a file by rate, pixels, jitter and refractory time."""
    cells: dict[Key, Cell] = defaultdict(Cell)
    for line in path.read_text().splitlines():
        row = json.loads(line)
        cells[row["rate"], row["pixels"], row["jitter_us"], row["refractory_us"]].add(row)
    return dict(cells)


def page(plot: Path | None) -> None:
    """Print the tables of what has been run."""
    cells = cells_of(RESULTS / "fast_bits.jsonl")
    for rate, pixels in product(RATES, sorted(PIXELS)):
        print(
            f"\n{rate} bit/s, {pixels} pixels; BER (-: no clock); columns: refractory {' '.join(map(str, TIMES_US))} us"
        )
        for jitter_us in TIMES_US:
            row = [cells.get((rate, pixels, jitter_us, r)) for r in TIMES_US]
            print(f"  jitter {jitter_us:4d} us  " + " ".join(f"{cell.text() if cell else '.':>8}" for cell in row))
    print(
        "\nBy rate: cells, with a clock in all runs, in none; BER below 1e-3; cells of the others where the genie's is"
    )
    for rate in RATES:
        own = [cell for key, cell in cells.items() if key[0] == rate and key[2] in TIMES_US]
        good = [cell for cell in own if cell.ber < BER_MOST]
        genie = [cell for cell in own if cell.ber >= BER_MOST and cell.genie < BER_MOST * cell.sent]
        locked, never = sum(c.locked == c.runs for c in own), sum(c.locked == 0 for c in own)
        print(f"  {rate:6d} bit/s: {len(own)}, {locked}, {never}; {len(good)}; {len(genie)}")
    print(f"\nAlong the border, {BORDER_RATE} bit/s: BER, of the bits decided, runs with a clock; the genie's BER")
    for pixels, jitter_bits in product(BORDER_PIXELS, BORDER_BITS):
        jitter_us = round(jitter_bits * bit_us(BORDER_RATE), 1)
        if cell := cells.get((BORDER_RATE, pixels, jitter_us, BORDER_REFRACTORY_US)):
            given = f"{cell.wrong / cell.decided:.1e}" if cell.decided else "-"
            print(
                f"  {pixels:3d} px, jitter {jitter_bits:g} bit: {cell.text():>8} {given:>8} {cell.locked}/{cell.runs}"
                f"  {cell.genie / cell.sent:.1e}"
            )
    _asked(cells)
    _strangers()
    if plot:
        draw(cells, plot)


def _asked(cells: dict[Key, Cell]) -> None:
    """Print the cells of which a BER is asked."""
    limits = ASKED["pixels"], ASKED["jitter_us"], ASKED["refractory_us"]
    asked = {
        key: cell
        for key, cell in cells.items()
        if key[0] == ASKED["rate"] and key[1] >= limits[0] and key[2] <= limits[1] and key[3] <= limits[2]
    }
    print(f"\n{ASKED['rate']} bit/s, jitter <= {limits[1]} us, refractory <= {limits[2]} us, >= {limits[0]} pixels")
    for key, cell in sorted(asked.items()):
        bad = np.repeat(list(cell.blocks), list(cell.blocks.values()))
        got = share(bad, np.full(len(bad), BLOCK))
        # Without a wrong bit: as if the next block had the 4 that a missed edge costs at most (both its neighbours).
        bound = got.high if bad.sum() else (1.0 - 0.05 ** (1.0 / len(bad))) * 4.0 / BLOCK
        print(f"  {key[1]:3d} px, jitter {key[2]}, refractory {key[3]}: {bad.sum()} of {got.n}, 95 % below {bound:.1e}")
    total = sum(cell.sent for cell in asked.values())
    print(f"  all: {sum(w * n for cell in asked.values() for w, n in cell.blocks.items())} of {total}")


def _strangers() -> None:
    trials = RESULTS / "fast_trials.jsonl"
    if not trials.exists():
        return
    heard: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for line in trials.read_text().splitlines():
        row = json.loads(line)
        heard[row["protocol"]][0] += row["heard_s"]
        heard[row["protocol"]][1] += len(row["told"])
    print("\nstrangers: camera-track-seconds heard, told, 95 % bound an hour")
    for protocol, (heard_s, told) in heard.items():
        bound_text = f"{3.0 / heard_s * 3600.0:.1f}" if not told else "-"
        print(f"  {protocol:<15} {heard_s:8.0f} s  {told:.0f}  {bound_text}")


def draw(cells: dict[Key, Cell], path: Path) -> None:
    """Draw the BER over jitter and refractory time at each rate, and along the border."""
    import matplotlib as mpl  # noqa: PLC0415 - only where a picture is asked for

    mpl.use("Agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    image: Any = None
    figure, axes = plt.subplots(1, len(RATES) + 1, figsize=(18, 3.9), layout="constrained")
    for axis, rate in zip(axes, RATES, strict=False):
        image = _map(axis, cells, rate)
    figure.colorbar(image, ax=axes[: len(RATES)], label="log10 BER", shrink=0.9)
    axes[0].set_ylabel("jitter, us")
    last = axes[-1]
    for pixels, colour in zip(BORDER_PIXELS, ("C3", "C0", "C2"), strict=True):
        own = [cells.get((BORDER_RATE, pixels, round(x * bit_us(BORDER_RATE), 1), BORDER_REFRACTORY_US))
               for x in BORDER_BITS]  # fmt: skip
        there = [(x, cell) for x, cell in zip(BORDER_BITS, own, strict=True) if cell is not None]
        least = 0.5 / (BITS - FIRST)
        last.semilogy([x for x, _ in there], [max(c.ber, least) for _, c in there], f"{colour}o-", label=f"{pixels} px")
        last.semilogy([x for x, _ in there], [max(c.genie / c.sent, least) for _, c in there], f"{colour}--")
    last.axhline(BER_MOST, color="0.6", lw=0.8)
    last.set_xlabel("jitter, bits")
    last.set_title("60 kbit/s; dashed: genie", fontsize=10)
    last.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def _map(axis: Any, cells: dict[Key, Cell], rate: int) -> Any:
    """Draw the BER of 50 pixels, the border of 9, 50 and 200, and where the preset lies; return the image."""
    n = len(TIMES_US)
    image: Any = None
    for pixels, colour in ((9, "C3"), (50, "white"), (200, "black")):
        table = np.full((n, n), np.nan)
        for i, k in product(range(n), repeat=2):
            if cell := cells.get((rate, pixels, TIMES_US[i], TIMES_US[k])):
                table[i, k] = np.log10(max(cell.ber, 0.5 / cell.sent))
                if pixels == 50 and not cell.locked:
                    axis.text(k, i, "-", ha="center", va="center", color="black")
        if pixels == 50:
            image = axis.imshow(table, origin="lower", vmin=-4.6, vmax=-0.3, cmap="viridis")
        if np.isfinite(table).all() and table.min() < np.log10(BER_MOST) < table.max():
            axis.contour(table, levels=[np.log10(BER_MOST)], colors=[colour], linewidths=2, linestyles="solid")
    axis.plot(TIMES_US.index(PRESET_US["refractory_us"]), TIMES_US.index(PRESET_US["jitter_us"]), "r*", ms=11)
    axis.set_xticks(range(n), TIMES_US)
    axis.set_yticks(range(n), TIMES_US)
    axis.set_xlabel("refractory time, us")
    axis.set_title(f"{rate / 1000:g} kbit/s, 50 pixels", fontsize=10)
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("bits", "trials", "page"))
    parser.add_argument("--budget", type=float, default=600.0, help="CPU seconds")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--runs", type=int, default=1, help="seeds a cell")
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
    if arguments.what == "bits":
        append(arguments.output or RESULTS / "fast_bits.jsonl", bit_cells(seeds), bit_row, arguments.budget)
    elif arguments.what == "trials":
        append(arguments.output or RESULTS / "fast_trials.jsonl", trial_cells(seeds), trial_row, arguments.budget)
    else:
        page(arguments.plot)


if __name__ == "__main__":
    main()
