"""A command of the bus as a request to a beacon, and the beacon's answer as a reply to the bus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import msgspec

from heliograph.beacons import BeaconCommand, BeaconReply, Settings
from heliograph_services.beacon_controller.records import (
    LEASE_LIMIT_MS,
    MESSAGE_LIMIT,
    Hello,
    Kind,
    Program,
    is_uart_text,
    program_for,
)

_CHANGED: Final = ("protocol", "options", "payload", "bit_rate", "power", "text", "gap_bits")
_MILLI: Final = 1000


@dataclass(slots=True)
class Job:
    """A command that waits for its end.

    Args:
        ticket: by which its reply is known.
        command: what was asked.
        arrived_s: when.
        deadline_s: when it has failed.
        tries: how often it was sent to the beacon.
        wanted: of a `set`, what is desired once it has been applied.
    """

    ticket: int
    command: BeaconCommand
    arrived_s: float
    deadline_s: float
    tries: int = 0
    wanted: Settings | None = None

    def reply(self, now_s: float, reason: str = "", detail: str = "") -> BeaconReply:
        """Return its end: applied without a reason, else failed."""
        return BeaconReply(
            name=self.command.name,
            nonce=self.command.nonce,
            outcome="failed" if reason else "applied",
            reason=reason,
            detail=detail[:300],
            tries=self.tries,
            took_s=round(max(0.0, now_s - self.arrived_s), 6),
        )


def merged(settings: Settings, command: BeaconCommand) -> Settings:
    """Return the settings with what a `set` changes; another protocol begins without the old one's own settings."""
    if command.protocol is not None and command.protocol != settings.protocol:
        settings = Settings(bit_rate=settings.bit_rate, power=settings.power)
    given = {name: getattr(command, name) for name in _CHANGED if getattr(command, name) is not None}
    return msgspec.structs.replace(settings, **given)


def checked_program(settings: Settings, hello: Hello | None) -> Program:
    """Return the program of settings, as far as is known within what the beacon can.

    Raises:
        ValueError: they say too little, or name a value that this beacon cannot send, and the range.
    """
    program = program_for(settings)
    if program is None:
        raise ValueError("a beacon needs protocol and bit_rate, and all but uart a payload")
    if hello is None:
        return program
    if not hello.speaks(program.protocol):
        raise ValueError(f"protocol {settings.protocol} is none that this beacon speaks")
    if not hello.rate_min <= program.bit_rate <= hello.rate_max:
        low, high = hello.rate_min / _MILLI, hello.rate_max / _MILLI
        raise ValueError(f"bit_rate of this beacon must be in [{low:g}, {high:g}], not {settings.bit_rate:g}")
    if not hello.has_power and settings.power not in {None, 1.0}:
        raise ValueError(f"power of this beacon must be 1, not {settings.power:g}")
    return program


def message_of(command: BeaconCommand, protocol: str | None, hello: Hello | None) -> bytes:
    """Return the payload of QUEUE for a `send`.

    Raises:
        ValueError: the message is one that the beacon cannot send; names its length or character.
    """
    is_text = command.text is not None
    data = command.text.encode("utf-8") if command.text is not None else command.data or b""
    limit = min(MESSAGE_LIMIT, hello.message_max if hello else MESSAGE_LIMIT)
    if len(data) > limit:
        raise ValueError(f"a message must have at most {limit} bytes, not {len(data)}")
    if protocol == "uart" and (command.text is None or not is_uart_text(command.text)):
        raise ValueError("a message of uart must be 7-bit ASCII without DEL")
    return bytes((1 if is_text else 0, command.times or 1)) + data


def lease_of(seconds: float) -> bytes:
    """Return the payload of ARM: the lease, an hour at most (it is renewed)."""
    return max(1, min(LEASE_LIMIT_MS, round(seconds * _MILLI))).to_bytes(4, "big")


KIND_OF: Final = {"set": Kind.SET, "arm": Kind.ARM, "disarm": Kind.DISARM, "send": Kind.QUEUE, "save": Kind.SAVE}
