"""The site that runs the tracker on scikit-learn and filterpy says what the laptop's says, byte for byte."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from heliograph.shell.site import Site, load_site
from support.processes import free_port
from support.replay import SERVICES, in_one_process, recording, site, through_processes
from support.scene import Scene

pytestmark = pytest.mark.processes

SITES = Path(__file__).parents[2] / "deploy" / "sites"
BACKENDS = {"clustering": "scikit-learn", "kalman": "filterpy"}


@pytest.fixture(scope="module")
def reference() -> Site:
    return load_site(SITES / "reference.toml")


@pytest.fixture(scope="module")
def laptop() -> Site:
    return load_site(SITES / "laptop.toml")


def test_the_two_sites_differ_in_the_tracker_s_backends_alone(reference: Site, laptop: Site) -> None:
    assert reference.beacon == laptop.beacon
    pairs = list(zip(reference.service, laptop.service, strict=True))
    assert [a.kind for a, _ in pairs] == [b.kind for _, b in pairs]
    for a, b in pairs:
        assert a.settings == dict(b.settings) | (BACKENDS if a.kind == "tracker" else {})


def test_real_processes_on_the_reference_identify_what_the_laptop_does_byte_for_byte(
    reference: Site, scene: Scene, tmp_path: Path
) -> None:
    for package in ("sklearn", "filterpy"):
        pytest.importorskip(package, reason=f"the reference backends need {package}")
    port = free_port()
    laptops = site(port, recording(scene.path), "", scene.beacons)
    tracker = next(entry for entry in reference.service if entry.kind == "tracker")
    settings = "\n".join(f"{name} = {json.dumps(value)}" for name, value in tracker.settings.items())
    references = laptops.replace('kind = "tracker"', f'kind = "tracker"\n{settings}')
    assert references.count("scikit-learn") == references.count("filterpy") == 1
    theirs = through_processes(tmp_path, references, port, SERVICES)
    (tmp_path / "laptop.toml").write_text(laptops)
    ours = in_one_process(tmp_path / "laptop.toml")
    assert len(ours["frames/"]) > 100
    assert sum(name.startswith("ids/") for name in ours) >= len(scene.names)
    assert theirs == ours
