"""Runs the cells of studies on several cores: a process a core, one thread each, spawned afresh.

Cells do not depend on each other nor on who runs them. What is done is kept at once, so that an interrupt loses at most
the cells that were being run.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Final

from heliograph.errors import HeliographError
from heliograph_services.cli.studies.catalogue import load
from heliograph_services.cli.studies.study import Cell, Counts, Done

# Libraries that would start threads of their own.
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
Job = tuple[str, Cell]


def run_all(jobs: Sequence[Job], cores: int, run: Callable[[Job], Done] | None = None) -> Iterator[tuple[str, Done]]:
    """Yield each cell as it is done, with its study's name; in order with one core, in any order with more.

    Args:
        jobs: names of studies with cells.
        cores: processes; 1: here.
        run: what runs a job; None: the study's own.

    Raises:
        HeliographError: a cell cannot be run; the message names it.
    """
    run = run or run_job
    if cores == 1 or len(jobs) < 2:
        for job in jobs:
            yield job[0], run(job)
        return
    os.environ |= dict.fromkeys(_THREADS, "1")
    pool = ProcessPoolExecutor(max_workers=min(cores, len(jobs)), mp_context=get_context("spawn"))
    try:
        left = iter(jobs)
        running: dict[Future[Done], str] = {}
        # Two a core: none waits for work, and little is lost when the pool is left.
        for job in _some(left, 2 * cores):
            running[pool.submit(run, job)] = job[0]
        while running:
            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            for one in ended:
                yield running.pop(one), one.result()
            for job in _some(left, len(ended)):
                running[pool.submit(run, job)] = job[0]
    except BrokenProcessPool:
        raise HeliographError("a process that ran cells has died: too little memory? go on with --resume") from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _some(left: Iterator[Job], n: int) -> list[Job]:
    return [job for _, job in zip(range(n), left, strict=False)]


def run_job(job: Job) -> Done:
    """Run a cell of a study.

    Raises:
        HeliographError: it cannot be run; the message names it.
    """
    name, cell = job
    study = load(name)
    began_s = _cpu_s()
    try:
        counts: Counts = study.run(cell)
    except HeliographError as error:
        raise type(error)(f"study {name}, cell {cell.key}: {error}") from None
    return Done(cell, counts, _cpu_s() - began_s)


def _cpu_s() -> float:
    """Return the CPU time of this process and of those that it has started and seen end."""
    return sum(os.times()[:4])
