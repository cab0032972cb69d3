"""Study 9 on real processes: what is published for the tracker crosses the proxy, and nothing else does."""

from __future__ import annotations

from pathlib import Path

import pytest

from heliograph_services.cli.studies.distribution import BIT_RATE, counts
from heliograph_services.cli.studies.distribution_scene import SENSOR, scene
from heliograph_services.cli.studies.link_runs import Link, play
from heliograph_services.event_source.cameras.formats.npz import write_npz

pytestmark = pytest.mark.processes
SECONDS = 5.0


def test_the_proxy_passes_the_bytes_that_are_published_within_a_twentieth(tmp_path: Path) -> None:
    seen = scene(5, SECONDS, BIT_RATE)
    file = tmp_path / "scene.npz"
    write_npz(file, *SENSOR, [seen.events])
    heard = play(file, "seed11", float(BIT_RATE), Link(2e6, 0.05), tmp_path)
    found = counts(seen, heard, SECONDS)
    print({name: value for name, value in found.items() if isinstance(value, (int, float))})
    assert found["refused"] == 0
    assert found["records"] > 100
    assert 0.95 < found["crossed"] / found["published"] < 1.05
    assert sum(row[3] for row in found["blocks"]["ours"]) > 0
    assert found["track_ms"]
