"""What is said about beacons on the bus: the state of one, and the commands that it is given.

::

    beacon/{name}/state    `BeaconState`, published when anything changes, the last one kept for late readers
    beacon/{name}/cmd      a query with a `BeaconCommand`, answered by one `BeaconReply`

A command ends once: `applied` (the beacon has said so), `failed` (it has not said so in time, and nobody tries any
more) or `refused` (it never reached the beacon). It carries a nonce that is never used again, and the wall times at
which it was issued and expires, so that a recorded command is worth nothing: while a controller runs it remembers the
nonce, and after another start it takes nothing that was issued before. Where the site has a secret, `mac` is::

    HMAC-SHA-256(secret, msgpack(body with mac = b""))
"""

from __future__ import annotations

import hmac
from typing import Annotated, ClassVar, Final, Literal, Self

import msgpack
import msgspec
from msgspec import Meta

from heliograph.messages import Count, Message, Name, Payload, Positive, Share
from heliograph.units import BIT_RATE_MAX, BIT_RATE_MIN

Operation = Literal["set", "arm", "disarm", "send", "save"]
Outcome = Literal["applied", "failed", "refused"]
# absent: its port is not there; silent: nothing comes from it; nonsense: what comes is no beacon, and it is left alone;
# foreign: a beacon that the site does not list, or another program of the protocol; ready: it obeys.
LinkWord = Literal["absent", "silent", "nonsense", "foreign", "ready"]
BitRate = Annotated[float, Meta(ge=BIT_RATE_MIN, le=BIT_RATE_MAX)]
GapBits = Annotated[int, Meta(ge=0, le=255)]
Options = dict[Annotated[str, Meta(max_length=32)], str | int]

_MAC_BYTES: Final = 32


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What a beacon is to send, or says that it sends; None where nobody has said.

    Args:
        protocol: a row of `heliograph.link.modulations`.
        options: the modulation's own.
        payload: its ID; None for a protocol that sends text alone.
        bit_rate: bits a second.
        power: share of the full light.
        text: what a protocol that sends text repeats between messages.
        gap_bits: how long it rests after each round.
        armed: whether it may shine.
        lease_s: how long it may, from now on.
    """

    protocol: Name | None = None
    options: Options = {}
    payload: Payload | None = None
    bit_rate: BitRate | None = None
    power: Share | None = None
    text: Annotated[str, Meta(max_length=64)] | None = None
    gap_bits: GapBits | None = None
    armed: bool = False
    lease_s: Positive = 0.0


class BeaconState(Message, frozen=True, kw_only=True):
    """A beacon as its controller knows it: what is wanted of it and what it says of itself, apart.

    `uid` is the hardware's own number and `port` where it was found; `link` says whether it obeys: `ready`, or why not
    (`absent`, `silent`, `nonsense`, `foreign`). `reported` is None until it has spoken. `waiting` counts its messages
    that are not yet sent. `counters` are of this beacon alone; `trouble` is the last one, in words.
    """

    SCHEMA: ClassVar[str] = "beacon"
    name: Name
    uid: Annotated[str, Meta(max_length=64)]
    port: Annotated[str, Meta(max_length=200)]
    link: LinkWord
    desired: Settings
    reported: Settings | None
    waiting: Count
    boots: Count
    counters: dict[str, Count]
    trouble: Annotated[str, Meta(max_length=300)]


class BeaconCommand(Message, frozen=True, kw_only=True):
    """One thing that a beacon is told to do; the fields of the other operations are absent.

    `set` changes those of protocol, options, payload, bit_rate, power, text and gap_bits that are given; `arm` lets it
    shine for `lease_s`; `disarm` makes it dark; `send` queues a text or bytes for its protocol to send, `times` times
    or once; `save` keeps its settings over a loss of power. `nonce` is hex, drawn anew for each command; `issued_ms`
    and `expires_ms` are Unix times.
    """

    SCHEMA: ClassVar[str] = "beacon_cmd"
    name: Name
    op: Operation
    nonce: Annotated[str, Meta(pattern=r"^[0-9a-f]{32}$")]
    issued_ms: Count
    expires_ms: Count
    protocol: Name | None = None
    options: Options | None = None
    payload: Payload | None = None
    bit_rate: BitRate | None = None
    power: Share | None = None
    lease_s: Annotated[float, Meta(gt=0.0, le=1e6)] | None = None
    text: Annotated[str, Meta(max_length=4096)] | None = None
    gap_bits: GapBits | None = None
    times: Annotated[int, Meta(ge=1, le=8)] | None = None
    data: Annotated[bytes, Meta(min_length=1, max_length=4096)] | None = None
    mac: Annotated[bytes, Meta(max_length=_MAC_BYTES)] = b""

    def __post_init__(self) -> None:
        allowed = _FIELDS[self.op]
        given = [name for name in _OF_OPERATIONS if getattr(self, name) is not None]
        wrong = [name for name in given if name not in allowed]
        if wrong:
            raise ValueError(f"{self.op} takes {', '.join(allowed) or 'nothing'}, not {wrong[0]}")
        if allowed and not given:
            raise ValueError(f"{self.op} needs one of {', '.join(allowed)}")
        if self.op == "send" and (self.text is None) == (self.data is None):
            raise ValueError("send needs text or data, not both")
        if self.op == "send" and not self.text and not self.data:
            raise ValueError("send needs something to send, not an empty text")

    def to_body(self) -> dict[str, object]:
        """Return the body; bytes stay bytes."""
        return {
            name: getattr(self, name) if name in {"data", "mac"} else msgspec.to_builtins(getattr(self, name))
            for name in self.__struct_fields__
        }

    def signed(self, secret: bytes) -> Self:
        """Return the command with its MAC; without a secret, as it is."""
        return msgspec.structs.replace(self, mac=_mac_of(self, secret)) if secret else self

    def is_authentic(self, secret: bytes) -> bool:
        """Return whether the MAC is the secret's; without a secret, True."""
        return not secret or hmac.compare_digest(self.mac, _mac_of(self, secret))


class BeaconReply(Message, frozen=True, kw_only=True):
    """How a command ended.

    `reason` is empty where it was applied; of a refusal it is the counter's name, of a failure one of `absent`,
    `silent`, `nonsense`, `foreign` (the link was so), `no answer`, `rebooted`, `declined`; `detail` says more. `nonce`
    is the command's, empty where it was not read. `tries` counts how often it was sent to the beacon, `took_s` runs
    from its arrival to this reply.
    """

    SCHEMA: ClassVar[str] = "beacon_reply"
    name: Name
    nonce: Annotated[str, Meta(max_length=32)]
    outcome: Outcome
    reason: Annotated[str, Meta(max_length=100)] = ""
    detail: Annotated[str, Meta(max_length=300)] = ""
    tries: Count = 0
    took_s: Positive = 0.0


_SETTINGS: Final = ("protocol", "options", "payload", "bit_rate", "power", "text", "gap_bits")
_FIELDS: Final[dict[str, tuple[str, ...]]] = {
    "set": _SETTINGS,
    "arm": ("lease_s",),
    "disarm": (),
    "send": ("text", "data", "times"),
    "save": (),
}
_OF_OPERATIONS: Final = (*_SETTINGS, "lease_s", "data", "times")


def _mac_of(command: BeaconCommand, secret: bytes) -> bytes:
    return hmac.digest(secret, msgpack.packb(msgspec.structs.replace(command, mac=b"").to_body()), "sha256")
