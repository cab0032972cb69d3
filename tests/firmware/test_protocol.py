"""The serial protocol of the firmware: what it answers, what it refuses, and that each request is carried out once."""

from __future__ import annotations

import binascii
import json
import random
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support import beacon_wire as wire
from support.beacon_wire import (
    ARM,
    CLEAR,
    CODE,
    DISARM,
    GET,
    PACKET,
    QUEUE,
    SAVE,
    SEED11,
    SET,
    STATUS,
    UART,
    Body,
    cobs,
    record,
    uncobs,
)
from support.firmware import Script

VECTORS: dict[str, Any] = json.loads((Path(__file__).parents[1] / "vectors/protocol.json").read_text("utf-8"))
SECOND = struct.pack(">I", 1000)


@pytest.fixture
def fresh(script_program: Path) -> Iterator[Script]:
    """Return a beacon that nobody greeted."""
    with Script(script_program) as script:
        yield script


@pytest.mark.parametrize("vector", VECTORS["cobs"], ids=lambda v: v["body"])
def test_cobs_has_the_known_answers(vector: dict[str, str]) -> None:
    assert cobs(bytes.fromhex(vector["body"])).hex() == vector["frame"]
    assert uncobs(bytes.fromhex(vector["frame"])).hex() == vector["body"]


@pytest.mark.parametrize("vector", VECTORS["frames"], ids=lambda v: v["what"])
def test_the_frames_of_the_vectors_are_understood_by_the_firmware_and_made_by_the_test(
    fresh: Script, vector: dict[str, str]
) -> None:
    (body,) = wire.parse(bytes.fromhex(vector["wire"]))
    assert body.wire().hex() == vector["wire"]
    answers = wire.parse(fresh.exchange(bytes.fromhex(vector["wire"])))
    if body.type in (wire.REPLY | ARM, wire.ON_AIR):
        assert answers == []  # no request: an echo
    else:
        assert [(answer.type, answer.seq) for answer in answers] == [(body.type | wire.REPLY, body.seq)]


@pytest.mark.parametrize("vector", VECTORS["damaged"], ids=lambda v: v["what"])
def test_damaged_frames_are_counted_and_not_answered(beacon: Script, vector: dict[str, str]) -> None:
    assert beacon.exchange(bytes.fromhex(vector["wire"])) == b""
    assert beacon.host.status().bad == 1
    assert beacon.exchange(b"\1" * 700 + b"\0") == b""
    assert beacon.host.status().bad == 2


def test_a_frame_after_noise_is_understood(beacon: Script) -> None:
    noise = random.Random(1).randbytes(100).replace(b"\0", b"\1")
    beacon.host.seq += 1
    request = Body(STATUS, beacon.host.seq, beacon.host.boot, b"")
    (reply,) = wire.parse(beacon.exchange(noise + request.wire()))
    assert wire.status_of(reply).bad == 1


def test_a_request_may_come_in_any_pieces(beacon: Script) -> None:
    request = Body(STATUS, 7, beacon.host.boot, b"").wire()
    said = b"".join(beacon.exchange(request[i : i + 1]) for i in range(len(request)))
    assert [body.seq for body in wire.parse(said)] == [7]


def test_hello_tells_who_it_is_and_repeats_the_nonce(beacon: Script) -> None:
    reply = beacon.host.ask(wire.HELLO, b"\xde\xad\xbe\xef", boot=0)
    nonce, version, uid, can, least, most, ticks, message, text, places = struct.unpack(
        ">4sB3x8sIIIIHBB", reply.payload[1:-6]
    )
    assert (nonce, version, uid) == (b"\xde\xad\xbe\xef", 1, bytes(range(1, 9)))
    assert (can, least, most, ticks) == (0x20F, 10_000, 20_000_000, 1_000_000_000)
    assert (message, text, places) == (240, 64, 4)
    assert reply.payload[-6:] == b"script"


def test_boot_is_said_again_each_second_until_somebody_asks(fresh: Script) -> None:
    fresh.run(3.5)
    assert [event.type for event in fresh.host.events] == [wire.BOOT] * 4
    fresh.host.hello()
    fresh.run(3.0)
    assert len(fresh.host.events) == 4


def test_a_request_that_is_repeated_is_carried_out_once_and_answered_alike(beacon: Script) -> None:
    host = beacon.host
    host.done(SET, record(PACKET, 1))
    request = Body(QUEUE, 500, host.boot, b"\1\1hello").wire()
    replies = {beacon.exchange(request) for _ in range(5)}
    assert len(replies) == 1
    status = host.status()
    assert (status.free, status.accepted, status.replays) == (3, 1, 4)
    # Another sequence number, or another content, is another request.
    beacon.exchange(Body(QUEUE, 501, host.boot, b"\1\1hello").wire())
    beacon.exchange(Body(QUEUE, 501, host.boot, b"\1\1hallo").wire())
    assert host.status().accepted == 3


