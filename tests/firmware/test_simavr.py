"""The AVR port in simavr: the firmware itself, cycle by cycle, with its interrupts, its serial line and its EEPROM."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.beacon_wire import ARM, CODE, DISARM, PACKET, QUEUE, SAVE, SEED11, SET, UART, record
from support.firmware import Script, live_changes

VECTORS = Path(__file__).parents[1] / "vectors"
FOREVER = struct.pack(">I", 3_600_000)


@pytest.fixture
def avr(avr_machine: tuple[Path, Path]) -> Iterator[Script]:
    """Return a beacon in simavr, greeted."""
    with Script(*avr_machine) as script:
        script.run(0.02)
        script.host.hello()
        yield script


def test_payloads_change_live_at_5_kbit_s_within_half_a_microsecond_and_no_frame_is_damaged(avr: Script) -> None:
    report, same = live_changes(avr, 25)
    assert same
    assert not report.damaged
    assert report.stretches == 1
    assert report.worst_error_ns <= 500
    assert abs(report.worst_drift_ns) <= 500
    assert avr.host.status().late == 0


def test_the_vectors_of_every_protocol_come_out_of_the_pin(avr: Script) -> None:
    def vectors(name: str) -> dict[str, list[dict[str, str]]]:
        found: dict[str, list[dict[str, str]]] = json.loads((VECTORS / f"{name}.json").read_text("utf-8"))
        return found

    host = avr.host
    host.done(SET, record(SEED11, 42, option=1, bit_rate=5000))
    host.done(ARM, FOREVER)
    avr.run(0.02)
    assert set(avr.check("seed11", 5000, parity="paper_text").frames) == {42}
    for book, index in ((1, 42), (2, 521)):
        host.done(DISARM)
        avr.run(0.02)
        since_ns = avr.now_ns
        host.done(SET, record(CODE, index, option=book, bit_rate=5000))
        host.done(ARM, FOREVER)
        avr.run(0.03)
        report = avr.check("code", 5000, since_ns, codebook=f"code{16 + 2 * book}d4")
        assert set(report.frames) == {index}
        assert not report.damaged
    host.done(DISARM)
    avr.run(0.02)
    since_ns = avr.now_ns
    host.done(SET, record(UART, bit_rate=5000, gap=22, text=b"Hi ~"))
    host.done(ARM, FOREVER)
    avr.run(0.03)
    assert "".join(avr.check("uart", 5000, since_ns).frames).startswith("Hi ~")
    host.done(DISARM)
    avr.run(0.02)
    since_ns = avr.now_ns
    first = vectors("packet")["packets"][0]
    host.done(SET, record(PACKET, 42, bit_rate=5000, kind=1, text=bytes.fromhex(first["data"])))
    host.done(ARM, FOREVER)
    avr.run(0.15)
    report = avr.check("packet", 5000, since_ns)
    # It has the number after that of the text before.
    assert set(report.frames) == {(42, 1, 0, b"hello")}
    assert not report.damaged


def test_a_message_is_sent_and_the_line_stays_true_at_a_rate_that_divides_no_tick(avr: Script) -> None:
    avr.host.done(SET, record(PACKET, 9, bit_rate=4321.987))
    avr.host.done(QUEUE, b"\1\1" + b"forty-two characters, in three of packets.")
    avr.host.done(ARM, FOREVER)
    avr.run(0.4)
    report = avr.check("packet", 4321.987)
    assert b"".join(data for _, _, _, data in report.frames) == b"forty-two characters, in three of packets."
    assert not report.damaged
    assert report.worst_error_ns <= 500 + 63
    assert abs(report.worst_drift_ns) <= 500 + 63
    assert avr.host.status().late == 0


def test_it_is_dark_within_one_bit_of_disarm_wherever_in_a_bit_it_comes(avr: Script) -> None:
    draw = random.Random(5)
    avr.host.done(SET, record(UART, bit_rate=500))
    for _ in range(12):
        avr.host.done(ARM, FOREVER)
        avr.run(0.01 + draw.uniform(0, 0.004))
        assert avr.edges[-1][1] == 1
        before_ns = avr.now_ns
        avr.host.done(DISARM)
        avr.run(0.02)
        assert avr.edges[-1][1] == 0
        # 14 bytes on the line, and the reply that follows the deed, take 1.3 ms.
        assert avr.edges[-1][0] - before_ns <= 2_000_000 + 1_400_000


def test_a_program_is_written_to_the_eeprom_while_it_blinks_and_no_frame_is_damaged(avr: Script) -> None:
    avr.host.done(SET, record(SEED11, 5, bit_rate=1000))
    avr.host.done(ARM, FOREVER)
    avr.host.done(SAVE)
    assert avr.host.status().saved
    avr.run(0.1)
    report = avr.check("seed11", 1000)
    assert set(report.frames) == {5}
    assert not report.damaged
