"""Edges from files must be sound; edges from streams are taken as they come, and damage is counted."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.errors import ConfigError, FileError, Refusal
from heliograph_services.event_source.simulation.lights import drive_of
from heliograph_services.event_source.simulation.lights.recorded import (
    AHEAD_US,
    RecordedDrive,
    StreamedDrive,
    open_edges,
)
from heliograph_services.event_source.simulation.world.spec import BeaconSpec, Still

SOUND = b"t_ns,level\n1000000,1\n2500000,0\n\n2500100,1\n9000000,1\n12000000,0\n"


def test_a_file_of_edges_is_its_light() -> None:
    drive = RecordedDrive("f", SOUND)
    t_us, level = drive.changes(0.0, 1e6)
    # The fourth line repeats the level: no change.
    assert t_us.tolist() == [1000.0, 2500.0, 2500.1, 12000.0]
    assert level.tolist() == [1.0, 0.0, 1.0, 0.0]
    assert [drive.level(t) for t in (0.0, 1000.0, 1000.1, 2500.05, 1e9)] == [0.0, 0.0, 1.0, 0.0, 0.0]
    assert drive.changes(1000.0, 2500.0)[0].tolist() == [1000.0]
    assert drive.frames_ended(0.0, 1e6) == []
    assert drive.known_until_us == float("inf")


def test_a_file_whose_first_edge_goes_dark_was_lit_before() -> None:
    assert RecordedDrive("f", b"5,0\n").level(0.0) == 1.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "at least 1 edge"),
        (b"t_ns,level\n", "at least 1 edge"),
        (b"1,1\n2,2\n", "line 2 must be t_ns,level with level 0 or 1, not '2,2'"),
        (b"1,1\n-2,0\n", "line 2 must be"),
        (b"1,1\n2.5,0\n", "line 2 must be"),
        (b"1,1\nhello\n", "line 2 must be .* not 'hello'"),
        (b"1,1\n2,0\n2,1\n", "line 3: t_ns must rise, not 2 after 2"),
        (b"9,1\n8,0\n", "line 2: t_ns must rise, not 8 after 9"),
        (b"9999999999999999999,1\n", "line 1: t_ns must be in"),
        (b"\xff\xfe\x00", "line 1 must be"),
    ],
)
def test_a_damaged_file_is_refused_with_its_line_and_value(text: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "edges.csv"
    path.write_bytes(text)
    spec = BeaconSpec(name="b", protocol="seed11", bit_rate=1000.0, edges=str(path), path=Still(at_m=(0.0, 0.0, 0.0)))
    with pytest.raises(FileError, match=words) as caught:
        drive_of(spec, 0, 0)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="No such file"):
        open_edges(str(tmp_path / "none"))
    with pytest.raises(FileError, match="must come from a file, a FIFO or a terminal"):
        open_edges(str(tmp_path))


@contextmanager
def fifo(folder: Path) -> Iterator[tuple[StreamedDrive, int]]:
    """A stream and the sender's end of it."""
    path = folder / "edges"
    os.mkfifo(path)
    drive = open_edges(str(path))
    assert isinstance(drive, StreamedDrive)
    sender = os.open(path, os.O_WRONLY)
    try:
        yield drive, sender
    finally:
        os.close(sender)
        drive.close()


def test_a_stream_is_known_up_to_its_last_line(tmp_path: Path) -> None:
    with fifo(tmp_path) as (drive, sender):
        assert not drive.poll()
        assert drive.known_until_us == float("-inf")
        os.write(sender, b"t_ns,level\n1000000,1\n20000")
        assert drive.poll()
        assert drive.known_until_us == 1000.0
        os.write(sender, b"00,0\n3000000,0\n")
        assert drive.poll()
        # The last line repeats the level: the time has come so far, nothing changed.
        assert drive.known_until_us == 3000.0
        t_us, level = drive.changes(0.0, 3000.0)
        assert (t_us.tolist(), level.tolist()) == ([1000.0, 2000.0], [1.0, 0.0])
        assert [drive.level(t) for t in (0.0, 1500.0, 2500.0)] == [0.0, 1.0, 0.0]
        assert not drive.refusals


def test_a_terminal_is_a_stream() -> None:
    controller, terminal = os.openpty()
    try:
        drive = open_edges(os.ttyname(terminal))
        assert isinstance(drive, StreamedDrive)
        os.write(controller, b"500,1\n")
        assert drive.poll()
        assert drive.changes(0.0, 10.0)[0].tolist() == [0.5]
        drive.close()
    finally:
        os.close(controller)
        os.close(terminal)


def test_a_sender_that_closes_has_ended_and_may_come_again(tmp_path: Path) -> None:
    path = tmp_path / "edges"
    os.mkfifo(path)
    drive = StreamedDrive(str(path))
    assert not drive.poll()
    assert not drive.ended  # nobody has come yet
    for line, known in ((b"1000,1\n", 1.0), (b"2000,0\n", 2.0)):
        sender = os.open(path, os.O_WRONLY)
        os.write(sender, line)
        assert drive.poll()
        assert (drive.ended, drive.known_until_us) == (False, known)
        os.close(sender)
        assert not drive.poll()
        assert (drive.ended, drive.known_until_us) == (True, float("inf"))
    assert drive.changes(0.0, 10.0)[0].tolist() == [1.0, 2.0]
    drive.close()
    drive.close()


