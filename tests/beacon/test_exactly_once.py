"""On a line that damages every twentieth byte and loses answers, commands end once, and what was desired comes back."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from heliograph_services.beacon_controller.config import BeaconControllerConfig
from support.lossy_line import UID, World, command, crane
from support.virtual_beacon import VirtualBeacon

BAD = 0.05
LOST = 0.1


@pytest.fixture
def beacon(build: Path) -> Any:
    made = VirtualBeacon(build, UID, 7)
    yield made
    made.close()


def settings(**changes: Any) -> BeaconControllerConfig:
    fields: dict[str, Any] = {"beacons": (crane(),), "commands_hz": 1000.0, "commands_burst": 1000}
    return BeaconControllerConfig(**fields | changes)


def test_a_thousand_commands_on_a_bad_line_end_once_each_and_are_carried_out_once_each(beacon: VirtualBeacon) -> None:
    world = World(settings(beacons=(crane(protocol="uart", payload=None, bit_rate=5000.0),)), bad=BAD, lost=LOST)
    world.plug("a", beacon)
    draw = random.Random(3)
    world.end_of(world.ask(command("arm", lease_s=3600.0)))
    before = beacon.look()
    ends = {"set": 0, "send": 0, "arm": 0}
    took: list[float] = []
    for number in range(1000):
        op = draw.choice(("set", "send", "arm"))
        wanted: dict[str, dict[str, Any]] = {
            "set": {"gap_bits": number % 200},
            "send": {"text": chr(65 + number % 26)},
            "arm": {"lease_s": 600.0},
        }
        ticket = world.ask(command(op, at_s=world.now_s, **wanted[op]))
        reply = world.end_of(ticket)
        took.append(reply.took_s)
        ends[op] += reply.outcome == "applied"
    world.run(world.now_s + 5.0)
    assert all(len(replies) == 1 for replies in world.replies.values())
    assert len(world.replies) == 1001
    assert sum(ends.values()) >= 999
    after = beacon.look()
    corrections = world.states["crane"].counters.get("corrections", 0)
    assert after.sets - before.sets == ends["set"]
    assert after.accepted - before.accepted == ends["send"]
    assert corrections == 1  # the site's own wish, at the start
    took.sort()
    print(f"applied {sum(ends.values())} of 1000; median {took[500] * 1e3:.0f} ms, longest {took[-1] * 1e3:.0f} ms")


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("what", ["reboot", "unplugged", "unplugged and rebooted"])
def test_the_desired_state_is_back_within_a_second(beacon: VirtualBeacon, what: str, seed: int) -> None:
    assert returned_s(World(settings(), seed=seed), beacon, what) < 1.0


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("what", ["reboot", "unplugged", "unplugged and rebooted"])
def test_the_desired_state_is_back_within_a_second_on_a_bad_line(beacon: VirtualBeacon, what: str, seed: int) -> None:
    assert returned_s(World(settings(), bad=BAD, lost=LOST, seed=seed), beacon, what) < 1.0


@pytest.mark.parametrize("what", ["reboot", "unplugged", "unplugged and rebooted"])
def test_a_message_under_way_when_the_beacon_goes_is_accepted_at_most_once(beacon: VirtualBeacon, what: str) -> None:
    uart = crane(protocol="uart", payload=None, bit_rate=5000.0)
    world = World(settings(beacons=(uart,)), bad=BAD, lost=LOST, seed=3)
    world.plug("a", beacon)
    assert world.end_of(world.ask(command("arm", lease_s=3600.0))).outcome == "applied"
    draw = random.Random(5)
    for _ in range(50):
        # Its queue has three places, so that each message is sent and gone before the next.
        world.run(world.now_s + 2.0)
        before = beacon.look().accepted
        ticket = world.ask(command("send", at_s=world.now_s, text="once"))
        world.run(world.now_s + draw.uniform(0.0, 0.2))
        accepted = taken_away(world, beacon, what, before)
        took = world.until(lambda: beacon.look().armed and beacon.look().millirate == 5_000_000, 5.0)
        assert took < 1.0
        reply = world.end_of(ticket)
        world.run(world.now_s + 1.0)
        accepted += beacon.look().accepted - (0 if "reboot" in what else before)
        assert len(world.replies[ticket]) == 1
        assert accepted == 1 if reply.outcome == "applied" else accepted <= 1


def taken_away(world: World, beacon: VirtualBeacon, what: str, before: int) -> int:
    """Take the beacon away and bring it back; return how many messages the boot before had accepted since."""
    accepted = 0
    if "unplugged" in what:
        world.unplug("a")
        world.run(world.now_s + 0.7)
    if "reboot" in what:
        accepted = beacon.look().accepted - before
        beacon.reboot()
    if "unplugged" in what:
        world.plug("a")
    return accepted


def returned_s(world: World, beacon: VirtualBeacon, what: str) -> float:
    """Bring a beacon to its desired state, take it away, bring it back; return how long it then takes."""
    world.plug("a", beacon)
    assert world.end_of(world.ask(command("arm", lease_s=600.0))).outcome == "applied"
    assert world.end_of(world.ask(command("set", payload=21))).outcome == "applied"
    world.run(world.now_s + 0.5)
    sets = 0 if "reboot" in what else beacon.look().sets
    taken_away(world, beacon, what, 0)
    waiting = world.now_s
    # Read off the beacon's own memory, not off its answers.
    took = world.until(lambda: beacon.look()[1:4:2] == (True, 21), 5.0)
    assert world.now_s - waiting == pytest.approx(took)
    world.run(world.now_s + 2.0)
    assert beacon.look().sets - sets <= 1
    assert world.states["crane"].link != "nonsense"
    return took
