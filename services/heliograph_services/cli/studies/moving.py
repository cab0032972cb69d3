"""Study 3: the table of moving beacons: the paper's simulated camera with and without flow, and 2 m/s at 5 m and 16 m.

The conditions are those of `link_scenes`. Who reads, the same events for all:

    ours          source, tracker and decoder as shipped; cold start, nothing known but protocol and bit rate
    ours/flow     the same with the flow network, where the paper has it (the simulated camera)
    paper/flow    the paper's receiver behind the paper's tracker, with flow, and paper/still without it
    genie         our receivers along the true path at the true bit rate, with the better of two ears
    paper         the paper's receiver on our tracks, as published and tuned; text: `wang2022`, likewise

The paper's receiver takes it for granted that a payload repeats: it has scenes of its own, in which it does. Every
frame that ours lost has a cause, the first that holds: *wrong* (published with other bits), *no track* (the tracker's
newest message has none within the beacon's gate), *region off* (none of the decoder's regions is within it), *refused*.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.core import Core
from heliograph_services.cli.pipeline import ONE_PROCESS
from heliograph_services.cli.studies import contest
from heliograph_services.cli.studies.contest import Scene
from heliograph_services.cli.studies.link_scenes import CONDITIONS, Condition, scenario
from heliograph_services.cli.studies.study import Cell, Counts, Done, Dots, Figure, Parameters, Row, Size, Study, Table
from heliograph_services.cli.studies.verdicts import RIGHT, WRONG, gates_px, tracked
from heliograph_services.decoder.config import DecoderConfig

BY_NAME: Final = {condition.name: condition for condition in CONDITIONS}
CAUSES: Final = ("wrong", "no track", "region off", "refused")
RUNS: Final = 6
# deploy/sites/paper.toml
PAPERS_TRACKER: Final[dict[str, Any]] = {
    "period_us": 100_000,
    "cluster_window_us": 20_000,
    "shape": "paper",
    "cost": "l1",
}
PAPERS_FLOW: Final[dict[str, Any]] = {"flow": "numba", "flow_reading": "paper", "flow_l_tau": 0.5, "prediction": "flow"}
TRACKERS: Final[dict[str, dict[str, Any]]] = {
    "ours/flow": {"flow": "numba", "prediction": "both"},
    "paper/flow": {**PAPERS_TRACKER, **PAPERS_FLOW},
    "paper/still": {**PAPERS_TRACKER, "prediction": "none"},
}
NRP: Final = "construction_site_nrp"
# MAR and BAR: hardware (published), and its simulation (published). It does not say with which lens it moved.
QUOTED: Final = {
    "5 m, 3.6 mm": ("MAR .65, BAR .94", "-"),
    "16 m, 16 mm": ("MAR .27, BAR .87", "-"),
    "11.5 m, 1 kbit/s": ("MAR .87", "-"),
    "16 m, 100 bit/s": ("MAR 1.00", "-"),
    NRP: ("with flow MAR .74, BAR .75; without .71, .72", "-"),
}


def cells(size: Size) -> list[Parameters]:
    """Return all cells: condition, whether payloads repeat, run."""
    if size == "quick":
        return [_cell("16 m, 16 mm", sends, 0, 1.5) for sends in ("fresh", "repeats")]
    return [
        _cell(condition.name, sends, run, condition.seconds)
        for condition in CONDITIONS
        for sends in (("fresh", "repeats") if condition.protocol == "seed11" else ("fresh",))
        for run in range(RUNS)
    ]


def _cell(name: str, sends: str, run: int, seconds: float) -> Parameters:
    condition = BY_NAME[name]
    if sends == "repeats":
        arms = [*contest.PAPERS.values(), *(("paper/flow", "paper/still") if name == NRP else ())]
    elif condition.protocol == "uart":
        arms = ["ours", *contest.WANGS.values(), *contest.EARS]
    else:
        arms = ["ours", "ours/flow", *contest.EARS] if name == NRP else ["ours", *contest.EARS]
    return {"arms": arms, "condition": name, "sends": sends, "run": run, "seconds": seconds}


class _Watched:
    """Makes the decoder of ours, and keeps where its regions are."""

    def __init__(self) -> None:
        self.places: list[npt.NDArray[np.float64]] = []
        self._decoder: Any = None

    def make(self, config: DecoderConfig) -> Core:
        """Make the decoder."""
        from heliograph_services.decoder.core import make_core  # noqa: PLC0415 - compiles on import

        self._decoder = make_core(config, ONE_PROCESS)
        core: Core = self._decoder
        return core

    def step(self) -> None:
        """Keep (2, n) x and y of all regions."""
        following = getattr(self._decoder, "_following", None)
        self.places.append(np.zeros((2, 0)) if following is None else following.regions.motion()[:2].copy())


def run(cell: Cell) -> Counts:
    """Run a cell."""
    one = cell.parameters
    condition = BY_NAME[one["condition"]]
    text = scenario(condition, cell.seed, repeats=one["sends"] == "repeats")
    seen = Scene(text, float(one["seconds"]), condition.protocol, condition.bit_rate, tracker=TRACKERS)
    watched = _Watched()
    found = contest.watch(seen, cell.seed, one["arms"], ours=watched.make, step=watched.step)
    out = contest.counts(found)
    if contest.OURS in one["arms"]:
        out["lost"] = lost(found, watched.places)
    return out


def lost(found: contest.Run, places: Sequence[npt.NDArray[np.float64]]) -> dict[str, list[int]]:
    """Return, by cause, how many frames ours lost, and how many of them each ear of the genie read."""
    sent, ours = found.sent, found.found[contest.OURS]
    cause = np.full(len(sent.t1_us), CAUSES.index("refused"), np.int64)
    middle_us = (sent.t0_us + sent.t1_us) // 2
    # Regions as of the end of the source's step in which the frame's middle lies.
    step = np.minimum(np.searchsorted(found.ends_us, middle_us), len(found.ends_us) - 1)
    at_us = np.asarray(found.ends_us, np.int64)[step]
    x_px, y_px = found.paths.places(at_us)
    gate = gates_px(found.paths, at_us)
    for j in range(len(cause)):
        px, py = places[int(step[j])]
        i = int(sent.beacon[j])
        if not np.any(np.hypot(px - x_px[i, j], py - y_px[i, j]) <= gate[i, j]):
            cause[j] = CAUSES.index("region off")
    cause[~tracked(sent, found.heard[contest.OURS].tracks, found.paths)] = CAUSES.index("no track")
    cause[ours.outcome == WRONG] = CAUSES.index("wrong")
    gone = sent.visible & (ours.outcome != RIGHT)
    return {
        name: [int((gone & (cause == i)).sum())]
        + [int((gone & (cause == i) & (found.found[ear].outcome == RIGHT)).sum()) for ear in contest.EARS]
        for i, name in enumerate(CAUSES)
    }


# The end of a row's name.
MAR: Final = ": MAR"
COLUMNS: Final = {**contest.PAPERS, "ours": "ours", "genie": "genie"}
NRP_COLUMNS: Final = {
    "paper's tracker, flow": "paper/flow",
    "paper's tracker, no flow": "paper/still",
    **COLUMNS,
    "ours, flow": "ours/flow",
}
TEXT_COLUMNS: Final = {**contest.WANGS, "ours": "ours", "genie": "genie"}


def tables(done: Sequence[Done]) -> list[Table]:
    """Return a table for each group of conditions: MAR and BAR of codes, characters of text."""
    out: dict[str, list[Row]] = {}
    names: dict[str, dict[str, str]] = {}
    for (name,), some in contest.grouped(done, "condition").items():
        condition = BY_NAME[name]
        columns = TEXT_COLUMNS if condition.protocol == "uart" else NRP_COLUMNS if name == NRP else COLUMNS
        columns = {**columns, **contest.plugged(some)}
        names[condition.group] = columns
        out.setdefault(condition.group, []).extend(_rows(condition, some, columns))
    note = (
        "Lost by ours: frames by cause, in brackets those that the genie's better ear read. The paper does not say with"
        " which lens it moved."
    )
    return [Table(group[0].upper() + group[1:], tuple(names[group]), rows, note) for group, rows in out.items()]


def _rows(condition: Condition, some: Sequence[Done], columns: dict[str, str]) -> list[Row]:
    first = contest.row(f"{condition.name}{MAR}", some, columns, QUOTED.get(condition.name, ("-", "-"))[0])
    ear = contest.EARS.index(contest.better_ear(some)) + 1
    causes = []
    for cause in CAUSES:
        counts = np.array([one.counts["lost"][cause] for one in some if "lost" in one.counts]).sum(axis=0)
        if np.ndim(counts) and counts[0]:
            causes.append(f"{cause} {counts[0]} ({counts[ear]})")
    first = Row(
        first.what,
        first.published,
        first.figures,
        first.worse,
        f"{first.n}; lost: {', '.join(causes) or 'none'}",
    )
    if condition.protocol == "uart":
        # By slot, and of the frames that count: (wrong + missing + inserted) / sent.
        mine = contest.table_of(some, contest.OURS)
        inserted = sum(one.counts["inserted"].get(contest.OURS, 0) for one in some)
        sent = int(mine[:, contest.SENT].sum())
        errors = sent - int(mine[:, contest.READ].sum()) + inserted
        cer = _cer(errors, sent, first.figures["ours"])
        return [first, Row(f"{condition.name}: CER", "-", {"ours": cer}, "", f"{sent} characters")]
    ears = {name: contest.better_ear(some) if arm == "genie" else arm for name, arm in columns.items()}
    if not contest.table_of(some, contest.OURS)[:, contest.BITS].any():
        return [first]
    bars = {name: contest.bar(some, arm) for name, arm in ears.items()}
    return [first, Row(f"{condition.name}: BAR", "-", bars, "", f"{bars['ours'].n} bits")]


def _cer(errors: int, sent: int, right: Figure) -> Figure:
    """Return a character error rate: its interval is as wide as that of the characters that are right."""
    if not sent:
        return Figure(None)
    rate = errors / sent
    if right.value is None or right.low is None or right.high is None:
        return Figure(round(rate, 5), n=sent)
    low, high = rate - (right.high - right.value), rate + (right.value - right.low)
    return Figure(round(rate, 5), round(max(low, 0.0), 5), round(high, 5), sent)


def panels(done: Sequence[Done]) -> list[Dots]:
    """Return MAR_sent of each table's conditions."""
    out = []
    for table in tables(done):
        rows = [row for row in table.rows if row.what.endswith(MAR)]
        said = [re.search(r"MAR (\d?\.\d+)", row.published) for row in rows]
        quoted = [(i, float(one[1])) for i, one in enumerate(said) if one]
        dots = {name: [row.figures.get(name, Figure(None)) for row in rows] for name in table.columns}
        out.append(Dots(table.title, "MAR_sent", [row.what.removesuffix(MAR) for row in rows], dots, quoted=quoted))
    return out


STUDY: Final = Study(
    name="moving",
    version=1,
    title="Moving beacons",
    about=(
        "The paper's table of moving beacons, and what else moves: shuttles at 2 m/s with turns of .2 s, text, sun, a"
        " trembling hand, the paper's simulated camera (images compared) at 50 bit/s up to 28 m. Intervals: bootstrap"
        " over run x beacon x second; K = 1, a new payload for every frame but for the paper's receiver."
    ),
    preset="dvxplorer_mini (VARIABLE_5000), 3.6 mm f/2.0 and 16 mm f/1.4; nrp",
    evidence="simulated",
    cells=cells,
    run=run,
    tables=tables,
    panels=panels,
    plugs=True,
)
