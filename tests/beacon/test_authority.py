"""A command is refused for the first thing that is wrong with it, by name, and nothing of it reaches the beacon."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from heliograph.beacons import BeaconCommand
from heliograph.errors import ConfigError, Refusal
from heliograph.keys import key
from heliograph_services.beacon_controller.authority import Authority, Denied
from heliograph_services.beacon_controller.config import BeaconControllerConfig
from support.lossy_line import SITE, STARTED_MS, UID, WALL_MS, World, command, crane, packed
from support.virtual_beacon import VirtualBeacon

SECRET = b"a secret that nobody guesses"
KEY = key(SITE, "beacon", "crane", "cmd")


def settings(**changes: Any) -> BeaconControllerConfig:
    fields: dict[str, Any] = {"beacons": (crane(), crane("00000000000000a2", name="lift"))}
    return BeaconControllerConfig(**fields | changes)


def verdict(
    authority: Authority, what: BeaconCommand | bytes, asked: str = KEY, after_s: float = 0.0
) -> BeaconCommand | Refusal:
    payload = what if isinstance(what, bytes) else packed(what)
    outcome = authority.check(asked, KEY, payload, WALL_MS + round(after_s * 1000), after_s)
    return outcome.reason if isinstance(outcome, Denied) else outcome


def test_a_command_on_its_own_key_is_let_through_once() -> None:
    authority = Authority(settings(), b"", STARTED_MS)
    what = command("set", payload=21)
    assert verdict(authority, what) == what
    assert verdict(authority, what) is Refusal.REPLAYED
    assert authority.refusals == {Refusal.REPLAYED: 1}


@pytest.mark.parametrize(
    ("what", "asked", "reason"),
    [
        (command("save"), "heliograph/@v1/yard/beacon/*/cmd", Refusal.NOT_EXACT),
        (command("save"), "heliograph/@v1/yard/beacon/lift/cmd", Refusal.NOT_EXACT),
        (command("save", name="lift"), KEY, Refusal.WRONG_KEY),
        (command("send", text="x" * 4000), KEY, Refusal.TOO_LARGE),
        (b"", KEY, Refusal.NOT_MSGPACK),
        (b"\x91" * 50, KEY, Refusal.NOT_MSGPACK),
        (msgspec.msgpack.encode({"body": {}}), KEY, Refusal.NO_ENVELOPE),
        (command("save", at_s=-20.0), KEY, Refusal.EXPIRED),
        (command("save", at_s=41.0), KEY, Refusal.EXPIRES_LATE),
        (command("save", at_s=1.5), KEY, Refusal.ISSUED_AHEAD),
        (command("set", bit_rate=9_000.0), KEY, Refusal.NOT_ALLOWED),
        (command("set", bit_rate=49.0), KEY, Refusal.NOT_ALLOWED),
        (command("set", power=0.6), KEY, Refusal.NOT_ALLOWED),
        (command("arm", lease_s=61.0), KEY, Refusal.NOT_ALLOWED),
    ],
)
def test_the_first_thing_that_is_wrong_is_why(what: BeaconCommand | bytes, asked: str, reason: Refusal) -> None:
    authority = Authority(settings(command_bytes=1000, power_max=0.5, lease_max_s=60.0), b"", STARTED_MS)
    assert verdict(authority, what, asked) is reason
    assert authority.refusals == {reason: 1}


def test_without_the_sites_secret_nothing_is_let_through() -> None:
    authority = Authority(settings(), SECRET, STARTED_MS)
    what = command("disarm")
    assert verdict(authority, what) is Refusal.NOT_AUTHENTIC
    assert verdict(authority, what.signed(b"another secret, just as long")) is Refusal.NOT_AUTHENTIC
    forged = msgspec.structs.replace(command("arm", lease_s=5.0).signed(SECRET), lease_s=50.0)
    assert verdict(authority, forged) is Refusal.NOT_AUTHENTIC
    signed = what.signed(SECRET)
    assert verdict(authority, signed) == signed


def test_more_commands_than_allowed_are_refused_and_the_allowance_comes_back() -> None:
    authority = Authority(settings(commands_hz=2.0, commands_burst=3), b"", STARTED_MS)
    outcomes = [verdict(authority, command("save")) for _ in range(5)]
    assert outcomes[3:] == [Refusal.TOO_FREQUENT] * 2
    assert isinstance(verdict(authority, command("save"), after_s=0.5), BeaconCommand)
    assert verdict(authority, command("save"), after_s=0.6) is Refusal.TOO_FREQUENT


def test_what_has_no_secret_costs_no_allowance() -> None:
    authority = Authority(settings(commands_hz=0.1, commands_burst=1), SECRET, STARTED_MS)
    for _ in range(50):
        assert verdict(authority, command("save")) is Refusal.NOT_AUTHENTIC
    assert isinstance(verdict(authority, command("save").signed(SECRET)), BeaconCommand)


def test_a_nonce_is_remembered_for_as_long_as_its_command_lives() -> None:
    authority = Authority(settings(), b"", STARTED_MS)
    what = command("save")
    assert verdict(authority, what) == what
    assert verdict(authority, what, after_s=19.9) is Refusal.REPLAYED
    assert verdict(authority, what, after_s=20.0) is Refusal.EXPIRED


def test_a_command_that_was_carried_out_before_a_restart_is_refused_after_it() -> None:
    before = Authority(settings(), SECRET, STARTED_MS)
    ahead = command("save", at_s=0.9).signed(SECRET)  # from a host whose clock is ahead by what is allowed
    for what in (ahead, command("save").signed(SECRET)):
        assert verdict(before, what) == what
        for restarted_s in (0.0, 0.001, 5.0):
            after = Authority(settings(), SECRET, WALL_MS + round(1000 * restarted_s))
            assert verdict(after, what, after_s=restarted_s + 0.01) is Refusal.ISSUED_BEFORE
            fresh = command("save", at_s=restarted_s + 1.01).signed(SECRET)
            assert verdict(after, fresh, after_s=restarted_s + 1.01) == fresh


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"op": "arm"}, "arm needs one of lease_s"),
        ({"op": "save", "payload": 1}, "save takes nothing, not payload"),
        ({"op": "send"}, "send needs one of text, data, times"),
        ({"op": "send", "text": "a", "data": b"b"}, "not both"),
        ({"op": "send", "text": ""}, "something to send"),
        ({"op": "set"}, "set needs one of"),
    ],
)
def test_a_command_that_contradicts_itself_cannot_be_made(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        command(**fields)


def test_a_refused_command_does_not_reach_the_beacon(build: Path) -> None:
    beacon = VirtualBeacon(build, UID, 3)
    world = World(settings(bit_rate_max=2_000.0))
    world.plug("a", beacon)
    world.until(lambda: beacon.look().sets == 1, 2.0)
    reply = world.end_of(world.ask(command("set", bit_rate=4_000.0)))
    assert (reply.outcome, reply.reason) == ("refused", Refusal.NOT_ALLOWED.value)
    assert "bit_rate must be in [50, 2000], not 4000" in reply.detail
    world.run(world.now_s + 1.0)
    assert beacon.look()[2:5] == (1, 42, 1_000_000)
    beacon.close()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ports": ("usb:1:2",)}, "port must look like usb:303a:1001"),
        ({"ports": ("/dev/a", "/dev/a")}, "ports must differ, not twice /dev/a"),
        ({"bit_rate_min": 3_000.0, "bit_rate_max": 2_000.0}, "bit_rate_min must be at most bit_rate_max = 2000"),
        ({"adapt": True, "adapt_max": 9_000.0}, r"must lie in \[50, 5000\]"),
        ({"beacons": (crane(), crane(name="b"))}, f"different uids, not twice {UID}"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises((ConfigError, msgspec.ValidationError), match=words):
        settings(**changes)


def test_the_controllers_page_names_every_reason_of_its_own() -> None:
    page = (Path(__file__).parents[2] / "services/heliograph_services/beacon_controller/README.md").read_text()
    names = list(Refusal)
    own = names[names.index(Refusal.NOT_EXACT) : names.index(Refusal.OTHER_BEACON) + 1]
    assert [reason.value for reason in own if f"`{reason.value}`" not in page] == []
