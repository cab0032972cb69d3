"""Tunes the receivers that ours is compared with: one setting each for all studies, chosen on development seeds.

    python bench/tune_others.py [--jobs N]          about 15 CPU minutes; writes bench/results/tuned_others.json

Scenes are those of the studies `bit_rate`, `distance` and `moving`, shorter, one seed each (11, 12, 13). What our
tracker and decoder hand to another receiver, as published, is kept; each setting of its grid reads it again. Chosen is
what reads the largest share of the frames, the mean over scenes: that of `heliograph.link.paper.TUNED`,
`heliograph.link.wang2022.tuned` and `heliograph.link.binning.TUNED_EVENTS`. `hindsight` is the mean of what the best
setting of each scene reads: more than an operator could choose.

A frame that is read counts as right if one with its payload was sent by any beacon of the scene and ended within half a
frame of it, one to one. Where a receiver gave up, the decoder made a new one: what was handed over ends there too.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from heliograph.link.binning import WINDOW_US
from heliograph.link.contract import LinkFrame, Receiver
from heliograph.link.modulations import modulation, seed11, uart
from heliograph.link.paper import PaperParameters, PaperReceiver
from heliograph.link.wang2022 import WangParameters, WangReceiver, published
from heliograph.units import bit_us
from heliograph_services.cli.studies import bit_rate, contest, distance, moving
from heliograph_services.cli.studies.link_scenes import scenario

RESULT: Final = Path(__file__).parent / "results" / "tuned_others.json"
SEEDS: Final = {"bit_rate": 11, "distance": 12, "moving": 13}
RATES: Final = (100.0, 250.0, 500.0, 1000.0, 2000.0, 2500.0, 3500.0)
# Two distances for each light and lens: where nearly all is read, and about where it ends.
DISTANCES_M: Final = {
    ("indoors", 3.6): (11.5, 50.0), ("indoors", 16.0): (11.5, 50.0),
    ("sun", 3.6): (11.5, 30.0), ("sun", 16.0): (30.0, 75.0),
}  # fmt: skip
BINNING_RATE_MOST: Final = 500.0
MAJORITY: Final = 2.0**-31
Job = tuple[str, str, dict[str, Any]]
Heard = dict[str, Any]


def jobs() -> list[Job]:
    """Return the scenes: study, what is sent, parameters."""
    out: list[Job] = []
    for sends in ("repeats", "text"):
        for rate in RATES:
            cell = bit_rate._cell(sends, bit_rate.MAIN, rate, 0, seconds=max(2.5, 25 * 11 / rate))  # noqa: SLF001
            out.append(("bit_rate", sends, cell))
        for (light, focal_mm), rate in product(DISTANCES_M, (100.0, 1000.0, 2500.0)):
            for metres in DISTANCES_M[light, focal_mm]:
                seconds = 4.5 if rate == 100.0 else 2.0
                cell = distance._cell(sends, light, focal_mm, rate, metres, seconds)  # noqa: SLF001
                out.append(("distance", sends, cell))
    for name, condition in moving.BY_NAME.items():
        if name != moving.NRP:
            sends = "repeats" if condition.protocol == "seed11" else "text"
            out.append(("moving", sends, {"condition": name, "rate": condition.bit_rate}))
    return out


class _Kept:
    """A receiver that keeps what it is fed with."""

    def __init__(self, inner: Receiver, fed: list[Any]) -> None:
        self._inner, self._fed = inner, fed

    def feed(self, t_us: Any, on: Any, until_us: int) -> Any:
        self._fed.append((np.array(t_us), np.array(on), int(until_us)))
        return self._inner.feed(t_us, on, until_us)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def _keep(into: list[list[Any]]) -> None:
    for kind, others in ((seed11.Seed11, ("paper",)), (uart.Uart, ("wang2022",))):
        made = getattr(kind, "plain_receiver", kind.receiver)
        kind.plain_receiver = made  # type: ignore[union-attr]

        def receiver(self: Any, rate: float, name: str = "default", made: Any = made, others: Any = others) -> Any:
            one = made(self, rate, name)
            if name not in others:
                return one
            into.append([])
            return _Kept(one, into[-1])

        kind.receiver = receiver  # type: ignore[method-assign,assignment]


def heard(job: Job) -> Heard:
    """Run a scene; return its frames, and what was handed to the receivers."""
    study, sends, cell = job
    rate, seed = float(cell["rate"]), SEEDS[study]
    if study == "moving":
        condition = moving.BY_NAME[cell["condition"]]
        text = scenario(condition, seed, repeats=sends == "repeats")
        seen = contest.Scene(text, 3.0, condition.protocol, rate)
    else:
        seen = {"bit_rate": bit_rate, "distance": distance}[study].scene(cell, seed)
    fed: list[list[Any]] = []
    _keep(fed)
    sent = contest.watch(seen, seed, ["paper" if sends == "repeats" else "wang2022"]).sent
    frames = np.stack([sent.t0_us, sent.t1_us, sent.payload, sent.visible])
    return {"sends": sends, "rate": rate, "frames": frames[:, np.argsort(sent.t1_us, kind="stable")], "fed": fed}


def paper_grid() -> list[PaperParameters]:
    """Return the settings of the paper's receiver, the published one first."""
    grid = product((1.0, 0.75, 0.5, 0.35, 0.25, 0.15), (0.5, 0.25), (5, 2, 1))
    return [PaperParameters(), *(PaperParameters(*one) for one in grid)]


