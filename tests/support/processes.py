"""Real processes on free loopback ports: started from a site file, waited for by messages, ended by their handles."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from heliograph import truth
from heliograph.messages import Message
from heliograph.shell.bus import Bus, connected
from heliograph.shell.links import client_config
from heliograph.shell.process import PARENT_VARIABLE, Stop
from heliograph.shell.site import BusLinks
from heliograph.wire import SCHEMAS, pack_body

# Long enough for a first compilation on a loaded machine; a test that hangs fails by name, not by the suite's limit.
PATIENCE_S: Final = 90.0


def free_port() -> int:
    """Return a port of the loopback that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


class Host:
    """The processes of one site file; each writes its log beside the file."""

    def __init__(self, folder: Path, name: str, text: str, services: list[str], *, router: bool = True) -> None:
        self.folder = folder
        self.path = folder / f"{name}.toml"
        self.path.write_text(text)
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._logs: list[Any] = []
        if router:
            self.start("router", "heliograph.shell.router", [])
        for kind in services:
            self.start(kind, f"heliograph_services.{kind}", ["--instance", kind])

    def start(self, kind: str, module: str | None = None, arguments: list[str] | None = None) -> None:
        """Start (again) a process."""
        module = module or f"heliograph_services.{kind}"
        arguments = ["--instance", kind] if arguments is None else arguments
        log = (self.folder / f"{self.path.stem}-{kind}.log").open("ab")
        self._logs.append(log)
        command = [sys.executable, "-m", module, "--site", str(self.path), *arguments]
        # Where one of its threads stands is told in its log if it does not stop.
        environment = os.environ | {PARENT_VARIABLE: "1", "PYTHONFAULTHANDLER": "1"}
        self.processes[kind] = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment, cwd=self.folder
        )

    def kill(self, kind: str) -> None:
        """End a process as a crash would."""
        self.processes[kind].kill()
        self.processes[kind].wait()

    def wait(self, kind: str, timeout_s: float = PATIENCE_S) -> int:
        """Wait for a process to end by itself; return its status."""
        return self.processes[kind].wait(timeout_s)

    def log(self, kind: str) -> str:
        """Return what a process has written so far."""
        return (self.folder / f"{self.path.stem}-{kind}.log").read_text()

    def wait_for_log(self, kind: str, text: str, timeout_s: float = PATIENCE_S) -> bool:
        """Wait until a process has written the text; return whether it did while it lived."""
        deadline = time.monotonic() + timeout_s
        while text not in self.log(kind):
            if time.monotonic() > deadline or self.processes[kind].poll() is not None:
                return False
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.processes[kind].wait(0.05)
        return True

    def alive(self) -> list[str]:
        """Return the kinds that still run."""
        return [kind for kind, process in self.processes.items() if process.poll() is None]

    def close(self) -> dict[str, int]:
        """Stop all in order, the router last; return their statuses."""
        last_first = sorted(self.processes.items(), key=lambda item: item[0] == "router")
        statuses = {}
        for kind, process in last_first:
            if process.poll() is None:
                process.terminate()
            try:
                statuses[kind] = process.wait(15)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGABRT)
                statuses[kind] = process.wait()
        for log in self._logs:
            log.close()
        return statuses


class Collector:
    """A client of the bus that keeps what it hears, in order, by schema."""

    def __init__(self, bus: Bus, names: list[str]) -> None:
        self.bus = bus
        self.messages: dict[str, list[Message]] = {name: [] for name in names}
        self.when: dict[str, list[float]] = {name: [] for name in names}
        self._changed = threading.Condition()
        self._end = threading.Event()
        schemas = {**SCHEMAS, **truth.SCHEMAS}
        inbox = bus.subscribe({name: schemas[name] for name in names})

        def run() -> None:
            while not self._end.is_set():
                sample = inbox.get(0.05)
                opened = bus.open(sample) if sample else None
                if sample is None or opened is None:
                    continue
                bus.gaps.see(sample.topic, sample.key, opened[0])
                with self._changed:
                    self.messages[sample.topic].append(opened[1])
                    self.when[sample.topic].append(time.monotonic())
                    self._changed.notify_all()

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()

    def until(self, condition: Callable[[Collector], bool], what: str, timeout_s: float = PATIENCE_S) -> None:
        """Wait until the condition holds.

        Raises:
            AssertionError: it did not come to hold in time.
        """
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while not condition(self):
                left = deadline - time.monotonic()
                heard = {name: len(messages) for name, messages in self.messages.items()}
                assert left > 0, f"waited {timeout_s} s for {what}; heard {heard}"
                self._changed.wait(min(left, 1.0))

    def bodies(self, *names: str) -> dict[str, list[bytes]]:
        """Return the packed bodies, in order, by schema and the key's names."""
        found: dict[str, list[bytes]] = {}
        for name in names:
            for message in list(self.messages[name]):
                track = getattr(message, "track", "")
                found.setdefault(f"{name}/{track if isinstance(track, str) else ''}", []).append(pack_body(message))
        return found

    def close(self) -> None:
        """Stop listening."""
        self._end.set()
        self._thread.join()


@contextlib.contextmanager
def collecting(port: int, site: str, names: list[str]) -> Iterator[Collector]:
    """Connect a collector to the router on a port, waiting for it."""
    links = BusLinks(connect=(f"tcp/127.0.0.1:{port}",), shared_memory=False)
    with connected(client_config(links), site, f"client/{os.getpid()}-{free_port()}", Stop()) as bus:
        assert bus is not None
        collector = Collector(bus, names)
        try:
            yield collector
        finally:
            collector.close()
