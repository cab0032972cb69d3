"""Who is on the serial lines, and what they are told.

A client of the beacon controller:

    heliograph beacon list|watch SITE.toml
    heliograph beacon set SITE.toml NAME --payload 42 --bit-rate 1000
    heliograph beacon arm SITE.toml NAME --lease 600     dark after 10 min
    heliograph beacon send SITE.toml NAME "hello"
    heliograph beacon disarm|save SITE.toml NAME

Exit status 0 where the beacon has done it, 1 where it has not, 2 where nobody
could be asked.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import secrets
import time
from collections.abc import Iterator, Sequence
from typing import Any, Final

import msgspec

from heliograph.beacons import BeaconCommand, BeaconReply, BeaconState, Settings
from heliograph.errors import BusError, ConfigError, Refusal
from heliograph.shell.bus import Bus, connected
from heliograph.shell.links import client_config
from heliograph.shell.process import Stop
from heliograph.shell.queries import ask
from heliograph.shell.site import BusLinks, Site, load_site
from heliograph_services.cli.lines import dump

# A controller ends a command after its deadline, 3 s by default and 60 s at most; the bus takes milliseconds.
_ANSWER_S: Final = 65.0
# A command that nobody takes up within this is worth nothing: clocks of two hosts may differ by some of it.
_EXPIRES_S: Final = 20.0
# A controller refuses what was issued within `clock_ahead_s` of its start, 1 s by default.
_JUST_STARTED_S: Final = 3.0
_LEASE_S: Final = 600.0
# The last states arrive within milliseconds of the subscription; a busy router takes longer.
_LIST_S: Final = 1.0
_WAIT_S: Final = 0.1
_NOT_DONE: Final = 1
_MS: Final = 1000
_KIND: Final = "beacon_controller"


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    arguments = _parser().parse_args(argv)
    site = load_site(arguments.site)
    if arguments.connect:
        site = msgspec.structs.replace(site, bus=BusLinks(connect=(arguments.connect,), tls=site.bus.tls))
    is_command = arguments.action not in {"list", "watch"}
    if is_command:
        command_of(arguments, site)  # what is wrong with it is told before anybody is looked for
    stop = Stop()
    stop.install()
    with connected(client_config(site.bus, wait=False), site.site, f"client/{os.getpid()}", stop) as bus:
        if bus is None:
            return 0
        if is_command:
            return _command(bus, stop, arguments, site)
        duration_s = arguments.duration if arguments.action == "watch" else _LIST_S
        return _follow(bus, stop, duration_s, is_list=arguments.action == "list", as_json=arguments.json)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="heliograph beacon", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    about = {
        "list": "show the beacons that the controller knows",
        "watch": "show each change of their states",
        "set": "change what a beacon sends; what is not given stays",
        "arm": "let it shine for a time",
        "disarm": "make it dark",
        "send": "send a text or bytes as a message",
        "save": "keep its settings over a loss of power",
    }
    made = {name: actions.add_parser(name, help=text, description=text) for name, text in about.items()}
    for name, sub in made.items():
        sub.add_argument("site", metavar="SITE.toml", help="the site file: where the bus is, and its beacons")
        if name not in {"list", "watch"}:
            sub.add_argument("name", metavar="NAME", help="the beacon, as the site file calls it")
            sub.add_argument("--secret-file", metavar="FILE", help="signs the command (default: the controller's own)")
        sub.add_argument("--connect", metavar="ENDPOINT", help="a router of the site, instead of the file's")
        sub.add_argument("--json", action="store_true", help="one JSON object a line")
    made["watch"].add_argument("--duration", type=float, default=math.inf, metavar="S", help="end after so long")
    made["set"].add_argument("--protocol", metavar="NAME", help="seed11, code, uart or packet")
    made["set"].add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="of the protocol")
    made["set"].add_argument("--payload", type=int, metavar="N", help="its ID")
    made["set"].add_argument("--bit-rate", type=float, metavar="N", help="bit/s")
    made["set"].add_argument("--power", type=float, metavar="X", help="share of the full light, 0 to 1")
    made["set"].add_argument("--text", metavar="TEXT", help="what uart or packet repeats between messages")
    made["set"].add_argument("--gap-bits", type=int, metavar="N", help="rest after each round of it")
    made["arm"].add_argument("--lease", type=float, default=_LEASE_S, metavar="S", help=f"default: {_LEASE_S:g} s")
    made["send"].add_argument("message", metavar="TEXT", help="the message; with --hex, bytes")
    made["send"].add_argument("--hex", action="store_true", help="TEXT is bytes, as hexadecimal digits")
    made["send"].add_argument("--times", type=int, metavar="N", help="how often it is sent (default: 1)")
    return parser


def command_of(arguments: argparse.Namespace, site: Site) -> BeaconCommand:
    """Return the command that the arguments ask for, signed where the site has a secret.

    Raises:
        ConfigError: the site lists no such beacon, a value is out of range, or the secret cannot be read.
    """
    names = [beacon.name for beacon in site.beacon if beacon.uid]
    if arguments.name not in names:
        known = ", ".join(names) or "none"
        raise ConfigError(f"{site.path}: no [[beacon]] {arguments.name!r} with a uid; there are: {known}")
    now_ms = time.time_ns() // 1_000_000
    body: dict[str, Any] = {
        "name": arguments.name,
        "op": arguments.action,
        "nonce": secrets.token_hex(16),
        "issued_ms": now_ms,
        "expires_ms": now_ms + round(_EXPIRES_S * _MS),
    }
    try:
        body |= _fields_of(arguments)
        command = msgspec.convert(body, BeaconCommand, strict=True)
    except (ValueError, TypeError) as error:  # msgspec.ValidationError included
        raise ConfigError(f"{arguments.action}: {error}") from None
    return command.signed(_secret_of(arguments, site))


def _fields_of(arguments: argparse.Namespace) -> dict[str, Any]:
    if arguments.action == "arm":
        return {"lease_s": arguments.lease}
    if arguments.action == "send":
        what = {"data": bytes.fromhex(arguments.message)} if arguments.hex else {"text": arguments.message}
        return what | ({"times": arguments.times} if arguments.times is not None else {})
    if arguments.action != "set":
        return {}
    names = ("protocol", "payload", "bit_rate", "power", "text", "gap_bits")
    fields = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    options: dict[str, str | int] = {}
    for option in arguments.option:
        name, equals, value = option.partition("=")
        if not equals:
            raise ValueError(f"option must look like codebook=code20d4, not {option!r}")
        options[name] = int(value) if value.isdecimal() else value
    return fields | ({"options": options} if options else {})


def _secret_of(arguments: argparse.Namespace, site: Site) -> bytes:
    path = arguments.secret_file
    if path is None:
        path = next((e.settings.get("secret_file", "") for e in site.service if e.kind == _KIND), "")
    if not path:
        return b""
    try:
        with open(path, "rb") as file:  # noqa: PTH123 - a path of the site file, as the controller reads it
            return file.read().strip()
    except OSError as error:
        raise ConfigError(f"secret file {path}: {error.strerror}") from None


def _command(bus: Bus, stop: Stop, arguments: argparse.Namespace, site: Site) -> int:
    """Give a command, and print its end; one that came too soon after the controller's start is issued anew."""
    deadline = time.monotonic() + _JUST_STARTED_S
    while True:
        command = command_of(arguments, site)
        replies = _replies(bus, command)
        too_soon = any(reply.reason == Refusal.ISSUED_BEFORE.value for reply in replies)
        if not too_soon or stop or time.monotonic() > deadline:
            break
        time.sleep(_WAIT_S)
    for reply in replies:
        as_json = {"type": "beacon_reply", **msgspec.to_builtins(reply)}
        print(dump(as_json) if arguments.json else _said(command, reply))
    return 0 if all(reply.outcome == "applied" for reply in replies) else _NOT_DONE


