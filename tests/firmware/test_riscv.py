"""The core on RV32 in QEMU's virt machine: the golden vectors on a third instruction set."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from support import beacon_wire as wire
from support.beacon_wire import ARM, CODE, DARK, PACKET, SEED11, SET, STATUS, UART, Host, TcpLine, record
from support.firmware import build, edge_check

VECTORS = Path(__file__).parents[1] / "vectors"
LEASE_S = 0.2


@dataclass
class Machine:
    """QEMU with the RISC-V port; the edges are what it has written so far."""

    host: Host
    line: TcpLine
    edges_file: Path

    def light(self, program: bytes) -> list[edge_check.Edge]:
        """Return the edges of one lease of a program."""
        before = len(self.edges())
        self.host.done(SET, program)
        self.host.done(ARM, struct.pack(">I", round(1000 * LEASE_S)))
        self.line.until(DARK)
        # The edges are written by the main loop, which answers one request after another: two later, all are there.
        self.host.done(STATUS)
        self.host.done(STATUS)
        return self.edges()[before:]

    def edges(self) -> list[edge_check.Edge]:
        """Return all edges so far."""
        return edge_check.read_edges(self.edges_file.read_text().splitlines())


@pytest.fixture(scope="module")
def riscv(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    folder = build("riscv", tmp_path_factory.mktemp("riscv"))
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(60)
        serial = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        quiet = ["-display", "none", "-monitor", "none", "-bios", "none", "-icount", "shift=6"]
        command = ["qemu-system-riscv32", "-M", "virt", *quiet, "-serial", serial]
        command += ["-semihosting-config", "enable=on,target=native", "-kernel", str(folder / "beacon-riscv.elf")]
        process = subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL)
        try:
            connection, _ = server.accept()
            line = TcpLine.of(connection, timeout_s=60)
            machine = Machine(Host(line), line, folder / "edges.txt")
            machine.host.hello()
            yield machine
            connection.close()
        finally:
            process.terminate()
            process.wait(30)


def test_packets_are_those_of_the_vectors(riscv: Machine) -> None:
    first = json.loads((VECTORS / "packet.json").read_text("utf-8"))["packets"][0]
    data = bytes.fromhex(first["data"])
    edges = riscv.light(record(PACKET, first["address"], bit_rate=5000, kind=1, text=data))
    (stretch,) = edge_check.stretches(edges, 5000)
    # Nothing was sent before: the number is 0, as the vector's.
    assert stretch.bits.startswith(first["air"] * 2)


def test_words_are_those_of_the_vectors(riscv: Machine) -> None:
    even = edge_check.check(riscv.light(record(SEED11, 42, bit_rate=5000)), "seed11", 5000)
    assert set(even.frames) == {42}
    text = edge_check.check(
        riscv.light(record(SEED11, 42, option=1, bit_rate=5000)), "seed11", 5000, {"parity": "paper_text"}
    )
    assert set(text.frames) == {42}
    for book, payload in ((1, 168), (2, 521)):
        edges = riscv.light(record(CODE, payload, option=book, bit_rate=5000))
        found = edge_check.check(edges, "code", 5000, {"codebook": f"code{16 + 2 * book}d4"})
        assert set(found.frames) == {payload}
        assert not found.damaged


def test_text_and_packets_come_back_from_the_light(riscv: Machine) -> None:
    edges = riscv.light(record(UART, bit_rate=5000, gap=22, text=b"U ~Hi"))
    assert "".join(edge_check.check(edges, "uart", 5000).frames).startswith("U ~HiU ~Hi")
    edges = riscv.light(record(PACKET, 42, bit_rate=5000, kind=1, text=b"hello"))
    found = edge_check.check(edges, "packet", 5000)
    assert {(address, data) for address, _, _, data in found.frames} == {(42, b"hello")}
    assert not found.damaged
    assert abs(found.worst_drift_ns) <= 100


def test_refusals_are_the_same(riscv: Machine) -> None:
    assert riscv.host.ask(SET, record(SEED11, 14)).payload == bytes([wire.AMBIGUOUS])
    assert riscv.host.ask(wire.SAVE).payload == bytes([wire.UNSUPPORTED])