def test_a_reply_that_the_line_did_not_take_is_said_when_it_is_asked_for_again(beacon: Script) -> None:
    beacon.host.done(SET, record(PACKET, 1))
    request = Body(QUEUE, 500, beacon.host.boot, b"\1\1hello").wire()
    beacon.tell("line", 0)
    assert beacon.exchange(request) == b""
    beacon.run(0.01)
    beacon.tell("line", 1)
    (reply,) = wire.parse(beacon.exchange(request))
    assert reply.payload == b"\0\0\1\3"


def test_a_request_meant_for_the_boot_before_is_refused(beacon: Script) -> None:
    old = beacon.host.boot
    beacon.tell("reboot")
    uid = bytes(range(1, 9))
    assert beacon.host.ask(SET, record(SEED11, 1), boot=old).payload == bytes([wire.WRONG_BOOT]) + uid
    assert beacon.host.hello().boot != old
    assert beacon.host.ask(GET).payload == bytes([wire.NO_PROGRAM])


def test_another_version_is_refused_but_hello_is_answered(beacon: Script) -> None:
    host = beacon.host
    (reply,) = wire.parse(beacon.exchange(Body(STATUS, 9, host.boot, b"", version=2).wire()))
    assert reply.payload == bytes([wire.WRONG_VERSION])
    (reply,) = wire.parse(beacon.exchange(Body(wire.HELLO, 10, 0, b"1234", version=2).wire()))
    assert reply.payload[0] == wire.OK
    assert reply.version == 1


REFUSED = [
    (record(0), wire.RANGE, 0),
    (record(5), wire.RANGE, 0),
    (record(SEED11, 64), wire.RANGE, 10),
    (record(SEED11, 1, option=2), wire.RANGE, 1),
    (record(SEED11, 1, size=1), wire.RANGE, 2),
    (record(SEED11, 1, gap=1), wire.RANGE, 3),
    (record(SEED11, 1, kind=1), wire.RANGE, 14),
    (record(SEED11, 1, kind=2), wire.RANGE, 14),
    (record(SEED11, 1, bit_rate=9.999), wire.RANGE, 4),
    (record(SEED11, 1, bit_rate=20000.001), wire.RANGE, 4),
    (record(SEED11, 1, power=0), wire.RANGE, 8),
    (record(SEED11, 1, power=1001), wire.RANGE, 8),
    (record(SEED11, 1, power=500), wire.UNSUPPORTED, None),
    (record(SEED11, 14), wire.AMBIGUOUS, None),
    (record(SEED11, 7, option=1), wire.AMBIGUOUS, None),
    (record(SEED11, 1, text=b"x"), wire.LENGTH, None),
    (record(SEED11, 1)[:-1], wire.LENGTH, None),
    (record(CODE, 169, option=1), wire.RANGE, 10),
    (record(CODE, 522, option=2), wire.RANGE, 10),
    (record(CODE, 0, option=3), wire.RANGE, 1),
    (record(CODE, 0, option=1, size=18), wire.RANGE, 2),
    (record(CODE, 0, size=3), wire.RANGE, 2),
    (record(CODE, 0, size=33), wire.RANGE, 2),
    (record(CODE, 16, size=4), wire.RANGE, 10),
    (record(UART, 1), wire.RANGE, 10),
    (record(UART, option=1), wire.RANGE, 1),
    (record(UART, text=b"ok\x7f"), wire.RANGE, 15),
    (record(UART, text=b"\xff"), wire.RANGE, 15),
    (record(UART, text=b"x" * 65), wire.LENGTH, None),
    (record(PACKET, 256), wire.RANGE, 10),
    (record(PACKET, 1, option=4), wire.RANGE, 1),
    (record(PACKET, 1, size=3), wire.RANGE, 2),
    (record(PACKET, 1, size=31), wire.RANGE, 2),
]


def test_programs_out_of_range_are_refused_whole_and_the_field_is_named(beacon: Script) -> None:
    host = beacon.host
    host.done(SET, record(SEED11, 42))
    for number, (program, result, field) in enumerate(REFUSED, 1):
        expected = bytes([result]) if field is None else bytes([result, field])
        assert host.ask(SET, program).payload == expected, program.hex()
        assert host.status().refused == number
    assert host.done(GET) == b"\0\1" + record(SEED11, 42)


