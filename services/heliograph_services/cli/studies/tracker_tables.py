"""What the rows of the tracker's study add up to: tables of text, with n and 95 % intervals (`study_tracker.py`)."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from heliograph.shares import difference, lower_bound, share
from heliograph_services.cli.studies.tracking import Clear, Identity
from heliograph_services.cli.studies.tracking_truth import quantile

Row = dict[str, Any]


def lines(study: str, rows: Sequence[Row]) -> list[str]:
    """Return the table of a study."""
    if not rows:
        return [f"{study}: no runs"]
    seeds = sorted(row["run"]["seed"] for row in rows)
    cpu_s = sum(sum(row["cpu_s"].values()) for row in rows)
    codes = ", ".join(sorted({row["code"] for row in rows}))
    head = (
        f"{study}: simulated, n = {len(rows)} runs, seeds {seeds[0]} to {seeds[-1]}, code {codes}, "
        f"{sum(row['seconds'] for row in rows):.0f} s of camera time, {cpu_s:.0f} CPU s ({cpu_s / len(rows):.1f} a run)"
    )
    return [head, *_TABLES[study](rows), ""]


def grouped(rows: Sequence[Row], *names: str) -> dict[str, list[Row]]:
    """Return the rows by these arguments of their runs, joined by spaces, in the order of the texts."""
    groups: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        groups[" ".join(f"{row['run'][name]:g}" if name == "bit_rate" else row["run"][name] for name in names)].append(
            row
        )
    return dict(sorted(groups.items()))


def columns(rows: Sequence[Row], classes: Sequence[str], reader: str) -> npt.NDArray[np.int64]:
    """Return (3, k): sent, right and wrong of a reader, by block of a beacon and a second."""
    blocks: dict[tuple[int, int, int], npt.NDArray[np.int64]] = {}
    for i, row in enumerate(rows):
        at = 3 + 2 * row["readers"].index(reader)
        for name in classes:
            for block in row[name]:
                key, counts = (i, block[0], block[1]), np.array([block[2], *block[at : at + 2]], np.int64)
                blocks[key] = blocks[key] + counts if key in blocks else counts
    return np.array(list(blocks.values()), np.int64).reshape(-1, 3).T


def _mar(rows: Sequence[Row]) -> list[str]:
    """Return the lines of one group: classes, readers, the difference."""
    out = []
    for classes, title in ((("out",), "outside close pairs"), (("in",), "inside"), (("out", "in"), "all visible")):
        sent, right, wrong = columns(rows, classes, "ours")
        if not sum(sent):
            continue
        text = f"  {title:<20} ours {share(right, sent)}"
        for other in ("told", "genie"):
            if all(other in row["readers"] for row in rows):
                _, others, wrong_others = columns(rows, classes, other)
                text += f"  {other} {sum(others) / sum(sent):.4f} (wrong {sum(wrong_others) / sum(sent):.5f})"
                if other == "genie":
                    text += f"  ours - genie {difference(right, others, sent)}"
        out.append(f"{text}  wrong {share(wrong, sent)}  frames {sum(sent)}, blocks {len(sent)}")
    published, insertions = (sum(row["published"]["ours"][i] for row in rows) for i in (0, 1))
    wrong_all = int(columns(rows, ("out", "in"), "ours")[2].sum())
    lost: Counter[str] = Counter()
    for row in rows:
        lost.update(row["lost"])
    square, n = (sum(row["frame_px2"][i] for row in rows) for i in (0, 1))
    rmse = math.sqrt(square / max(n, 1))
    received = 1 - (insertions + wrong_all) / published if published else math.nan
    out.append(
        f"  MAR_received {received:.4f} ({insertions} insertions)  frames' places RMSE {rmse:.3f} px"
        f"  lost outside close pairs {lost['frames']}: without a track {lost['untracked']}, the genie too"
        f" {lost.get('genie_too', '-')}"
    )
    return out


def clear_of(rows: Sequence[Row], which: str) -> Clear:
    """Return the counts of CLEAR MOT of all runs together."""
    return sum((Clear(**row[which]["clear"]) for row in rows), Clear())


def firsts_ms(rows: Sequence[Row]) -> list[float]:
    """Return when each beacon of each run was first identified, infinite where never."""
    return [math.inf if t is None else t / 1e3 for row in rows for t in row["first_us"]]


def occluded(rows: Sequence[Row]) -> tuple[int, int, int, Counter[str]]:
    """Return how many were kept, of how many that were read before; how many were not; and what became of the rest."""
    found = Counter(one["outcome"] for row in rows for one in row["beacons"])
    late = found.pop("late", 0)
    n, kept = sum(found.values()), found.pop("kept", 0)
    return kept, n, late, found


def _tracks(rows: Sequence[Row], which: str) -> str:
    clear = clear_of(rows, which)
    identity = sum((Identity(**row[which]["identity"]) for row in rows), Identity())
    instants = sum(row[which]["instants"] for row in rows)
    gospa = sum(row[which]["gospa_px"] * row[which]["instants"] for row in rows) / max(instants, 1)
    lags = [row[which]["lag_us"] for row in rows if row[which]["lag_us"] is not None]
    return (
        f"  {which.replace('_', ' '):<13} MOTA {clear.mota:.4f}  IDF1 {identity.idf1:.4f}  GOSPA {gospa:.3f} px"
        f"  RMSE {clear.rmse_px:.3f} px  misses {clear.misses}  false {clear.false}  switches {clear.switches}"
        f"  transfers {clear.transfers}  of {clear.objects}  lag {np.mean(lags) / 1e3 if lags else math.nan:.1f} ms"
    )


def _moving(rows: Sequence[Row]) -> list[str]:
    out = []
    for names in (("background", "sensor", "move"), ("background", "sensor", "move", "bit_rate")):
        for name, group in grouped(rows, *names).items():
            out += [name, *_mar(group)]
            if "bit_rate" not in names:
                out += [_tracks(group, "tracks_all"), _tracks(group, "tracks_valid")]
    return out


def _identities(rows: Sequence[Row]) -> list[str]:
    out = []
    for name, group in grouped(rows, "sensor", "move", "bit_rate").items():
        out += [name, *_held(group), _tracks(group, "tracks_all"), _tracks(group, "tracks_valid")]
    return out


def _held(rows: Sequence[Row]) -> list[str]:
    firsts = firsts_ms(rows)
    states: Counter[str] = Counter()
    for row in rows:
        states.update(row["states"])
    in_time = sum(t <= 3000 for t in firsts)
    total = max(sum(states.values()), 1)
    text = (
        f"  identity swaps {sum(row['swaps'] for row in rows)} in {sum(row['seconds'] for row in rows):.0f} s;"
        f" states {total}: confused {states['confused'] / total:.5f}, nowhere {states['nowhere'] / total:.5f};"
        f" identified within 3 s {in_time} of {len(firsts)} (bound {lower_bound(in_time, len(firsts)):.3f});"
        f" first identified (lockstep, period {rows[0]['period_us'] / 1e3:.0f} ms) median {quantile(firsts, 0.5):.0f},"
        f" p95 {quantile(firsts, 0.95):.0f} ms"
    )
    return [text]


def _crowd(rows: Sequence[Row]) -> list[str]:
    return [*_held(rows), *_mar(rows), _tracks(rows, "tracks_all"), _tracks(rows, "tracks_valid")]


def _crossings(rows: Sequence[Row]) -> list[str]:
    out = [f"  {'kind':<14} {'n':>4} {'numbers kept':>18} {'identities right':>22} {'both':>20}  otherwise"]
    groups = grouped(rows, "kind")
    for name, group in (*groups.items(), ("all", list(rows))):
        n, otherwise = len(group), Counter(row["numbers"] for row in group if row["numbers"] != "kept")
        counts = [
            sum(row["numbers"] == "kept" for row in group),
            sum(row["read"] for row in group),
            sum(row["numbers"] == "kept" and row["read"] for row in group),
        ]
        texts = [f"{k} {k / n:.3f} (> {lower_bound(k, n):.3f})" for k in counts]
        out.append(f"  {name:<14} {n:>4} {texts[0]:>18} {texts[1]:>22} {texts[2]:>20}  {dict(otherwise)}")
    out.append(f"  identity swaps published on the way: {sum(row['swaps'] for row in rows)}")
    return out


def _occlusions(rows: Sequence[Row]) -> list[str]:
    out = []
    groups = grouped(rows, "motion", "camera")
    for name, group in (*groups.items(), ("all", list(rows))):
        kept, n, late, found = occluded(group)
        bound = lower_bound(kept, n) if n else math.nan
        out.append(
            f"  {name:<18} kept {kept} of {n}: {kept / max(n, 1):.3f} (> {bound:.3f})"
            f"  {dict(found)}  not read before: {late}"
        )
    hidden = [one["hidden_us"] / 1e3 for row in rows for one in row["beacons"]]
    out.append(f"  hidden for {min(hidden):.0f} to {max(hidden):.0f} ms")
    return out


def _handheld(rows: Sequence[Row]) -> list[str]:
    nowhere, confused = (sum(row[name] for row in rows) for name in ("nowhere", "confused"))
    names = sum(row["names"] for row in rows)
    states = f"  identities published nowhere {nowhere}, confused {confused}; track numbers used {names}"
    return [*_mar(rows), states, _tracks(rows, "tracks_valid")]


def _spin(rows: Sequence[Row]) -> list[str]:
    readers = rows[0]["readers"]
    out = [f"  {'px/s':>12} {'frames':>7} {'tracked':>8}  " + "  ".join(f"{name:<24}" for name in readers)]
    for k, one in enumerate(rows[0]["bins"]):
        blocks = [block for row in rows for block in row["bins"][k]["blocks"]]
        if not blocks:
            continue
        sent = [block[1] for block in blocks]
        shares = [share([block[3 + i] for block in blocks], sent) for i in range(len(readers))]
        near = sum(block[2] for block in blocks) / sum(sent)
        low, high = one["px_s"]
        out.append(f"  {low:>5}..{high:<5} {sum(sent):>7} {near:>8.3f}  " + "  ".join(f"{s!s:<24}" for s in shares))
    return out


_TABLES: dict[str, Callable[[Sequence[Row]], list[str]]] = {
    "moving": _moving,
    "identities": _identities,
    "crowd": _crowd,
    "crossings": _crossings,
    "occlusions": _occlusions,
    "handheld": _handheld,
    "spin": _spin,
}
