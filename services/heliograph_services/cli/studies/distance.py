"""Study 2: MAR over distance, both lenses, indoors and in the sun; the largest distance that holds (R95).

The paper's "Static OCC performance" over distance. A scene has twelve beacons at one distance, in a grid over the image
with random places on the pixels and clocks within 100 ppm: twelve times as many frames as one beacon gives, each 100 px
or more from the next. Ours and the genie read new payloads, the paper's receiver one that repeats, `wang2022` (the
baseline of the paper's figure) text, all with as many blocks, so that a bound of .95 is within everybody's reach.

R95 is the largest tested distance at which, and below which at every tested distance, the lower 95 % bound of MAR_sent
is at least .95 (docs/metrics.md): it belongs to the beacon's radiant intensity, the lens, the light and the preset.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from heliograph_services.cli.studies import contest
from heliograph_services.cli.studies.bit_rate import curve, letters
from heliograph_services.cli.studies.contest import Scene
from heliograph_services.cli.studies.link_scenes import F_NUMBERS
from heliograph_services.cli.studies.study import (
    Cell,
    Counts,
    Done,
    Figure,
    Panel,
    Parameters,
    Row,
    Size,
    Study,
    Table,
)

ARMS: Final = {
    "fresh": ["ours", *contest.EARS],
    "repeats": list(contest.PAPERS.values()),
    "text": ["ours", *contest.WANGS.values()],
}
DISTANCES_M: Final = (0.5, 1.0, 2.0, 5.0, 11.5, 16.0, 30.0, 50.0, 75.0, 100.0)
LENSES_MM: Final = (3.6, 16.0)
RATES: Final = (100.0, 1000.0, 2500.0)
# W/m2 on the ground, within the camera's band: an office, full sun.
LIGHTS: Final = {"indoors": 2.0, "sun": 500.0}
# Five blocks of a second for each of twelve beacons: sixty without a loss have a bound of .951.
SECONDS_S: Final = 4.5
COLUMNS_ROWS: Final = (4, 3)
SPACING_PX: Final = 150.0
SPREAD_PX: Final = 20.0
# Images of more pixels cost minutes of CPU a second for twelve of them; indoors, nearer than 2 m (3.6 mm) and 11.5 m
# (16 mm), a single beacon shows what happens there, with bounds too weak for R95, which begins beyond.
NEAR_PX: Final = 5.0
NEAR_S: Final = 2.0
DIAMETER_M: Final = 0.02
PITCH_MM: Final = 9e-3
CLOCK_PPM: Final = 100.0
HELD: Final = 0.95
QUOTED: Final = {(11.5, 16.0, 1000.0, "indoors"): ".87", (16.0, 16.0, 100.0, "indoors"): "1.00"}


def is_near(focal_mm: float, distance_m: float) -> bool:
    """Return whether an image is so large that a scene has one beacon, and no part in R95."""
    return DIAMETER_M / distance_m * focal_mm / PITCH_MM > NEAR_PX


def cells(size: Size) -> list[Parameters]:
    """Return all cells: what is sent, light, lens, bit rate, distance."""
    if size == "quick":
        return [_cell(sends, "indoors", 16.0, 1000.0, 16.0, 1.5) for sends in ARMS]
    return [
        _cell(sends, light, focal_mm, rate, distance_m, NEAR_S if is_near(focal_mm, distance_m) else SECONDS_S)
        for light in LIGHTS
        for focal_mm in LENSES_MM
        for rate in RATES
        for distance_m in DISTANCES_M
        for sends in ARMS
        if light == "indoors" or not is_near(focal_mm, distance_m)
    ]


def _cell(sends: str, light: str, focal_mm: float, rate: float, distance_m: float, seconds: float) -> Parameters:
    return {
        "arms": ARMS[sends],
        "sends": sends,
        "light": light,
        "focal_mm": focal_mm,
        "rate": rate,
        "distance_m": distance_m,
        "seconds": seconds,
    }


def run(cell: Cell) -> Counts:
    """Run a cell."""
    return contest.counts(contest.watch(scene(cell.parameters, cell.seed), cell.seed, cell.parameters["arms"]))


def scene(one: Parameters, seed: int) -> Scene:
    """Return what is seen."""
    rng = np.random.default_rng(seed)
    rate, distance_m, focal_mm = (float(one[name]) for name in ("rate", "distance_m", "focal_mm"))
    text = (
        f'about = "still beacons at {distance_m:g} m"\nirradiance_w_m2 = {LIGHTS[one["light"]]}\n'
        f'[camera]\nsensor = "dvxplorer_mini"\npath = {{ kind = "still", at_m = [0, 0, {distance_m}] }}\n'
        f"lens = {{ focal_mm = {focal_mm}, f_number = {F_NUMBERS[focal_mm]} }}\n"
    )
    metres_a_px = PITCH_MM * distance_m / focal_mm
    columns, rows = COLUMNS_ROWS
    protocol = "uart" if one["sends"] == "text" else "seed11"
    for i in range(1 if is_near(focal_mm, distance_m) else columns * rows):
        x_px = (i % columns - (columns - 1) / 2) * SPACING_PX + rng.uniform(-SPREAD_PX, SPREAD_PX)
        y_px = (i // columns - (rows - 1) / 2) * SPACING_PX + rng.uniform(-SPREAD_PX, SPREAD_PX)
        says = {"fresh": "fresh = true", "repeats": "payload = 42"}.get(one["sends"])
        text += (
            f'[[beacon]]\nname = "b{i:02d}"\nprotocol = "{protocol}"\nbit_rate = {rate}\n'
            f"{says or _text(rng, rate, one)}\nclock_ppm = {rng.uniform(-CLOCK_PPM, CLOCK_PPM):.1f}\n"
            f"start_us = {rng.uniform(0.0, 11e6 / rate):.1f}\n"
            f'path = {{ kind = "still", at_m = [{x_px * metres_a_px:.6f}, {y_px * metres_a_px:.6f}, 0] }}\n'
        )
    return Scene(text, float(one["seconds"]), protocol, rate)


def _text(rng: np.random.Generator, rate: float, one: Parameters) -> str:
    return f'text = "{letters(rng, rate, float(one["seconds"]))}"'


def r95(done: Sequence[Done], arm: str) -> Figure:
    """Return the largest distance that holds, in metres; 0 where the nearest does not."""
    reached, tested = 0.0, 0
    far = [one for one in done if not is_near(one["focal_mm"], one["distance_m"])]
    for (distance_m,), some in sorted(contest.grouped(far, "distance_m").items()):
        found = contest.mar(some, contest.better_ear(some) if arm == "genie" else arm)
        tested += found.n
        if found.low is None or found.low < HELD:
            break
        reached = float(distance_m)
    return Figure(reached if tested else None, n=tested, unit="m")


COLUMNS: Final = {**contest.PAPERS, "ours": "ours", "genie": "genie"}
TEXT: Final = {**contest.WANGS, "ours": "ours"}

# What is sent, name of the curve, arm.
DRAWN: Final = (
    ("fresh", "ours", "ours"),
    ("fresh", "genie", "genie"),
    ("text", "ours (text)", "ours"),
    *(("repeats", name, arm) for name, arm in contest.PAPERS.items()),
    *(("text", f"{name} (text)", arm) for name, arm in contest.WANGS.items()),
)


def tables(done: Sequence[Done]) -> list[Table]:
    """Return R95, and MAR at every distance."""
    codes = [one for one in done if one["sends"] != "text"]
    text = [one for one in done if one["sends"] == "text"]
    columns = {**COLUMNS, **contest.plugged(codes)}
    ranges = [*_ranges(codes, columns, "codes"), *_ranges(text, TEXT, "text")]
    names = (*contest.WANGS, *columns)
    rows = [
        contest.row(_name(key), some, columns, QUOTED.get((key[3], key[1], key[2], key[0]), "-"))
        for key, some in contest.grouped(codes, "light", "focal_mm", "rate", "distance_m").items()
    ]
    said = [
        contest.row(_name(key), some, TEXT)
        for key, some in contest.grouped(text, "light", "focal_mm", "rate", "distance_m").items()
    ]
    note = (
        "Of .4 W/sr and 20 mm; 0 m: not even at the nearest, 2 m (3.6 mm) or 11.5 m (16 mm): nearer, large images are"
        " shown by one beacon, without such bounds. `text`: `uart`, the rest `seed11`."
    )
    return [
        Table("R95", names, ranges, note),
        Table("Codes: MAR_sent at each distance", tuple(columns), rows),
        Table("Text: characters right at each distance", tuple(TEXT), said),
    ]


def _name(key: tuple[Any, ...]) -> str:
    light, focal_mm, rate, distance_m = key
    return f"{light}, {focal_mm:g} mm, {rate:g} bit/s, {distance_m:g} m"


def _ranges(done: Sequence[Done], columns: dict[str, str], what: str) -> list[Row]:
    out = []
    for (light, focal_mm, rate), some in contest.grouped(done, "light", "focal_mm", "rate").items():
        figures = {name: r95(some, arm) for name, arm in columns.items()}
        mine = figures["ours"].value or 0.0
        worse = "; ".join(f"{name}: {one.value:g} m" for name, one in figures.items() if (one.value or 0.0) > mine)
        n = f"{sum(one.counts['blocks'].get('ours') is not None for one in some)} distances"
        out.append(Row(f"{what}, {light}, {focal_mm:g} mm, {rate:g} bit/s", "-", figures, worse, n))
    return out


def panels(done: Sequence[Done]) -> list[Panel]:
    """Return a panel for each bit rate (a row), light and lens."""
    out = []
    for (rate, light, focal_mm), some in sorted(contest.grouped(done, "rate", "light", "focal_mm").items()):
        by = {sends: [one for one in some if one["sends"] == sends] for sends in ARMS}
        curves = [curve(name, by[sends], arm, "distance_m") for sends, name, arm in DRAWN]
        quoted = [
            (d, float(value), "the paper (quoted)")
            for (d, f, r, where), value in QUOTED.items()
            if (f, r, where) == (focal_mm, rate, light)
        ]
        title = f"{light}, {focal_mm:g} mm, {rate:g} bit/s"
        out.append(Panel(title, "m", "MAR_sent", curves, log_x=True, quoted=quoted))
    return out


STUDY: Final = Study(
    name="distance",
    version=1,
    title="Still beacons, over distance",
    about=(
        "Twelve beacons of .4 W/sr and 20 mm at one distance, DVXplorer Mini (VARIABLE_5000), 3.6 mm f/2.0 and 16 mm"
        " f/1.4, on ground lit by 2 W/m2 (indoors) or 500 W/m2 (sun), clocks within 100 ppm, K = 1. The paper's range"
        " depends on its beacon's power, which it does not give: its values are for information, as it says itself."
    ),
    preset="dvxplorer_mini (VARIABLE_5000), 3.6 mm f/2.0 and 16 mm f/1.4",
    evidence="simulated",
    cells=cells,
    run=run,
    tables=tables,
    panels=panels,
    plugs=True,
)
