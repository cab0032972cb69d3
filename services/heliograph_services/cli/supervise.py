"""`heliograph up|down|status SITE.toml`: the processes of a host, started, looked at and stopped."""

from __future__ import annotations

import argparse
import dataclasses
import json
import signal
import sys
from pathlib import Path
from typing import Final

from heliograph.shell.process import Stop
from heliograph.shell.site import load_site
from heliograph_services.cli.plan import plan_of
from heliograph_services.cli.supervision import ProcessState, Supervised, SupervisionError

_DONE: Final = 0
_NOT_ALL: Final = 1
# How often a foreground `up` looks whether all is still there.
_LOOK_S: Final = 0.5


def _parser(command: str) -> argparse.ArgumentParser:
    texts = {
        "up": "Start this host's processes and return when all of them run.",
        "down": "Stop this host's processes in order and wait until they have ended.",
        "status": "Show this host's processes; exit status 0 if all run (or have ended as they should), else 1.",
    }
    parser = argparse.ArgumentParser(prog=f"heliograph {command}", description=texts[command])
    parser.add_argument("site", metavar="SITE.toml", help="the site file of this host")
    parser.add_argument("--run-dir", default="run", metavar="DIR", help="logs and state go to DIR/{site}-{host} (run)")
    if command == "up":
        parser.add_argument("--foreground", action="store_true", help="stay, and stop everything on Ctrl-C or SIGTERM")
        parser.add_argument(
            "--until-end", action="store_true", help="stay in the foreground until all sources have ended"
        )
    if command == "status":
        parser.add_argument("--json", action="store_true", help="one JSON object a line")
    return parser


def run(argv: list[str]) -> int:
    """Run `up`, `down` or `status` with its arguments.

    Raises:
        HeliographError: the site file is wrong, it runs already, or a process does not start.
    """
    command, *rest = argv
    arguments = _parser(command).parse_args(rest)
    supervised = Supervised(plan_of(load_site(arguments.site), Path(arguments.run_dir)))
    if command == "up":
        return _up(supervised, foreground=arguments.foreground or arguments.until_end, until_end=arguments.until_end)
    if command == "down":
        return _down(supervised)
    return _status(supervised, as_json=arguments.json)


def up(argv: list[str]) -> int:
    """Run `heliograph up`."""
    return run(["up", *argv])


def down(argv: list[str]) -> int:
    """Run `heliograph down`."""
    return run(["down", *argv])


def status(argv: list[str]) -> int:
    """Run `heliograph status`."""
    return run(["status", *argv])


def _up(supervised: Supervised, *, foreground: bool, until_end: bool) -> int:
    stop = Stop()
    if foreground:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
    supervised.start(follow_parent=foreground)
    try:
        states = supervised.wait_running()
    except BaseException:
        supervised.stop()
        raise
    sys.stderr.write(f"{supervised.plan.title}: {len(states)} processes run; logs in {supervised.plan.folder}\n")
    if not foreground:
        return _DONE
    with supervised:
        return _watch(supervised, stop, until_end=until_end)


def _watch(supervised: Supervised, stop: Stop, *, until_end: bool) -> int:
    """Stay until told to stop; say on stderr what changes."""
    seen: dict[str, tuple[str, int]] = {}
    while not stop.wait(_LOOK_S):
        states = supervised.states()
        if not states:
            raise SupervisionError(f"{supervised.plan.title}: the supervisor ended; see {supervised.plan.folder}")
        for state in states:
            now = (state.state, state.restarts)
            if seen.get(state.name, now) != now:
                sys.stderr.write(f"{state.name}: {state.state}, pid {state.pid}, {state.restarts} restarts\n")
            seen[state.name] = now
        sources = [state for state in states if state.kind == "event_source"]
        if until_end and sources and all(state.ended_well for state in sources):
            return _DONE
    return _DONE


def _down(supervised: Supervised) -> int:
    stopped = supervised.stop()
    sys.stderr.write(f"{supervised.plan.title}: {'stopped' if stopped else 'was not running'}\n")
    return _DONE


def _status(supervised: Supervised, *, as_json: bool) -> int:
    states = supervised.states()
    if as_json:
        for state in states:
            print(json.dumps({"type": "process", **dataclasses.asdict(state)}))
    elif states:
        print(table(states))
    else:
        print(f"{supervised.plan.title}: not running")
    well = states and all(state.state == "running" or state.ended_well for state in states)
    return _DONE if well else _NOT_ALL


def table(states: list[ProcessState]) -> str:
    """Return the processes as lines of text, columns aligned."""
    rows = [("process", "pid", "state", "uptime", "restarts")]
    for s in states:
        state = f"exited ({s.exit_status})" if s.state == "exited" else s.state
        rows.append((s.name, str(s.pid or "-"), state, _duration(s.uptime_s) if s.pid else "-", str(s.restarts)))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"
