"""On the air: the vectors that Python's encoders pass, in C; changes between frames; darkness where it is due."""

from __future__ import annotations

import json
import random
import struct
from pathlib import Path
from typing import Any

import pytest

from heliograph.link.modulations.packet import Packet
from support import beacon_wire as wire
from support.beacon_wire import ARM, CODE, DISARM, PACKET, QUEUE, SEED11, SET, UART, record
from support.firmware import Script, edge_check, lit_within

VECTORS = Path(__file__).parents[1] / "vectors"
BOOKS = {"code18d4": 1, "code20d4": 2}
RATES = ("1/2", "2/3", "3/4", "5/6")
FOREVER = struct.pack(">I", 3_600_000)


def vectors(name: str) -> Any:
    return json.loads((VECTORS / f"{name}.json").read_text("utf-8"))


def bits_on_air(beacon: Script, program: bytes, bits: int, bit_rate: float = 1000.0, queue: bytes = b"") -> str:
    """Return the first bits that a program sends, from a dark beacon."""
    beacon.host.done(SET, program)
    if queue:
        beacon.host.done(QUEUE, queue)
    beacon.run(0.01)
    beacon.host.done(ARM, FOREVER)
    begin_ns = beacon.now_ns
    beacon.run((bits + 2) / bit_rate + 0.003)
    beacon.host.done(DISARM)
    beacon.run(0.002 + 2 / bit_rate)
    # The pump wakes on its dark grid of 1 ms after the ARM.
    start_ns = -(-begin_ns // 1_000_000) * 1_000_000
    at_ns = [start_ns + (k + 0.5) * 1e9 / bit_rate for k in range(bits)]
    return "".join(str(next((lit for t, lit in reversed(beacon.edges) if t <= now), 0)) for now in at_ns)


@pytest.mark.parametrize("vector", vectors("seed11")["frames"], ids=lambda v: f"{v['payload']}-{v['parity']}")
def test_seed11_sends_the_bits_of_the_vectors_again_and_again(beacon: Script, vector: dict[str, Any]) -> None:
    option = ("even", "paper_text").index(vector["parity"])
    assert bits_on_air(beacon, record(SEED11, vector["payload"], option=option), 33) == vector["bits"] * 3


@pytest.mark.parametrize("book", BOOKS)
def test_code_sends_the_words_of_the_vectors(beacon: Script, book: str) -> None:
    for index, word in vectors("code")["books"][book]["words"].items():
        program = record(CODE, int(index), option=BOOKS[book])
        assert bits_on_air(beacon, program, 2 * len(word)) == 2 * word


@pytest.mark.parametrize("word", ["0111", "00000100000100001001", "11110000" * 4])
def test_code_sends_any_word_that_it_is_given(beacon: Script, word: str) -> None:
    program = record(CODE, int(word, 2), size=len(word))
    assert bits_on_air(beacon, program, 2 * len(word)) == 2 * word


@pytest.mark.parametrize("vector", vectors("uart")["texts"], ids=lambda v: repr(v["text"]))
def test_uart_sends_the_bits_of_the_vectors_between_idle_light(beacon: Script, vector: dict[str, Any]) -> None:
    bits = vector["bits"]
    program = record(UART, gap=5, text=vector["text"].encode())
    idle = "1" * 11
    assert bits_on_air(beacon, program, 11 + 2 * (len(bits) + 5)) == idle + 2 * (bits + "1" * 5)


@pytest.mark.parametrize("vector", vectors("packet")["packets"][:2], ids=lambda v: v["data"])
def test_packet_sends_the_bits_of_the_vectors_of_number_0(beacon: Script, vector: dict[str, Any]) -> None:
    program = record(PACKET, vector["address"], kind=int(vector["text"]), text=bytes.fromhex(vector["data"]))
    assert bits_on_air(beacon, program, 309) == vector["air"]


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("block", [4, 13, 30])
def test_packets_of_every_layout_are_those_of_the_decoders_own_encoder(beacon: Script, block: int, rate: str) -> None:
    said = bytes(random.Random(block).randbytes(2 * block + 3))
    expected = "".join(map(str, Packet(block, rate).message(said, address=200)))
    program = record(PACKET, 200, option=RATES.index(rate), size=block, bit_rate=5000)
    on_air = bits_on_air(beacon, program, len(expected), 5000.0, queue=b"\0\1" + said)
    assert on_air == expected


def test_the_vectors_of_many_fragments_are_sent_under_the_number_that_a_queue_has_reached(beacon: Script) -> None:
    first, second = vectors("packet")["packets"][3:]
    said = bytes.fromhex(first["data"] + second["data"])
    host = beacon.host
    host.done(SET, record(PACKET, first["address"], bit_rate=5000))
    for message in (b"a", b"b", b"c", said):
        host.done(QUEUE, b"\1\1" + message)
    host.done(ARM, FOREVER)
    beacon.run(0.7)
    air = "".join(stretch.bits for stretch in edge_check.stretches(beacon.edges, 5000))
    assert first["air"] + second["air"] in air


@pytest.mark.parametrize(
    ("protocol", "options", "make"),
    [
        ("seed11", {}, lambda p: record(SEED11, p, bit_rate=5000)),
        ("code", {"codebook": "code18d4"}, lambda p: record(CODE, p, option=1, bit_rate=5000)),
        ("packet", {}, lambda p: record(PACKET, p, bit_rate=5000)),
    ],
)
def test_payloads_change_live_and_no_frame_is_damaged(
    script_program: Path, protocol: str, options: dict[str, Any], make: Any
) -> None:
    draw = random.Random(1)
    ambiguous = {14, 60, 15, 56, 23, 57, 28, 30, 29, 46, 39, 58, 59, 63, 61, 62}
    # A clock of 2 MHz, as the AVR port has: a tick is 0.5 us.
    with Script(script_program, 2_000_000) as beacon:
        beacon.host.hello()
        sent: list[int] = []
        while len(sent) < 200:
            payload = draw.choice([p for p in range(64) if p not in ambiguous and (not sent or p != sent[-1])])
            beacon.host.done(SET, make(payload))
            if not sent:
                beacon.host.done(ARM, FOREVER)
            sent.append(payload)
            beacon.run(draw.uniform(0.013, 0.03) if protocol == "packet" else draw.uniform(0.0045, 0.01))
            if protocol == "packet":
                beacon.run(0.13)
        beacon.run(0.1)
        report = beacon.check(protocol, 5000, **options)
    heard = [frame[0] if protocol == "packet" else frame for frame in report.frames]
    assert not report.damaged
    assert [payload for i, payload in enumerate(heard) if i == 0 or payload != heard[i - 1]] == sent
    assert report.worst_error_ns <= 500


def test_the_bit_clock_is_off_by_less_than_a_tick_and_never_drifts(script_program: Path) -> None:
    draw = random.Random(2)
    for rate in [50.0, 5000.0, *(round(draw.uniform(50, 5000), 3) for _ in range(20))]:
        with Script(script_program, 2_000_000) as beacon:
            beacon.host.hello()
            beacon.host.done(SET, record(SEED11, 42, bit_rate=rate))
            beacon.host.done(ARM, FOREVER)
            beacon.run(2.0)
            report = beacon.check("seed11", rate)
        assert len(report.frames) > 2.0 * rate / 11 - 3
        assert not report.damaged
        assert report.worst_error_ns <= 500 + 1
        assert abs(report.worst_drift_ns) <= 500 + 1


def test_bit_rate_and_payload_change_together_between_two_frames(beacon: Script) -> None:
    beacon.host.done(SET, record(SEED11, 42, bit_rate=1000))
    beacon.host.done(ARM, FOREVER)
    beacon.run(0.0123)
    beacon.host.done(SET, record(SEED11, 5, bit_rate=4000))
    beacon.run(0.5)
    # The second word of 42 began at 11 ms; the new program begins with its end, 22 ms after the first edge.
    first_ns = beacon.edges[0][0]
    change_ns = first_ns + 22_000_000
    before = [edge for edge in beacon.edges if edge[0] <= change_ns]
    after = [edge for edge in beacon.edges if edge[0] >= change_ns]
    assert edge_check.check(before, "seed11", 1000).frames == [42]  # the second one has no edge after it
    report = edge_check.check(after, "seed11", 4000)
    assert set(report.frames) == {5}
    assert not report.damaged
    assert [event.type for event in beacon.host.events].count(wire.ON_AIR) == 2


def test_it_is_dark_at_boot_and_a_saved_program_does_not_light_it(beacon: Script) -> None:
    beacon.host.done(SET, record(SEED11, 42))
    beacon.host.done(wire.SAVE)
    beacon.host.done(ARM, FOREVER)
    beacon.run(0.1)
    now_ns = beacon.now_ns
    beacon.host.events += wire.parse(beacon.tell("reboot"))
    beacon.run(1.5)
    assert not lit_within(beacon.edges, now_ns + 1, beacon.now_ns)
    beacon.host.hello()
    assert beacon.host.status().saved
    beacon.host.done(ARM, FOREVER)
    beacon.run(0.1)
    assert set(beacon.check("seed11", 1000, now_ns + 1).frames) == {42}


@pytest.mark.parametrize("rate", [50, 777, 5000])
def test_it_is_dark_within_one_bit_of_disarm(beacon: Script, rate: int) -> None:
    draw = random.Random(rate)
    beacon.host.done(SET, record(UART, bit_rate=rate))
    for _ in range(20):
        beacon.host.done(ARM, FOREVER)
        beacon.run(3 / rate + draw.random() / rate + 0.001)
        assert beacon.edges[-1][1] == 1
        beacon.host.done(DISARM)
        at_ns = beacon.now_ns
        beacon.run(1.5 / rate + 0.002)
        assert beacon.edges[-1][1] == 0
        assert beacon.edges[-1][0] - at_ns <= 1e9 / rate


@pytest.mark.parametrize("rate", [50, 777, 5000])
@pytest.mark.parametrize("how", ["run", "stall"])
def test_it_is_dark_within_one_bit_of_the_leases_end_even_if_the_main_loop_hangs(
    beacon: Script, rate: int, how: str
) -> None:
    beacon.host.done(SET, record(UART, bit_rate=rate))
    for lease_ms in (1, 37, 100):
        beacon.host.done(ARM, struct.pack(">I", lease_ms))
        at_ns = beacon.now_ns
        beacon.run(0.01)
        beacon.run(lease_ms / 1000 + 2 / rate, how)
        assert beacon.edges[-1][1] == 0
        # The pump took the lease at most 1 ms, a dark bit, after it was granted.
        assert beacon.edges[-1][0] - at_ns <= lease_ms * 1e6 + 1e9 / rate + (1e6 if how == "stall" else 0)
        beacon.run(0.1)
        assert not beacon.host.status().armed


def test_a_lease_that_is_renewed_in_time_leaves_the_light_as_it_is(beacon: Script) -> None:
    beacon.host.done(SET, record(SEED11, 42))
    for _ in range(20):
        beacon.host.done(ARM, struct.pack(">I", 100))
        beacon.run(0.07)
    report = beacon.check("seed11", 1000)
    assert report.stretches == 1
    assert not report.damaged
    beacon.run(0.1)
    assert [event.type for event in beacon.host.events].count(wire.DARK) == 1


@pytest.mark.parametrize("protocol", ["uart", "packet"])
def test_messages_arrive_whole_in_order_and_are_reported_when_they_are_over(beacon: Script, protocol: str) -> None:
    host = beacon.host
    rate = 5000.0
    program = record(UART, bit_rate=rate, gap=22) if protocol == "uart" else record(PACKET, 9, bit_rate=rate)
    host.done(SET, program)
    host.done(ARM, FOREVER)
    texts = [f"message {i} ".encode() * (1 + i % 3) for i in range(12)]
    waiting = list(texts)
    while waiting:
        if host.ask(QUEUE, b"\1\1" + waiting[0]).payload[0] == wire.OK:
            waiting.pop(0)
        beacon.run(0.02)
    beacon.run(2.0)
    ended = [struct.unpack(">HB", event.payload) for event in host.events if event.type == wire.MESSAGE]
    assert ended == [(i + 1, 0) for i in range(12)]
    report = beacon.check(protocol, rate)
    assert not report.damaged
    if protocol == "uart":
        assert "".join(report.frames) == b"".join(texts).decode()
    else:
        assert b"".join(data for _, _, _, data in report.frames) == b"".join(texts)
    assert host.status().late == 0


def test_a_message_that_was_cut_is_sent_again_from_its_beginning(beacon: Script) -> None:
    host = beacon.host
    host.done(SET, record(UART, bit_rate=1000, gap=22))
    host.done(QUEUE, b"\1\1" + b"0123456789")
    host.done(ARM, FOREVER)
    beacon.run(0.080)
    host.done(DISARM)
    beacon.run(0.1)
    again_ns = beacon.now_ns
    host.done(ARM, FOREVER)
    beacon.run(0.5)
    assert "".join(beacon.check("uart", 1000, again_ns).frames) == "0123456789"
    assert host.status().sent == 1


def test_repeats_of_a_message_keep_its_number_and_the_next_one_has_the_next(beacon: Script) -> None:
    host = beacon.host
    host.done(SET, record(PACKET, 9, bit_rate=5000, gap=40))
    host.done(ARM, FOREVER)
    host.done(QUEUE, b"\1\3" + b"thrice")
    host.done(QUEUE, b"\1\1" + b"once")
    beacon.run(1.0)
    frames = beacon.check("packet", 5000, gap=40).frames
    said = [(number, data) for _, number, _, data in frames if data]
    assert said == [(1, b"thrice")] * 3 + [(2, b"once")]
    fillers = {number for _, number, _, data in frames if not data}
    assert fillers == {0, 3}


def test_new_words_have_a_new_number_and_the_same_words_keep_theirs(beacon: Script) -> None:
    host = beacon.host
    seen = []
    for text, rate in ((b"one", 5000), (b"one", 5000), (b"two", 5000)):
        host.done(SET, record(PACKET, 9, bit_rate=rate, kind=1, text=text))
        host.done(ARM, FOREVER)
        beacon.run(0.4)
    for _, number, _, data in beacon.check("packet", 5000).frames:
        if (number, data) not in seen:
            seen.append((number, data))
    assert seen == [(0, b"one"), (1, b"two")]


def test_a_program_of_another_protocol_drops_the_messages_and_says_so(beacon: Script) -> None:
    host = beacon.host
    host.done(SET, record(UART, bit_rate=1000))
    host.done(ARM, FOREVER)
    for _ in range(3):
        host.done(QUEUE, b"\1\1" + b"never to be said to the end")
    beacon.run(0.1)
    host.done(SET, record(SEED11, 42))
    beacon.run(0.1)
    ended = [struct.unpack(">HB", event.payload) for event in host.events if event.type == wire.MESSAGE]
    assert ended == [(1, 2), (2, 2), (3, 2)]
    assert host.ask(QUEUE, b"\1\1x").payload[0] == wire.NOT_NOW


def test_a_main_loop_that_hangs_repeats_a_word_and_idles_between_packets(beacon: Script) -> None:
    host = beacon.host
    host.done(SET, record(SEED11, 42))
    host.done(ARM, FOREVER)
    beacon.run(0.05)
    beacon.run(0.2, "stall")
    assert not beacon.check("seed11", 1000).damaged
    assert host.status().late == 0
    host.done(SET, record(PACKET, 1, bit_rate=5000))
    beacon.run(0.2)
    since_ns = beacon.now_ns
    beacon.run(0.5, "stall")
    beacon.run(0.5)
    assert not beacon.check("packet", 5000, since_ns, gap=3000).damaged
    assert host.status().late == 1
