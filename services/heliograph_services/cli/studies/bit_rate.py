"""Study 1: MAR of a still beacon at 50 cm over its bit rate, in every read-out mode of the DVXplorer Mini.

The paper's "Static OCC performance" over bit rate. `seed11` for ours and the genie, with a new payload for every frame;
the paper's receiver takes it for granted that a payload repeats and has scenes of its own in which it does; `wang2022`,
the baseline of the paper's figure, reads text (`uart`), beside our receiver of text. A run draws from its seed the
beacon's phase, a clock within 100 ppm of the nominal one, and a place on the pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from heliograph_services.cli.studies import contest
from heliograph_services.cli.studies.contest import Scene
from heliograph_services.cli.studies.link_scenes import TEXT_LETTERS
from heliograph_services.cli.studies.study import Cell, Counts, Curve, Done, Panel, Parameters, Size, Study, Table

# Scans of a quiet sensor, us (docs/sensors.md).
SCAN_US: Final = {
    "VARIABLE_5000": 199.0,
    "VARIABLE_2000": 499.0,
    "VARIABLE_10000": 99.6,
    "VARIABLE_15000": 65.0,
    "CONSTANT_100": 10_000.0,
    "CONSTANT_200": 5_000.0,
    "CONSTANT_500": 2_000.0,
    "CONSTANT_1000": 1_000.0,
    "CONSTANT_LOSSY_2000": 500.0,
    "CONSTANT_LOSSY_5000": 200.0,
    "CONSTANT_LOSSY_10000": 100.0,
}
# The paper's camera runs so, as far as its figure tells: over .94 up to 2.5 kbit/s.
MAIN: Final = "VARIABLE_5000"
RATES: Final = (100.0, 250.0, 500.0, 1000.0, 2000.0, 2250.0, 2500.0, 3500.0)
# Bit rate x scan of the other modes: from four scans a bit to one.
BITS_A_SCAN: Final = (0.25, 0.4, 0.5, 0.8)
QUOTED: Final = "> .94"
QUOTED_RATE: Final = 2500.0
CLOCK_PPM: Final = 100.0
ARMS: Final = {
    "fresh": ["ours", "core"],
    "repeats": list(contest.PAPERS.values()),
    "text": ["ours", *contest.WANGS.values()],
}

SCENARIO: Final = """about = "a still beacon at 50 cm, indoors"
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
mode = "{mode}"
path = {{ kind = "still", at_m = [0.0, 0.0, 0.5] }}
lens = {{ focal_mm = 3.6, f_number = 2.0 }}
[[beacon]]
name = "a"
protocol = "{protocol}"
{says}
bit_rate = {rate}
clock_ppm = {ppm}
start_us = {start_us}
path = {{ kind = "still", at_m = [{x_m}, {y_m}, 0.0] }}
"""


def cells(size: Size) -> list[Parameters]:
    """Return all cells: what is sent, mode, bit rate, number of the run."""
    if size == "quick":
        quick = [("fresh", MAIN, rate, 0) for rate in (500.0, 2500.0)] + [("repeats", MAIN, 500.0, 0)]
        return [_cell(*one, seconds=1.5) for one in [*quick, ("text", MAIN, 2000.0, 0)]]
    out = []
    # Twelve runs of five blocks without a loss have a bound of .951.
    for sends, runs in (("fresh", 12), ("repeats", 4), ("text", 3)):
        out += [_cell(sends, MAIN, rate, run, seconds=5.0) for rate in RATES for run in range(runs)]
    for mode, scan_us in SCAN_US.items():
        if mode != MAIN:
            rates = [round(share / scan_us * 1e6) for share in BITS_A_SCAN]
            # At least ten frames beyond those that do not count.
            out += [
                _cell(sends, mode, float(rate), run, seconds=max(2.5, 15 * 11 / rate))
                for sends, runs in (("fresh", 2), ("repeats", 1))
                for rate in rates
                for run in range(runs)
            ]
    return out


def _cell(sends: str, mode: str, rate: float, run: int, *, seconds: float) -> Parameters:
    return {"arms": ARMS[sends], "sends": sends, "mode": mode, "rate": rate, "run": run, "seconds": seconds}


def run(cell: Cell) -> Counts:
    """Run a cell."""
    one = cell.parameters
    return contest.counts(contest.watch(scene(one, cell.seed), cell.seed, one["arms"]))


def scene(one: Parameters, seed: int) -> Scene:
    """Return what is seen."""
    rate, sends = float(one["rate"]), one["sends"]
    rng = np.random.default_rng([seed, round(rate)])
    x_m, y_m = rng.uniform(-0.02, 0.02, 2)
    ppm, start_us = rng.uniform(-CLOCK_PPM, CLOCK_PPM), rng.uniform(0.0, 11e6 / rate)
    says = {
        "fresh": "fresh = true",
        "repeats": "payload = 42",
        "text": f'text = "{letters(rng, rate, one["seconds"])}"',
    }
    text = SCENARIO.format(
        mode=one["mode"],
        protocol="uart" if sends == "text" else "seed11",
        says=says[sends],
        rate=rate,
        ppm=float(ppm),
        start_us=float(start_us),
        x_m=float(x_m),
        y_m=float(y_m),
    )
    return Scene(text, float(one["seconds"]), "uart" if sends == "text" else "seed11", rate)


def letters(rng: np.random.Generator, rate: float, seconds: float) -> str:
    """Return text enough for a run, without repetition."""
    n = min(int(rate / 11.0 * seconds) + 20, 9_000)
    return "".join(TEXT_LETTERS[i] for i in rng.integers(0, len(TEXT_LETTERS), n))


COLUMNS: Final = {**contest.PAPERS, "ours": "ours", "genie": "core"}
TEXT: Final = {**contest.WANGS, "ours": "ours"}


def tables(done: Sequence[Done]) -> list[Table]:
    """Return a table of codes and one of text."""
    codes = [one for one in done if one["sends"] != "text"]
    columns = {**COLUMNS, **contest.plugged(codes)}
    rows = []
    for (mode, rate), some in sorted(contest.grouped(codes, "mode", "rate").items(), key=_order):
        quoted = QUOTED if mode == MAIN and rate <= QUOTED_RATE else "-"
        rows.append(contest.row(f"{mode}, {rate:g} bit/s", some, columns, quoted))
    text = [one for one in done if one["sends"] == "text"]
    said = [
        contest.row(f"{mode}, {rate:g} bit/s", some, TEXT)
        for (mode, rate), some in sorted(contest.grouped(text, "mode", "rate").items(), key=_order)
    ]
    return [
        Table("Codes (`seed11`): MAR_sent", tuple(columns), rows, "The paper's receiver: a payload that repeats."),
        Table("Text (`uart`): characters right", tuple(TEXT), said),
    ]


def _order(item: tuple[tuple[Any, ...], list[Done]]) -> tuple[int, float]:
    mode, rate = item[0]
    return list(SCAN_US).index(mode), rate


def panels(done: Sequence[Done]) -> list[Panel]:
    """Return the curves of the main mode, and ours in all others."""
    main = [one for one in done if one["mode"] == MAIN]
    curves = [
        curve(name, [one for one in main if one["sends"] == sends], arm, "rate")
        for name, sends, arm in (
            ("ours", "fresh", "ours"),
            ("genie", "fresh", "core"),
            ("ours (text)", "text", "ours"),
            *((name, "repeats", arm) for name, arm in contest.PAPERS.items()),
            *((f"{name} (text)", "text", arm) for name, arm in contest.WANGS.items()),
        )
    ]
    fresh = [one for one in done if one["sends"] == "fresh" and one["mode"] != MAIN]
    modes = [curve(mode, some, "ours", "rate") for (mode,), some in contest.grouped(fresh, "mode").items()]
    quoted = [(QUOTED_RATE, 0.94, "the paper (quoted): over .94 up to here")]
    return [
        Panel(f"50 cm, {MAIN}", "bit/s", "MAR_sent", curves, quoted=quoted),
        Panel("ours, other read-out modes", "bit/s", "MAR_sent", modes, log_x=True),
    ]


def curve(name: str, done: Sequence[Done], arm: str, along: str) -> Curve:
    """Return MAR of an arm along a parameter."""
    out = Curve(name, [], [])
    for (x,), some in sorted(contest.grouped(done, along).items()):
        found = contest.mar(some, contest.better_ear(some) if arm == "genie" else arm)
        if found.value is not None and found.low is not None and found.high is not None:
            out.x.append(float(x))
            out.y.append(found.value)
            out.low.append(found.low)
            out.high.append(found.high)
    return out


STUDY: Final = Study(
    name="bit_rate",
    version=1,
    title="A still beacon at 50 cm, over bit rate",
    about=(
        "The paper's static figure. 3.6 mm, indoors (2 W/m2), random phase between bits and scans, clocks within 100"
        " ppm, K = 1. Its curve is read from the text alone: over .94 up to 2.5 kbit/s, then a quick decrease."
    ),
    preset="dvxplorer_mini, 3.6 mm f/2.0, all read-out modes",
    evidence="simulated",
    cells=cells,
    run=run,
    tables=tables,
    panels=panels,
    plugs=True,
)
