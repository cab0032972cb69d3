"""Two ways to say no.

An *operator's or programmer's* mistake is an exception that names the value and the range; the shell prints it as
one line and leaves with status 2. *Bad input from the world* (a damaged message, a lamp that imitates a beacon) is
never an exception in a stream: it is a `Refusal`, counted under its value and published.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum, unique


class HeliographError(Exception):
    """What an operator can mend; its text is one line that names the value and what is allowed."""


class ConfigError(HeliographError):
    """A setting is unknown, out of range, or contradicts another."""


class FileError(HeliographError):
    """A file is missing, of an unknown kind, damaged, or lacks what decoding it needs."""


class BusError(HeliographError):
    """The links of the site cannot be opened as they are planned."""


@unique
class Refusal(Enum):
    """Why a piece of input was not used. The value is the counter's name on the bus and in the store."""

    # There is one object a member. Enum's own hash is a call in Python, at every look at a counter.
    __hash__ = object.__hash__

    # A message on the bus, in the order in which it is checked (heliograph.messages).
    TOO_LARGE = "message too large"
    NOT_MSGPACK = "message is not msgpack"
    NO_ENVELOPE = "message without a sound envelope"
    UNKNOWN_SCHEMA = "message of an unknown schema"
    WRONG_VERSION = "message of another major version"
    WRONG_KEY = "message does not belong on its key"
    BAD_BODY = "message body breaks its schema"
    # A stream of messages, when each of them alone is sound.
    TIME_BACKWARDS = "time runs backwards"
    TIME_JUMP = "time jumps"
    OFF_SENSOR = "outside the sensor"
    OTHER_CAMERA = "message of another camera"
    OTHER_GEOMETRY = "geometry or tick changed within a stream"
    CORE_FAULT = "core refused its input"
    # Events and files.
    TRUNCATED = "file ends in the middle of a record"
    UNORDERED = "events out of order"
    DAMAGED = "file is damaged"
    # Tracking.
    TOO_FEW_PIXELS = "target too small"
    TOO_MANY_PIXELS = "target too large"
    NOT_ROUND = "target not round"
    # The link, in the order in which a frame is checked.
    NO_START_CODE = "no start code"
    PARITY = "parity"
    STOP_BITS = "stop bits"
    UNKNOWN_WORD = "word is not in the codebook"
    AMBIGUOUS = "word reads as two payloads"
    PERIODIC = "word is a plain square wave"
    OFF_GRID = "a transition off the bit grid"
    OCCLUSION = "silence longer than the longest legal run"
    WEAK = "likelihood below the threshold"
    PAYLOAD_CHANGED = "payload differs from the confirmed one"
    NO_CLOCK = "no bit clock found"
    # Packets and their messages.
    CHECKSUM = "checksum"
    REPEATED = "received before"
    LOST = "message lost"
    # Commands to beacons, in the order in which they are checked behind those of any message.
    NOT_EXACT = "not asked on the exact key of a listed beacon"
    NOT_AUTHENTIC = "command without the site's secret"
    EXPIRED = "command expired"
    EXPIRES_LATE = "command lives too long"
    REPLAYED = "nonce used before"
    ISSUED_BEFORE = "command from before the start"
    ISSUED_AHEAD = "command from the future"
    TOO_FREQUENT = "commands too frequent"
    NOT_ALLOWED = "beyond what the site allows"
    # What comes from a beacon's line.
    NOT_ASKED = "answer to nothing that was asked"
    NONSENSE = "answer breaks the beacon protocol"
    OTHER_BEACON = "another beacon answers in its place"


Refusals = Counter[Refusal]


def by_name(refusals: Refusals) -> dict[str, int]:
    """Return the counts under the refusals' names, in the order of `Refusal`, zeros left out."""
    if not refusals:
        return {}
    return {reason.value: refusals[reason] for reason in Refusal if refusals[reason]}
