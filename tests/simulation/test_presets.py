"""Presets: every number has a source and a worth, mistakes are refused in one line that names them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import pytest

from heliograph.errors import ConfigError
from heliograph_services.event_source.simulation.contract import PixelNumbers
from heliograph_services.event_source.simulation.readout.numbers import AerNumbers, ImageNumbers, ScanNumbers
from heliograph_services.event_source.simulation.readout.presets import (
    KINDS,
    PIXEL,
    READOUTS,
    load_preset,
    names,
    parse_preset,
    read_preset,
    readout_of,
)

NAMES = ["davis346", "dvxplorer", "dvxplorer_mini", "genx320", "ideal", "imx636", "nrp"]
FOLDER = Path(__file__).parents[2] / "services/heliograph_services/event_source/simulation/readout/presets"


def test_the_presets_are_these() -> None:
    assert names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_number_says_where_it_is_from_and_what_it_is_worth(name: str) -> None:
    preset = read_preset(name)
    sourced = [item for table in preset.tables.values() for item in table.values()]
    assert len(sourced) >= 12
    for item in sourced:
        assert item.kind in KINDS
        assert len(item.source) >= 15
        assert "\n" not in item.source


@pytest.mark.parametrize("name", NAMES)
def test_every_mode_of_every_preset_is_a_sensor(name: str) -> None:
    preset = read_preset(name)
    for mode in ["", *preset.modes()]:
        sensor = load_preset(name, mode)
        assert sensor.name == name
        if sensor.kind != "images":
            readout_of(sensor, 3)
        if isinstance(sensor.readout, ScanNumbers):
            assert sensor.readout.mode == (mode or "VARIABLE_5000")


def test_the_tables_of_rules_have_the_fields_of_the_records() -> None:
    assert list(PIXEL) == [field.name for field in fields(PixelNumbers)]
    records: Mapping[str, type[ScanNumbers | AerNumbers | ImageNumbers]] = {
        "scan": ScanNumbers,
        "aer": AerNumbers,
        "images": ImageNumbers,
    }
    for kind, record in records.items():
        assert list(READOUTS[kind]) == [field.name for field in fields(record) if field.name != "mode"]


def test_the_real_sensors_are_as_large_as_they_are() -> None:
    sizes = {name: (s.width, s.height, s.pitch_um) for name in NAMES for s in [load_preset(name)]}
    assert sizes["dvxplorer_mini"] == sizes["dvxplorer"] == (640, 480, 9.0)
    assert sizes["davis346"] == (346, 260, 18.5)
    assert sizes["imx636"] == (1280, 720, 4.86)
    assert sizes["genx320"] == (320, 320, 6.3)


def test_an_override_changes_one_number() -> None:
    sensor = load_preset("dvxplorer_mini", "", {"pixel.threshold_on": 0.25, "readout.latch": "step"})
    assert sensor.pixel.threshold_on == 0.25
    assert sensor.pixel.threshold_off == 0.2
    assert isinstance(sensor.readout, ScanNumbers)
    assert sensor.readout.latch == "step"
    assert load_preset("dvxplorer_mini").pixel.threshold_on == 0.2
    assert load_preset("nrp", "", {"pixel.dark_w_m2": 0.01}).pixel.dark_w_m2 == 0.01


@pytest.mark.parametrize(
    ("name", "mode", "override", "words"),
    [
        ("dvexplorer", "", {}, ["dvexplorer", "davis346", "TOML file"]),
        ("dvxplorer", "VARIABLE_1", {}, ["dvxplorer", "VARIABLE_1", "VARIABLE_5000"]),
        ("davis346", "VARIABLE_5000", {}, ["davis346", "none", "VARIABLE_5000"]),
        ("dvxplorer", "", {"pixel.treshold_on": 0.2}, ["dvxplorer", "pixel.treshold_on"]),
        ("dvxplorer", "", {"threshold_on": 0.2}, ["'threshold_on'", "pixel.threshold_on"]),
        ("dvxplorer", "", {"pixel.threshold_on": 0.0}, ["pixel.threshold_on", "from 0.01 to 5", "not 0.0"]),
        ("dvxplorer", "", {"pixel.threshold_on": float("nan")}, ["pixel.threshold_on", "not nan"]),
        ("dvxplorer", "", {"pixel.threshold_on": "low"}, ["pixel.threshold_on", "'low'"]),
        ("dvxplorer", "", {"readout.latch": "last"}, ["readout.latch", "first, net, step", "'last'"]),
        ("dvxplorer", "", {"readout.clock_ns": 20.5}, ["readout.clock_ns", "whole number", "20.5"]),
        ("dvxplorer", "CONSTANT_100", {"readout.fixed_us": 100.0}, ["readout.fixed_us", "9100", "not 100"]),
        ("nrp", "", {"pixel.threshold_on": 0.2}, ["nrp", "pixel.threshold_on", "pixel.dark_w_m2"]),
        ("davis346", "", {"sensor.width": 0}, ["sensor.width", "from 8 to 4096", "not 0"]),
    ],
)
def test_a_mistake_is_refused_in_one_line(
    name: str, mode: str, override: dict[str, float | str], words: list[str]
) -> None:
    with pytest.raises(ConfigError) as refused:
        load_preset(name, mode, override)
    text = str(refused.value)
    assert "\n" not in text
    for word in words:
        assert word in text


GOOD = (FOLDER / "davis346.toml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('kind = "aer"', 'kind = "laser"', ["kind", "scan, aer, images", "'laser'"]),
        ("width = {", "wide = {", ["sensor.wide", "width"]),
        ("value = 18.5, ", "", ["sensor.pitch_um", "value, kind, source"]),
        ("value = 18.5,", "value = 1850.0,", ["sensor.pitch_um", "from 0.5 to 100", "1850"]),
        ('value = 18.5, kind = "published"', 'value = 18.5, kind = "known"', ["sensor.pitch_um", "assumed", "'known'"]),
        ('source = "dv-processing getPixelPitch"', 'source = " "', ["sensor.pitch_um", "source"]),
        ("[pixel]", "[pixels]", ["'pixels'", "pixel"]),
        ("[sensor]", "[[sensor]]", ["sensor", "table"]),
        ('about = "iniVation DAVIS346"', "about = 1", ["about", "text"]),
        ('about = "iniVation DAVIS346"', 'default_mode = "X"', ["default_mode", "'X'"]),
        ("[sensor]", "[sensor", ["preset test"]),
    ],
)
def test_a_file_that_is_not_sound_is_refused_in_one_line(old: str, new: str, words: list[str]) -> None:
    assert old in GOOD
    with pytest.raises(ConfigError) as refused:
        parse_preset(GOOD.replace(old, new, 1), "test")
    text = str(refused.value)
    assert "\n" not in text
    for word in ["preset test", *words]:
        assert word in text


def test_a_number_without_an_entry_is_refused() -> None:
    lines = [line for line in GOOD.splitlines() if not line.startswith("leak_hz")]
    with pytest.raises(ConfigError, match=r"pixel\.leak_hz must be given \(from 0 to 1000\)"):
        parse_preset("\n".join(lines), "test")


def test_a_preset_may_be_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace("value = 12000000.0", "value = 24e6"))
    readout = load_preset(str(path)).readout
    assert isinstance(readout, AerNumbers)
    assert readout.bus_hz == 24e6


def test_a_camera_of_images_has_no_readout_of_pixels() -> None:
    with pytest.raises(ConfigError, match="nrp"):
        readout_of(load_preset("nrp"), 0)


def test_presets_are_read_without_compiling_anything() -> None:
    code = (
        "import sys\n"
        "from heliograph_services.event_source.simulation.readout.presets import load_preset\n"
        "load_preset('dvxplorer_mini')\n"
        "sys.exit('numba' in sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
