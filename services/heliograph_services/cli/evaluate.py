"""The paper's figures and tables, beside ours, made on this machine.

Each study leaves in --out: STUDY.jsonl (its cells), STUDY.json (its result),
STUDY.png (where matplotlib is), and all together results.md. A run that was
interrupted goes on with --resume. Without studies: all of them. Exit status 0
if all cells are done.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heliograph import __version__
from heliograph.errors import ConfigError, FileError
from heliograph_services.cli.studies.catalogue import COST_S, STUDIES, load
from heliograph_services.cli.studies.study import Cell, Size, Study

if TYPE_CHECKING:
    from heliograph_services.cli.studies.stored import Book

LIST: Final = "list"


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    parser = argparse.ArgumentParser(
        prog="heliograph evaluate",
        description=__doc__,
        epilog=f"studies; about how many CPU seconds a full and a quick run take:\n{costs()}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("study", nargs="*", metavar="STUDY", help="which studies; `list` names them (default: all)")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="a few cells of each, in minutes")
    size.add_argument("--full", action="store_true", help="all cells, in hours of a core (default)")
    size.add_argument("--long", action="store_true", help="as --full, false alarms for 3 camera-hours a protocol")
    parser.add_argument("--release", default=__version__, metavar="TAG", help="what the seeds come from; `development`")
    parser.add_argument("--out", type=Path, default=Path("results"), metavar="DIR", help="default: results")
    parser.add_argument("--resume", action="store_true", help="go on with the cells that are there")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes (default: cores)")
    parser.add_argument(
        "--peer", action="append", default=[], metavar="MODULE:NAME", help="another decoder beside ours"
    )
    parser.add_argument("--page", action="store_true", help="run nothing; write results.md of what is there")
    parser.add_argument("--json", action="store_true", help="one JSON object a study")
    arguments = parser.parse_args(argv)
    if LIST in arguments.study:
        return _list(as_json=arguments.json)
    for name in arguments.study:
        load(name)
    if not 1 <= arguments.jobs <= 1024:
        raise ConfigError(f"--jobs must be in [1, 1024], not {arguments.jobs}")
    if not arguments.release or len(arguments.release) > 64:
        raise ConfigError(f"--release must have 1 to 64 characters, not {len(arguments.release)}")
    if arguments.page:
        _write_page(arguments.out)
        return 0
    wanted: Size = "quick" if arguments.quick else "long" if arguments.long else "full"
    return evaluate(
        list(dict.fromkeys(arguments.study)) or list(STUDIES),
        wanted,
        arguments.release,
        arguments.out,
        resume=arguments.resume,
        cores=arguments.jobs,
        peers=arguments.peer,
        as_json=arguments.json,
    )


def costs() -> str:
    """Return the studies, a line each, with what they cost, and the sums."""
    lines = [f"  {name:<13}{full:>6} {quick:>4}  {STUDIES[name]}" for name, (full, quick) in COST_S.items()]
    full, quick = (sum(cost[i] for cost in COST_S.values()) for i in range(2))
    return "\n".join([*lines, f"  {'all':<13}{full:>6} {quick:>4}"])


def _list(*, as_json: bool) -> int:
    for name, about in STUDIES.items():
        full, quick = COST_S[name]
        told = {"type": "study", "name": name, "about": about, "full_cpu_s": full, "quick_cpu_s": quick}
        print(json.dumps(told) if as_json else f"{name:<13}{full:>6} {quick:>4}  {about}")
    return 0


def evaluate(
    names: Sequence[str],
    size: Size,
    release: str,
    out: Path,
    *,
    resume: bool,
    cores: int,
    peers: Sequence[str] = (),
    as_json: bool = False,
) -> int:
    """Run studies and write what came of them; return the exit status.

    Args:
        names: of the studies.
        size: of each.
        release: what the seeds come from.
        out: the folder.
        resume: go on with what is there.
        cores: processes.
        peers: MODULE:NAME of decoders that read the scenes beside ours.
        as_json: print JSON.

    Raises:
        ConfigError: cells are there without `resume`, or of another release, size or code; no such peer.
        FileError: the folder cannot be written, a file in it is broken, or a study's data are not here.
    """
    from heliograph_services.cli.bench import this_machine  # noqa: PLC0415 - not needed for --help
    from heliograph_services.cli.studies.peers import factory_of  # noqa: PLC0415
    from heliograph_services.cli.studies.stored import Book  # noqa: PLC0415
    from heliograph_services.cli.studies.workers import run_all  # noqa: PLC0415

    for peer in peers:
        factory_of(peer)
    studies = _runnable(names)
    cells = {
        study.name: [_with(cell, peers if study.plugs else ()) for cell in study.all_cells(size, release)]
        for study in studies
    }
    books = {study.name: Book(out, study, size, release, resume=resume) for study in studies}
    jobs = [(name, cell) for name, some in cells.items() for cell in some if cell.key not in books[name].done]
    for name in dict.fromkeys(name for name, _ in jobs):
        books[name].look(this_machine())
    progress = Progress(len(jobs))
    # Times of real processes are no times beside others'.
    alone = [job for job in jobs if load(job[0]).timing]
    together = [job for job in jobs if not load(job[0]).timing]
    for some, at_once in ((together, cores), (alone, 1)):
        for name, done in run_all(some, at_once):
            books[name].keep(done)
            progress.step(name, done.cpu_s)
    progress.end()
    for study in studies:
        _finish(study, books[study.name], cells[study.name], out, as_json=as_json)
    _write_page(out)
    return 0


def _runnable(names: Sequence[str]) -> list[Study]:
    """Return the studies, without those whose data are not here where all were asked for."""
    out = []
    for study in map(load, names):
        why = study.missing() if study.missing is not None else ""
        if why and len(names) < len(STUDIES):
            raise FileError(f"study {study.name}: {why}")
        if why:
            print(f"left out: study {study.name}: {why}", file=sys.stderr)
        else:
            out.append(study)
    return out


def _with(cell: Cell, peers: Sequence[str]) -> Cell:
    """Return a cell that peers read too, where it has readers and every frame is new."""
    arms = cell.parameters.get("arms")
    if not peers or not arms or "ours" not in arms:
        return cell
    return Cell(cell.parameters | {"arms": [*arms, *peers]}, cell.seed)


def _finish(study: Study, book: Book, cells: Sequence[Cell], out: Path, *, as_json: bool) -> None:
    from heliograph_services.cli.studies.pictures import can_draw, draw  # noqa: PLC0415
    from heliograph_services.cli.studies.stored import result_of, write_result  # noqa: PLC0415

    result = result_of(study, book.head, book.looks, book.done, cells)
    path = out / f"{study.name}.json"
    write_result(path, result)
    done = [book.done[cell.key] for cell in cells if cell.key in book.done]
    if done and can_draw():
        draw(study, done, path.with_suffix(".png"))
    if as_json:
        print(json.dumps({"type": "study", **result}), flush=True)
    else:
        print(f"{study.name}: {result['cells_done']} cells, {result['cpu_s']:.0f} CPU s: {path}", flush=True)


def _write_page(out: Path) -> None:
    from heliograph_services.cli.studies.results_page import page  # noqa: PLC0415
    from heliograph_services.cli.studies.stored import write_whole  # noqa: PLC0415

    if not out.is_dir():
        raise FileError(f"{out}: no folder of results")
    write_whole(out / "results.md", page(out))


class Progress:
    """A line on stderr that says how far it is: overwritten on a terminal, else a line each tenth.

    Args:
        total: cells to run.
    """

    def __init__(self, total: int) -> None:
        self._total = total
        self._done = 0
        self._cpu_s = 0.0
        self._began_s = time.monotonic()
        self._is_terminal = sys.stderr.isatty()

    def step(self, name: str, cpu_s: float) -> None:
        """Count a cell."""
        self._done += 1
        self._cpu_s += cpu_s
        took_s = time.monotonic() - self._began_s
        left_s = took_s / self._done * (self._total - self._done)
        filled = 30 * self._done // self._total
        text = (
            f"[{'#' * filled}{'.' * (30 - filled)}] {self._done}/{self._total} cells, {self._cpu_s:.0f} CPU s,"
            f" {left_s:.0f} s left: {name}"
        )
        if self._is_terminal:
            print(f"\r{text[:79]:<79}", end="", file=sys.stderr, flush=True)
        elif self._done * 10 // self._total > (self._done - 1) * 10 // self._total:
            print(text, file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the line."""
        if self._is_terminal and self._done:
            print(file=sys.stderr)
