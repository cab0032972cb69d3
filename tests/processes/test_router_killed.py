"""A router that dies and comes back: every process finds it again by itself, and goes on."""

from __future__ import annotations

from pathlib import Path

import pytest

from heliograph.messages import Identification
from support.processes import Collector, Host, collecting, free_port
from support.scene import listed_beacons

pytestmark = pytest.mark.processes

SITES = Path(__file__).parents[2] / "deploy" / "sites"


def accepted(heard: Collector, after: int) -> set[str]:
    """Return the beacons in the identifications after the first so many."""
    states = [m for m in list(heard.messages["ids"])[after:] if isinstance(m, Identification)]
    return {m.beacon for m in states if not m.lost}


def test_processes_find_a_router_that_came_back_and_identify_again(tmp_path: Path) -> None:
    port = free_port()
    text = (SITES / "laptop.toml").read_text().replace("127.0.0.1:7447", f"127.0.0.1:{port}")
    text = text.replace('kind = "metrics_sink"', f'kind = "metrics_sink"\nfile = "{tmp_path}/metrics.sqlite"')
    _, expected = listed_beacons(SITES / "laptop.toml")
    host = Host(tmp_path, "laptop", text, ["event_source", "tracker", "decoder", "metrics_sink"])
    try:
        with collecting(port, "laptop", ["ids"]) as heard:
            heard.until(lambda h: accepted(h, 0) >= expected, "all beacons")
            host.kill("router")
            before = len(heard.messages["ids"])
            host.start("router", "heliograph.shell.router", [])
            heard.until(lambda h: accepted(h, before) >= expected, "all beacons through the new router", 30)
        assert sorted(host.alive()) == ["decoder", "event_source", "metrics_sink", "router", "tracker"]
    finally:
        statuses = host.close()
    assert {name: status for name, status in statuses.items() if name != "router"} == dict.fromkeys(
        ["event_source", "tracker", "decoder", "metrics_sink"], 0
    )
