"""Zenoh's configuration, from the site's plan of links: no multicast, no gossip, nothing that is not in the plan.

Services are clients of their host's router, routers dial routers (two peers behind one router would exchange nothing).
A plain link must stay on this host; any other needs mutual TLS, and a router that listens on one needs access control.
"""

from __future__ import annotations

import ipaddress
import json
import re
from pathlib import Path
from typing import Any, Final

from heliograph.errors import ConfigError
from heliograph.keys import ROOT, TOPICS
from heliograph.shell.site import BusLinks, RouterLinks, Tls

# Dial again after 0.1 s, then at most every 0.5 s (Zenoh's own rhythm takes 1.9 s to come back).
_RETRY: Final = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
# A frozen process or a cut link is noticed after 1 s; Zenoh's own lease is 10 s.
LEASE_MS: Final = 1000
_LOCAL: Final = {"unixsock-stream", "unixpipe", "vsock"}
_SECURED: Final = {"tls", "quic"}
_ENDPOINT: Final = re.compile(r"(?P<scheme>[a-z-]+)/(?P<address>[^?#]+)")


def is_loopback(endpoint: str) -> bool:
    """Return whether a link on this endpoint stays on this host.

    Raises:
        ConfigError: this is no endpoint.
    """
    match = _ENDPOINT.match(endpoint)
    if match is None:
        raise ConfigError(f"endpoint must look like tcp/127.0.0.1:7447, not {endpoint!r}")
    if match["scheme"] in _LOCAL:
        return True
    host = match["address"].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False  # a name that may lead anywhere


def _refuse_plain(endpoints: tuple[str, ...], tls: Tls | None) -> None:
    for endpoint in endpoints:
        if is_loopback(endpoint):
            continue
        if tls is None or endpoint.partition("/")[0] not in _SECURED:
            raise ConfigError(
                f"link {endpoint} leaves this host: it must be tls/ or quic/ with [bus.tls], or stay on loopback"
            )


def _base(shared_memory: bool, tls: Tls | None) -> dict[str, Any]:
    link: dict[str, Any] = {"tx": {"lease": LEASE_MS, "keep_alive": 4}}
    if tls is not None:
        link["tls"] = {
            "root_ca_certificate": tls.root_ca,
            "listen_certificate": tls.certificate,
            "listen_private_key": tls.private_key,
            "connect_certificate": tls.certificate,
            "connect_private_key": tls.private_key,
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": link, "shared_memory": {"enabled": shared_memory}},
        "timestamping": {"enabled": {"router": True, "peer": True, "client": True}},
    }


def client_config(links: BusLinks, *, wait: bool = True) -> dict[str, Any]:
    """Return the configuration of a service or a command that reaches the bus.

    Args:
        links: the site's `[bus]`.
        wait: dial until a router answers; otherwise fail within a second.

    Raises:
        ConfigError: a plain link leaves this host.
    """
    _refuse_plain(links.connect, links.tls)
    if not links.connect:
        raise ConfigError("[bus] connect must name at least one router")
    connect = {
        "endpoints": list(links.connect),
        "timeout_ms": -1 if wait else 1000,
        "exit_on_failure": not wait,
        "retry": _RETRY,
    }
    return {"mode": "client", "connect": connect, **_base(links.shared_memory, links.tls)}


def router_config(links: RouterLinks, bus: BusLinks) -> dict[str, Any]:
    """Return the configuration of a host's router.

    Raises:
        ConfigError: a plain link leaves this host, an unknown topic in `keep`, or no access control where it is needed.
    """
    _refuse_plain((*links.listen, *links.connect), bus.tls)
    config: dict[str, Any] = {
        "mode": "router",
        "listen": {"endpoints": list(links.listen), "exit_on_failure": True},
        # A router whose peer is away goes on alone and dials in the background. With a timeout of 0 Zenoh 1.10 dials a
        # peer that is not there at the start only once: the hosts could not start in any order.
        "connect": {
            "endpoints": list(links.connect),
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": _RETRY,
        },
        **_base(bus.shared_memory, bus.tls),
    }
    # Between hosts alone: Zenoh compresses (LZ4) where both ends would, and clients would not. Names that a batch of
    # messages repeats cross a radio once: a tenth less there, and nothing waits for it.
    config["transport"]["unicast"] = {"compression": {"enabled": True}}
    if links.id:
        config["id"] = links.id
    if not all(is_loopback(endpoint) for endpoint in links.listen) and not links.access_control:
        raise ConfigError("[router] listens beyond this host: access_control must name a file (deny by default)")
    if links.access_control:
        config["access_control"] = _access_control(Path(links.access_control))
    elif links.keep:
        config["access_control"] = _keeping(links)
    return config


def _access_control(path: Path) -> dict[str, Any]:
    try:
        rules: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"[router] access_control {path}: {error}") from None
    return rules


def _keeping(links: RouterLinks) -> dict[str, Any]:
    """Return rules under which the kept topics never go to the peers, whoever asks for them there."""
    unknown = [topic for topic in links.keep if topic not in TOPICS]
    if unknown:
        raise ConfigError(f"[router] keep: {unknown[0]!r} is no topic; there are: {', '.join(TOPICS)}")
    if not links.peers:
        raise ConfigError("[router] keep needs `peers`: the Zenoh ids of the routers it must keep the topics from")
    return {
        "enabled": True,
        "default_permission": "allow",
        "rules": [
            {
                "id": "keep",
                "permission": "deny",
                "messages": ["put", "declare_subscriber", "query", "reply"],
                "flows": ["egress", "ingress"],
                "key_exprs": [f"{ROOT}/*/{topic}/**" for topic in links.keep],
            }
        ],
        "subjects": [{"id": "elsewhere", "zids": list(links.peers)}],
        "policies": [{"rules": ["keep"], "subjects": ["elsewhere"]}],
    }
