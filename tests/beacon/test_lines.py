"""Who is on a line: several beacons, strangers, those who answer nonsense; leases, saving, and darkness."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from heliograph.errors import ConfigError, Refusal
from heliograph_services.beacon_controller.config import BeaconControllerConfig
from heliograph_services.beacon_controller.core import ControllerCore
from heliograph_services.beacon_controller.frames import Deframer, Frame, pack
from support.lossy_line import UID, World, command, crane
from support.virtual_beacon import Seen, VirtualBeacon

OTHER = "00000000000000a2"
Make = Callable[[str], VirtualBeacon]


@pytest.fixture
def make(build: Path) -> Iterator[Make]:
    made: list[VirtualBeacon] = []

    def one(uid: str) -> VirtualBeacon:
        made.append(VirtualBeacon(build, uid, 100 + len(made)))
        return made[-1]

    yield one
    for beacon in made:
        beacon.close()


class Babbler:
    """Something else on the line: it answers each write with what `says` makes of it."""

    def __init__(self, says: Callable[[bytes], bytes]) -> None:
        self._says = says
        self._out = b""

    def run_to(self, now_s: float) -> None: ...

    def receive(self, data: bytes) -> None:
        self._out += self._says(data)

    def take(self) -> bytes:
        out, self._out = self._out, b""
        return out


def settings(*beacons: Any, **changes: Any) -> BeaconControllerConfig:
    return BeaconControllerConfig(beacons=beacons or (crane(), crane(OTHER, name="lift", payload=21)), **changes)


def test_several_beacons_are_found_by_their_uids_and_given_what_the_site_wants(make: Make) -> None:
    world = World(settings())
    lift, one = make(OTHER), make(UID)
    world.plug("a", lift)
    world.plug("b", one)
    world.until(lambda: (lift.look().payload, one.look().payload) == (21, 42), 2.0)
    world.run(world.now_s + 0.2)
    assert {name: (state.port, state.link) for name, state in world.states.items()} == {
        "crane": ("b", "ready"),
        "lift": ("a", "ready"),
    }
    assert world.end_of(world.ask(command("arm", name="lift", lease_s=5.0))).outcome == "applied"
    assert (lift.look().armed, one.look().armed) == (True, False)


def test_a_beacon_that_the_site_does_not_list_is_told_and_left_alone(make: Make) -> None:
    world = World(settings(crane()))
    stranger = make(OTHER)
    world.plug("a", stranger)
    world.run(1.0)
    written = world.written["a"]
    world.run(5.0)
    assert world.written["a"] == written
    state = world.states[f"uid-{OTHER}"]
    assert (state.link, state.port) == ("foreign", "a")
    assert OTHER in state.trouble
    assert stranger.look().sets == 0


def test_the_same_uid_on_a_second_port_is_left_alone(make: Make) -> None:
    world = World(settings())
    world.plug("a", make(UID))
    world.run(1.0)
    twin = make(UID)
    world.plug("b", twin)
    world.run(3.0)
    assert world.states[f"uid-{UID}"].trouble == f"uid {UID} is already on a"
    assert world.states["crane"].port == "a"
    assert twin.look().sets == 0


@pytest.mark.parametrize(
    "says",
    [
        lambda data: b"login: " * 3,
        lambda data: bytes(random.Random(len(data)).randrange(256) for _ in range(40)),
        lambda data: data,  # an echo: sound frames that are requests
        lambda data: b"".join(
            pack(Frame(frame.kind | 0x80, frame.seq, 9, b"\0" + frame.payload)) for frame in Deframer().feed(data)
        ),
        lambda data: b"".join(pack(Frame(frame.kind | 0x80, frame.seq, 0, b"")) for frame in Deframer().feed(data)),
    ],
    ids=["text", "noise", "echo", "short answers", "answers of no boot"],
)
def test_who_answers_nonsense_is_told_and_left_alone(says: Callable[[bytes], bytes]) -> None:
    world = World(settings(nonsense_s=1.0))
    world.plug("a", Babbler(says))
    world.run(4.0)
    written = world.written["a"]
    world.run(10.0)
    assert world.written["a"] == written
    assert world.core.gauges["left alone"] == 1.0


def test_a_beacon_that_turns_to_nonsense_is_told_and_its_commands_fail_at_once(make: Make) -> None:
    world = World(settings())
    beacon = make(UID)
    world.plug("a", beacon)
    world.run(1.0)
    boot = beacon.boot
    plug = Babbler(
        lambda data: b"".join(pack(Frame(f.kind | 0x80, f.seq, boot, b"\xee")) for f in Deframer().feed(data))
    )
    world.lines["a"].beacon = plug
    world.until(lambda: world.states["crane"].link == "nonsense", 3.0)
    asked = world.ask(command("set", at_s=world.now_s, payload=5))
    reply = world.end_of(asked, 0.1)
    assert (reply.outcome, reply.reason) == ("failed", "nonsense")
    assert world.core.refusals[Refusal.NONSENSE] >= 8


def test_who_was_left_alone_is_greeted_when_it_announces_a_new_boot(make: Make) -> None:
    world = World(settings(nonsense_s=1.0))
    world.plug("a", Babbler(lambda data: b"ets Jul 29 2019 rst:0x1\r\n" * 2))
    world.run(3.0)
    assert world.core.gauges["left alone"] == 1.0
    beacon = make(UID)
    world.lines["a"].beacon = beacon
    world.until(lambda: beacon.look().payload == 42, 3.0)


def test_a_silent_port_is_not_nonsense_and_its_commands_fail_after_the_deadline() -> None:
    world = World(settings())
    world.plug("a", Babbler(lambda data: b""))
    ticket = world.ask(command("save"))
    reply = world.end_of(ticket)
    assert (reply.outcome, reply.reason) == ("failed", "absent")
    assert reply.took_s == pytest.approx(3.0, abs=0.05)
    assert world.core.gauges["left alone"] == 0.0


def test_a_beacon_is_dark_when_its_lease_ends_and_is_not_armed_again(make: Make) -> None:
    world = World(settings())
    beacon = make(UID)
    world.plug("a", beacon)
    world.end_of(world.ask(command("arm", lease_s=2.0)))
    assert beacon.look().armed
    world.run(world.now_s + 2.1)
    assert not beacon.look().armed
    world.run(world.now_s + 3.0)
    assert not beacon.look().armed
    assert world.states["crane"].desired.armed is False


def test_a_lease_beyond_the_protocols_hour_is_renewed(make: Make) -> None:
    world = World(settings(crane(), poll_s=60.0))
    beacon = make(UID)
    world.plug("a", beacon)
    world.end_of(world.ask(command("arm", lease_s=7_200.0)))
    world.run(world.now_s + 0.5)
    assert world.states["crane"].desired.lease_s == pytest.approx(7_200.0, abs=2.0)
    assert world.core.step(world.now_s).writes == []
    later = world.core.step(world.now_s + 1_900.0).writes
    kinds = [frame.kind for _, data in later for frame in Deframer().feed(data)]
    assert kinds == [0x04]


def test_a_beacon_that_is_told_to_be_dark_while_away_is_dark_when_it_comes_back(make: Make) -> None:
    world = World(settings())
    beacon = make(UID)
    world.plug("a", beacon)
    world.end_of(world.ask(command("arm", lease_s=100.0)))
    world.unplug("a")
    reply = world.end_of(world.ask(command("disarm", at_s=world.now_s)))
    assert (reply.outcome, reply.reason) == ("failed", "absent")
    assert beacon.look().armed
    world.plug("a")
    world.until(lambda: not beacon.look().armed, 1.0)


def test_what_a_failed_set_asked_for_does_not_come_later(make: Make) -> None:
    world = World(settings())
    beacon = make(UID)
    world.plug("a", beacon)
    world.run(1.0)
    world.unplug("a")
    assert world.end_of(world.ask(command("set", at_s=world.now_s, payload=5))).outcome == "failed"
    world.plug("a")
    world.run(world.now_s + 2.0)
    assert beacon.look().payload == 42


def test_a_message_that_a_reboot_overtook_has_failed_and_is_not_sent_again(make: Make) -> None:
    world = World(settings(crane(protocol="uart", payload=None)), seed=4)
    beacon = make(UID)
    world.plug("a", beacon)
    world.run(1.0)
    world.lines["a"].is_open = False  # its answers are lost
    ticket = world.ask(command("send", at_s=world.now_s, text="once"))
    world.run(world.now_s + 0.3)
    world.lines["a"].is_open = True
    beacon.reboot()
    reply = world.end_of(ticket)
    assert (reply.outcome, reply.reason) == ("failed", "rebooted")
    world.run(world.now_s + 2.0)
    assert beacon.look()[5:] == (0, 0)


def test_a_refusal_of_the_beacon_is_told_in_words(make: Make) -> None:
    world = World(settings())
    world.plug("a", make(UID))
    world.run(1.0)
    twin = world.end_of(world.ask(command("set", at_s=world.now_s, payload=56)))  # reads like 15
    assert (twin.outcome, twin.reason) == ("failed", "declined")
    message = world.end_of(world.ask(command("send", at_s=world.now_s, text="hello")))
    assert message.detail == "its protocol carries no messages"
    wide = world.end_of(world.ask(command("set", at_s=world.now_s, payload=64)))
    assert wide.detail == "payload of seed11 must be in [0, 63], not 64"
    assert world.end_of(world.ask(command("save", at_s=world.now_s))).outcome == "applied"


def test_without_the_sites_wishes_the_beacons_own_program_and_lease_are_kept(make: Make) -> None:
    beacon = make(UID)
    first = World(settings())
    first.plug("a", beacon)
    first.end_of(first.ask(command("set", payload=21)))
    first.end_of(first.ask(command("arm", lease_s=50.0)))
    second = World(settings(apply_site=False), seed=9)
    second.plug("a", beacon)
    second.now_s = first.now_s
    second.run(first.now_s + 3.0)
    seen: Seen = beacon.look()
    assert (seen.payload, seen.armed, seen.sets) == (21, True, 2)
    assert second.states["crane"].desired.payload == 21


def test_a_site_that_wants_what_no_beacon_sends_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"crane: protocol must be one of seed11, code, uart, packet, not 'frequency'"
    ):
        ControllerCore(settings(crane(protocol="frequency")), b"", 1, 0)
