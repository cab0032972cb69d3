"""The card's split: source and decoder on the drone, tracker on the ground, one router each, a radio between them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from heliograph.messages import Identification
from heliograph_services.cli.studies.radio import Proxy
from support.processes import Collector, Host, collecting, free_port
from support.scene import listed_beacons

pytestmark = pytest.mark.processes

SITES = Path(__file__).parents[2] / "deploy" / "sites"
CUT_S = 5.0
# The card's limit for the radio link.
BYTES_PER_S_LIMIT = 300_000


def ported(name: str, ports: dict[str, int]) -> str:
    """Return a shipped site file on other ports, without shared memory (which would bypass the proxy)."""
    text = (SITES / name).read_text()
    for old, new in ports.items():
        text = text.replace(f"127.0.0.1:{old}", f"127.0.0.1:{new}")
    return text.replace("shared_memory = true", "shared_memory = false")


@contextmanager
def split(folder: Path) -> Iterator[tuple[Host, Host, Proxy, int, int]]:
    """Start ground and drone; the drone's router reaches the ground's through the proxy alone."""
    ground_port, drone_port = free_port(), free_port()
    proxy = Proxy(ground_port)
    drone_text = ported("onboard.toml", {"7449": drone_port, "7448": proxy.port})
    ground_text = ported("ground.toml", {"7448": ground_port}).replace(
        'kind = "metrics_sink"', f'kind = "metrics_sink"\nfile = "{folder}/metrics.sqlite"'
    )
    ground = Host(folder, "ground", ground_text, ["tracker", "metrics_sink"])
    drone = Host(folder, "drone", drone_text, ["event_source", "decoder"])
    try:
        yield ground, drone, proxy, ground_port, drone_port
    finally:
        for host in (drone, ground):
            host.close()
        proxy.close()


def identified(heard: Collector) -> set[str]:
    states = [m for m in heard.messages["ids"] if isinstance(m, Identification)]
    return {state.beacon for state in states if not state.lost}


def refreshes(heard: Collector, since: float, until: float) -> list[float]:
    return [when for when in heard.when["ids"] if since <= when <= until]


def test_the_split_identifies_what_one_host_does_and_bridges_a_cut_of_the_radio(tmp_path: Path) -> None:
    _, expected = listed_beacons(SITES / "laptop.toml")
    with (
        split(tmp_path) as (ground, drone, proxy, ground_port, drone_port),
        collecting(drone_port, "site", ["ids", "health"]) as on_board,
        collecting(ground_port, "site", ["ids", "frames", "health"]) as on_ground,
    ):
        on_ground.until(lambda heard: identified(heard) >= expected, "all beacons on the ground")
        on_board.until(lambda heard: identified(heard) >= expected, "all beacons on board")

        passed, since = proxy.bytes_passed, time.monotonic()
        marks = len(on_board.when["ids"])
        on_board.until(lambda heard: len(heard.when["ids"]) > marks + 150, "three seconds of refreshes")
        rate = (proxy.bytes_passed - passed) / (time.monotonic() - since)
        print(f"radio link: {rate / 1e3:.0f} kB/s")
        assert rate <= BYTES_PER_S_LIMIT

        cut_at = time.monotonic()
        proxy.cut()
        on_board.until(lambda heard: heard.when["ids"][-1] > cut_at + CUT_S, "five seconds without the radio")
        proxy.restore()
        restored_at = time.monotonic()
        during = refreshes(on_board, cut_at, cut_at + CUT_S)
        holes = [b - a for a, b in pairwise(during)]
        print(f"on board during the cut: {len(during)} refreshes, longest hole {max(holes):.2f} s")
        assert len(during) > 100
        assert max(holes) < 1.0

        board_states = {(m.track, m.t_us) for m in list(on_board.messages["ids"]) if isinstance(m, Identification)}
        on_ground.until(
            lambda heard: board_states <= {(m.track, m.t_us) for m in heard.messages["ids"]},  # type: ignore[attr-defined]
            "the ground to recover what it missed",
            30,
        )
        print(f"ground complete {time.monotonic() - restored_at:.1f} s after the radio came back")
        assert on_ground.bus.gaps.missing["ids"] == 0
        assert on_ground.bus.gaps.missing["frames"] > 0
        assert sorted(ground.alive()) == ["metrics_sink", "router", "tracker"]
        assert sorted(drone.alive()) == ["decoder", "event_source", "router"]


def test_raw_events_never_cross_the_radio_even_when_the_ground_asks_for_all(tmp_path: Path) -> None:
    with (
        split(tmp_path) as (_, _, _, ground_port, drone_port),
        collecting(drone_port, "site", ["events"]) as on_board,
        collecting(ground_port, "site", ["events", "onsets"]) as on_ground,
    ):
        on_ground.until(lambda heard: len(heard.messages["onsets"]) > 50, "onsets on the ground")
        on_board.until(lambda heard: len(heard.messages["events"]) > 50, "events on board")
        assert on_ground.messages["events"] == []


def test_a_router_that_the_rule_does_not_know_is_told_to_the_operator(tmp_path: Path) -> None:
    ground_port, drone_port = free_port(), free_port()
    ground = Host(tmp_path, "ground", ported("ground.toml", {"7448": ground_port}).replace('id = "', 'id = "aa'), [])
    drone = Host(tmp_path, "drone", ported("onboard.toml", {"7449": drone_port, "7448": ground_port}), [])
    try:
        assert drone.wait_for_log("router", "is not among `peers`: events may cross")
    finally:
        drone.close()
        ground.close()
