"""Beacons that send packets: their text as messages, a line each, and what a scenario must not ask of them."""

from __future__ import annotations

from typing import Any

import pytest

from heliograph.errors import ConfigError
from heliograph.link.modulations.packet import Packet
from heliograph_services.event_source.simulation.lights import drive_of
from heliograph_services.event_source.simulation.world.checks import check_tables
from heliograph_services.event_source.simulation.world.load import load_scenario, site_beacons
from heliograph_services.event_source.simulation.world.spec import BeaconSpec, Still

HERE = Still(at_m=(0.0, 0.0, 0.0))
SCENARIO = """
about = "a data beacon"
[camera]
sensor = "imx636"
path = {{ kind = "still", at_m = [0.0, 0.0, 5.0] }}
lens = {{ focal_mm = 3.6, f_number = 2.0 }}
[[beacon]]
name = "buoy"
protocol = "{protocol}"
{says}
bit_rate = 5000
path = {{ kind = "still", at_m = [0.0, 0.0, 0.0] }}
"""


def spec(**fields: Any) -> BeaconSpec:
    return BeaconSpec(name="buoy", path=HERE, protocol="packet", bit_rate=5000.0, **fields)


def test_a_text_is_sent_a_message_a_line_with_the_payload_as_address() -> None:
    drive = drive_of(spec(text="one\n\ntwo, which takes two fragments", payload=9), 0, 0)
    frames = drive.frames_ended(1.0, 4 * 309 * 200.0 + 1.0)
    assert [frame.payload for frame in frames] == [9] * 4
    expected = [
        *Packet().message("one", 9, 0),
        *Packet().message("two, which takes two fragments", 9, 1),
    ]
    t_us, level = drive.changes(0.0, len(expected) * 200.0)
    lit, at = drive.level(0.0), 0
    bits = []
    for i in range(len(expected)):
        while at < len(t_us) and t_us[at] <= i * 200.0 + 1e-6:
            lit, at = level[at], at + 1
        bits.append(int(lit))
    assert bits == expected


def test_a_payload_alone_is_sent_as_an_empty_message() -> None:
    frames = drive_of(spec(payload=200), 0, 0).frames_ended(1.0, 2 * 309 * 200.0 + 1.0)
    assert [frame.payload for frame in frames] == [200, 200]


@pytest.mark.parametrize(
    ("protocol", "says", "told"),
    [
        ("packet", 'text = "\\n"', "text of packet must have a line that is not empty"),
        ("packet", "payload = 256", r"payload of packet must be in \[0, 255\], not 256"),
        ("packet", 'payload = 256\ntext = "a"', r"address must be in \[0, 255\], not 256"),
        ("uart", 'payload = 1\ntext = "a"', "a beacon of uart must have one of payload, text"),
    ],
)
def test_what_a_scenario_cannot_send_is_told_in_one_line(tmp_path: Any, protocol: str, says: str, told: str) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(SCENARIO.format(protocol=protocol, says=says))
    with pytest.raises(ConfigError, match=told):
        load_scenario(str(path))


def test_a_site_lists_the_address_as_payload(tmp_path: Any) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(SCENARIO.format(protocol="packet", says='payload = 9\ntext = "hello"'))
    scenario = load_scenario(str(path))
    check_tables(scenario, "here")
    (beacon,) = site_beacons(scenario)
    assert (beacon.name, beacon.protocol, beacon.payload) == ("buoy", "packet", 9)
