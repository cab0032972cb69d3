"""The ports: opened, read, lost and opened again, a thread each; the only module that knows pyserial.

A device and a URL (`socket://HOST:PORT`, a pty's path) are tried for ever; `usb:VID:PID[:SERIAL]` stands for all
devices that show these numbers, found by looking twice a second. The control lines are set low before a port
is opened: many ESP32 boards are reset by them.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import serial
from serial.tools import list_ports

from heliograph_services.beacon_controller.config import USB

# A reader that nobody writes to looks up so often whether it is to end.
_READ_S: Final = 0.1
_LOOK_S: Final = 0.5
_CLOSE_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class PortEvent:
    """Something that happened to a port.

    Args:
        port: its name.
        what: "opened", "heard" or "lost".
        data: what was heard.
        why: of a loss.
    """

    port: str
    what: str
    data: bytes = b""
    why: str = ""


Take = Callable[[PortEvent], None]


class Port:
    """One device or URL.

    Args:
        name: what pyserial opens.
        baud: for devices.
        reopen_s: how often it is tried.
        take: is told what happens, from the port's own thread.
        once: end for good when it is lost (a device that was found, and will be found again).
    """

    def __init__(self, name: str, baud: int, reopen_s: float, take: Take, *, once: bool = False) -> None:
        self.name = name
        self._baud = baud
        self._reopen_s = reopen_s
        self._take = take
        self._once = once
        self._open: Any = None
        self._end = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, daemon=True, name=f"port-{name}")
        self._thread.start()

    @property
    def has_ended(self) -> bool:
        """Whether it is lost for good."""
        return not self._thread.is_alive()

    def write(self, data: bytes) -> bool:
        """Write without waiting; return whether all went out. What is cut short is damage on the line."""
        with self._lock:
            if self._open is None:
                return False
            try:
                return bool(self._open.write(data) == len(data))
            except (OSError, ValueError):  # serial.SerialException is an OSError
                return False

    def close(self) -> None:
        """End the thread, and close the port."""
        self._end.set()
        self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        while not self._end.is_set():
            opened = self._opened()
            if opened is None:
                if self._once:
                    return
                self._end.wait(self._reopen_s)
                continue
            with self._lock:
                self._open = opened
            self._take(PortEvent(self.name, "opened"))
            why = self._read(opened)
            with self._lock:
                self._open = None
            with contextlib.suppress(OSError):
                opened.close()
            self._take(PortEvent(self.name, "lost", why=why))
            if self._once:
                return
            self._end.wait(self._reopen_s)

    def _opened(self) -> Any:
        try:
            port = serial.serial_for_url(self.name, do_not_open=True, baudrate=self._baud, timeout=_READ_S)
            port.write_timeout = 0
            port.dtr = port.rts = False
            if isinstance(port, serial.Serial):
                port.exclusive = True
            port.open()
        except (OSError, ValueError):  # not there, not ours to open, or no such scheme (told at the start)
            return None
        return port

    def _read(self, port: Any) -> str:
        try:
            while not self._end.is_set():
                data = port.read(1)
                if not data:
                    continue
                waiting = port.in_waiting
                if waiting:
                    data += port.read(waiting)
                self._take(PortEvent(self.name, "heard", data))
        except (OSError, TypeError) as error:  # pyserial: TypeError where another thread has closed the device
            return str(error)[:200] or type(error).__name__
        return "stopped"


class Ports:
    """All ports of a controller.

    Args:
        names: as the settings give them.
        baud: for devices.
        reopen_s: how often one that has gone is tried.
        take: is told what happens, from the ports' threads.
    """

    def __init__(self, names: tuple[str, ...], baud: int, reopen_s: float, take: Take) -> None:
        self._baud = baud
        self._reopen_s = reopen_s
        self._take = take
        self._end = threading.Event()
        self._lock = threading.Lock()
        self._patterns = [match for name in names if (match := USB.fullmatch(name))]
        self._ports = {name: Port(name, baud, reopen_s, take) for name in names if not USB.fullmatch(name)}
        self._finder: threading.Thread | None = None
        if self._patterns:
            self._finder = threading.Thread(target=self._find, daemon=True, name="usb")
            self._finder.start()

    def write(self, name: str, data: bytes) -> bool:
        """Write to a port; return whether all went out."""
        with self._lock:
            port = self._ports.get(name)
        return port is not None and port.write(data)

    def close(self) -> None:
        """Close all ports and end their threads."""
        self._end.set()
        if self._finder is not None:
            self._finder.join(_CLOSE_S)
        for port in self._ports.values():
            port.close()

    def _find(self) -> None:
        while not self._end.is_set():
            for device in found(self._patterns):
                with self._lock:
                    port = self._ports.get(device)
                    if port is None or port.has_ended:
                        self._ports[device] = Port(device, self._baud, self._reopen_s, self._take, once=True)
            self._end.wait(_LOOK_S)


def found(patterns: list[Any]) -> list[str]:
    """Return the devices that show the USB numbers of a pattern, sorted."""
    return sorted(
        info.device
        for info in list_ports.comports()
        if any(
            info.vid == int(match[1], 16)
            and info.pid == int(match[2], 16)
            and (match[3] is None or match[3] == info.serial_number)
            for match in patterns
        )
    )
