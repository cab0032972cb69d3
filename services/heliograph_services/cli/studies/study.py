"""What a study is: cells that are run apart, and tables that are made of their counts.

A *cell* is a setting with a seed; running it yields counts (plain values for JSON), and nothing but its parameters and
its seed decides them. A *table* is made of the counts of all cells: added, then divided (docs/metrics.md). So cells can
be run in any order, on any number of cores, today and tomorrow, and a table can be made again without running anything.

The seed of a cell comes from the study's name, the release tag and the cell's parameters without those that PAIRED
names: cells that differ in them alone see the same scene. Release `development` has the seeds 0 to 99, all others seeds
from 1000 on.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from heliograph.shares import Share, difference, share

# `long` differs from `full` where bounds of rare things take hours.
Size = Literal["quick", "full", "long"]
Evidence = Literal["simulated", "recording", "simulated light, real processes"]
Parameters = dict[str, Any]
Counts = dict[str, Any]

DEVELOPMENT: Final = "development"
DEVELOPMENT_SEEDS: Final = 100
FIRST_SEED: Final = 1_000
# Who reads, or by which link the readers are joined, does not change what is seen.
PAIRED: Final = frozenset({"arms", "link"})


@dataclass(frozen=True, slots=True)
class Cell:
    """What is run at a time, in at most a minute of a core.

    Args:
        parameters: plain values for JSON, unique in a study.
        seed: of all that is drawn.
    """

    parameters: Parameters
    seed: int

    @property
    def key(self) -> str:
        """What tells it from the study's other cells."""
        return key_of(self.parameters)


@dataclass(frozen=True, slots=True)
class Done:
    """A cell that was run.

    Args:
        cell: which.
        counts: what came of it.
        cpu_s: what it cost.
    """

    cell: Cell
    counts: Counts
    cpu_s: float

    def __getitem__(self, name: str) -> Any:
        """Return a parameter."""
        return self.cell.parameters[name]


@dataclass(frozen=True, slots=True)
class Figure:
    """A value with its 95 % interval; low and high are None where there is none, value where nothing was measured."""

    value: float | None
    low: float | None = None
    high: float | None = None
    n: int = 0
    unit: str = ""

    @classmethod
    def of(cls, found: Share) -> Figure:
        """Return a share as a figure."""
        if not found.n or math.isnan(found.value):
            return cls(None)
        return cls(round(found.value, 5), round(found.low, 5), round(found.high, 5), found.n)

    def __str__(self) -> str:
        if self.value is None:
            return "-"
        unit = f" {self.unit}" if self.unit else ""
        if self.low is None or self.high is None:
            return f"{self.value:g}{unit}"
        if self.unit:
            return f"{self.value:g} [{self.low:g} {self.high:g}]{unit}"
        return f"{self.value:.4f} [{self.low:.4f} {self.high:.4f}]"


@dataclass(frozen=True, slots=True)
class Row:
    """A line of a table.

    Args:
        what: the condition.
        published: the paper's value, quoted; `-` where it has none.
        figures: by column.
        worse: where ours is worse than others that were measured here, in words; empty: nowhere.
        n: of what the figures are made.
        evidence: of the figures.
    """

    what: str
    published: str
    figures: dict[str, Figure]
    worse: str
    n: str
    evidence: Evidence = "simulated"


