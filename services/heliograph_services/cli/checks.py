"""What `heliograph doctor` looks at, one function a question; each returns lines with what to do about them."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Literal

import msgspec

from heliograph.errors import HeliographError

Verdict = Literal["ok", "warn", "fail"]

PYTHON_MIN: Final = (3, 11)
# A day of metrics is 107 MB, an hour of events at 1 Mev/s 29 GB.
DISK_WARN_BYTES: Final = 2 * 1024**3
DISK_FAIL_BYTES: Final = 100 * 1024**2
DEFAULT_PORT: Final = 7447
# Extras that gather others, and those of developers: `deploy/check` sees to these.
_NOT_FOR_OPERATORS: Final = frozenset({"all", "dev", "test"})
# What readers of recordings need, by the module that is looked for.
CAMERA_LIBRARIES: Final = {
    "faery": ("recordings: AEDAT4, RAW, DAT, ES, CSV", "pip install 'heliograph[event_source]'"),
    "scipy": ("recordings: MATLAB", "pip install 'heliograph[matlab]'"),
}
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_EXTRA: Final = re.compile(r"extra\s*==\s*['\"]([^'\"]+)['\"]")
_TIMEOUT_S: Final = 5.0


class Check(msgspec.Struct, frozen=True):
    """One line of the doctor.

    Args:
        check: what was looked at.
        verdict: ok; warn: works, but less than it could; fail: heliograph will not work so.
        detail: what was found.
        advice: what to do; empty where nothing is.
    """

    check: str
    verdict: Verdict
    detail: str
    advice: str = ""


def python() -> Iterator[Check]:
    """Is the interpreter new enough?"""
    found = ".".join(map(str, sys.version_info[:3]))
    good = sys.version_info[:2] >= PYTHON_MIN
    wanted = ".".join(map(str, PYTHON_MIN))
    yield Check("python", "ok" if good else "fail", found, "" if good else f"install Python {wanted} or later")


def packages() -> Iterator[Check]:
    """Which extras have all their packages?"""
    for extra, names in requirements(requires("heliograph") or []).items():
        if extra in _NOT_FOR_OPERATORS:
            continue
        have, lack = [], []
        for name in names:
            try:
                have.append(f"{name} {version(name)}")
            except PackageNotFoundError:
                lack.append(name)
        label = f"extra {extra}" if extra else "packages"
        if not lack:
            yield Check(label, "ok", ", ".join(have) or "needs nothing more")
        else:
            target = f"heliograph[{extra}]" if extra else "heliograph"
            yield Check(
                label, "warn" if extra else "fail", f"absent: {', '.join(lack)}", f"if wanted: pip install '{target}'"
            )


def requirements(lines: list[str]) -> dict[str, list[str]]:
    """Return the packages of each extra ("" for what all need), from the lines of a distribution's metadata.

    Extras that only name other extras are left out: those speak for themselves.
    """
    found: dict[str, list[str]] = {"": []}
    for line in lines:
        requirement, _, marker = line.partition(";")
        match = _NAME.match(requirement.strip())
        if match is None:
            continue
        extra = _EXTRA.search(marker)
        names = found.setdefault(extra.group(1) if extra else "", [])
        if match.group() != "heliograph":
            names.append(match.group())
    return {extra: names for extra, names in found.items() if names or not extra}


def bus() -> Iterator[Check]:
    """Does a message come through a router on a free loopback port, from one session to another?"""
    if find_spec("zenoh") is None:
        yield Check("bus", "fail", "zenoh is absent", "pip install heliograph")
        return
    from heliograph_services.cli.bus_check import round_trip_ms  # noqa: PLC0415 - zenoh only where it is there

    try:
        took_ms = round_trip_ms(free_port(), _TIMEOUT_S)
    except (HeliographError, OSError) as error:
        yield Check("bus", "fail", str(error), "is loopback open? Does a firewall or sandbox forbid local sockets?")
        return
    if took_ms is None:
        advice = "is loopback slow or filtered? try again, then with RUST_LOG=zenoh=debug"
        yield Check("bus", "fail", f"no message came back within {_TIMEOUT_S:g} s", advice)
    else:
        yield Check("bus", "ok", f"a message went through a router on loopback and back in {took_ms:.1f} ms")


def free_port() -> int:
    """Return a TCP port on loopback that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def numba_cache() -> Iterator[Check]:
    """Can compiled kernels be kept?"""
    if find_spec("numba") is None:
        yield Check(
            "kernel cache", "warn", "numba is absent", "pip install 'heliograph[decoder]' where events are read"
        )
        return
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else _package_folder() / "__pycache__"
    problem = _unwritable(folder)
    if problem is None:
        yield Check("kernel cache", "ok", str(folder))
    else:
        advice = "set NUMBA_CACHE_DIR to a writable folder; without one every start compiles for a minute"
        yield Check("kernel cache", "warn", f"{folder}: {problem}", advice)


def _package_folder() -> Path:
    spec = find_spec("heliograph")
    return Path(spec.origin).parent if spec is not None and spec.origin else Path()


