"""One host's processes under `supervisor`, planned by a site file.

Everything lives in one folder, ``run/{site}-{host}/``::

    supervisor.ini     what supervisord reads; written anew at each start
    sock               its XML-RPC interface, for this user alone
    supervisord.pid    its process
    supervisord.log    starts and ends of the processes; restarts are counted from it
    {process}.log      what a process wrote to stderr (JSON lines)

A process that ends without being asked is started again; one that ends within a second after 1, 2, 3 ... s. Final are
status 2 (a setting is wrong, trying again gains nothing) and an event source's status 0 (its recording has ended).
"""

from __future__ import annotations

import argparse
import fcntl
import http.client
import os
import signal
import socket
import subprocess
import sys
import time
import xmlrpc.client
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self, cast

from heliograph.errors import HeliographError
from heliograph.shell.process import PARENT_VARIABLE, end_with_parent
from heliograph_services.cli.plan import START_S, STOP_S, Plan, Program, ini_of, last_line, log_of

# Attached and asked by a program of ours that may be killed: supervisord then must not stay behind.
_FOLLOW_FLAG: Final = "--follow-parent"

State = Literal["stopped", "starting", "running", "backoff", "stopping", "exited", "fatal", "unknown"]


class SupervisionError(HeliographError):
    """Processes could not be started, found or stopped."""


@dataclass(frozen=True, slots=True)
class ProcessState:
    """What supervisor says of a process; `pid` and `uptime_s` are 0 and `exit_status` -1 where there is none."""

    name: str
    kind: str
    pid: int
    state: State
    uptime_s: float
    restarts: int
    exit_status: int

    @property
    def ended_well(self) -> bool:
        """Whether it is an event source whose recording has ended."""
        return self.kind == "event_source" and self.state == "exited" and self.exit_status == 0


class _UnixConnection(http.client.HTTPConnection):
    def __init__(self, path: Path) -> None:
        super().__init__("localhost", timeout=30)
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(str(self._path))


class _UnixTransport(xmlrpc.client.Transport):
    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = _UnixConnection(self._path)
        self._connection = (host, connection)  # where the base class looks for what to close
        return connection


