"""Lights that repeat themselves in step with a word are read, and none is told."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph_services.cli.studies import false_alarms, repeaters


def test_flashes_repeat_in_step_with_a_word_within_two_per_cent() -> None:
    rng = np.random.default_rng(1)
    for kind in repeaters.KINDS[:2]:
        for _ in range(10):
            _, (at_us, on), seconds = repeaters.repeater(kind, "seed11", 1000.0, rng)
            assert seconds == pytest.approx(repeaters.WORDS * 0.011)
            times = [at_us[i] - at_us[0] for i in range(2, len(at_us), 2) if on[i]]
            off = [abs(time / 11_000.0 - 1.0) for time in times]
            assert min(off) <= 0.021


def test_none_of_them_is_told_though_some_are_read() -> None:
    row = repeaters.repeaters_row(false_alarms.plan(("code", 2500.0)), "code", 2500.0, 24, 5)
    assert row["candidates"] == 24
    assert row["read"] > 0
    assert row["told"] == []
