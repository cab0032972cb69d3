"""The firmware's own core, compiled by the machine's C compiler, as a beacon in a test: in its time or as a process.

The library runs in virtual time: a thousand commands on a bad line take a second. The program is the virtual beacon of
`firmware/README.md`, on a pseudo-terminal or a TCP port, in real time.
"""

from __future__ import annotations

import contextlib
import ctypes
import signal
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from support.firmware import FIRMWARE, build, make

_OUT_BYTES = 65_536
_EDGES = 65_536


@cache
def library(folder: Path) -> Any:
    """Return the core with its test's shim as a shared library, built in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    made = folder / "beacon.so"
    if absent := make.missing("posix"):
        pytest.skip(absent)
    sources = [str(path) for path in sorted((FIRMWARE / "core").glob("*.c"))]
    shim = str(Path(__file__).with_suffix(".c"))
    flags = ["-std=c11", "-O1", "-fPIC", "-shared", f"-I{FIRMWARE / 'core'}"]
    subprocess.run(["cc", *flags, "-o", str(made), shim, *sources], check=True, timeout=110)
    loaded = ctypes.CDLL(str(made))
    loaded.vb_new.restype = ctypes.c_void_p
    loaded.vb_take.restype = loaded.vb_edges.restype = ctypes.c_size_t
    return loaded


class Seen(NamedTuple):
    """What a beacon does: `sets` and `accepted` count what it has carried out since it booted."""

    lit: bool
    armed: bool
    sets: int
    payload: int
    millirate: int
    accepted: int
    sent: int


class VirtualBeacon:
    """A beacon in virtual time.

    Args:
        folder: where the library is built.
        uid: 16 hexadecimal digits.
        boot: its first boot number.
    """

    def __init__(self, folder: Path, uid: str, boot: int) -> None:
        self._library = library(folder)
        self.uid = uid
        self.boot = boot
        self._self = ctypes.c_void_p(self._library.vb_new(bytes.fromhex(uid), ctypes.c_uint16(boot)))
        self._out = ctypes.create_string_buffer(_OUT_BYTES)

    def run_to(self, now_s: float) -> None:
        """Let time pass."""
        self._library.vb_run(self._self, ctypes.c_uint64(round(now_s * 1e9)))

    def receive(self, data: bytes) -> None:
        """Put bytes on its line."""
        self._library.vb_receive(self._self, data, ctypes.c_size_t(len(data)))

    def take(self) -> bytes:
        """Return what it has written since."""
        n = self._library.vb_take(self._self, self._out)
        return self._out.raw[:n]

    def reboot(self) -> None:
        """Cut its power for a moment."""
        self.boot = self.boot % 0xFFFF + 1
        self._library.vb_boot(self._self, ctypes.c_uint16(self.boot))

    def edges(self) -> list[tuple[int, int]]:
        """Return the light's changes since: (ns, level)."""
        times, levels = (ctypes.c_uint64 * _EDGES)(), (ctypes.c_uint8 * _EDGES)()
        n = self._library.vb_edges(self._self, times, levels)
        return list(zip(times[:n], levels[:n], strict=True))

    def look(self) -> Seen:
        """Return what it does at this moment, read off its memory: to ask it would be a request, which it remembers."""
        seen = (ctypes.c_uint32 * len(Seen._fields))()
        self._library.vb_look(self._self, seen)
        return Seen(bool(seen[0]), bool(seen[1]), *seen[2:])

    def close(self) -> None:
        """Give its memory back."""
        self._library.vb_free(self._self)


@cache
def program(folder: Path) -> Path:
    """Return the virtual beacon's program, built in a folder."""
    return build("posix", folder) / "beacon-posix"


class BeaconProcess:
    """The virtual beacon as a process; `url` is where its line is, once it is ready."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        command = [str(program(folder)), *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)

    @property
    def url(self) -> str:
        """What pyserial opens: waits until the beacon says that it is ready."""
        assert self.process.stdout is not None
        words = self.process.stdout.readline().decode().split()
        assert words[:1] == ["ready"], words
        return words[2] if words[1] == "pty" else f"socket://127.0.0.1:{words[2]}"

    def reboot(self) -> None:
        """Cut its power for a moment."""
        self.process.send_signal(signal.SIGUSR1)

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(ProcessLookupError):
            self.process.terminate()
        self.process.wait(10)
        if self.process.stdout is not None:
            self.process.stdout.close()


@contextlib.contextmanager
def beacon_process(folder: Path, *arguments: str) -> Iterator[BeaconProcess]:
    """Start the virtual beacon, and end it."""
    beacon = BeaconProcess(folder, *arguments)
    try:
        yield beacon
    finally:
        beacon.close()
