"""A decoder whose tracker has died goes on with what it follows; the tracker comes back and takes up where it was."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from heliograph.messages import Identification, Tracks
from support.processes import Collector, Host, collecting, free_port
from support.scene import listed_beacons

pytestmark = pytest.mark.processes

SITES = Path(__file__).parents[2] / "deploy" / "sites"
WITHOUT_S = 3.0


def followed(heard: Collector, since: float) -> set[str]:
    """Return the beacons whose states arrived after a time, lost ones left out."""
    pairs = zip(list(heard.messages["ids"]), list(heard.when["ids"]), strict=False)
    return {m.beacon for m, when in pairs if isinstance(m, Identification) and when >= since and not m.lost}


def boots(heard: Collector) -> set[str]:
    """Return the words that the trackers heard so far draw their tracks' names from."""
    return {name.split("-")[0] for m in heard.messages["tracks"] if isinstance(m, Tracks) for name in m.track}


def test_identifications_are_refreshed_without_a_tracker_and_survive_its_return(tmp_path: Path) -> None:
    port = free_port()
    text = (SITES / "laptop.toml").read_text().replace("127.0.0.1:7447", f"127.0.0.1:{port}")
    text = text.replace('kind = "metrics_sink"', f'kind = "metrics_sink"\nfile = "{tmp_path}/metrics.sqlite"')
    site_name = text.split('site = "', 1)[1].split('"', 1)[0]
    _, expected = listed_beacons(SITES / "laptop.toml")
    host = Host(tmp_path, "laptop", text, ["event_source", "tracker", "decoder", "metrics_sink"])
    try:
        with collecting(port, site_name, ["ids", "tracks"]) as heard:
            heard.until(lambda h: followed(h, 0) >= expected, "all beacons")
            host.kill("tracker")
            killed = time.monotonic()
            heard.until(lambda h: h.when["ids"][-1] > killed + WITHOUT_S, "time without a tracker")
            assert followed(heard, killed + WITHOUT_S - 0.5) == expected
            old = boots(heard)
            host.start("tracker")
            heard.until(lambda h: bool(boots(h) - old), "tracks of the new tracker")
            back = time.monotonic()
            heard.until(lambda h: h.when["ids"][-1] > back + 2.0, "two seconds with the new tracker")
            assert followed(heard, back + 1.5) == expected
    finally:
        host.close()
