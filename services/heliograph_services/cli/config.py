"""`heliograph config show|check SITE.toml`: the settings of each process, where each comes from, and what is wrong."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from typing import Any, Final

import msgspec

from heliograph.errors import ConfigError, HeliographError
from heliograph.link.modulations import modulation
from heliograph.shell.config import Origin, resolve
from heliograph.shell.links import client_config, router_config
from heliograph.shell.site import Site, load_site
from heliograph_services.cli.services import config_type

EXIT_WRONG: Final = 2


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status (0 sound, 2 wrong)."""
    parser = argparse.ArgumentParser(prog="heliograph config", description=__doc__)
    parser.add_argument("action", choices=("show", "check"))
    parser.add_argument("site", metavar="SITE.toml")
    parser.add_argument("--origin", action="store_true", help="show where each value comes from")
    parser.add_argument("--json", action="store_true", help="one JSON object a process")
    arguments = parser.parse_args(argv)
    site = load_site(arguments.site)
    if arguments.action == "check":
        return _check(site)
    for label, settings in settings_of(site).items():
        _show(label, settings, origin=arguments.origin, as_json=arguments.json)
    return 0


def settings_of(site: Site) -> dict[str, dict[str, Origin]]:
    """Return the settings of each process of a site, under "kind/instance".

    Raises:
        ConfigError: a setting is wrong.
    """
    found = {}
    for entry in site.service:
        _, origins = resolve(config_type(entry.kind), entry, site, os.environ, {})
        found[f"{entry.kind}/{entry.instance}"] = origins
    return found


def problems(site: Site) -> list[str]:
    """Return what is wrong with a site beyond its form: links, settings of processes, beacons; a line each."""
    found = []

    def attempt(work: Any, *arguments: Any) -> None:
        try:
            work(*arguments)
        except HeliographError as error:
            found.append(str(error))
        except ValueError as error:
            found.append(f"{site.path}: {error}")

    attempt(client_config, site.bus)
    if site.router is not None:
        attempt(router_config, site.router, site.bus)
    for entry in site.service:
        attempt(lambda entry=entry: resolve(config_type(entry.kind), entry, site, os.environ, {}))
    for beacon in site.beacon:

        def encodes(beacon: Any = beacon) -> None:
            link = modulation(beacon.protocol, **beacon.options)
            if beacon.payload is not None:
                try:
                    link.encode(beacon.payload)
                except ValueError as error:
                    raise ConfigError(f"{site.path}: [[beacon]] {beacon.name}: {error}") from None

        attempt(encodes)
    for protocol in dict.fromkeys(beacon.protocol for beacon in site.beacon):
        attempt(_together, site, protocol)
    return list(dict.fromkeys(found))


def _together(site: Site, protocol: str) -> None:
    """Check what the beacons of one protocol must not be to each other."""
    alike = [beacon for beacon in site.beacon if beacon.protocol == protocol]
    check = getattr(modulation(protocol, **alike[0].options), "check_beacons", None)
    if check is None:
        return
    try:
        scans = (entry.settings.get("scan_rate_hz", 0.0) for entry in site.service if entry.kind == "decoder")
        check([(b.name, b.payload, b.bit_rate) for b in alike], min((s for s in scans if s), default=0.0))
    except ValueError as error:
        raise ConfigError(f"{site.path}: {error}") from None


def _check(site: Site) -> int:
    found = problems(site)
    for line in found:
        print(line)
    if not found:
        print(f"{site.path}: sound: {len(site.service)} processes, {len(site.beacon)} beacons")
    return EXIT_WRONG if found else 0


def _show(label: str, settings: dict[str, Origin], *, origin: bool, as_json: bool) -> None:
    plain = {name: msgspec.to_builtins(entry.value) for name, entry in settings.items()}
    if as_json:
        where = {name: entry.where for name, entry in settings.items()}
        print(json.dumps({"process": label, "settings": plain} | ({"origin": where} if origin else {})))
        return
    print(f"[{label}]")
    for name, entry in settings.items():
        value = json.dumps(plain[name])
        value = value if len(value) <= 40 else value[:37] + "..."
        print(f"  {name:<24} {value:<28}" + (f" {entry.where}" if origin else ""))
