"""Runs a core as a process: `main_of(Service(...))` is all of a service's `__main__`.

Order of a start: arguments and settings (a mistake is one line and status 2), kernels warm, bus open, subscriptions,
liveliness, then the loop. Live, the newest input counts and silence makes ticks. In lockstep nothing may be lost: an
input waits until the core is `ready` for it, `progress` is published after it, and a gap ends the process.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

import msgspec

from heliograph.errors import ConfigError, HeliographError
from heliograph.shell.config import add_flags, given_flags, resolve
from heliograph.shell.process import (
    Stop,
    end_with_parent,
    keep_kernels,
    keep_out_of_collections,
    wake_promptly,
)
from heliograph.shell.site import BusLinks, ServiceEntry, Site, load_site

if TYPE_CHECKING:
    from heliograph.core import Context, Core
    from heliograph.shell.loop import Runner

_LOG = logging.getLogger(__name__)
ConfigT = TypeVar("ConfigT", bound=msgspec.Struct)
EXIT_CONFIG: Final = 2
EXIT_FAULT: Final = 1


@dataclass(frozen=True)
class Service(Generic[ConfigT]):
    """What the shell must know of a service.

    Args:
        kind: its name in the site file and on the bus.
        about: one line for `--help`.
        config: its settings.
        make: makes the core; imports what is heavy, warms kernels.
        inputs: schema -> whether it is the camera's (then only the configured camera's are read).
        paced_by: the input that carries the camera's time, gated in lockstep and followed by progress; "" for none.
        urgent: whether it lies on the way from a light to its reader, and is woken in time (`wake_promptly`).
        timed: the input whose way through the process is timed (`heliograph.shell.hops`); by default the one that
            paces it.
        queue: most messages of a topic that wait for it; 0 for the bus's own limit.
        extra_schemas: records that are not in `heliograph.wire.SCHEMAS`, as "module:attribute" of a table.
    """

    kind: str
    about: str
    config: type[ConfigT]
    make: Callable[[ConfigT, Context], Core]
    inputs: Mapping[str, bool]
    paced_by: str = ""
    urgent: bool = False
    timed: str = ""
    queue: int = 0
    extra_schemas: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Launch(Generic[ConfigT]):
    """A process as it was asked for: its site, name and settings."""

    site: Site
    kind: str
    instance: str
    config: ConfigT


def parser_for(kind: str, about: str, config: type[msgspec.Struct]) -> argparse.ArgumentParser:
    """Return the command line of a service."""
    parser = argparse.ArgumentParser(prog="heliograph-" + kind.replace("_", "-"), description=about)
    parser.add_argument("--site", metavar="FILE", help="the site file (TOML)")
    parser.add_argument("--instance", default=kind, metavar="NAME", help=f"which of the site's (default: {kind})")
    parser.add_argument("--connect", action="append", metavar="ENDPOINT", help="router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--log-level", default="info", choices=("debug", "info", "warning", "error"))
    parser.add_argument("--log-format", default="json", choices=("json", "text"))
    add_flags(parser, config)
    return parser


def launch_of(kind: str, about: str, config: type[ConfigT], argv: Sequence[str] | None) -> Launch[ConfigT]:
    """Return what the command line asks for; logs are set up on the way.

    Raises:
        ConfigError: a setting or the site file is wrong.
    """
    arguments = parser_for(kind, about, config).parse_args(argv)
    from heliograph.shell import logs  # noqa: PLC0415 - not needed for --help

    logs.set_up(kind, arguments.instance, arguments.log_level, arguments.log_format)
    if arguments.site:
        site = load_site(arguments.site)
        entry = site.entry(kind, arguments.instance)
    elif arguments.connect:
        site = Site()
        entry = ServiceEntry(kind=kind, instance=arguments.instance, settings={})
    else:
        raise ConfigError("give --site FILE, or --connect ENDPOINT to run without one")
    if arguments.connect:
        links = BusLinks(connect=tuple(arguments.connect), shared_memory=site.bus.shared_memory, tls=site.bus.tls)
        site = msgspec.structs.replace(site, bus=links)
    settings, _ = resolve(config, entry, site, os.environ, given_flags(arguments))
    return Launch(site, kind, arguments.instance, settings)


def guarded(work: Callable[[Stop], int]) -> int:
    """Run a process's work under its manners; return its exit status.

    An operator's mistake is one line on stderr and status 2.
    """
    end_with_parent()
    keep_kernels()
    stop = Stop()
    stop.install()
    try:
        status = work(stop)
    except HeliographError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)  # noqa: T201 - the operator's line
        status = EXIT_CONFIG
    if threading.active_count() > 1:
        # A thread that still dials a router cannot be ended, and would abort the process should it return while the
        # interpreter goes. What had to be said has been said.
        logging.shutdown()
        sys.stdout.flush()
        os._exit(status)
    return status


def main_of(service: Service[Any], argv: Sequence[str] | None = None) -> int:
    """Run a service until it is stopped; return its exit status (0 stopped, 1 fault, 2 wrong settings)."""

    def work(stop: Stop) -> int:
        launch = launch_of(service.kind, service.about, service.config, argv)
        if service.urgent:
            wake_promptly()
        return _serve(service, launch, stop)

    return guarded(work)


def _serve(service: Service[Any], launch: Launch[Any], stop: Stop) -> int:
    # Here, not above: Zenoh and numpy take the better part of a second that --help and a wrong setting need not pay.
    import secrets  # noqa: PLC0415

    from heliograph.core import Context  # noqa: PLC0415
    from heliograph.shell.bus import connected  # noqa: PLC0415
    from heliograph.shell.links import client_config  # noqa: PLC0415
    from heliograph.shell.loop import Runner  # noqa: PLC0415

    context = Context(launch.instance, secrets.token_hex(3), launch.site.lockstep)
    source = f"{service.kind}/{launch.instance}"
    config = client_config(launch.site.bus)
    core = service.make(launch.config, context)
    keep_out_of_collections()
    with connected(config, launch.site.site, source, stop) as bus:
        if bus is None:
            return 0
        runner: Runner = Runner(service, launch, core, bus)
        return runner.run(stop)
