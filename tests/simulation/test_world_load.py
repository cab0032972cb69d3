"""Scenario files: what is read, and what is refused in one line that names file, key, value and range."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from heliograph.errors import ConfigError
from heliograph.site import Beacon
from heliograph_services.event_source.simulation.world.load import (
    built_in,
    load_scenario,
    parse_scenario,
    scenario_of,
    site_beacons,
)

GOOD = """
[camera]
path = { kind = "still", at_m = [0, 0, 5] }
[[beacon]]
name = "a"
protocol = "seed11"
payload = 42
bit_rate = 1000
path = { kind = "still", at_m = [0, 0, 0] }
"""
SHIPPED = {
    "clutter", "construction_site", "construction_site_nrp", "construction_site_sun", "construction_site_sun_moving",
    "crowd", "empty", "five", "handheld", "lab_moving", "lab_moving_16mm", "lab_static", "night", "protocols", "spin",
    "still",
}  # fmt: skip


def refusal(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_scenario(text, "my.toml")
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith("scenario my.toml: ")
    return line.removeprefix("scenario my.toml: ")


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


def test_the_scenarios_that_the_project_promises_are_there() -> None:
    assert set(built_in()) >= SHIPPED


def test_a_good_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "good.toml"
    path.write_text(GOOD, "utf-8")
    scenario = load_scenario(str(path))
    assert scenario.beacons[0].payload == 42
    assert scenario.camera.sensor == "dvxplorer_mini"


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("bit_rate = 1000", "bit_rate = 0", "beacon[0].bit_rate must be a number from 1 to 100000, not 0"),
        ("bit_rate = 1000", 'bit_rate = "x"', "beacon[0].bit_rate must be a number from 1 to 100000, not 'x'"),
        ("bit_rate = 1000", "bit_rate = nan", "beacon[0].bit_rate must be a finite number, not nan"),
        ("bit_rate = 1000", "", "beacon[0].bit_rate is missing"),
        ("payload = 42", "payload = -1", "beacon[0].payload must be a whole number from 0 to 9.22337e+18, not -1"),
        ("[0, 0, 0]", "[0, 0]", "beacon[0].path.at_m must be a list of 3, not [0, 0]"),
        ("[0, 0, 0]", "[0, 1e5, 0]", "beacon[0].path.at_m[1] must be a number from -10000 to 10000, not 100000.0"),
        ("[0, 0, 0]", "[0, inf, 0]", "beacon[0].path.at_m[1] must be a finite number, not inf"),
        ('kind = "still", at_m = [0, 0, 0]', 'kind = "spiral"',
         "beacon[0].path.kind must be one of 'circle', 'shuttle', 'sine', 'still', 'waypoints', not 'spiral'"),
        ("[camera]", "[camera]\nlens = { f_number = 0.1 }",
         "camera.lens.f_number must be a number from 0.7 to 64, not 0.1"),
        ("[camera]", "[camera]\nlens = { focus_m = 0.0 }",
         "camera.lens.focus_m must be a number above 0 and at most 100000, not 0.0"),
        ("[camera]", "duration_s = 0\n[camera]", "duration_s must be a number above 0 and at most 100000, not 0"),
        ("[camera]", 'ground = { texture = "sand" }\n[camera]',
         "ground.texture must be one of 'asphalt', 'boards', 'plain', 'site', not 'sand'"),
        ("[camera]", "beacons = 3\n[camera]",
         "beacons = 3 is unknown; the scenario may have about, duration_s, irradiance_w_m2, camera, ground, mains, "),
        ("[camera]", "[camera]\nlens = { focal = 16 }",
         "camera.lens.focal = 16 is unknown; camera.lens may have focal_mm, f_number, transmission, psf_sigma_px, "),
        ('name = "a"', 'name = "a b"',
         "beacon[0].name must be a text of at least 1 and at most 64 letters like ^[A-Za-z0-9_][A-Za-z0-9_.:-]*$, not"),
        ("payload = 42", "", "beacon[0]: beacon a must have one of payload, text, fresh, edges"),
        ("payload = 42", 'payload = 42\ntext = "x"',
         "beacon[0] (a): a beacon of seed11 must have one of payload, text"),
        ("payload = 42", 'payload = 42\ncarried_by = "x"', "beacon[0]: a must have either path or carried_by"),
    ],
)  # fmt: skip
def test_what_a_table_may_not_say_is_refused_with_key_value_and_range(old: str, new: str, line: str) -> None:
    assert refusal(changed(old, new)).startswith(line)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("payload = 42", "payload = 14",
         "beacon[0] (a): payload 14 cannot be sent: with parity even it reads like 60 under rotation"),
        ("payload = 42", "payload = 64", "beacon[0] (a): payload must be in [0, 63], not 64"),
        ("payload = 42", 'text = "hi"', "beacon[0] (a): protocol seed11 cannot send text 'hi': it sends payloads"),
        ('protocol = "seed11"', 'protocol = "uart"',
         "beacon[0] (a): protocol uart cannot send payload 42: it sends text"),
        ('protocol = "seed11"\npayload = 42', 'protocol = "uart"\nfresh = true',
         "beacon[0] (a): fresh must be false: uart has no payloads to draw from"),
        ('protocol = "seed11"', 'protocol = "morse"', "beacon[0] (a): protocol must be one of seed11, code, uart"),
        ("payload = 42", "payload = 42\noptions = { parity = \"odd\" }",
         "beacon[0] (a): parity must be one of even, paper_text, not 'odd'"),
        ("[camera]", "[camera]\nlens = { focal_mm = 50, focus_m = 0.06 }",
         "camera.lens.focus_m must be at least twice the focal length, 0.1 m, not 0.06"),
        ("[camera]", "[camera]\nlens = { focal_mm = 0.5 }",
         "camera.lens.focal_mm must be at least 0.898 with this sensor (640x480, 9 um), not 0.5"),
        ("[camera]", '[camera]\nsensor = "dvx"', "camera.sensor: "),
        ("[camera]", '[camera]\nmode = "FAST"', "camera.sensor: preset dvxplorer_mini: mode must be one of"),
        ("at_m = [0, 0, 5]", "at_m = [0, 0, 0]",
         "camera.path must stay above the ground (z at least 0.018 m, 5 focal lengths), not come to 0 m at 0 s"),
        ('path = { kind = "still", at_m = [0, 0, 5] }',
         'path = { kind = "sine", at_m = [0, 0, 5], amplitude_m = [0, 0, 6], period_s = [1, 1, 4] }',
         "camera.path must stay above the ground"),
        ("at_m = [0, 0, 0]", "at_m = [0, 0, -1]",
         "beacon[0] (a) must stay on or above the ground (z at least 0 m), not come to -1 m"),
        ("at_m = [0, 0, 0]", "at_m = [100, 0, 0]",
         "beacon[0] (a) must be on the sensor (640x480 px) at some time of its 60 s (duration_s), but its path never"),
        ("at_m = [0, 0, 0]", "at_m = [0, 0, 9]", "beacon[0] (a) must be on the sensor"),
        ("at_m = [0, 0, 0]", "at_m = [0, 0, 4.99]",
         "beacon[0] (a) must stay at least 0.018 m (5 focal lengths) from the camera, not come within 0.01 m"),
        ('{ kind = "still", at_m = [0, 0, 0] }',
         '{ kind = "circle", centre_m = [0, 0, 0], radius_m = 2, turn_s = 0.01 }',
         "beacon[0] (a) must move at most 20000 px/s over the sensor, not"),
        ('{ kind = "still", at_m = [0, 0, 0] }', '{ kind = "circle", centre_m = [0, 0, 0], radius_m = 2, turn_s = 0 }',
         "beacon[0].path: turn_s must be at least 0.001 or at most -0.001, not 0"),
        ('{ kind = "still", at_m = [0, 0, 0] }',
         '{ kind = "shuttle", from_m = [0, 0, 0], to_m = [1, 0, 0], speed_m_s = 4, turn_s = 1 }',
         "beacon[0].path: turn_s must be at most 0.5 (2 |to_m - from_m| / speed_m_s), not 1"),
        ('path = { kind = "still", at_m = [0, 0, 0] }', 'carried_by = "cart"',
         "beacon[0].carried_by must be one of the assets (of which there are none), not 'cart'"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_with_key_value_and_range(old: str, new: str, line: str) -> None:
    assert refusal(changed(old, new)).startswith(line)


def test_an_image_larger_than_any_spot_is_refused() -> None:
    text = changed("payload = 42", "payload = 42\ndiameter_m = 10").replace("at_m = [0, 0, 0]", "at_m = [0, 0, 3.5]")
    assert re.fullmatch(
        r"beacon\[0\] \(a\) must have an image of at most 250 px \(standard deviation\), not 667: .*", refusal(text)
    )


def test_two_lights_or_two_assets_of_one_name_are_refused() -> None:
    again = GOOD[GOOD.index("[[beacon]]") :]
    assert refusal(GOOD + again) == "every beacon or clutter must have a name of its own, but two are called 'a'"
    crowd = '[[crowd]]\nprefix = "a"\ncount = 1\nprotocol = "seed11"\nbit_rate = 100\narea_m = [-1, -1, 1, 1]\n'
    assert refusal(changed('"a"', '"a000"') + crowd).endswith("two are called 'a000'")
    asset = '[[asset]]\nname = "x"\nsize_m = [1, 1]\npath = { kind = "still", at_m = [0, 0, 1] }\n'
    assert refusal(GOOD + asset + asset) == "every asset must have a name of its own, but two are called 'x'"


def test_a_crowds_area_and_count_are_checked() -> None:
    crowd = '[[crowd]]\ncount = 60\nprotocol = "seed11"\nbit_rate = 100\narea_m = [-1, -1, 1, 1]\n'
    assert refusal(GOOD + crowd).startswith("crowd[0]: count must be at most 44,")
    assert refusal(GOOD + crowd.replace("[-1, -1, 1, 1]", "[1, -1, 1, 1]")).startswith("crowd[0]: area_m must be")
    assert refusal(GOOD + crowd.replace("60", "4").replace("[-1, -1, 1, 1]", "[50, 50, 60, 60]")).startswith(
        "b000 must be on the sensor"
    )


def test_what_is_no_toml_or_no_file_is_refused(tmp_path: Path) -> None:
    assert "line 1" in refusal("= 3")
    with pytest.raises(ConfigError, match=r"^scenario must be one of clutter, .* or a TOML file, not 'nowhere'$"):
        load_scenario("nowhere")
    path = tmp_path / "latin.toml"
    path.write_bytes(b'about = "\xe9"')
    with pytest.raises(ConfigError, match="not UTF-8"):
        load_scenario(str(path))


FULL = """
duration_s = 3.0
camera.path = { kind = "waypoints", points = [[0, 0, 0, 5], [2, 1, 0, 5], [4, 0, 0, 5]], smooth_s = 0.5 }
camera.attitude = { points = [[0, 0, -90, 0], [4, 360, -90, 0]], smooth_s = 0.5 }
camera.shake = { rms_deg = 0.1, low_hz = 1.0, high_hz = 9.0 }
camera.lens = { focal_mm = 3.6, f_number = 2.0, focus_m = 5.0 }
camera.override = { "pixel.threshold_on" = 0.25 }
[[asset]]
name = "cart"
path = { kind = "shuttle", from_m = [-1, 0, 1], to_m = [1, 0, 1], speed_m_s = 1.0, turn_s = 0.1 }
size_m = [1, 1]
[[mains]]
centre_m = [0, 0]
size_m = [1, 1]
irradiance_w_m2 = 1.0
[[beacon]]
name = "a"
protocol = "code"
options = { codebook = "code20d4" }
payload = 42
bit_rate = 1000
carried_by = "cart"
leds = [[0.1, 0.0]]
half_angle_deg = 60
[[clutter]]
name = "b"
signal = { kind = "telegraph", mean_on_s = 0.1, mean_off_s = 0.1 }
path = { kind = "sine", at_m = [0, 0, 0], amplitude_m = [1, 0, 0], period_s = [2, 1, 1] }
[[crowd]]
count = 2
protocol = "seed11"
bit_rate = 100
area_m = [-1, -1, 1, 1]
"""


def leaves(data: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    entries = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in entries:
        yield (*at, key)
        yield from leaves(value, (*at, key))


@pytest.mark.parametrize("wrong", ["x", -1, 1e-9, 10**30, float("nan"), True, [], {}], ids=repr)
def test_whatever_a_file_says_instead_of_a_value_is_read_or_refused_in_one_line(wrong: object) -> None:
    refusals: list[str] = []
    for path in leaves(tomllib.loads(FULL)):
        data: Any = tomllib.loads(FULL)
        node = data
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = wrong
        try:
            scenario_of(data)
        except ConfigError as error:
            refusals.append(str(error))
    assert refusals
    assert all(re.fullmatch("scenario: [^\n]+", line) for line in refusals)


def test_a_site_lists_the_beacons_as_they_send() -> None:
    assert site_beacons(load_scenario("still")) == [
        Beacon(name="crane", protocol="seed11", bit_rate=1000, payload=42),
        Beacon(name="lift", protocol="seed11", bit_rate=1000, payload=21),
        Beacon(name="truck", protocol="seed11", bit_rate=1000, payload=51),
        Beacon(name="mixer", protocol="code", bit_rate=1000, payload=77, options={"codebook": "code20d4"}),
        Beacon(name="gate", protocol="uart", bit_rate=1000),
    ]
    crowd = site_beacons(load_scenario("crowd"))
    assert len(crowd) == 100
    assert len({beacon.payload for beacon in crowd}) == 100
    assert parse_scenario(changed("payload = 42", "fresh = true"), "x").beacons[0].fresh
    assert site_beacons(parse_scenario(changed("payload = 42", "fresh = true"), "x"))[0].payload is None


def test_reading_a_scenario_needs_no_compiler() -> None:
    code = (
        "import sys; from heliograph_services.event_source.simulation.world import load;"
        "load.load_scenario('construction_site_nrp'); sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
