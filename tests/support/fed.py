"""Services as processes with the test as their source: a router, a client that hears, a bus to play on."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from heliograph.shell.bus import Bus, connected
from heliograph.shell.links import client_config
from heliograph.shell.process import Stop
from heliograph.shell.site import BusLinks
from support.processes import Collector, Host, collecting, free_port


class Fed(NamedTuple):
    """The processes, what a client has heard, and the bus in the name of a source."""

    host: Host
    heard: Collector
    bus: Bus


def site_text(name: str, port: int, services: str) -> str:
    """Return a site file whose router listens on that port.

    Args:
        name: of the site.
        port: of the loopback.
        services: the file's `[[service]]` and `[[beacon]]` tables.
    """
    return f"""
site = "{name}"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
[router]
listen = ["tcp/127.0.0.1:{port}"]
{services}
"""


@contextlib.contextmanager
def fed(folder: Path, name: str, services: str, kinds: list[str], hears: list[str]) -> Iterator[Fed]:
    """Start the processes and join their bus, until the test leaves; end them.

    Args:
        folder: for the site file and the logs.
        name: of the site.
        services: as of `site_text`.
        kinds: of the services.
        hears: schemas that the client keeps.
    """
    port = free_port()
    host = Host(folder, name, site_text(name, port, services), kinds)
    links = BusLinks(connect=(f"tcp/127.0.0.1:{port}",), shared_memory=False)
    try:
        with (
            collecting(port, name, hears) as heard,
            connected(client_config(links), name, "event_source/feeder", Stop()) as bus,
        ):
            assert bus is not None
            yield Fed(host, heard, bus)
    finally:
        statuses = host.close()
    assert all(statuses[kind] == 0 for kind in kinds), statuses
