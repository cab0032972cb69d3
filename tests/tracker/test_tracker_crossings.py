"""Two beacons whose images cross keep their names, by position alone (`bench/bench_crossings.py` does many)."""

from __future__ import annotations

import pytest

from support.crossings import Kind, crossing, outcomes

STRAIGHT = Kind()
BENT = Kind(acceleration_px_s2=(0.0, 300.0))


@pytest.mark.parametrize("kind", [STRAIGHT, BENT], ids=["straight", "bent"])
def test_beacons_that_cross_keep_their_names(kind: Kind) -> None:
    assert outcomes(range(8), kind) == {"kept": 8}


def test_the_script_makes_the_images_touch() -> None:
    overlaps_s = [crossing(seed, STRAIGHT).overlap_s for seed in range(8)]
    assert min(overlaps_s) > 0.01
    assert max(overlaps_s) > 0.04