def binning_grid(rate: float) -> list[PaperParameters]:
    """Return the settings of `binning`, the described one first."""
    width = WINDOW_US / bit_us(rate)
    grid = [(MAJORITY, 1), *product((MAJORITY, 0.25, 0.5, 0.75), (2, 5, 10, 20, 40))]
    return [PaperParameters(width, *one) for one in grid]


def wang_grid(rate: float) -> list[WangParameters]:
    """Return the settings of `wang2022`, the published one first."""
    was = published(rate)
    grid = product((1.0, 0.5, 0.25, 0.12, 0.06, 0.03, 0.015), (1 / 3, 2 / 3, 1.0), (0.5, 0.6), (0.1, 0.3))
    return [WangParameters(was.upper * k, was.lower * k, cut, middle=at, window=by) for k, cut, at, by in grid]


def share_read(of: Heard, receivers: Sequence[Receiver]) -> float:
    """Return the share of the frames that count which fresh receivers, one for each that was fed, read right."""
    read: list[tuple[int, int]] = []
    for one, fed in zip(receivers, of["fed"], strict=True):
        out: list[Any] = []
        for t_us, on, until_us in fed:
            out += one.feed(t_us, on, until_us)
        read += [(frame.t_us, frame.payload) for frame in [*out, *one.flush()] if isinstance(frame, LinkFrame)]
    t0_us, t1_us, payload, counts = of["frames"]
    half_us = (t1_us - t0_us) // 2
    used = np.zeros(len(t1_us), np.bool_)
    for t_us, said in read:
        low, high = np.searchsorted(t1_us, [t_us - half_us.max(), t_us + half_us.max() + 1])
        near = np.arange(low, high)
        near = near[~used[near] & (payload[near] == said) & (np.abs(t1_us[near] - t_us) <= half_us[near])]
        if len(near):
            used[near[np.argmin(np.abs(t1_us[near] - t_us))]] = True
    return float((used & (counts > 0)).sum() / max(counts.sum(), 1))


def shares(path: Path) -> dict[str, list[float]]:
    """Return, by receiver, the share that each setting reads of what was kept in a file."""
    with np.load(path, allow_pickle=True) as kept:
        of: Heard = kept["heard"].item()
    rate, code = of["rate"], modulation("seed11").code  # type: ignore[attr-defined]
    out: dict[str, list[float]] = {}
    if of["sends"] == "text":
        out["wang2022"] = [share_read(of, [WangReceiver(rate, p) for _ in of["fed"]]) for p in wang_grid(rate)]
        return out
    grids = {"paper": paper_grid(), **({"binning": binning_grid(rate)} if rate <= BINNING_RATE_MOST else {})}
    for name, grid in grids.items():
        out[name] = [share_read(of, [PaperReceiver(code, rate, p) for _ in of["fed"]]) for p in grid]
    return out


def _keep_scene(job: tuple[Path, Job]) -> Path:
    path, scene = job
    np.savez(path, heard=np.array(heard(scene), object))
    return path


def all_shares(cores: int) -> Iterator[dict[str, list[float]]]:
    """Yield the shares of each scene."""
    with tempfile.TemporaryDirectory(prefix="heliograph-tune-") as folder, ProcessPoolExecutor(cores) as pool:
        named = [(Path(folder) / f"{i}.npz", job) for i, job in enumerate(jobs())]
        paths = list(pool.map(_keep_scene, named))
        for i, one in enumerate(pool.map(shares, paths)):
            print(f"{i + 1} of {len(named)} scenes", file=sys.stderr)
            yield one


def main() -> int:
    """Tune; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    found: dict[str, list[list[float]]] = {}
    for one in all_shares(parser.parse_args().jobs):
        for name, row in one.items():
            found.setdefault(name, []).append(row)
    # Settings as they are at 1 kbit/s.
    grids = {"paper": paper_grid(), "binning": binning_grid(1000.0), "wang2022": wang_grid(1000.0)}
    result = {"seeds": SEEDS, "receivers": {}}
    for name, rows in sorted(found.items()):
        table = np.array(rows)
        mean = table.mean(axis=0)
        best = int(np.argmax(mean))
        result["receivers"][name] = {  # type: ignore[index]
            "scenes": len(rows),
            "settings": len(mean),
            "published": round(float(mean[0]), 4),
            "tuned": round(float(mean[best]), 4),
            "hindsight": round(float(table.max(axis=1).mean()), 4),
            "chosen_at_1000_bit_s": asdict(grids[name][best]),
        }
    RESULT.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(result["receivers"], indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
