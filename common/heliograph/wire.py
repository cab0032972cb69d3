"""The envelope: how a record becomes bytes on the bus, and how bytes are refused.

A payload is one msgpack map, its keys in this order::

    schema str    the record's schema, e.g. "tracks"
    version       [major, minor]; another major is refused, another minor read (unknown fields are left out)
    source str    "{service}/{instance}" of the sender
    boot str      8 hex digits drawn when the sender started
    seq int       counts the sender's messages on this key from 0: a jump is a loss
    clock str     whose clock `t_us` is: the camera's name, or "" for none
    t_us int      camera time of the content
    mono_ns int   sender's monotonic clock
    wall_ns int   sender's wall clock
    body map      the record's fields (heliograph.messages, heliograph.streams)

Its Zenoh encoding is ``application/msgpack;heliograph.{schema}.v{major}``. Bytes are checked from the outside inwards;
what fails has a name (`heliograph.errors.Refusal`) and is counted by the receiver. Nothing here raises on bad bytes.
"""

from __future__ import annotations

from typing import Annotated, Final

import msgpack
import msgspec
from msgspec import Meta

from heliograph import beacons, flow, messages, streams
from heliograph.errors import Refusal
from heliograph.messages import TIME_LIMIT_US, Message

# 4M events are 33 MB; nothing else comes near.
PAYLOAD_LIMIT: Final = 64 * 1024 * 1024
# The truth is not here: its reader asks for it by name (heliograph.truth), so that no receiver decodes it by accident.
SCHEMAS: Final[dict[str, type[Message]]] = {
    kind.SCHEMA: kind
    for kind in (
        streams.Events,
        streams.Onsets,
        streams.Image,
        messages.Tracks,
        messages.Status,
        messages.Frames,
        messages.Identification,
        messages.Data,
        messages.Link,
        messages.Progress,
        messages.Health,
        messages.Metrics,
        messages.Clock,
        flow.Flow,
        beacons.BeaconState,
        beacons.BeaconCommand,
        beacons.BeaconReply,
    )
}

_Int63 = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
_Word = Annotated[str, Meta(max_length=160)]


class Header(msgspec.Struct, frozen=True, kw_only=True):
    """Everything of an envelope but its body; see the module's table."""

    schema: _Word
    version: tuple[Annotated[int, Meta(ge=0)], Annotated[int, Meta(ge=0)]]
    source: _Word
    boot: _Word
    seq: Annotated[int, Meta(ge=0, le=TIME_LIMIT_US)]
    clock: _Word
    t_us: Annotated[int, Meta(ge=-TIME_LIMIT_US, le=TIME_LIMIT_US)]
    mono_ns: _Int63
    wall_ns: _Int63


class Refused(msgspec.Struct, frozen=True):
    """Bytes that are no message: why, and one line for the log."""

    reason: Refusal
    detail: str


def header_for(message: Message, *, source: str, boot: str, seq: int, mono_ns: int, wall_ns: int) -> Header:
    """Return the header of a record; schema, version, clock and time follow from it."""
    return Header(
        schema=message.SCHEMA,
        version=message.VERSION,
        source=source,
        boot=boot,
        seq=seq,
        clock=getattr(message, "camera", ""),
        t_us=message.time_us,
        mono_ns=mono_ns,
        wall_ns=wall_ns,
    )


def encoding_of(message: Message | type[Message]) -> str:
    """Return the Zenoh encoding of a record's schema."""
    return f"application/msgpack;heliograph.{message.SCHEMA}.v{message.VERSION[0]}"


def pack(header: Header, message: Message) -> bytes:
    """Return the payload of a record under a header."""
    envelope = msgspec.structs.asdict(header)
    envelope["body"] = message.to_body()
    packed: bytes = msgpack.packb(envelope)
    return packed


def pack_body(message: Message) -> bytes:
    """Return the body alone: what is the same in every run of the same input."""
    packed: bytes = msgpack.packb(message.to_body())
    return packed


def unpack(payload: bytes, expected: dict[str, type[Message]] | None = None) -> tuple[Header, Message] | Refused:
    """Return header and record of a payload, or why there is none.

    Args:
        payload: the bytes of one sample.
        expected: the schemas that the caller reads, by name; `SCHEMAS` by default.
    """
    schemas = SCHEMAS if expected is None else expected
    if len(payload) > PAYLOAD_LIMIT:
        return Refused(Refusal.TOO_LARGE, f"{len(payload)} bytes, at most {PAYLOAD_LIMIT}")
    try:
        envelope = msgpack.unpackb(payload, raw=False, strict_map_key=True, unicode_errors="strict")
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError) as error:
        # msgpack raises ValueError's children for short, surplus, badly nested and non-UTF-8 input alike.
        return Refused(Refusal.NOT_MSGPACK, f"{type(error).__name__}: {error}"[:200])
    if not isinstance(envelope, dict) or not isinstance(envelope.get("body"), dict):
        return Refused(Refusal.NO_ENVELOPE, "no map with a body")
    body = envelope.pop("body")
    try:
        header = msgspec.convert(envelope, Header, strict=True)
    except msgspec.ValidationError as error:
        return Refused(Refusal.NO_ENVELOPE, str(error)[:200])
    kind = schemas.get(header.schema)
    if kind is None:
        return Refused(Refusal.UNKNOWN_SCHEMA, f"schema {header.schema!r}, not one of {', '.join(schemas)}")
    if header.version[0] != kind.VERSION[0]:
        return Refused(
            Refusal.WRONG_VERSION, f"{header.schema} version {header.version[0]}, this reader has {kind.VERSION[0]}"
        )
    try:
        return header, kind.from_body(body)
    except (ValueError, TypeError, OverflowError) as error:
        return Refused(Refusal.BAD_BODY, f"{header.schema}: {error}"[:300])
