"""The ESP32 port itself, compiled for this machine, on a model of the RMT peripheral. It never ran on silicon."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.beacon_wire import ARM, DISARM, GET, HELLO, PACKET, QUEUE, SAVE, SEED11, SET, STORAGE, UART, record
from support.firmware import Script, build, live_changes

FOREVER = struct.pack(">I", 3_600_000)
TICK_NS = 100


CHIPS = ("esp32", "esp32c3", "esp32s3")
# A memory full of symbols of 0.2 ms is asked for ahead.
AHEAD_S = {"esp32": 0.0128, "esp32c3": 0.0096, "esp32s3": 0.0096}


@pytest.fixture(scope="session", params=CHIPS)
def esp32_program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    chip = str(request.param)
    return build(chip, tmp_path_factory.mktemp(chip)) / f"beacon-{chip}-host"


@pytest.fixture
def esp32(esp32_program: Path) -> Iterator[Script]:
    with Script(esp32_program) as script:
        script.run(0.01)
        script.host.hello()
        yield script


def test_an_edge_is_off_by_at_most_a_tick_and_nothing_drifts_at_any_rate(esp32_program: Path) -> None:
    draw = random.Random(7)
    for rate in (50.0, 5000.0, *(round(draw.uniform(50, 5000), 3) for _ in range(8))):
        with Script(esp32_program) as beacon:
            beacon.run(0.01)
            beacon.host.hello()
            beacon.host.done(SET, record(SEED11, 42, bit_rate=rate))
            beacon.host.done(ARM, FOREVER)
            beacon.run(1.0)
            report = beacon.check("seed11", rate)
        assert len(report.frames) >= rate / 11 - 3
        assert not report.damaged
        assert report.worst_error_ns <= TICK_NS + 1
        assert abs(report.worst_drift_ns) <= TICK_NS + 1


def test_each_chip_says_which_it_is(esp32_program: Path, esp32: Script) -> None:
    chip = esp32_program.name.split("-")[1]
    assert esp32.host.done(HELLO, b"\1\2\3\4").endswith(b"\4" + chip.encode())
    esp32.host.done(SET, record(SEED11, 42, bit_rate=5000))
    esp32.host.done(ARM, FOREVER)
    since_ns = esp32.now_ns
    esp32.run(0.05)
    esp32.host.done(SET, record(SEED11, 21, bit_rate=5000))
    asked_ns = esp32.now_ns
    esp32.run(0.1)
    frames = esp32.check("seed11", 5000, since_ns).frames
    # A memory, and the frame that was begun when it was filled last.
    ahead_ns = frames.index(21) * 11 * 200_000 + since_ns - asked_ns
    assert ahead_ns <= AHEAD_S[chip] * 1e9 + 2 * 11 * 200_000


def test_payloads_change_live_without_a_damaged_frame(esp32: Script) -> None:
    # The peripheral's 64 symbols are 12.8 ms at 5 kbit/s, 5.8 frames.
    report, same = live_changes(esp32, 60, ahead_frames=6)
    assert same
    assert not report.damaged
    assert report.stretches == 1


@pytest.mark.parametrize("rate", [50, 777, 5000])
def test_it_is_dark_within_one_bit_of_disarm_and_of_the_leases_end(esp32: Script, rate: int) -> None:
    draw = random.Random(rate)
    esp32.host.done(SET, record(UART, bit_rate=rate))
    for lease in (FOREVER, struct.pack(">I", 100), FOREVER):
        esp32.host.done(ARM, lease)
        armed_ns = esp32.now_ns
        esp32.run(0.06 + draw.uniform(0, 0.01))
        assert esp32.edges[-1][1] == 1
        if lease == FOREVER:
            esp32.host.done(DISARM)
            end_ns = esp32.now_ns
        else:
            end_ns = armed_ns + 100_000_000
        esp32.run(0.2)
        assert esp32.edges[-1][1] == 0
        assert end_ns - 1e9 / rate <= esp32.edges[-1][0] <= end_ns + 1e9 / rate
    # The ESP32 stops with its interrupts off: the line's FIFO of 128 bytes fills in 11 ms.
    assert all(waited_ns < 400_000 for waited_ns in esp32.waited_ns)


def test_it_is_lit_again_where_it_was_armed_right_after_a_disarm(esp32: Script) -> None:
    esp32.host.done(SET, record(SEED11, 42, bit_rate=5000))
    for _ in range(20):
        esp32.host.done(ARM, FOREVER)
        since_ns = esp32.now_ns
        esp32.run(0.05)
        esp32.host.done(DISARM)
        report = esp32.check("seed11", 5000, since_ns)
        assert set(report.frames) == {42}
        assert len(report.frames) >= 18


def test_messages_go_out_whole_and_programs_are_kept(esp32: Script) -> None:
    host = esp32.host
    program = record(PACKET, 9, bit_rate=5000, power=500)
    host.done(SET, program)
    host.done(QUEUE, b"\1\1" + b"from the model of a chip")
    host.done(ARM, FOREVER)
    esp32.run(0.5)
    report = esp32.check("packet", 5000)
    assert b"".join(data for _, _, _, data in report.frames) == b"from the model of a chip"
    assert not report.damaged
    esp32.tell("fail", 1)
    assert host.ask(SAVE).payload == bytes([STORAGE])
    esp32.tell("fail", 0)
    host.done(SAVE)
    assert program in esp32.kept[0]
    assert host.done(GET)[2:] == program
