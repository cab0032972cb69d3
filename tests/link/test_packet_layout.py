"""Packets on the air: against vectors worked out without the encoder, and the properties that the layout promises."""

from __future__ import annotations

import json
from itertools import groupby
from math import gcd
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.link.convolutional import PATTERNS, mother_bits
from heliograph.link.modulations import modulation
from heliograph.link.packet_layout import SYNC, SYNC_BITS, Layout, Packet, interleaver_step, layout_of, scrambler
from reference import packet_plain

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "packet.json").read_text("utf-8"))
PACKETS = st.builds(
    Packet,
    address=st.integers(0, 255),
    text=st.booleans(),
    number=st.integers(0, 15),
    fragment=st.integers(0, 63),
    more=st.just(False),
    data=st.binary(max_size=16),
)


def packet_of(vector: dict[str, Any]) -> Packet:
    data = bytes.fromhex(vector["data"])
    address, text, number, fragment, more = (vector[name] for name in ("address", "text", "number", "fragment", "more"))
    return Packet(address, text, number, fragment, more, data)


def whole_of(vector: dict[str, Any]) -> bytes:
    return int(vector["before_code"][:-6], 2).to_bytes(23, "big")


@pytest.mark.parametrize("vector", VECTORS["packets"], ids=lambda vector: vector["data"] or "empty")
def test_packets_are_as_worked_out_beside_the_encoder(vector: dict[str, Any]) -> None:
    assert "".join(map(str, Layout().encode(packet_of(vector)))) == vector["air"]
    assert Layout().parse(whole_of(vector)) == packet_of(vector)
    assert whole_of(vector)[-4:].hex() == vector["crc"]


@given(PACKETS)
def test_the_plain_writer_agrees_on_any_packet(packet: Packet) -> None:
    plain = packet_plain.packet(
        packet.address, packet.text, packet.number, packet.fragment, packet.more, packet.data
    )  # fmt: skip
    assert "".join(map(str, Layout().encode(packet))) == plain["air"]


def test_known_answers_of_others() -> None:
    assert packet_plain.crc32("".join(packet_plain.number(byte, 8) for byte in b"123456789")) == f"{0xCBF43926:032b}"
    assert "".join(map(str, scrambler(64))) == VECTORS["scrambler"] == f"{0xFF83DF1732094ED1:064b}"
    assert "".join(map(str, mother_bits([1, *(0,) * 6]))) == VECTORS["impulse"]


@given(st.integers(4, 30), st.sampled_from(sorted(PATTERNS)))
def test_every_code_bit_is_sent_once_and_neighbours_lie_apart(block: int, rate: str) -> None:
    tables = layout_of(block, rate).tables()
    n = len(tables.mother)
    assert len(set(tables.mother.tolist())) == n
    assert gcd(interleaver_step(n), n) == 1
    # What six places in a row carry lies at least a seventh of the code apart, but for what the coprime step costs.
    step = interleaver_step(n)
    nearest = min(min(k * step % n, n - k * step % n) for k in range(1, 6))
    assert nearest >= n / 7 - 6 * (step - n / 7)


def test_the_sync_is_unlike_itself_at_every_shift() -> None:
    signs = [1 - 2 * (SYNC >> i & 1) for i in range(SYNC_BITS)]
    shifted = [sum(a * b for a, b in zip(signs[k:], signs, strict=False)) for k in range(1, SYNC_BITS)]
    assert max(map(abs, shifted)) <= 4
    assert sum(signs) == 0
    assert max(len(list(run)) for _, run in groupby(signs)) <= 4


def test_a_packet_of_16_bytes_takes_309_bits_which_is_2071_net_at_5_kbit_s() -> None:
    assert layout_of().bits == 309
    assert 128 / layout_of().bits * 5000 == pytest.approx(2071, abs=1)


@pytest.mark.parametrize("data", [b"", b"\0" * 16, b"\xff" * 16, b"UUUUUUUUUUUUUUUU"])
def test_no_data_make_a_long_run(data: bytes) -> None:
    bits = [bit for number in range(16) for bit in Layout().encode(Packet(0, False, number, 0, False, data))]
    assert max(len(list(run)) for _, run in groupby(bits)) <= 14
    assert 0.4 < sum(bits) / len(bits) < 0.6


@given(PACKETS, st.integers(0, 183))
def test_a_flipped_bit_is_refused(packet: Packet, flipped: int) -> None:
    vector = packet_plain.packet(packet.address, packet.text, packet.number, packet.fragment, False, packet.data)
    whole = int(vector["before_code"][:-6], 2)
    assert Layout().parse(whole.to_bytes(23, "big")) == packet
    assert Layout().parse((whole ^ 1 << flipped).to_bytes(23, "big")) is None


def test_a_right_check_over_what_no_sender_makes_is_refused() -> None:
    import zlib  # noqa: PLC0415 - here alone

    for header, data in ((17, bytes(16)), (3, b"abcd" + bytes(12))):
        checked = bytes([1]) + header.to_bytes(2, "big") + data
        assert Layout().parse(checked + zlib.crc32(checked).to_bytes(4, "big")) is None


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"block": 3}, r"block must be in \[4, 30\] bytes, not 3"),
        ({"block": "16"}, r"block must be in \[4, 30\] bytes, not '16'"),
        ({"rate": "7/8"}, "rate must be one of 1/2, 2/3, 3/4, 5/6, not '7/8'"),
        ({"parity": "even"}, "packet does not take the options"),
    ],
)
def test_options_out_of_range_are_named(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        modulation("packet", **options)


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (256, r"payload of packet must be in \[0, 255\], not 256"),
        (-1, r"payload of packet must be in \[0, 255\], not -1"),
        (bytes(1025), "a message must have at most 1024 bytes, not 1025"),
    ],
)
def test_what_cannot_be_sent_is_named(payload: Any, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        modulation("packet").encode(payload)


def test_a_layout_refuses_fields_out_of_range() -> None:
    with pytest.raises(ValueError, match=r"number must be in \[0, 15\], not 16"):
        Layout().encode(Packet(0, False, 16, 0, False, b""))
    with pytest.raises(ValueError, match="data must have 16 to 16 bytes, not 3"):
        Layout().encode(Packet(0, False, 0, 0, True, b"abc"))
    with pytest.raises(ValueError, match="a packet has 23 bytes, not 2"):
        Layout().parse(b"ab")
