"""The site of the firmware in the loop, as it is shipped."""

from __future__ import annotations

from pathlib import Path

from heliograph.shell.site import load_site
from heliograph_services.cli.config import problems
from heliograph_services.event_source.simulation.world.load import load_scenario

LOOP = Path(__file__).parents[2] / "firmware" / "loop"


def test_the_shipped_site_is_sound_and_lists_the_beacon_of_its_scene() -> None:
    site = load_site(LOOP / "site.toml")
    assert problems(site) == []
    scene = load_scenario(str(LOOP / "scene.toml"))
    assert [(b.name, b.protocol, b.bit_rate) for b in site.beacon] == [
        (b.name, b.protocol, b.bit_rate) for b in scene.beacons
    ]
    assert site.beacon[0].uid
