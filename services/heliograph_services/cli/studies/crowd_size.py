"""Study 8: 1 to 200 beacons at once, each with a new payload for every frame, on small ellipses at up to .5 m/s.

A scene is spread over the image of a DVXplorer Mini 5 m away, as the scenario `crowd` is. Frames of close pairs (two
blob diameters, docs/metrics.md) are counted with the rest: in a crowd they are part of the matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from heliograph_services.cli.studies import contest
from heliograph_services.cli.studies.bit_rate import curve
from heliograph_services.cli.studies.contest import Scene
from heliograph_services.cli.studies.study import Cell, Counts, Done, Panel, Parameters, Size, Study, Table

SIZES: Final = (1, 2, 5, 10, 20, 50, 100, 200)
RATES: Final = (1000.0, 2000.0)
RUNS: Final = 2
SECONDS_S: Final = 3.0
# The paper's receiver has scenes of its own (a payload repeats), up to as many as `seed11` can tell apart.
PAPERS_MOST: Final = 44

SCENARIO: Final = """about = "a crowd"
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
path = {{ kind = "still", at_m = [0, 0, 5] }}
[[crowd]]
prefix = "tag"
count = {count}
protocol = "seed11"
fresh = {fresh}
bit_rate = {rate}
area_m = [-3.7, -2.7, 3.7, 2.7]
speed_m_s = 0.5
intensity_w_sr = 0.1
diameter_m = 0.01
"""


def cells(size: Size) -> list[Parameters]:
    """Return all cells: beacons, bit rate, whether payloads repeat, run."""
    if size == "quick":
        return [_cell(5, 1000.0, sends, 0, 1.5) for sends in ("fresh", "repeats")]
    return [
        _cell(count, rate, sends, run, SECONDS_S)
        for count in SIZES
        for rate in RATES
        for sends in ("fresh", "repeats")
        for run in range(RUNS if count > 2 else 3 * RUNS)
        if sends == "fresh" or count <= PAPERS_MOST
    ]


def _cell(count: int, rate: float, sends: str, run: int, seconds: float) -> Parameters:
    arms = ["ours", "core"] if sends == "fresh" else list(contest.PAPERS.values())
    return {"arms": arms, "count": count, "rate": rate, "sends": sends, "run": run, "seconds": seconds}


def scene(one: Parameters) -> Scene:
    """Return what is seen."""
    fresh = "true" if one["sends"] == "fresh" else "false"
    text = SCENARIO.format(count=one["count"], rate=one["rate"], fresh=fresh)
    return Scene(text, float(one["seconds"]), "seed11", float(one["rate"]))


def run(cell: Cell) -> Counts:
    """Run a cell."""
    one = cell.parameters
    found = contest.watch(scene(one), cell.seed, one["arms"])
    arm = one["arms"][0]
    tracks = {name for message in found.heard[arm].tracks for name in message.track}
    close = int((found.sent.close & found.sent.visible).sum())
    return contest.counts(found) | {"tracks": len(tracks), "close": close, "visible": int(found.sent.visible.sum())}


COLUMNS: Final = {**contest.PAPERS, "ours": "ours", "genie": "core"}


def tables(done: Sequence[Done]) -> list[Table]:
    """Return MAR by number and bit rate."""
    columns = {**COLUMNS, **contest.plugged(done)}
    rows = []
    for (rate, count), some in sorted(contest.grouped(done, "rate", "count").items()):
        fresh = [one for one in some if one["sends"] == "fresh"]
        visible = sum(one.counts["visible"] for one in fresh)
        close = sum(one.counts["close"] for one in fresh) / max(visible, 1)
        rows.append(contest.row(f"{count} at {rate:g} bit/s ({close:.3f} of the frames in close pairs)", some, columns))
    return [Table("MAR_sent", tuple(columns), rows, "No sequence of this kind is in the paper.")]


def panels(done: Sequence[Done]) -> list[Panel]:
    """Return a panel for each bit rate."""
    out = []
    for (rate,), some in contest.grouped(done, "rate").items():
        curves = [curve(name, some, arm, "count") for name, arm in COLUMNS.items()]
        out.append(Panel(f"{rate:g} bit/s", "beacons", "MAR_sent", curves, log_x=True))
    return out


STUDY: Final = Study(
    name="crowd_size",
    version=1,
    title="Number of beacons",
    about=(
        "1 to 200 beacons of .1 W/sr and 10 mm at 5 m, each on its own ellipse at up to .5 m/s, `seed11`, K = 1, a new"
        " payload for every frame (one that repeats for the paper's receiver); close pairs included."
    ),
    preset="dvxplorer_mini (VARIABLE_5000), 3.6 mm f/2.0",
    evidence="simulated",
    cells=cells,
    run=run,
    tables=tables,
    panels=panels,
    plugs=True,
)
