"""The frames of firmware/PROTOCOL.md, from its own example, and under damage."""

from __future__ import annotations

import json
import random
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph_services.beacon_controller.frames import Deframer, Frame, pack

VECTORS = Path(__file__).parents[1] / "vectors" / "protocol.json"
HELLO = bytes.fromhex("00 03 01 01 02 01 01 07 01 02 03 04 2f c2 00")
frames = st.builds(
    Frame,
    kind=st.integers(0, 255),
    seq=st.integers(0, 0xFFFF),
    boot=st.integers(0, 0xFFFF),
    payload=st.binary(max_size=246),
)


def test_the_worked_example_of_the_protocols_page_is_packed_and_read() -> None:
    hello = Frame(1, 1, 0, bytes([1, 2, 3, 4]))
    assert pack(hello) == HELLO
    assert Deframer().feed(HELLO) == [hello]


def test_the_golden_frames_that_the_firmware_reads_are_packed_and_read_here() -> None:
    golden = json.loads(VECTORS.read_text())
    for case in golden["frames"]:
        wire, body = bytes.fromhex(case["wire"]), bytes.fromhex(case["body"])
        (frame,) = Deframer().feed(wire)
        assert bytes((frame.version, frame.kind)) + frame.seq.to_bytes(2, "big") == body[:4], case["what"]
        assert frame.payload == body[6:]
        assert pack(frame) == wire
    for case in golden["damaged"]:
        deframer = Deframer()
        assert deframer.feed(bytes.fromhex(case["wire"])) == [], case["what"]
        assert sum(deframer.refusals.values()) == 1


@given(st.lists(frames, max_size=4), st.lists(st.integers(1, 300), max_size=20))
def test_any_frames_come_back_however_they_are_cut(sent: list[Frame], cuts: list[int]) -> None:
    wire = b"".join(pack(frame) for frame in sent)
    deframer = Deframer()
    found: list[Frame] = []
    for cut in cuts:
        found += deframer.feed(wire[:cut])
        wire = wire[cut:]
    assert found + deframer.feed(wire) == sent
    assert not deframer.refusals


def test_a_closing_00_that_is_damaged_into_01_takes_its_frame_with_it_and_no_more() -> None:
    first, second = Frame(3, 7, 9, b"\1\2\3"), Frame(4, 8, 9)
    deframer = Deframer()
    assert deframer.feed(pack(first)[:-1] + b"\1" + pack(second)) == [second]
    assert deframer.refusals == {Refusal.CHECKSUM: 1}


def test_noise_is_dropped_and_counted_and_the_next_frame_is_read() -> None:
    draw = random.Random(5)
    deframer = Deframer()
    read = deframer.feed(bytes(draw.randrange(256) for _ in range(200_000)))
    assert len(read) <= 2  # a CRC of 16 bits lets one frame of 65,536 pass
    assert deframer.refusals[Refusal.DAMAGED] + deframer.refusals[Refusal.CHECKSUM] > 500
    assert deframer.feed(HELLO) == [Frame(1, 1, 0, bytes([1, 2, 3, 4]))]
