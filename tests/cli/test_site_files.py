"""The site files that are shipped: they load, fit each other, and list the beacons of the scene that they show."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import zenoh

from heliograph.shell.config import resolve
from heliograph.shell.links import client_config, router_config
from heliograph.shell.site import load_site
from heliograph_services.cli.demo import site_text
from heliograph_services.cli.services import config_type
from heliograph_services.event_source.simulation.world.load import load_scenario, site_beacons

DEPLOY = Path(__file__).parents[2] / "deploy"
SITES = ("laptop", "protocols", "onboard", "ground", "reference", "paper")


@pytest.mark.parametrize("name", SITES)
def test_a_shipped_site_has_valid_settings_and_links_that_zenoh_accepts(name: str) -> None:
    site = load_site(DEPLOY / "sites" / f"{name}.toml")
    assert site.router is not None
    for config in (client_config(site.bus), router_config(site.router, site.bus)):
        zenoh.Config.from_json5(json.dumps(config))
    for entry in site.service:
        resolve(config_type(entry.kind), entry, site, {}, {})


@pytest.mark.parametrize("name", SITES)
def test_a_shipped_site_lists_the_beacons_of_the_scene(name: str) -> None:
    site = load_site(DEPLOY / "sites" / f"{name}.toml")
    scenario = {"paper": "construction_site_nrp", "protocols": "protocols"}.get(name, "five")
    assert list(site.beacon) == site_beacons(load_scenario(scenario))


def test_drone_and_ground_are_two_halves_of_one_site() -> None:
    drone, ground = (load_site(DEPLOY / "sites" / f"{name}.toml") for name in ("onboard", "ground"))
    assert drone.router is not None
    assert ground.router is not None
    assert drone.site == ground.site
    assert drone.router.connect == ground.router.listen
    assert drone.router.peers == (ground.router.id,)
    assert drone.router.keep == ("events",)
    kinds = sorted(entry.kind for half in (drone, ground) for entry in half.service)
    assert kinds == sorted(entry.kind for entry in load_site(DEPLOY / "sites" / "laptop.toml").service)


def test_the_ports_of_the_routers_differ() -> None:
    ports = [load_site(DEPLOY / "sites" / f"{name}.toml").router for name in SITES]
    assert len({router.listen for router in ports if router}) == len(SITES)


@pytest.mark.parametrize("scenario", ["five", "still", "empty", "construction_site", "crowd"])
def test_the_demo_writes_a_site_that_lists_the_beacons_of_its_scene(tmp_path: Path, scenario: str) -> None:
    path = tmp_path / "demo.toml"
    path.write_text(
        site_text({"scenario": scenario, "duration_s": 5.0}, "tcp/127.0.0.1:7000", tmp_path), encoding="utf-8"
    )
    site = load_site(path)
    assert list(site.beacon) == site_beacons(load_scenario(scenario))
    for entry in site.service:
        resolve(config_type(entry.kind), entry, site, {}, {})
