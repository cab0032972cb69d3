"""A study whose cells cost nothing: the shares of heads of coins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from heliograph.shares import share
from heliograph_services.cli.studies.study import (
    Cell,
    Counts,
    Curve,
    Done,
    Figure,
    Panel,
    Parameters,
    Row,
    Size,
    Study,
    Table,
)


def cells(size: Size) -> list[Parameters]:
    return [{"p": p, "run": run} for p in (0.1, 0.5, 0.9) for run in range(1 if size == "quick" else 4)]


def run(cell: Cell) -> Counts:
    heads = np.random.default_rng(cell.seed).random(50) < cell.parameters["p"]
    return {"blocks": [[10, int(part.sum())] for part in np.split(heads, 5)]}


def done_of(job: tuple[str, Cell]) -> Done:
    return Done(job[1], run(job[1]), 0.0)


def tables(done: Sequence[Done]) -> list[Table]:
    rows = []
    for p in dict.fromkeys(one["p"] for one in done):
        blocks = np.array([block for one in done if one["p"] == p for block in one.counts["blocks"]])
        found = Figure.of(share(blocks[:, 1], blocks[:, 0]))
        rows.append(Row(f"p = {p}", "-", {"ours": found}, "", f"{found.n} throws"))
    return [Table("Heads", ("ours",), rows)]


def panels(done: Sequence[Done]) -> list[Panel]:
    return [Panel("heads", "p", "share", [Curve("p", [one["p"] for one in done], [0.0] * len(done))])]


STUDY: Final = Study("toy", 1, "Coins", "Coins are thrown.", "none", "simulated", cells, run, tables, panels)
