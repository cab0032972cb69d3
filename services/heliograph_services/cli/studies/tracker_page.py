"""The page of the tracker's study (docs/tracker.md): what was asked beside what came out, then every table.

All figures are made of stored rows; nothing is written by hand. An answer is `yes` if the value and the nearer end of
its 95 % interval fulfil what was asked, `value only` if the value alone does, `no` if it does not. What is reported
without a bound has `-`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from heliograph.shares import difference, lower_bound, share
from heliograph_services.cli.studies import tracker_tables
from heliograph_services.cli.studies.tracker_tables import clear_of, columns, firsts_ms, grouped, occluded

Row = dict[str, Any]

_INTRO: Final = """# The tracker, measured

Made by `python bench/study_tracker.py all --page docs/tracker.md` from the rows in `bench/results/tracker/`; what is
measured, and how: [metrics.md](metrics.md), and the docstring of `bench/study_tracker.py`. Evidence: **simulated**, all
of it. K = 1: every frame is decided on its own. In lockstep, tracks every 100 ms. The genie is the same receivers along
the true paths. Intervals are 95 %: a bootstrap over blocks of run x beacon x 1 s, or the lower bound of Clopper and
Pearson where single beacons or runs are counted.
"""
_CLASSES: Final = (("out", "outside close pairs"), ("in", "inside close pairs"))
# Parts of the curve at a glance.
_SPIN_PX_S: Final = ((0, 3000), (3000, 6000), (6000, 9000), (9000, 11_500))


@dataclass(frozen=True, slots=True)
class Answer:
    """One thing that was asked, and what came out; texts as the page prints them."""

    study: str
    what: str
    asked: str
    found: str
    n: str
    met: str

    def line(self) -> str:
        """Return the row of a Markdown table."""
        return f"| {self.study} | {self.what} | {self.asked} | {self.found} | {self.n} | {self.met} |"


def newest(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of the code that the last row is of: rows of two codes are never mixed."""
    return [row for row in rows if row["code"] == rows[-1]["code"]]


def page(studies: Mapping[str, Sequence[Row]]) -> str:
    """Return the page in Markdown; a study without rows is named as not run.

    Args:
        studies: rows by the study's name, in the order of the page, oldest first.
    """
    kept = {name: newest(rows) for name, rows in studies.items()}
    out = [_INTRO, "## At a glance", "", "| study | what | asked | found | n | met |", "|---|---|---|---|---|---|"]
    out += [answer.line() for name, rows in kept.items() if rows for answer in _ANSWERS[name](rows)]
    if kept.get("moving"):
        out += ["", "## Frames of 20 moving beacons, by condition", "", *_by_condition(kept["moving"])]
    for name, rows in kept.items():
        out += ["", f"## {name}", ""]
        if not rows:
            out.append("Not run.")
            continue
        commits = ", ".join(sorted({row.get("commit", "unknown") for row in rows}))
        out += [f"Commit {commits}.", "", "```text", *tracker_tables.lines(name, rows)[:-1], "```"]
    return "\n".join(out) + "\n"


def _met(value: bool, bound: bool) -> str:
    return ("yes" if bound else "value only") if value else "no"