def test_damaged_lines_are_counted_and_left_out(tmp_path: Path) -> None:
    with fifo(tmp_path) as (drive, sender):
        os.write(sender, b"1000,1\n2000;\n\xff\xff\n3000,7\n" + b"9" * 200 + b"\n4000,0\n")
        assert drive.poll()
        assert drive.refusals == {Refusal.DAMAGED: 4}
        assert drive.changes(0.0, 10.0)[0].tolist() == [1.0, 4.0]


def test_a_line_without_end_is_not_kept(tmp_path: Path) -> None:
    with fifo(tmp_path) as (drive, sender):
        os.write(sender, b"1" * 1000)
        assert drive.poll()
        os.write(sender, b"\n1000,1\n2000,0\n")
        assert drive.poll()
        assert drive.refusals == {Refusal.DAMAGED: 1}
        assert drive.changes(0.0, 10.0)[0].tolist() == [1.0, 2.0]


def test_an_edge_for_a_time_that_was_told_is_refused_and_its_level_comes_at_once(tmp_path: Path) -> None:
    with fifo(tmp_path) as (drive, sender):
        os.write(sender, b"1000,1\n")
        drive.poll()
        assert drive.changes(0.0, 5.0)[0].tolist() == [1.0]
        os.write(sender, b"3000,0\n7000,1\n")
        drive.poll()
        assert drive.refusals == {Refusal.TIME_BACKWARDS: 1}
        assert drive.changes(0.0, 5.0)[0].tolist() == [1.0]
        t_us, level = drive.changes(5.0, 10.0)
        assert (t_us.tolist(), level.tolist()) == ([5.0, 7.0], [0.0, 1.0])


def test_one_line_that_jumps_is_damage_and_two_are_a_silence(tmp_path: Path) -> None:
    with fifo(tmp_path) as (drive, sender):
        os.write(sender, b"1000,1\n900000000000000,0\n2000,0\n")
        drive.poll()
        assert drive.refusals == {Refusal.TIME_JUMP: 1}
        assert drive.known_until_us == 2.0
        os.write(sender, b"90000000000000,1\n90000000001000,0\n")
        drive.poll()
        assert drive.refusals == {Refusal.TIME_JUMP: 2}
        assert drive.known_until_us == 90e9 + 1.0


def test_a_sender_that_begins_anew_goes_on_from_its_last_edge(tmp_path: Path) -> None:
    with fifo(tmp_path) as (drive, sender):
        os.write(sender, b"8000,1\n9000,0\n1000,1\n3000,0\n4000,1\n")
        drive.poll()
        assert drive.refusals == {Refusal.TIME_BACKWARDS: 1}
        t_us, level = drive.changes(0.0, 100.0)
        assert (t_us.tolist(), level.tolist()) == ([8.0, 9.0, 9.0, 11.0, 12.0], [1.0, 0.0, 1.0, 0.0, 1.0])


def test_a_sender_far_ahead_is_left_waiting(tmp_path: Path) -> None:
    with fifo(tmp_path) as (drive, sender):
        ahead_ns = int(AHEAD_US * 1000) + 1000
        os.write(sender, b"1000,1\n%d,0\n" % ahead_ns)
        assert drive.poll()
        os.write(sender, b"%d,1\n" % (ahead_ns + 1000))
        assert not drive.poll()
        drive.changes(0.0, 20_000.0)
        assert drive.poll()


@given(st.lists(st.binary(max_size=40), max_size=30))
def test_no_bytes_raise_or_make_time_run_backwards(chunks: list[bytes]) -> None:
    reader, sender = os.pipe()
    try:
        drive = StreamedDrive(f"/dev/fd/{reader}")
        for chunk in chunks:
            if chunk:
                os.write(sender, chunk)
            drive.poll()
        t_us, level = drive.changes(0.0, 1e15)
        assert (np.diff(t_us) >= 0).all()
        assert set(level.tolist()) <= {0.0, 1.0}
        drive.close()
    finally:
        os.close(reader)
        os.close(sender)


def test_a_beacon_of_edges_needs_no_encoder(tmp_path: Path) -> None:
    path = tmp_path / "edges.csv"
    path.write_bytes(SOUND)
    here = Still(at_m=(0.0, 0.0, 0.0))
    spec = BeaconSpec(name="b", protocol="of_the_firmware", bit_rate=1000.0, edges=str(path), path=here)
    assert len(drive_of(spec, 0, 0).changes(0.0, 1e6)[0]) == 4
    with pytest.raises(ConfigError, match="protocol must be one of"):
        drive_of(BeaconSpec(name="b", protocol="of_the_firmware", bit_rate=1.0, payload=1, path=here), 0, 0)


def test_notes_among_the_edges_say_how_far_the_light_is_known(tmp_path: Path) -> None:
    text = b"# until 500000\n1000000,1\n# a note\n# until 2000000\n2000000,0\n# until 9000000\n"
    assert RecordedDrive("f", text).changes(0.0, 1e6)[0].tolist() == [1000.0, 2000.0]
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    drive = StreamedDrive(str(fifo))
    with fifo.open("wb", buffering=0) as sender:
        for part, known_us in ((text[:15], 500.0), (text[15:50], 2000.0), (text[50:], 9000.0)):
            sender.write(part)
            assert drive.poll()
            assert drive.known_until_us == known_us
    assert drive.level(0.0) == 0.0
    assert drive.changes(0.0, 1e6)[0].tolist() == [1000.0, 2000.0]
    assert not drive.refusals
    drive.close()
