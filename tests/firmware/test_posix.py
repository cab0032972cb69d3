"""The virtual beacon: a real process on a real line, in real time; and the edge checker as people run it."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support import beacon_wire as wire
from support.beacon_wire import ARM, PACKET, QUEUE, SAVE, SET, Host, TcpLine, record
from support.firmware import build, edge_check

FOREVER = struct.pack(">I", 3_600_000)


@pytest.fixture(scope="session")
def posix_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("posix", tmp_path_factory.mktemp("posix")) / "beacon-posix"


@contextmanager
def running(program: Path, *options: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    process = subprocess.Popen([str(program), *map(str, options)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().split()[2]
    finally:
        process.terminate()
        process.stdout.close()
        assert process.wait(20) == 0


def test_a_message_over_tcp_is_in_the_edges_that_it_writes(
    posix_program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edges = tmp_path / "edges.csv"
    with running(posix_program, "--tcp", 0, "--edges", edges, "--uid", "00000000deadbeef") as (_, port):
        line = TcpLine(int(port))
        host = Host(line)
        assert b"\xde\xad\xbe\xef" in host.hello().payload
        host.done(SET, record(PACKET, 7, bit_rate=5000))
        host.done(ARM, FOREVER)
        host.done(QUEUE, b"\1\1typed by hand")
        line.until(wire.MESSAGE)
        line.socket.close()
    said = edges.read_text()
    assert "# until" in said
    report = edge_check.check(edge_check.read_edges(said.splitlines()), "packet", 5000)
    assert b"".join(data for _, _, _, data in report.frames) == b"typed by hand"
    assert report.worst_error_ns <= 1
    assert edge_check.main([str(edges), "--protocol", "packet", "--bit-rate", "5000"]) == 0
    assert json.loads(capsys.readouterr().out)["damaged"] == 0
    assert edge_check.main([str(edges), "--protocol", "seed11", "--bit-rate", "5000"]) == 1
    assert edge_check.main([str(tmp_path / "none"), "--protocol", "seed11", "--bit-rate", "5000"]) == 2


def test_a_client_may_leave_and_another_come_and_a_reboot_keeps_what_was_saved(
    posix_program: Path, tmp_path: Path
) -> None:
    with running(posix_program, "--tcp", 0, "--store", tmp_path / "store") as (process, port):
        line = TcpLine(int(port))
        host = Host(line)
        host.hello()
        host.done(SET, record(PACKET, 7))
        host.done(SAVE)
        line.socket.close()
        line = TcpLine(int(port))
        again = Host(line, boot=host.boot)
        assert again.status().saved
        process.send_signal(signal.SIGUSR1)
        assert line.until(wire.BOOT).boot != host.boot
        again.hello()
        status = again.status()
        assert status.saved
        assert not status.armed
        line.socket.close()


def test_a_pty_is_a_line_too(posix_program: Path, tmp_path: Path) -> None:
    link = tmp_path / "beacon"
    with running(posix_program, "--pty", link) as (_, name):
        assert str(link.readlink()) == name
        line = os.open(link, os.O_RDWR | os.O_NOCTTY)
        os.write(line, wire.Body(wire.HELLO, 1, 0, b"abcd").wire())
        said = b""
        while b"posix" not in said:
            said += os.read(line, 4096)
        os.close(line)
    assert not link.exists()


@pytest.mark.parametrize("options", [[], ["--tcp"], ["--tcp", "x"], ["--tcp", "0", "--uid", "12"], ["--what", "1"]])
def test_wrong_options_are_told_in_one_line(posix_program: Path, options: list[str]) -> None:
    done = subprocess.run([str(posix_program), *options], capture_output=True, text=True, check=False, timeout=20)
    assert done.returncode == 2
    assert done.stderr.startswith("usage: beacon-posix")
    assert done.stderr.count("\n") == 1


def test_the_codebooks_in_c_are_those_of_the_decoder() -> None:
    tool = Path(__file__).parents[2] / "firmware/tools/make_codebooks.py"
    program = f"import runpy; print(runpy.run_path({str(tool)!r})['source'](), end='')"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=20)
    assert done.stdout == (tool.parents[1] / "core/hg_codebooks.c").read_text()
