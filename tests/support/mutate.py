"""Damaged messages: bytes flipped, cut, doubled and inserted, and sound envelopes with absurd values inside."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import msgpack

from heliograph.messages import Message
from heliograph.wire import pack
from support.records import header_of

ABSURD: tuple[Any, ...] = (
    None, True, -1, 0, 2**53, -(2**53), 2**63 - 1, 2**64 - 1, 1e300, -1e300, float("nan"), float("inf"), "", "x" * 500,
    "a/b", "*", b"", b"\x00" * 999, [], [[]], {}, {"x": {}}, [1, 2, 3], ["cam0"] * 3,
)  # fmt: skip


def _any_path(value: Any, rng: random.Random) -> Any:
    """Return the value with one thing at a random depth replaced by an absurd one."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        name = rng.choice(list(value))
        return value | {name: _any_path(value[name], rng)}
    if isinstance(value, list) and value and rng.random() < 0.7:
        at = rng.randrange(len(value))
        return [*value[:at], _any_path(value[at], rng), *value[at + 1 :]]
    if isinstance(value, int) and not isinstance(value, bool) and rng.random() < 0.5:
        return value + rng.choice((-(2**40), -(10**6), -1, 1, 10**6, 2**40))
    return rng.choice(ABSURD)


def _bytes(raw: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(raw)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at = rng.randrange(len(damaged)) if damaged else 0
        match rng.randrange(5):
            case 0:
                damaged = damaged[:at]
            case 1:
                damaged[at:at] = rng.randbytes(rng.randrange(1, 5))
            case 2:
                damaged += damaged[at:]
            case _ if damaged:
                damaged[at] ^= 1 << rng.randrange(8)
            case _:
                pass
    return bytes(damaged)


def mutations(message: Message, n: int, seed: int) -> Iterator[bytes]:
    """Yield n damaged payloads of a record, the same for the same seed."""
    rng = random.Random(seed)
    raw = pack(header_of(message), message)
    whole = msgpack.unpackb(raw)
    for _ in range(n):
        match rng.randrange(3):
            case 0:
                yield _bytes(raw, rng)
            case 1:
                yield msgpack.packb(whole | {"body": _any_path(whole["body"], rng)})
            case _:
                yield msgpack.packb(_any_path(whole, rng))