def test_requests_that_cannot_be_carried_out_are_refused_with_their_reason(beacon: Script) -> None:
    host = beacon.host

    def refused(kind: int, payload: bytes = b"") -> tuple[int, ...]:
        return tuple(host.ask(kind, payload).payload)

    assert refused(0x0A) == (wire.UNKNOWN,)
    assert refused(0x3F) == (wire.UNKNOWN,)
    assert refused(ARM, SECOND) == (wire.NO_PROGRAM,)
    assert refused(SAVE) == (wire.NO_PROGRAM,)
    assert refused(QUEUE, b"\1\1x") == (wire.NOT_NOW,)
    assert refused(STATUS, b"x") == (wire.LENGTH,)
    assert refused(ARM, b"\0\0\1") == (wire.LENGTH,)
    host.done(SET, record(UART))
    assert refused(ARM, struct.pack(">I", 0)) == (wire.RANGE, 0)
    assert refused(ARM, struct.pack(">I", 3_600_001)) == (wire.RANGE, 0)
    assert refused(QUEUE, b"\1\1") == (wire.LENGTH,)
    assert refused(QUEUE, b"\1\1" + b"x" * 241) == (wire.LENGTH,)
    assert refused(QUEUE, b"\0\1x") == (wire.RANGE, 0)
    assert refused(QUEUE, b"\2\1x") == (wire.RANGE, 0)
    assert refused(QUEUE, b"\1\0x") == (wire.RANGE, 1)
    assert refused(QUEUE, b"\1\11x") == (wire.RANGE, 1)
    assert refused(QUEUE, b"\1\1ab\x7f") == (wire.RANGE, 4)
    for _ in range(4):
        host.done(QUEUE, b"\1\1x")
    assert refused(QUEUE, b"\1\1x") == (wire.FULL,)
    assert host.done(CLEAR) == b"\4"
    assert host.status().dropped == 4


def test_what_is_kept_comes_back_after_a_reboot_and_is_written_once(beacon: Script) -> None:
    host = beacon.host
    program = record(PACKET, 9, bit_rate=2500, gap=7, kind=1, text="grüße".encode())
    host.done(SET, program)
    beacon.tell("store", 0)
    assert host.ask(SAVE).payload == bytes([wire.STORAGE])
    assert not host.status().saved
    beacon.tell("store", 1)
    host.done(SAVE)
    host.done(SAVE)
    assert len(beacon.kept) == 1
    host.done(SET, record(SEED11, 1))
    beacon.tell("reboot")
    host.hello()
    assert host.done(GET) == b"\0\0" + program
    assert host.status().saved


@pytest.mark.parametrize("damage", ["", "48", "ff" * 85, "a wrong bit", "cut", "another layout", "what it cannot send"])
def test_a_store_that_is_damaged_is_no_program(beacon: Script, damage: str) -> None:
    host = beacon.host
    host.done(SET, record(SEED11, 42))
    host.done(SAVE)
    kept = bytearray(beacon.kept[0])
    if damage == "a wrong bit":
        kept[10] ^= 4
    elif damage == "cut":
        kept = kept[:-1]
    elif damage == "another layout":
        kept[2] = 2
    elif damage == "what it cannot send":
        kept[4] = 9
        kept[-2:] = struct.pack(">H", binascii.crc_hqx(bytes(kept[:-2]), 0xFFFF) ^ 0xFFFF)
    else:
        kept = bytearray.fromhex(damage)
    beacon.tell("kept", kept.hex())
    beacon.tell("reboot")
    host.hello()
    assert host.ask(GET).payload == bytes([wire.NO_PROGRAM])


def test_events_that_the_line_does_not_take_wait_and_what_is_forgotten_leaves_a_gap_in_their_count(
    beacon: Script,
) -> None:
    host = beacon.host
    host.done(SET, record(SEED11, 1, bit_rate=5000))
    before = host.events[-1].seq
    beacon.tell("line", 0)
    for _ in range(12):
        beacon.exchange(Body(ARM, 900, host.boot, struct.pack(">I", 5)).wire())
        beacon.exchange(Body(DISARM, 901, host.boot, b"").wire())
        beacon.exchange(Body(ARM, 902, host.boot, struct.pack(">I", 5)).wire())
        beacon.run(0.02)
    beacon.tell("line", 1)
    beacon.run(0.01)
    waited = [event.seq for event in host.events if event.seq > before]
    assert len(waited) == 8
    assert waited == list(range(waited[0], waited[0] + 8))
    assert waited[0] > before + 1


def test_under_5_percent_of_bad_bytes_every_request_is_carried_out_once(beacon: Script) -> None:
    """A host that repeats until the reply comes, over a line that spoils bytes in both directions."""
    draw = random.Random(4)
    host = beacon.host
    host.done(SET, record(PACKET, 1, bit_rate=5000))

    def spoiled(stream: bytes) -> bytes:
        return bytes(byte ^ draw.randrange(1, 256) if draw.random() < 0.05 else byte for byte in stream)

    def heard(stream: bytes) -> list[Body]:
        found = []
        for frame in stream.split(b"\0"):
            try:
                found += wire.parse(b"\0" + frame + b"\0")
            except (ValueError, struct.error):
                continue
        return found

    carried_out = 0
    for seq in range(2000, 2150):
        request = Body(SET, seq, host.boot, record(PACKET, seq % 256, bit_rate=5000))
        for _ in range(60):
            answers = heard(spoiled(beacon.exchange(spoiled(request.wire()))))
            if any(answer.seq == seq and answer.type == SET | wire.REPLY for answer in answers):
                carried_out += 1
                break
    status = host.status()
    assert carried_out == 150
    assert status.program == 151
    assert status.replays > 0