@dataclass(frozen=True, slots=True)
class Table:
    """A table of the results.

    Args:
        title: above it.
        columns: names of figures, in order.
        rows: its lines.
        note: below it.
    """

    title: str
    columns: tuple[str, ...]
    rows: list[Row]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Curve:
    """A line of a plot: x, y and the interval of y (NaN: none)."""

    name: str
    x: list[float]
    y: list[float]
    low: list[float] = field(default_factory=list)
    high: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Panel:
    """A plot.

    Args:
        title: above it.
        x_label: below it.
        y_label: beside it.
        curves: in it.
        log_x: whether x is logarithmic.
        quoted: (x, y, what) points of the paper.
    """

    title: str
    x_label: str
    y_label: str
    curves: list[Curve]
    log_x: bool = False
    quoted: list[tuple[float, float, str]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Dots:
    """A plot of conditions, one below the other: in each, a dot with its interval for each who reads.

    Args:
        title: above it.
        x_label: below it.
        rows: the conditions, from above.
        dots: by name, a figure for each condition; without a value: no dot.
        log_x: whether x is logarithmic.
        bounds: the figures are what nothing found excludes, but those of the unit `found`.
        quoted: (row, x) of the paper's values.
    """

    title: str
    x_label: str
    rows: list[str]
    dots: dict[str, list[Figure]]
    log_x: bool = False
    bounds: bool = False
    quoted: list[tuple[int, float]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Study:
    """A study.

    Args:
        name: its name, in commands and files.
        version: rises when cells mean something else.
        title: of its section.
        about: what is done, in a paragraph of Markdown.
        preset: sensors and lenses.
        evidence: of its figures.
        cells: parameters of all cells of a size.
        run: one cell; a function of a module's own, so that another process can find it.
        tables: of the cells that are done.
        panels: likewise; None: it has a picture.
        timing: its figures are times of this machine, and differ from run to run.
        plugs: its cells have `arms`, and peers can be among them.
        missing: why it cannot be run here (data that are not shipped); empty: it can.
        picture: draws what was found on a matplotlib axis; instead of panels.
    """

    name: str
    version: int
    title: str
    about: str
    preset: str
    evidence: Evidence
    cells: Callable[[Size], list[Parameters]]
    run: Callable[[Cell], Counts]
    tables: Callable[[Sequence[Done]], list[Table]]
    panels: Callable[[Sequence[Done]], Sequence[Panel | Dots]] | None = None
    timing: bool = False
    plugs: bool = False
    missing: Callable[[], str] | None = None
    picture: Callable[[Sequence[Done], Any], None] | None = None

    def all_cells(self, size: Size, release: str) -> list[Cell]:
        """Return all cells, with their seeds.

        Raises:
            ValueError: two cells have the same parameters.
        """
        cells = [Cell(one, seed_of(self, release, one)) for one in self.cells(size)]
        if len({cell.key for cell in cells}) < len(cells):
            raise ValueError(f"cells of {self.name} must differ")
        return cells


def key_of(parameters: Parameters) -> str:
    """Return parameters as one line, the same for the same values."""
    return json.dumps(parameters, sort_keys=True, separators=(",", ":"))


def seed_of(study: Study, release: str, parameters: Parameters) -> int:
    """Return the seed of a cell: from 0 to 99 in development, from 1000 on otherwise."""
    scene = {name: value for name, value in parameters.items() if name not in PAIRED}
    digest = hashlib.sha256(f"{study.name}/{study.version} {release} {key_of(scene)}".encode()).digest()
    number = int.from_bytes(digest[:4], "little")
    return number % DEVELOPMENT_SEEDS if release == DEVELOPMENT else FIRST_SEED + number


Blocks = npt.NDArray[np.int64]


def worse_than(ours: Blocks, others: dict[str, Blocks]) -> str:
    """Say beside whom ours reads less, beyond chance.

    Where the blocks are of the same frames, the interval of the paired difference lies below 0; else the intervals of
    both shares do not touch.

    Args:
        ours: (k, 2) frames sent and right, by block.
        others: likewise, by name; blocks of the same frames come in the same order.
    """
    said = []
    for name, theirs in others.items():
        if not len(ours) or not len(theirs):
            continue
        if ours.shape == theirs.shape and np.array_equal(ours[:, 0], theirs[:, 0]):
            apart = difference(ours[:, 1], theirs[:, 1], ours[:, 0])
            if apart.high < 0.0:
                said.append(f"{name}: {apart.value:.4f} [{apart.low:.4f} {apart.high:.4f}]")
            continue
        mine, other = share(ours[:, 1], ours[:, 0]), share(theirs[:, 1], theirs[:, 0])
        if mine.high < other.low:
            said.append(f"{name}: {mine.value:.4f} against {other.value:.4f}")
    return "; ".join(said)
