"""Build the beacon's firmware for tests, and drive it on a clock of the test's own."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Self

import pytest

from support import beacon_wire as wire

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"
# The edge checker is a tool of the firmware's, for people with a logic analyser.
sys.path.insert(0, str(FIRMWARE / "tools"))

import edge_check  # noqa: E402 - found by the line above
import make  # noqa: E402 - likewise

__all__ = ["FIRMWARE", "ROOT", "Script", "build", "edge_check", "lit_within", "live_changes", "make"]


def build(target: str, folder: Path) -> Path:
    """Build a target of `firmware/tools/make.py` in a folder; return the folder. Skips where the compiler is absent."""
    try:
        make.build(target, folder)
    except make.MissingError as error:
        pytest.skip(str(error))
    return folder


class Script:
    """A beacon whose time stands still until `run`: `firmware/fakes/script.c`, or an emulator that obeys its words."""

    def __init__(self, program: Path, *arguments: object) -> None:
        self.process = subprocess.Popen(
            [str(program), *map(str, arguments)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.edges: list[edge_check.Edge] = []
        self.kept: list[bytes] = []
        self.waited_ns: list[int] = []  # in which it heard nothing
        self.now_ns = 0
        self.host = wire.Host(self.exchange)
        self.host.events += wire.parse(self._answers())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        assert self.process.wait(10) == 0

    def tell(self, *words: object) -> bytes:
        """Give a command; return what was put on the line."""
        assert self.process.stdin is not None
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        self.process.stdin.flush()
        return self._answers()

    def exchange(self, bytes_in: bytes) -> bytes:
        """Put bytes on the line; return what came back."""
        return self.tell("rx", bytes_in.hex())

    def run(self, seconds: float, how: str = "run") -> None:
        """Let time pass; events are kept by the host."""
        ns = round(seconds * 1e9)
        self.now_ns += ns
        self.host.events += wire.parse(self.tell(how, ns))

    def check(self, protocol: str, bit_rate: float, since_ns: int = 0, **options: Any) -> edge_check.Report:
        """Return what the light held since a time."""
        gap = options.pop("gap", 0)
        edges = [edge for edge in self.edges if edge[0] >= since_ns]
        return edge_check.check(edges, protocol, bit_rate, options, gap)

    def _answers(self) -> bytes:
        assert self.process.stdout is not None
        said = b""
        for line in self.process.stdout:
            word, _, rest = line.strip().partition(" ")
            if word == ".":
                return said
            if word == "tx":
                said += bytes.fromhex(rest)
            elif word == "edge":
                self.edges += edge_check.read_edges([rest])
            elif word == "now":
                self.now_ns = int(rest)
            elif word == "waited":
                self.waited_ns.append(int(rest))
            elif word == "kept":
                self.kept.append(bytes.fromhex(rest))
        raise ConnectionError("the beacon ended")


def live_changes(
    beacon: Script, changes: int, bit_rate: float = 5000.0, ahead_frames: float = 0.0
) -> tuple[edge_check.Report, bool]:
    """Change the payload of `seed11` so often while it blinks.

    Args:
        beacon: greeted.
        changes: how many.
        bit_rate: bits a second.
        ahead_frames: so much is prepared ahead of the pin; of changes that follow each other faster, some are not seen.

    Returns:
        What the light held, and whether it held these payloads and nothing else, in this order.
    """
    draw = random.Random(3)
    twins = {14, 60, 15, 56, 23, 57, 28, 30, 29, 46, 39, 58, 59, 63, 61, 62}
    fine = [payload for payload in range(64) if payload not in twins]
    sent = [42]
    beacon.host.done(wire.SET, wire.record(wire.SEED11, 42, bit_rate=bit_rate))
    beacon.host.done(wire.ARM, struct.pack(">I", 3_600_000))
    for _ in range(changes):
        # Two frames at least, so that each is seen; at no fixed place in a frame.
        beacon.run((draw.uniform(2.2, 4.0) + ahead_frames) * 11 / bit_rate)
        sent.append(draw.choice([payload for payload in fine if payload != sent[-1]]))
        beacon.host.done(wire.SET, wire.record(wire.SEED11, sent[-1], bit_rate=bit_rate))
    beacon.run((4 + ahead_frames) * 11 / bit_rate)
    report = beacon.check("seed11", bit_rate)
    heard = [payload for payload, _ in groupby(report.frames)]
    return report, heard == sent


def lit_within(edges: Sequence[edge_check.Edge], begin_ns: int, end_ns: int) -> bool:
    """Return whether there was light at any time in [begin_ns, end_ns)."""
    level_before = next((level for t_ns, level in reversed(edges) if t_ns <= begin_ns), 0)
    return bool(level_before) or any(level for t_ns, level in edges if begin_ns <= t_ns < end_ns)
