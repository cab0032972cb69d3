"""The site file: which processes run on a host, how they reach each other, and which beacons there are.

::

    site = "laptop"                       # {site} in the keys
    host = "laptop"                       # the host whose processes this file names
    lockstep = false                      # true: replay, nothing lost, the same result every time
    [bus]
    connect = ["tcp/127.0.0.1:7447"]      # services are clients of their host's router
    shared_memory = true
    [router]                              # this host's router; absent where somebody else runs it
    listen = ["tcp/127.0.0.1:7447"]
    connect = []                          # routers of other hosts
    keep = []                             # topics that never leave this host through `connect`
    [[service]]
    kind = "decoder"                      # instance = kind unless given; every other key is a setting
    [[beacon]]
    name = "crane"                        # heliograph.site.Beacon
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta

from heliograph.errors import ConfigError
from heliograph.messages import Name
from heliograph.site import Beacon

_Endpoint = Annotated[str, Meta(min_length=5, max_length=200)]


class Tls(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Files of mutual TLS, which every link beyond this host needs."""

    root_ca: str
    certificate: str
    private_key: str


class BusLinks(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How services reach the bus: as clients of these routers."""

    connect: tuple[_Endpoint, ...] = ("tcp/127.0.0.1:7447",)
    shared_memory: bool = True
    tls: Tls | None = None


class RouterLinks(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """This host's router.

    Args:
        listen: endpoints for services, clients and other routers.
        connect: routers of other hosts, dialled until they answer.
        peers: Zenoh ids of those routers, which `keep` needs to know them by.
        id: this router's own Zenoh id (hex digits), so that others can name it as a peer; drawn where empty.
        keep: topics that never leave this host towards `peers`.
        access_control: a file with Zenoh's `access_control` (JSON), needed beyond this host.
    """

    listen: tuple[_Endpoint, ...] = ("tcp/127.0.0.1:7447",)
    connect: tuple[_Endpoint, ...] = ()
    peers: tuple[str, ...] = ()
    id: Annotated[str, Meta(pattern=r"^[0-9a-f]{0,32}$")] = ""
    keep: tuple[str, ...] = ()
    access_control: str = ""


class ServiceEntry(msgspec.Struct, frozen=True, kw_only=True):
    """One `[[service]]`: its kind, its name among its kind, and its settings as they stand in the file."""

    kind: Name
    instance: Name
    settings: dict[str, Any]


class Site(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A checked site file; `path` is where it was read from ("" for none)."""

    site: Name = "site"
    host: Name = "host"
    lockstep: bool = False
    bus: BusLinks = BusLinks()
    router: RouterLinks | None = None
    service: tuple[ServiceEntry, ...] = ()
    beacon: tuple[Beacon, ...] = ()
    path: str = ""

    def entry(self, kind: str, instance: str) -> ServiceEntry:
        """Return the entry of a process.

        Raises:
            ConfigError: the file names no such process.
        """
        for entry in self.service:
            if entry.kind == kind and entry.instance == instance:
                return entry
        known = ", ".join(f"{e.kind}/{e.instance}" for e in self.service) or "none"
        raise ConfigError(f"{self.path}: no [[service]] {kind}/{instance}; there are: {known}")


_TOP: Final = ("site", "host", "lockstep", "bus", "router", "service", "beacon")


def read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's content.

    Raises:
        ConfigError: the file cannot be read, or is no TOML; one line with the place.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None


def load_site(path: str | Path) -> Site:
    """Return the checked site file.

    Raises:
        ConfigError: missing, not TOML, an unknown key, a value of a wrong type or out of range, a name given twice.
    """
    path = Path(path)
    raw = read_toml(path)
    return site_of(raw, str(path))


def site_of(raw: Mapping[str, Any], path: str) -> Site:
    """Return the site of a parsed file; `path` names it in errors.

    Raises:
        ConfigError: as `load_site`.
    """
    unknown = [name for name in raw if name not in _TOP]
    if unknown:
        raise ConfigError(f"{path}: unknown key {unknown[0]!r}; known: {', '.join(_TOP)}")
    entries = []
    for number, table in enumerate(raw.get("service", []), 1):
        if not isinstance(table, dict) or not isinstance(table.get("kind"), str):
            raise ConfigError(f'{path}: [[service]] number {number} needs kind = "..."')
        settings = {name: value for name, value in table.items() if name not in {"kind", "instance"}}
        entries.append({"kind": table["kind"], "instance": table.get("instance", table["kind"]), "settings": settings})
    try:
        site = msgspec.convert({**raw, "service": entries, "path": path}, Site, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: {error}") from None
    _refuse_twins(path, "service", [f"{e.kind}/{e.instance}" for e in site.service])
    _refuse_twins(path, "beacon", [b.name for b in site.beacon])
    return site


def _refuse_twins(path: str, what: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{path}: [[{what}]] {name} is given twice")
