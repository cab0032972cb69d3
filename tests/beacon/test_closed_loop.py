"""The closed loop chooses the bit rate that the link carries and comes down when it fades (the firmware's core)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from heliograph.messages import Identification, Link
from heliograph_services.beacon_controller.config import BeaconControllerConfig
from support.lossy_line import UID, World, command, crane
from support.virtual_beacon import VirtualBeacon


def config(**changes: Any) -> BeaconControllerConfig:
    return BeaconControllerConfig(beacons=(crane(bit_rate=500.0),), adapt=True, **changes)


def seen(rate: float, t_us: int, share: float) -> tuple[Identification, Link]:
    """Return what a decoder says of the track in a second."""
    name = "crane" if rate == 500.0 else f"crane.{rate:g}"
    who = Identification(
        camera="cam0",
        track="t-0",
        t_us=t_us,
        since_us=0,
        protocol="seed11",
        beacon=name,
        payload=42,
        x_px=1.0,
        y_px=1.0,
        vx_px_s=0.0,
        vy_px_s=0.0,
        bearing=None,
        confidence=1.0,
        margin=9.0,
        frames_used=3,
        change="refreshed",
        lost=False,
    )
    link = Link(
        camera="cam0",
        track="t-0",
        t_us=t_us,
        protocol="seed11",
        bit_rate=rate,
        snr_db=9.0,
        jitter_us=9.0,
        clock_ppm=0.0,
        events_per_transition=5.0,
        mar_estimate=share,
    )
    return who, link


def watched(world: World, beacon: VirtualBeacon, seconds: int, carries: Callable[[int], float]) -> list[float]:
    """Let a decoder tell each second of a link that carries so many bit/s then; return the beacon's rates."""
    rates = []
    begin_s = world.now_s
    for second in range(seconds):
        rate = beacon.look().millirate / 1000
        share = 1.0 if rate <= carries(second) else 0.4 if rate <= 2 * carries(second) else None
        if share is not None:
            for message in seen(rate, round(world.now_s * 1e6), share):
                world.core.feed(message, world.now_s)
        world.run(begin_s + second + 1.0)
        rates.append(beacon.look().millirate / 1000)
    return rates


@pytest.fixture
def beacon(build: Path) -> Any:
    made = VirtualBeacon(build, UID, 5)
    yield made
    made.close()


def test_the_rate_climbs_to_what_the_link_carries_falls_with_it_and_comes_back(beacon: VirtualBeacon) -> None:
    world = World(config())
    world.plug("a", beacon)
    world.end_of(world.ask(command("arm", lease_s=600.0)))
    rates = watched(world, beacon, 90, lambda s: 4_000.0 if s < 25 else 300.0 if s < 45 else 4_000.0)
    assert rates[20:25] == [2_000.0] * 5  # the limit of the settings
    assert rates[40:45] == [250.0] * 5
    assert rates[-1] == 2_000.0
    assert beacon.look().armed


def test_a_rate_that_the_link_did_not_carry_is_not_tried_again_at_once(beacon: VirtualBeacon) -> None:
    world = World(config())
    world.plug("a", beacon)
    rates = watched(world, beacon, 60, lambda s: 500.0)
    ascents = [i for i in range(1, 60) if rates[i] > rates[i - 1]]
    assert 2 <= len(ascents) <= 4
    assert rates.count(500.0) >= 45


def test_a_beacon_that_nobody_sees_comes_down_to_the_lowest_rate(beacon: VirtualBeacon) -> None:
    world = World(config())
    world.plug("a", beacon)
    world.run(12.0)
    assert beacon.look().millirate == 250_000


def test_a_rate_that_an_operator_sets_is_held_for_a_while(beacon: VirtualBeacon) -> None:
    world = World(config())
    world.plug("a", beacon)
    world.run(1.0)
    assert world.end_of(world.ask(command("set", at_s=1.0, bit_rate=1_000.0))).outcome == "applied"
    world.run(25.0)
    assert beacon.look().millirate == 1_000_000


def test_the_loop_is_open_unless_it_is_asked_for(beacon: VirtualBeacon) -> None:
    world = World(BeaconControllerConfig(beacons=(crane(bit_rate=500.0),)))
    world.plug("a", beacon)
    assert set(watched(world, beacon, 15, lambda s: 4_000.0)) == {500.0}