class Supervised:
    """The processes of a plan: start, look, stop. Another process may have started them."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._folder = plan.folder
        self._child: subprocess.Popen[bytes] | None = None

    def start(self, *, follow_parent: bool, environment: Mapping[str, str] | None = None) -> None:
        """Start supervisord, which starts the processes; return when it answers.

        Args:
            follow_parent: everything ends when the calling process (its main thread) ends, however it ends.
            environment: variables for the processes, on top of this process's own.

        Raises:
            SupervisionError: it runs already, or does not start.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        with self._only_one():
            if self.supervisor_pid():
                raise SupervisionError(
                    f"{self.plan.title} is running already (supervisor {self.supervisor_pid()} in {self._folder}); "
                    "`heliograph down` stops it"
                )
            self._clean()
            ini = self._folder / "supervisor.ini"
            ini.write_text(ini_of(self.plan, Path.cwd()), encoding="utf-8")
            command = [sys.executable, "-m", __name__, str(ini), *([_FOLLOW_FLAG] if follow_parent else [])]
            with (self._folder / "supervisord.out").open("wb") as out:
                # A session of its own: the terminal's Ctrl-C must reach the processes once, through their supervisor.
                self._child = subprocess.Popen(  # noqa: S603 - our own module
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=out,
                    start_new_session=True,
                    env={**os.environ, **(environment or {})},
                )
            child = self._child
            # Alone it forks and its first process ends well; attached it stays.
            self._until(lambda: self._answers() or bool(child.poll()), 20.0)
            if not follow_parent:
                child.wait(timeout=20.0)
            if not self._answers():
                self.stop()
                said = last_line(self._folder / "supervisord.out") or "it does not answer"
                raise SupervisionError(f"{self.plan.title}: supervisord did not start: {said}")

    def _clean(self) -> None:
        """Remove what an earlier run left; its logs are kept as they are until a process writes anew."""
        for name in ("sock", "supervisord.pid", "supervisord.log"):
            (self._folder / name).unlink(missing_ok=True)
        for program in self.plan.programs:
            log_of(self.plan, program.name).unlink(missing_ok=True)

    @contextmanager
    def _only_one(self) -> Iterator[None]:
        with (self._folder / "lock").open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise SupervisionError(f"{self.plan.title} is being started by somebody else") from None
            yield

    def supervisor_pid(self) -> int:
        """Return the supervisor's process id, or 0 where none runs; a dead one's pid file does not count."""
        try:
            pid = int((self._folder / "supervisord.pid").read_text(encoding="ascii"))
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
            state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
        except (OSError, ValueError, IndexError):
            return 0
        # The number may be another process's by now; a zombie waits for its parent alone.
        return pid if os.fsencode(self._folder / "supervisor.ini") in command.split(b"\0") and state != "Z" else 0

    @contextmanager
    def _remote(self) -> Iterator[Any]:
        server = xmlrpc.client.ServerProxy("http://localhost/RPC2", transport=_UnixTransport(self._folder / "sock"))
        try:
            yield server.supervisor
        finally:
            server("close")()

    def _answers(self) -> bool:
        try:
            with self._remote() as remote:
                return bool(remote.getState()["statecode"] == 1)
        except (OSError, http.client.HTTPException, xmlrpc.client.Error):
            return False

    def states(self) -> list[ProcessState]:
        """Return what each process does, in the order of the plan; [] where no supervisor runs."""
        try:
            with self._remote() as remote:
                rows = {row["name"]: row for row in remote.getAllProcessInfo()}
        except (OSError, http.client.HTTPException, xmlrpc.client.Error):
            return []
        spawned = self._spawned()
        return [_state_of(p, rows[p.name], spawned.get(p.name, 0)) for p in self.plan.programs if p.name in rows]

    def last_line(self, name: str) -> str:
        """Return what a process wrote last ("" for nothing)."""
        return last_line(log_of(self.plan, name))

    def _spawned(self) -> dict[str, int]:
        """Return how often each process was started, from supervisord's log."""
        counts: dict[str, int] = {}
        try:
            text = (self._folder / "supervisord.log").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return counts
        for line in text.splitlines():
            _, found, rest = line.partition(" spawned: '")
            if found:
                name = rest.partition("'")[0]
                counts[name] = counts.get(name, 0) + 1
        return counts

    def release(self) -> None:
        """Start the processes that the plan holds back.

        Raises:
            SupervisionError: the supervisor does not answer, or refuses.
        """
        try:
            with self._remote() as remote:
                for program in self.plan.programs:
                    if program.held:
                        remote.startProcess(program.name, False)
        except (OSError, http.client.HTTPException, xmlrpc.client.Error) as error:
            raise SupervisionError(f"{self.plan.title}: cannot start what was held back: {error}") from None

    def wait_running(self, timeout_s: float = 60.0) -> list[ProcessState]:
        """Return when all processes run (an event source may have ended well).

        Raises:
            SupervisionError: one ended or does not get there; names it and says the last line of its log.
        """
        end = time.monotonic() + timeout_s
        while True:
            states = self.states()
            if not states:
                raise SupervisionError(f"{self.plan.title}: the supervisor ended; see {self._folder}/supervisord.log")
            for state in states:
                failed = state.state in {"backoff", "fatal", "exited"} and not state.ended_well
                if failed or state.restarts or (time.monotonic() > end and not _settled(state)):
                    said = self.last_line(state.name) or "it wrote nothing"
                    raise SupervisionError(f"{state.name} did not start ({state.state}): {said}")
            if all(_settled(state) for state in states):
                return states
            time.sleep(0.05)

    def stop(self, timeout_s: float = STOP_S + 10.0) -> bool:
        """Stop all processes in order and wait for the end; return False where none ran.

        Raises:
            SupervisionError: something still runs after the time-out.
        """
        pid = self.supervisor_pid() or (self._child.pid if self._child and self._child.poll() is None else 0)
        if pid:
            try:
                os.kill(pid, signal.SIGTERM)
            except ProcessLookupError:
                pid = 0
        gone = self._until(
            lambda: not self.supervisor_pid() and (not self._child or self._child.poll() is not None), timeout_s
        )
        if not gone:
            raise SupervisionError(f"{self.plan.title}: supervisor {pid} did not end within {timeout_s:g} s")
        for name in ("sock", "supervisord.pid"):
            (self._folder / name).unlink(missing_ok=True)
        return bool(pid)

    @staticmethod
    def _until(condition: Callable[[], bool], timeout_s: float) -> bool:
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def _settled(state: ProcessState) -> bool:
    return state.ended_well or (state.state == "running" and state.uptime_s >= START_S)


def _state_of(program: Program, row: Mapping[str, Any], spawned: int) -> ProcessState:
    name = str(row["statename"]).lower()
    known = ("stopped", "starting", "running", "backoff", "stopping", "exited", "fatal")
    alive = bool(row["pid"])
    return ProcessState(
        name=program.name,
        kind=program.kind,
        pid=int(row["pid"]),
        state=cast("State", name) if name in known else "unknown",
        uptime_s=float(max(0, row["now"] - row["start"])) if alive else 0.0,
        restarts=max(0, spawned - 1),
        exit_status=int(row["exitstatus"]) if name == "exited" else -1,
    )


def main() -> None:
    """Become supervisord: ``python -m heliograph_services.cli.supervision supervisor.ini [--follow-parent]``."""
    from supervisor import supervisord  # noqa: PLC0415 - only this process needs it

    parser = argparse.ArgumentParser()
    parser.add_argument("ini")
    parser.add_argument(_FOLLOW_FLAG, dest="follow", action="store_true")
    arguments = parser.parse_args()
    # The processes end with this one, however it ends.
    os.environ[PARENT_VARIABLE] = "1"
    if arguments.follow:
        end_with_parent()
    # On its own it becomes a daemon, so that whoever started it may go without leaving a child behind.
    supervisord.main([*(["-n"] if arguments.follow else []), "-c", arguments.ini])


if __name__ == "__main__":
    main()