def _unwritable(folder: Path) -> str | None:
    """Return why a file cannot be made in a folder, or None where it can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return error.strerror or str(error)


def disk() -> Iterator[Check]:
    """Is there room where metrics and logs go?"""
    here = Path.cwd()
    problem = _unwritable(here)
    if problem is not None:
        yield Check(
            "disk", "warn", f"{here}: {problem}", "start services where they may write, or set file = ... in the site"
        )
        return
    free = shutil.disk_usage(here).free
    verdict: Verdict = "ok" if free >= DISK_WARN_BYTES else "warn" if free >= DISK_FAIL_BYTES else "fail"
    advice = "" if verdict == "ok" else "make room: metrics take 0.1 GB a day, recordings 29 GB an hour at 1 Mev/s"
    yield Check("disk", verdict, f"{free / 1e9:.1f} GB free at {here}", advice)


def cores() -> Iterator[Check]:
    """Are there enough processors for a site on this host?"""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    good = count >= 2
    advice = "" if good else "source and decoder want a core each at 1 Mev/s and more; `heliograph bench decode` tells"
    yield Check("cores", "ok" if good else "warn", str(count), advice)


def clock() -> Iterator[Check]:
    """Is the wall clock kept by somebody? Identifications of several hosts are compared by it."""
    answer = _ask_chrony()
    answer = _ask_systemd() if answer is None else answer
    if answer is None:
        advice = "on several hosts: install chrony; on one host nothing depends on it"
        yield Check("clock", "warn", "neither chrony nor systemd-timesyncd answers", advice)
        return
    synchronised, detail = answer
    advice = "" if synchronised else "on several hosts: install or start chrony; times between hosts are not comparable"
    yield Check("clock", "ok" if synchronised else "warn", detail, advice)


def _said_by(*command: str) -> str | None:
    program = shutil.which(command[0])
    if program is None:
        return None
    try:
        # The program was found on the operator's own path, the arguments are ours.
        done = subprocess.run(  # noqa: S603
            [program, *command[1:]], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def _ask_chrony() -> tuple[bool, str] | None:
    said = _said_by("chronyc", "-n", "tracking")
    if said is None:
        return None
    fields = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in said.splitlines())}
    offset = fields.get("System time", "offset unknown")
    return fields.get("Leap status") == "Normal", f"chrony: {fields.get('Leap status', 'unknown')}, {offset}"


def _ask_systemd() -> tuple[bool, str] | None:
    said = _said_by("timedatectl", "show", "--property=NTPSynchronized", "--value")
    if said is None or not said.strip():
        return None
    good = said.strip() == "yes"
    return good, f"systemd: {'synchronised' if good else 'not synchronised'}"


def cameras() -> Iterator[Check]:
    """Which recordings can be read? NPZ always can."""
    for name, (what, advice) in CAMERA_LIBRARIES.items():
        there = find_spec(name) is not None
        yield Check(
            f"camera {name}", "ok" if there else "warn", what if there else f"absent ({what})", "" if there else advice
        )


def ports(endpoints: tuple[str, ...]) -> Iterator[Check]:
    """Are the router's ports free?"""
    for endpoint in endpoints:
        match = re.fullmatch(r"(tcp|tls|ws)/(?P<host>.+):(?P<port>\d+)", endpoint)
        if match is None:
            continue
        host, port = match["host"].strip("[]"), int(match["port"])
        problem = _cannot_listen(host, port)
        if problem is None:
            yield Check(f"port {port}", "ok", f"{endpoint} is free")
        else:
            advice = "a running site holds it (heliograph status SITE.toml), or another program: ss -ltnp"
            yield Check(f"port {port}", "warn", f"{endpoint}: {problem}", advice)


def _cannot_listen(host: str, port: int) -> str | None:
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            # As a server does: a port whose last connections are still fading away counts as free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        return error.strerror or str(error)
    return None


def site(path: str) -> Iterator[Check]:
    """Is the site file sound, and are its router's ports free?"""
    from heliograph.shell.site import load_site  # noqa: PLC0415 - only where a site is given
    from heliograph_services.cli.config import problems  # noqa: PLC0415

    try:
        loaded = load_site(path)
    except HeliographError as error:
        yield Check("site", "fail", str(error), "mend the file; `heliograph config check` says the same")
        return
    found = problems(loaded)
    for problem in found:
        yield Check(
            "site", "fail", problem, "mend the file; `heliograph config show --origin` tells where values come from"
        )
    if not found:
        yield Check("site", "ok", f"{path}: {len(loaded.service)} processes, {len(loaded.beacon)} beacons")
    if loaded.router is not None:
        yield from ports(loaded.router.listen)


def everything(site_path: str | None) -> Iterator[Check]:
    """Yield all checks, each as it is done."""
    questions: list[Callable[[], Iterator[Check]]] = [python, packages, cores, disk, numba_cache, clock, cameras, bus]
    if site_path is None:
        questions.append(lambda: ports((f"tcp/127.0.0.1:{DEFAULT_PORT}",)))
    else:
        questions.append(lambda: site(site_path))
    for question in questions:
        yield from question()
