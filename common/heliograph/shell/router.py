"""A host's Zenoh router as a process: the services of the host are its clients, it dials the routers of other hosts."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from typing import Final

from heliograph.errors import ConfigError
from heliograph.shell.process import Stop, wake_promptly
from heliograph.shell.run import guarded
from heliograph.shell.site import RouterLinks, load_site

_LOG = logging.getLogger(__name__)
_WAIT_S: Final = 0.2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the router of a site file's host until it is stopped; return the exit status."""
    parser = argparse.ArgumentParser(prog="heliograph-router", description=__doc__)
    parser.add_argument("--site", metavar="FILE", required=True, help="the site file (TOML)")
    parser.add_argument("--log-level", default="info", choices=("debug", "info", "warning", "error"))
    parser.add_argument("--log-format", default="json", choices=("json", "text"))
    arguments = parser.parse_args(argv)
    from heliograph.shell import logs  # noqa: PLC0415 - not needed for --help

    logs.set_up("router", "router", arguments.log_level, arguments.log_format)
    return guarded(lambda stop: _route(arguments.site, stop))


def _route(path: str, stop: Stop) -> int:
    from heliograph.shell.bus import connected  # noqa: PLC0415 - not needed for --help
    from heliograph.shell.links import router_config  # noqa: PLC0415

    site = load_site(path)
    if site.router is None:
        raise ConfigError(f"{path}: no [router]: this host uses somebody else's")
    wake_promptly()
    with connected(router_config(site.router, site.bus), site.site, f"router/{site.host}", stop) as bus:
        if bus is None:
            return 0
        bus.announce("router", site.host)
        _LOG.info("routing", extra={"fields": {"listen": site.router.listen, "connect": site.router.connect}})
        told: set[str] = set()
        while not stop.wait(_WAIT_S):
            if site.router.keep:
                _tell_strangers(bus.routers(), site.router, told)
    return 0


def _tell_strangers(routers: list[str], links: RouterLinks, told: set[str]) -> None:
    """Say, once for each, which routers the kept topics are not kept from: the rule knows its peers by their ids."""
    for stranger in sorted(set(routers) - set(links.peers) - told):
        told.add(stranger)
        _LOG.error("router %s is not among `peers`: %s may cross to it", stranger, ", ".join(links.keep))


if __name__ == "__main__":
    sys.exit(main())
