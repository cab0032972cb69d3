"""Site files and settings: every mistake is one line that names the place, the value and the range."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from heliograph.errors import ConfigError
from heliograph.shell.config import add_flags, given_flags, resolve, variable
from heliograph.shell.links import client_config, is_loopback, router_config
from heliograph.shell.site import BusLinks, RouterLinks, ServiceEntry, Site, Tls, load_site, site_of
from heliograph.site import Beacon


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    camera: str = "cam0"
    rate: Annotated[float, Meta(gt=0, le=10, extra_json_schema={"description": "How often."})] = 1.0
    n: Annotated[int, Meta(ge=0, le=9)] = 3
    on: bool = False
    mode: Literal["a", "b"] = "a"
    names: tuple[str, ...] = ()
    either: float | Literal["auto"] = "auto"
    beacons: tuple[Beacon, ...] = ()

    def __post_init__(self) -> None:
        if self.mode == "b" and self.n == 0:
            raise ValueError("mode b needs n of at least 1")


SITE = Site(path="x.toml", beacon=(Beacon(name="crane", protocol="seed11", payload=42, bit_rate=1000),))


def settle(
    toml: dict[str, Any] | None = None, env: dict[str, str] | None = None, flags: dict[str, str] | None = None
) -> Any:
    entry = ServiceEntry(kind="decoder", instance="d", settings=toml or {})
    return resolve(Settings, entry, SITE, env or {}, flags or {})


def test_flags_beat_the_environment_which_beats_the_file_which_beats_defaults() -> None:
    toml: dict[str, Any] = {"n": 4, "rate": 2.0, "mode": "b"}
    env = {variable("decoder", "n"): "5", variable("decoder", "rate"): "3.5"}
    config, origins = settle(toml, env, {"n": "6"})
    assert (config.n, config.rate, config.mode, config.camera) == (6, 3.5, "b", "cam0")
    wheres = {name: origins[name].where for name in ("n", "rate", "mode", "camera")}
    assert wheres == {"n": "--n", "rate": "$HELIOGRAPH_DECODER_RATE", "mode": "x.toml", "camera": "default"}


def test_beacons_come_from_the_site_and_from_nowhere_else() -> None:
    config, _ = settle()
    assert config.beacons == SITE.beacon
    with pytest.raises(ConfigError, match="unknown setting 'beacons'"):
        settle({"beacons": []})


def test_text_becomes_the_type_of_the_setting() -> None:
    config, _ = settle(flags={"on": "true", "names": '["a", "b"]', "either": "12.5"})
    assert (config.on, config.names, config.either) == (True, ("a", "b"), 12.5)
    assert settle(flags={"either": "auto"})[0].either == "auto"


@pytest.mark.parametrize(
    ("toml", "env", "flags", "told"),
    [
        ({"rate": 11.0}, {}, {}, r"x.toml \[\[service\]\] decoder/d: rate: Expected `float` <= 10.0"),
        ({"rate": "fast"}, {}, {}, "rate: Expected `float`, got `str`, not 'fast'"),
        ({"ratte": 1}, {}, {}, "unknown setting 'ratte'; known: camera, rate"),
        ({}, {"HELIOGRAPH_DECODER_N": "-1"}, {}, r"\$HELIOGRAPH_DECODER_N: Expected `int` >= 0, not '-1'"),
        ({}, {}, {"mode": "c"}, "--mode: Invalid enum value 'c'"),
        ({"mode": "b", "n": 0}, {}, {}, "mode b needs n of at least 1"),
    ],
)
def test_a_wrong_setting_is_one_line_that_names_origin_and_range(
    toml: dict[str, Any], env: dict[str, str], flags: dict[str, str], told: str
) -> None:
    with pytest.raises(ConfigError, match=told) as caught:
        settle(toml, env, flags)
    assert "\n" not in str(caught.value)


def test_flags_that_are_not_given_override_nothing() -> None:
    parser = argparse.ArgumentParser()
    add_flags(parser, Settings)
    assert given_flags(parser.parse_args([])) == {}
    assert given_flags(parser.parse_args(["--n", "4"])) == {"n": "4"}
    assert "How often. (default: 1.0)" in parser.format_help()
    assert "--beacons" not in parser.format_help()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("site = ", "not TOML"),
        ("sight = 'x'", "unknown key 'sight'"),
        ("site = 3", "Expected `str`"),
        ("site = 'a/b'", r"matching regex"),
        ("[[service]]\ninstance = 'x'", "number 1 needs kind"),
        ("[[service]]\nkind = 'a'\n[[service]]\nkind = 'a'", r"\[\[service\]\] a/a is given twice"),
        ("[[beacon]]\nname='a'\nprotocol='p'\nbit_rate=0", "bit_rate|>= 1"),
        ("[bus]\nconnekt = []", "unknown field `connekt`"),
    ],
)
def test_a_wrong_site_file_is_one_line_that_names_the_file(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "site.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=told) as caught:
        load_site(path)
    assert "site.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_site_file_is_a_configuration_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_site(tmp_path / "none.toml")


def test_a_process_that_the_site_does_not_name_is_told_with_those_it_names() -> None:
    site = site_of({"service": [{"kind": "decoder"}]}, "x.toml")
    with pytest.raises(ConfigError, match=r"no \[\[service\]\] tracker/t; there are: decoder/decoder"):
        site.entry("tracker", "t")


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tcp/[::1]:7447", True),
        ("tcp/localhost:1", True),
        ("unixsock-stream//run/x", True),
        ("tcp/0.0.0.0:7447", False),
        ("tcp/10.0.0.2:7447", False),
        ("udp/beacon.example:7447", False),
    ],
)
def test_loopback_is_told_from_the_rest(endpoint: str, local: bool) -> None:
    assert is_loopback(endpoint) is local


def test_a_plain_link_beyond_this_host_is_refused_and_a_secured_one_is_not() -> None:
    far = BusLinks(connect=("tcp/10.0.0.2:7447",))
    with pytest.raises(ConfigError, match=r"tcp/10\.0\.0\.2:7447 leaves this host"):
        client_config(far)
    with pytest.raises(ConfigError, match="endpoint must look like"):
        client_config(BusLinks(connect=("10.0.0.2:7447",)))
    tls = Tls(root_ca="ca.pem", certificate="c.pem", private_key="k.pem")
    secured = client_config(BusLinks(connect=("tls/10.0.0.2:7447",), tls=tls))
    assert secured["transport"]["link"]["tls"]["enable_mtls"] is True
    with pytest.raises(ConfigError, match="access_control must name a file"):
        router_config(RouterLinks(listen=("tls/10.0.0.2:7447",)), BusLinks(tls=tls))


def test_keeping_a_topic_needs_a_known_topic_and_the_peers() -> None:
    with pytest.raises(ConfigError, match="'gossip' is no topic"):
        router_config(RouterLinks(keep=("gossip",), peers=("1",)), BusLinks())
    with pytest.raises(ConfigError, match="keep needs `peers`"):
        router_config(RouterLinks(keep=("events",)), BusLinks())


def test_routers_compress_between_them_and_clients_do_not() -> None:
    links = BusLinks(connect=("tcp/127.0.0.1:7447",))
    assert router_config(RouterLinks(), links)["transport"]["unicast"]["compression"]["enabled"] is True
    assert "unicast" not in client_config(links)["transport"]
