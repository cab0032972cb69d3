"""The table of methods: what counts for a method whose receiver decides by windows, not by frames."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from heliograph_services.cli.studies.contest import Run
from heliograph_services.cli.studies.methods import windows
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