def _replies(bus: Bus, command: BeaconCommand) -> list[BeaconReply]:
    answers, refused = ask(bus, command, {BeaconReply.SCHEMA: BeaconReply}, _ANSWER_S)
    replies = [answer for answer in answers if isinstance(answer, BeaconReply) and answer.name == command.name]
    if not replies:
        why = refused[0] if refused else "is a beacon_controller running there?"
        raise BusError(f"nobody answers for {command.name}: {why}")
    return replies


def _said(command: BeaconCommand, reply: BeaconReply) -> str:
    """Return a reply for people."""
    if reply.outcome == "applied":
        tries = f"{reply.tries} tries" if reply.tries != 1 else "1 try"
        return f"{reply.name}: {command.op} applied in {reply.took_s * _MS:.1f} ms, {tries}"
    return f"{reply.name}: {command.op} {reply.outcome}: {reply.reason}: {reply.detail}"


def _follow(bus: Bus, stop: Stop, duration_s: float, *, is_list: bool, as_json: bool) -> int:
    states: dict[str, BeaconState] = {}
    for state in _states(bus, stop, duration_s):
        states[state.name] = state
        if not is_list:
            print(_line(state, as_json=as_json), flush=True)
    if is_list:
        for name in sorted(states):
            print(_line(states[name], as_json=as_json))
        if not states:
            raise BusError("no beacon is known: is a beacon_controller running there?")
    return 0


def _states(bus: Bus, stop: Stop, duration_s: float) -> Iterator[BeaconState]:
    inbox = bus.subscribe({BeaconState.SCHEMA: BeaconState})
    deadline = time.monotonic() + duration_s
    while not stop and (left_s := deadline - time.monotonic()) > 0:
        sample = inbox.get(min(_WAIT_S, left_s))
        opened = bus.open(sample) if sample is not None else None
        if opened is not None and isinstance(opened[1], BeaconState):
            yield opened[1]


def _line(state: BeaconState, *, as_json: bool) -> str:
    if as_json:
        return json.dumps({"type": "beacon", **msgspec.to_builtins(state)}, ensure_ascii=False)
    told = _words(state.reported) if state.reported is not None else "has not spoken"
    if state.reported is not None and _essence(state.reported) != _essence(state.desired):
        told += f"  (wanted: {_words(state.desired)})"
    where = state.port or "-"
    trouble = f"  ! {state.trouble}" if state.trouble and state.link != "ready" else ""
    waiting = f"  {state.waiting} waiting" if state.waiting else ""
    return f"{state.name:<12} {state.link:<8} {where:<20} {told}{waiting}{trouble}"


def _essence(settings: Settings) -> tuple[object, ...]:
    return settings.protocol, settings.payload, settings.bit_rate, settings.armed


def _words(settings: Settings) -> str:
    if settings.protocol is None:
        return "nothing set"
    payload = "" if settings.payload is None else f" {settings.payload}"
    light = f"lit for {settings.lease_s:.0f} s" if settings.armed else "dark"
    return f"{settings.protocol}{payload} at {settings.bit_rate or 0:g} bit/s, {light}"
