"""A light of few events that shines and moves, and is dark for many bits: what confirms it, and what it is not."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph_services.tracker.backends import chosen
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.shape import Targets
from heliograph_services.tracker.sighting import Rule, Sighting, see, shines
from heliograph_services.tracker.tracks import TrackTable

WINDOW_US = 5_000
RULE = Rule(0.3, 5e-3, 5e-3, 1, 12_000.0, 9_000.0, 8e7)


def target(on: int, off: int, pixels: int = 12) -> Targets:
    """Return one target at (50, 50)."""
    whole = np.ones(1)
    return Targets(
        50 * whole, 50 * whole, np.array([pixels], np.int32), 2.5 * whole, 2.5 * whole, np.array([on], np.int32),
        np.array([off], np.int32), np.zeros(1, np.int32), whole, np.zeros((1, 2)), np.zeros(1, np.uint8),
        np.zeros(1), np.zeros((1, 2)), np.zeros(1), np.zeros(1, np.bool_), np.zeros(1, np.bool_),
    )  # fmt: skip


Windows = list[tuple[int, int] | None]


def followed(windows: Windows, pixels: int = 12) -> TrackTable:
    """Return the row that is seen as these brighter and darker events, or not at all; the last one of `pixels`."""
    table, filters = TrackTable(), chosen(TrackerConfig()).filters
    place, no = np.full((1, 2), 50.0), np.zeros(1, np.int64)
    table.append(
        xy_px=place, var_px2=np.ones(1), radius_px=np.full(1, 2.5), size_px=np.full(1, 12.0), polarity=np.zeros(1),
        blinks=np.zeros(1, np.bool_), sign=no, born_us=0, seen_us=WINDOW_US, speed_var=1e4,
    )  # fmt: skip
    for k, window in enumerate(windows):
        if window is not None:
            of = pixels if k == len(windows) - 1 else 12
            one = np.zeros(1, np.int64)
            see(table, filters, Sighting(one, one, one), target(*window, of), (k + 2) * WINDOW_US, RULE)
    return table


LIT: Windows = [(8, 5)] * 12
DARK: Windows = [None] * 8


def test_a_light_that_shines_and_comes_back_as_a_rise_has_blinked_however_few_its_events() -> None:
    assert followed([*LIT, *DARK, (13, 0)]).blinks[0] == 1


@pytest.mark.parametrize(
    ("windows", "pixels"),
    [
        ([*LIT, (13, 0)], 12),
        ([*LIT, *DARK, (0, 13)], 12),
        ([*LIT, *DARK, (7, 6)], 12),
        ([*LIT, *DARK, (30, 0)], 30),
        ([(12, 0)] * 12 + [*DARK, (13, 0)], 12),
    ],
    ids=["never dark", "came back darker", "came back as it was", "came back larger", "was an edge"],
)
def test_nothing_else_has(windows: Windows, pixels: int) -> None:
    assert followed(windows, pixels).blinks[0] == 0


def test_rises_and_falls_of_whole_bits_leave_the_habit() -> None:
    bit: Windows = [(13, 0), (8, 5), (8, 5), (8, 5), (3, 10)]
    assert shines(followed([*bit, *DARK, *bit, *DARK, *bit, *DARK])).all()
    assert not shines(followed([(12, 0), (0, 12)] * 20)).any()
