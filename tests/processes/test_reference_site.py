"""The site that runs the tracker on scikit-learn, filterpy and torch says what the fast backends say, byte for byte."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import msgpack
import pytest

from heliograph.shell.site import Site, load_site
from support.processes import free_port
from support.replay import SERVICES, in_one_process, recording, site, through_processes
from support.scene import Scene

pytestmark = pytest.mark.processes

SITES = Path(__file__).parents[2] / "deploy" / "sites"
BACKENDS = {"clustering": "scikit-learn", "kalman": "filterpy", "flow": "torch", "prediction": "both"}


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


def test_real_processes_on_the_reference_say_what_the_fast_ones_do_and_identify_what_the_laptop_does(
    reference: Site, scene: Scene, tmp_path: Path
) -> None:
    for package in ("sklearn", "filterpy", "torch"):
        pytest.importorskip(package, reason=f"the reference backends need {package}")
    port = free_port()
    laptop = site(port, recording(scene.path), "", scene.beacons)
    tracker = next(entry for entry in reference.service if entry.kind == "tracker")
    theirs = through_processes(tmp_path, with_tracker(laptop, tracker.settings), port, SERVICES)
    texts = {"fast": with_tracker(laptop, {"flow": "numba", "prediction": "both"}), "laptop": laptop}
    said = {}
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text)
        said[name] = in_one_process(tmp_path / f"{name}.toml")
    assert len(theirs["frames/"]) > 100
    assert theirs == said["fast"]
    assert identified(theirs) == identified(said["laptop"]) >= scene.names


def with_tracker(text: str, settings: Mapping[str, object]) -> str:
    """Return a site's text with settings of its tracker."""
    lines = "\n".join(f"{name} = {json.dumps(value)}" for name, value in settings.items())
    return text.replace('kind = "tracker"', f'kind = "tracker"\n{lines}')


def identified(said: dict[str, list[bytes]]) -> set[str | None]:
    """Return the beacons that were identified."""
    bodies = [msgpack.unpackb(body) for name in said if name.startswith("ids/") for body in said[name]]
    return {body["beacon"] for body in bodies}
