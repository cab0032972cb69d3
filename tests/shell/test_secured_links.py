"""Mutual TLS between a client and its router, with real certificates on loopback."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
import zenoh

from heliograph.errors import BusError
from heliograph.keys import key
from heliograph.shell.bus import open_session
from heliograph.shell.links import client_config, router_config
from heliograph.shell.site import BusLinks, RouterLinks, Tls
from support.processes import PATIENCE_S, free_port

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl, which makes the certificates, is not here"),
]

SAN = "subjectAltName=DNS:localhost,IP:127.0.0.1"


def openssl(*arguments: str) -> None:
    subprocess.run(["openssl", *arguments], check=True, capture_output=True, timeout=PATIENCE_S)


def authority(folder: Path, name: str) -> None:
    subject = ["-subj", f"/CN={name}", "-keyout", str(folder / f"{name}.key"), "-out", str(folder / f"{name}.pem")]
    openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2", *subject)


def identity(folder: Path, name: str, issuer: str) -> Tls:
    """Make a key and a certificate, and return them as a site file names them; all trust the authority `ca`."""
    path = str(folder / name)
    issued = ["-CA", str(folder / f"{issuer}.pem"), "-CAkey", str(folder / f"{issuer}.key"), "-CAcreateserial"]
    (folder / "extensions").write_text(SAN)
    request = ["-subj", f"/CN={name}", "-keyout", path + ".key", "-out", path + ".csr"]
    openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", *request)
    extensions = ["-extfile", str(folder / "extensions"), "-days", "1"]
    openssl("x509", "-req", "-in", path + ".csr", *issued, *extensions, "-out", path + ".pem")
    return Tls(root_ca=str(folder / "ca.pem"), certificate=path + ".pem", private_key=path + ".key")


def test_a_client_with_a_certificate_is_served_and_one_of_another_authority_is_not(tmp_path: Path) -> None:
    authority(tmp_path, "ca")
    authority(tmp_path, "stranger")
    ours, theirs = identity(tmp_path, "drone", "ca"), identity(tmp_path, "thief", "stranger")
    endpoint = f"tls/localhost:{free_port()}"
    (tmp_path / "acl.json").write_text(json.dumps({"enabled": False}))
    links = RouterLinks(listen=(endpoint,), access_control=str(tmp_path / "acl.json"))
    router = open_session(router_config(links, BusLinks(tls=identity(tmp_path, "router", "ca"))))
    assert router is not None
    with router:
        client = open_session(client_config(BusLinks(connect=(endpoint,), tls=ours), wait=False))
        assert client is not None
        with client:
            assert [str(zid) for zid in client.info.routers_zid()] == [str(router.info.zid())]
            name = key("s", "clock", "cam0")
            with router.declare_subscriber(name, zenoh.handlers.FifoChannel(1)) as heard:
                client.put(name, b"over TLS")
                assert heard.recv().payload.to_bytes() == b"over TLS"
        with pytest.raises(BusError, match="cannot open the bus at tls/localhost"):
            open_session(client_config(BusLinks(connect=(endpoint,), tls=theirs), wait=False))
