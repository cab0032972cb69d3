"""The stream that most tests of the tracker share."""

from __future__ import annotations

import pytest

from heliograph.streams import Onsets
from support.tracker_runs import second


@pytest.fixture
def two() -> list[Onsets]:
    return second()
