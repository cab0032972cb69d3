"""Which processes a site file names for its host, and how `supervisor` is told to run them."""

from __future__ import annotations

import json
import os
import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from heliograph.errors import ConfigError
from heliograph.shell.site import Site

ROUTER: Final = "router"
# A process that lives this long has started; supervisor counts in whole seconds.
START_S: Final = 1
# Delays grow by 1 s a try: 60 tries are half an hour of a full disk or an unplugged camera.
_START_TRIES: Final = 60
# The longest orderly stop seen is 1.5 s (a Zenoh session that closes while its router is gone waits 1 s).
STOP_S: Final = 6
_PATH_LIMIT: Final = 107 - len("/sock.4194304")  # sun_path, and supervisor binds under a temporary name
_CONFIG_STATUS: Final = 2


@dataclass(frozen=True, slots=True)
class Program:
    """A process to be: its name here, what it runs, and whether it is held back until it is asked for."""

    name: str
    kind: str
    instance: str
    command: tuple[str, ...]
    held: bool = False


@dataclass(frozen=True, slots=True)
class Plan:
    """What runs on one host, and in which folder it is kept."""

    title: str
    folder: Path
    programs: tuple[Program, ...]


def program_name(kind: str, instance: str) -> str:
    """Return how a process is called here; supervisor keeps the colon for itself."""
    return (kind if instance == kind else f"{kind}.{instance}").replace(":", "~")


def plan_of(site: Site, run_dir: Path) -> Plan:
    """Return the processes that a site file names for its host.

    Raises:
        ConfigError: the file names none, or the folder's path is longer than a socket's may be.
    """
    path = Path(site.path).resolve()
    folder = run_dir.resolve() / f"{site.site}-{site.host}"
    if len(os.fsencode(folder)) > _PATH_LIMIT:
        raise ConfigError(f"{folder}: a run folder's path must have at most {_PATH_LIMIT} bytes: choose --run-dir")
    run = (sys.executable, "-m")
    programs = []
    if site.router is not None:
        programs.append(Program(ROUTER, ROUTER, ROUTER, (*run, "heliograph.shell.router", "--site", str(path))))
    for entry in site.service:
        command = (*run, f"heliograph_services.{entry.kind}", "--site", str(path), "--instance", entry.instance)
        programs.append(Program(program_name(entry.kind, entry.instance), entry.kind, entry.instance, command))
    if not programs:
        raise ConfigError(f"{site.path}: names no [router] and no [[service]], so there is nothing to start")
    return Plan(f"{site.site}-{site.host}", folder, tuple(programs))


def holding(plan: Plan, kind: str) -> Plan:
    """Return the plan with all processes of a kind held back."""
    return replace(plan, programs=tuple(replace(p, held=p.held or p.kind == kind) for p in plan.programs))


def ini_of(plan: Plan, directory: Path) -> str:
    """Return supervisor's configuration.

    Args:
        plan: the processes.
        directory: their working directory, to which paths in the site file are relative.
    """
    lines = [
        *("[unix_http_server]", f"file={_text(plan.folder / 'sock')}", "chmod=0700"),
        *(
            "[rpcinterface:supervisor]",
            "supervisor.rpcinterface_factory=supervisor.rpcinterface:make_main_rpcinterface",
        ),
        *("[supervisord]", "silent=true", "nocleanup=true", "loglevel=info"),
        f"logfile={_text(plan.folder / 'supervisord.log')}",
        "logfile_maxbytes=0",  # restarts are counted from it, and it grows by a line a start
        f"pidfile={_text(plan.folder / 'supervisord.pid')}",
        f"childlogdir={_text(plan.folder)}",
    ]
    for number, program in enumerate(plan.programs):
        source = program.kind == "event_source"
        lines += [
            f"[program:{program.name}]",
            f"command={_text(shlex.join(program.command))}",
            f"directory={_text(directory)}",
            f"priority={number + 1}",
            # A short recording may end within the second in which supervisor would call it a failed start.
            f"startsecs={0 if source else START_S}",
            f"startretries={_START_TRIES}",
            f"autostart={'false' if program.held else 'true'}",
            "autorestart=unexpected",
            f"exitcodes={f'0,{_CONFIG_STATUS}' if source else _CONFIG_STATUS}",
            f"stopwaitsecs={STOP_S}",
            "redirect_stderr=true",
            f"stdout_logfile={_text(log_of(plan, program.name))}",
            "stdout_logfile_maxbytes=10MB",
            "stdout_logfile_backups=2",
        ]
    return "\n".join(lines) + "\n"


def _text(value: object) -> str:
    """Return a value as supervisor's INI reads it back.

    Raises:
        ConfigError: it cannot be written there.
    """
    text = str(value)
    if "\n" in text or " ;" in text:
        raise ConfigError(f"a path may hold no line end and no ' ;', not {text!r}")
    return text.replace("%", "%%")


def log_of(plan: Plan, name: str) -> Path:
    """Return the file to which a process logs."""
    return plan.folder / f"{name}.log"


def last_line(path: Path) -> str:
    """Return what the last line of a log says ("" where there is none): a JSON line's message, else the line."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - 65_536))
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    text = next((line.strip() for line in reversed(lines) if line.strip()), "")
    try:
        record = json.loads(text)
    except ValueError:
        return text
    return str(record.get("message", text)) if isinstance(record, dict) else text
