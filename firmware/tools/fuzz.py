"""Fuzz the beacon's core: `python firmware/tools/fuzz.py [--seconds 60] [--build FOLDER]`.

Two fuzzers (Debian: clang, libclang-rt-dev) share the time: `fuzz_beacon`, the whole core on a line and a clock that
the fuzzer holds, and `fuzz_parsers`, the line, the record and the store alone. Each begins with a program of every
protocol, lit, with messages, saved and rebooted, so that it starts behind the checks of length and range, and not
before them. Exit status 0 if both are clean, 1 if not (the input lies in the folder), 2 if they cannot be made, 3 if
what it takes is not here.
"""

from __future__ import annotations

import argparse
import re
import struct
import subprocess
import sys
from pathlib import Path
from typing import Final

from make import FIRMWARE, BuildError, MissingError, build

SET, ARM, DISARM, QUEUE, CLEAR, STATUS, SAVE = 3, 4, 5, 6, 7, 8, 9
HOUR: Final = struct.pack(">I", 3_600_000)
PROGRAMS: Final = {
    "seed11": struct.pack(">BBBBIHIB", 1, 0, 0, 0, 5_000_000, 1000, 42, 0),
    "code": struct.pack(">BBBBIHIB", 2, 2, 0, 0, 777_000, 500, 100, 0),
    "word": struct.pack(">BBBBIHIB", 2, 0, 7, 0, 777_000, 500, 100, 0),
    "uart": struct.pack(">BBBBIHIB", 3, 0, 0, 5, 5_000_000, 1000, 0, 0) + b"hello",
    "packet": struct.pack(">BBBBIHIB", 4, 3, 4, 0, 20_000_000, 1000, 7, 1) + b"hello",
}
_EXECUTED: Final = re.compile(r"stat::number_of_executed_units:\s*(\d+)")


def _request(kind: int, seq: int, payload: bytes = b"") -> bytes:
    """Return fuzz_beacon's step for a request."""
    return bytes([100 + 8 * kind + (seq - 100) % 8, len(payload)]) + payload


def of_beacon() -> dict[str, bytes]:
    """Return first inputs of `fuzz_beacon`, one for each program."""
    run, hang, boot = bytes([229]), bytes([249]), bytes([254])
    return {
        name: _request(SET, 1, program)
        + _request(ARM, 2, HOUR)
        + run
        + _request(QUEUE, 3, b"\1\2a message of some length")
        + run * 3
        + hang
        + _request(SAVE, 4)
        + _request(STATUS, 5)
        + _request(SET, 6, PROGRAMS["uart"])
        + run
        + _request(CLEAR, 7)
        + _request(DISARM, 0)
        + run
        + _request(ARM, 1, struct.pack(">I", 20))
        + run
        + boot
        + _request(ARM, 2, HOUR)
        + run
        for name, program in PROGRAMS.items()
    }


def of_parsers() -> dict[str, bytes]:
    """Return first inputs of `fuzz_parsers`: HELLO on the wire (PROTOCOL.md), a body, and each record."""
    hello = bytes.fromhex("0003010102010107010203042fc200")
    return {
        "line": b"\0" + hello,
        "body": b"\1\3\7" + bytes.fromhex("01030002123401000000000f424003e80000002a00"),
        **{name: b"\2" + program for name, program in PROGRAMS.items()},
    }


def fuzz(program: Path, inputs: dict[str, bytes], seconds: int, folder: Path) -> bool:
    """Run a fuzzer; tell how many inputs it tried, and return whether all were fine."""
    corpus = folder / f"{program.name}.corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    for name, data in inputs.items():
        (corpus / name).write_bytes(data)
    limits = [f"-max_total_time={seconds}", "-max_len=2048", "-print_final_stats=1"]
    command = [str(program.resolve()), *limits, str(corpus.resolve())]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603 - just built
    executed = _EXECUTED.search(done.stderr)
    if done.returncode:
        print(done.stderr[-4000:], file=sys.stderr)
    how = "clean" if not done.returncode else "NOT CLEAN"
    print(f"{program.name}: {executed[1] if executed else '?'} inputs in {seconds} s, {how}", flush=True)
    return not done.returncode


def main(arguments: list[str]) -> int:
    """Fuzz; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=int, default=60, help="for both together (default: 60)")
    parser.add_argument("--build", type=Path, default=FIRMWARE / "build", metavar="FOLDER")
    chosen = parser.parse_args(arguments)
    if chosen.seconds < len(("beacon", "parsers")):
        parser.error(f"--seconds must be at least 2, not {chosen.seconds}")
    try:
        beacon, parsers = build("fuzz", chosen.build)
    except BuildError as error:
        print(f"fuzz.py: {error}", file=sys.stderr)
        return 3 if isinstance(error, MissingError) else 2
    half_s = chosen.seconds // 2
    outcomes = [
        fuzz(beacon, of_beacon(), half_s, chosen.build),
        fuzz(parsers, of_parsers(), half_s, chosen.build),
    ]
    return 0 if all(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
