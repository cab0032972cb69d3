"""Write first inputs for firmware/fuzz/fuzz_beacon.c: `python firmware/tools/make_corpus.py FOLDER`.

A program of every protocol, lit, with messages, saved and rebooted: so the fuzzer begins behind the checks of length
and range, and not before them.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path

SET, ARM, DISARM, QUEUE, CLEAR, STATUS, SAVE = 3, 4, 5, 6, 7, 8, 9
HOUR = struct.pack(">I", 3_600_000)
PROGRAMS = {
    "seed11": struct.pack(">BBBBIHIB", 1, 0, 0, 0, 5_000_000, 1000, 42, 0),
    "code": struct.pack(">BBBBIHIB", 2, 2, 0, 0, 777_000, 500, 100, 0),
    "word": struct.pack(">BBBBIHIB", 2, 0, 7, 0, 777_000, 500, 100, 0),
    "uart": struct.pack(">BBBBIHIB", 3, 0, 0, 5, 5_000_000, 1000, 0, 0) + b"hello",
    "packet": struct.pack(">BBBBIHIB", 4, 3, 4, 0, 20_000_000, 1000, 7, 1) + b"hello",
}


def request(kind: int, seq: int, payload: bytes = b"") -> bytes:
    """Return the fuzzer's step for a request."""
    return bytes([100 + 8 * kind + (seq - 100) % 8, len(payload)]) + payload


def first_inputs() -> dict[str, bytes]:
    """Return an input for each program."""
    run, hang, boot = bytes([229]), bytes([249]), bytes([254])
    return {
        name: request(SET, 1, program)
        + request(ARM, 2, HOUR)
        + run
        + request(QUEUE, 3, b"\1\2a message of some length")
        + run * 3
        + hang
        + request(SAVE, 4)
        + request(STATUS, 5)
        + request(SET, 6, PROGRAMS["uart"])
        + run
        + request(CLEAR, 7)
        + request(DISARM, 0)
        + run
        + request(ARM, 1, struct.pack(">I", 20))
        + run
        + boot
        + request(ARM, 2, HOUR)
        + run
        for name, program in PROGRAMS.items()
    }


if __name__ == "__main__":
    for name, data in first_inputs().items():
        (Path(sys.argv[1]) / name).write_bytes(data)