def _by_condition(rows: Sequence[Row]) -> list[str]:
    """Return the table of MAR_sent beside the genie's."""
    out = [
        "| ground, sensor, speed | bit/s | class | ours | genie | ours - genie | wrong | frames (blocks) | met |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, group in grouped(rows, "background", "sensor", "move", "bit_rate").items():
        where, rate = name.rsplit(" ", 1)
        for key, title in _CLASSES:
            sent, right, wrong = columns(group, (key,), "ours")
            if not sent.sum():
                continue
            genie = columns(group, (key,), "genie")[1]
            gap = difference(right, genie, sent)
            met = _met(gap.value >= -0.01, gap.low >= -0.01) if key == "out" else "-"
            out.append(
                f"| {where} | {rate} | {title} | {share(right, sent)} | {genie.sum() / sent.sum():.4f} | {gap} |"
                f" {wrong.sum() / sent.sum():.5f} | {sent.sum()} ({len(sent)}) | {met} |"
            )
    return out


def _moving(rows: Sequence[Row]) -> list[Answer]:
    out = []
    for name, group in grouped(rows, "background", "sensor", "move").items():
        sent, right, wrong = columns(group, ("out",), "ours")
        gap = difference(right, columns(group, ("out",), "genie")[1], sent)
        n, what = f"{sent.sum()} frames, {len(group)} runs", f"outside close pairs, {name}"
        met = _met(gap.value >= -0.01, gap.low >= -0.01)
        out.append(Answer("moving", f"MAR_sent, ours - genie, {what}", "at least -.01", str(gap), n, met))
        bad = share(wrong, sent)
        met = _met(bad.value <= 0.001, bad.high <= 0.001)
        out.append(Answer("moving", f"wrong frames, {what}", "at most .001", str(bad), n, met))
    return out


def _identities(rows: Sequence[Row]) -> list[Answer]:
    out = []
    for name, group in grouped(rows, "sensor", "move", "bit_rate").items():
        swaps, seconds = sum(row["swaps"] for row in group), sum(row["seconds"] for row in group)
        n = f"{len(group)} runs of {seconds / len(group):.0f} s, 20 beacons"
        out.append(Answer("identities", f"identity swaps, {name} bit/s", "0 in 60 s", str(swaps), n, _none(swaps)))
        rmse = clear_of(group, "tracks_all").rmse_px
        met = "yes" if rmse < 0.5 else "no"
        out.append(Answer("identities", f"tracks' RMSE, {name} bit/s", "under .5 px", f"{rmse:.3f} px", n, met))
    return out


def _crowd(rows: Sequence[Row]) -> list[Answer]:
    firsts = firsts_ms(rows)
    in_time, swaps = sum(t <= 3000 for t in firsts), sum(row["swaps"] for row in rows)
    n, seconds = len(firsts), sum(row["seconds"] for row in rows)
    bound = lower_bound(in_time, n)
    met = _met(in_time >= 0.98 * n, bound >= 0.98)
    found = f"{in_time} of {n} (bound {bound:.3f})"
    return [
        Answer("crowd", "identified within 3 s", "at least 98 of 100", found, f"{n} beacons", met),
        Answer("crowd", "identity swaps", "0 in 30 s", str(swaps), f"{seconds:.0f} s", _none(swaps)),
    ]


def _crossings(rows: Sequence[Row]) -> list[Answer]:
    out, n = [], len(rows)
    for what, kept in (
        ("numbers kept", sum(row["numbers"] == "kept" for row in rows)),
        ("identities right", sum(row["read"] for row in rows)),
        ("both", sum(row["numbers"] == "kept" and row["read"] for row in rows)),
    ):
        out.append(_counted("crossings", what, kept, n, 0.98))
    return out


def _occlusions(rows: Sequence[Row]) -> list[Answer]:
    out = []
    for name, group in (*grouped(rows, "motion", "camera").items(), ("all", list(rows))):
        kept, n, _, _ = occluded(group)
        out.append(_counted("occlusions", f"the same track and payload, {name}", kept, n, 0.95))
    return out


def _handheld(rows: Sequence[Row]) -> list[Answer]:
    sent, right, _ = columns(rows, ("out", "in"), "ours")
    found = share(right, sent)
    met = _met(found.value >= 0.97, found.low >= 0.97)
    n = f"{sent.sum()} frames, {len(rows)} runs"
    return [Answer("handheld", "MAR_sent (visible)", "at least .97", str(found), n, met)]


def _spin(rows: Sequence[Row]) -> list[Answer]:
    out, readers = [], rows[0]["readers"]
    for low, high in _SPIN_PX_S:
        within = [k for k, one in enumerate(rows[0]["bins"]) if low <= one["px_s"][0] < high]
        # Each bin's own blocks: at high speed a second of the one beacon lies in several bins.
        blocks = np.array([block for row in rows for k in within for block in row["bins"][k]["blocks"]], np.int64)
        if not len(blocks):
            continue
        ours, genie = (share(blocks[:, 3 + readers.index(name)], blocks[:, 1]) for name in ("ours", "genie"))
        found, n = f"{ours}, genie {genie.value:.4f}", f"{ours.n} frames, {len(rows)} runs"
        out.append(Answer("spin", f"MAR_sent, {low} to {high} px/s", "the curve below", found, n, "-"))
    return out


def _counted(study: str, what: str, k: int, n: int, asked: float) -> Answer:
    if not n:
        return Answer(study, what, f"at least {asked:g}", "-", "0", "no")
    bound = lower_bound(k, n)
    met = _met(k >= asked * n, bound >= asked)
    return Answer(study, what, f"at least {asked:g}", f"{k / n:.3f} (bound {bound:.3f})", str(n), met)


def _none(count: int) -> str:
    return "no" if count else "yes"


_ANSWERS: Final[dict[str, Callable[[Sequence[Row]], list[Answer]]]] = {
    "moving": _moving,
    "identities": _identities,
    "crowd": _crowd,
    "crossings": _crossings,
    "occlusions": _occlusions,
    "handheld": _handheld,
    "spin": _spin,
}
