"""The table of methods: what counts for a method whose receiver decides by windows, not by frames."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from heliograph_services.cli.studies.contest import Run
from heliograph_services.cli.studies.methods import tables, windows
from heliograph_services.cli.studies.study import Cell, Done
from heliograph_services.cli.studies.verdicts import MISSING, RIGHT, WRONG

WINDOW_US = 50_000
# 32 periods at 1500 Hz.
FRAME_US = 64_000_000 / 3000


def of_frequency(outcome_at: dict[int, int], hidden: tuple[int, int] = (0, 0)) -> Run:
    """Return a run of 2 s in which the frame nearest to the end of these windows was matched; hidden: not visible."""
    t1_us = np.round(np.arange(1, 94) * FRAME_US).astype(np.int64)
    t0_us = np.round(np.arange(0, 93) * FRAME_US).astype(np.int64)
    outcome = np.full(len(t1_us), MISSING, np.int8)
    for window, verdict in outcome_at.items():
        outcome[np.argmin(np.abs(t1_us - window * WINDOW_US))] = verdict
    visible = (t1_us <= hidden[0]) | (t0_us >= hidden[1])
    sent = SimpleNamespace(t0_us=t0_us, t1_us=t1_us, visible=visible)
    return cast("Run", SimpleNamespace(sent=sent, found={"ours": SimpleNamespace(outcome=outcome)}))


def sums(rows: list[list[int]]) -> Any:
    return np.array(rows, np.int64).reshape(-1, 7)[:, 2:5].sum(axis=0).tolist()


def test_a_frequency_read_in_every_window_is_read_whole_though_a_window_holds_two_frames() -> None:
    rows = windows(of_frequency(dict.fromkeys(range(1, 40), RIGHT)), "ours", WINDOW_US)
    assert sums(rows) == [39, 39, 0]
    assert [row[:2] for row in rows] == [[0, 0], [0, 1]]


def test_windows_that_were_missed_or_misread_count_as_sent() -> None:
    outcome = dict.fromkeys(range(1, 40), RIGHT) | {5: MISSING, 6: WRONG}
    assert sums(windows(of_frequency(outcome), "ours", WINDOW_US)) == [39, 37, 1]


def test_a_window_in_which_a_frame_does_not_count_does_not_count() -> None:
    rows = windows(of_frequency(dict.fromkeys(range(1, 40), RIGHT), (500_000, 600_000)), "ours", WINDOW_US)
    sent, read, wrong = sums(rows)
    assert sent == read < 39
    assert wrong == 0


def one(rate: float, right: list[int], *, distance_m: float = 5.0, moves: bool = False) -> Done:
    """Return a cell of ours: 100 frames in each of its seconds, so many right."""
    blocks = [[0, second, 100, n, 0, 0, 0] for second, n in enumerate(right)]
    parameters = {"method": "ours", "rate": rate, "distance_m": distance_m, "moves": moves}
    return Done(Cell(parameters, 0), {"blocks": {"ours": blocks}, "inserted": {"ours": 0}}, 0.0)


def test_throughput_and_range_lie_between_what_the_bounds_of_mar_give() -> None:
    perfect, good, bad = [100] * 90, [97, 93] * 45, [50] * 90
    cells = [one(500.0, perfect), one(1000.0, perfect), one(2000.0, good), one(2500.0, bad)]
    cells += [one(1000.0, bad, distance_m=40.0), one(1000.0, perfect, moves=True)]
    figures = tables(cells)[0].rows[0].figures
    throughput, goodput, distance = (figures[name] for name in ("throughput", "goodput", "range"))
    assert (throughput.low, throughput.value, throughput.high) == (1000.0, 2000.0, 2000.0)
    assert goodput.value == round(0.95 * 2000 * 6 / 11, 1)
    assert goodput.low is not None
    assert goodput.high is not None
    assert goodput.low < goodput.value < goodput.high
    assert (distance.low, distance.value, distance.high) == (5.0, 5.0, 5.0)
    assert goodput.n == 9000


def test_few_frames_leave_open_what_is_held() -> None:
    cells = [one(500.0, [100] * 3), one(1000.0, [100] * 3), one(1000.0, [100] * 3, moves=True)]
    throughput = tables(cells)[0].rows[0].figures["throughput"]
    assert (throughput.low, throughput.value, throughput.high) == (0.0, 1000.0, 1000.0)
