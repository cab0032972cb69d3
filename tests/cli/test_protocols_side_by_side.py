"""One beacon of every protocol in one scene, in lockstep: each is identified, each text read, nothing else."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from heliograph.link.modulations import names
from heliograph_services.event_source.simulation.world.load import load_scenario

SITE = Path(__file__).parents[2] / "deploy" / "sites" / "protocols.toml"
SCENARIO = load_scenario("protocols")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    file = tmp_path_factory.mktemp("protocols") / "p.npz"
    text = ""
    for arguments in (
        ["simulate", "protocols", "-o", str(file), "--duration", "1", "--seed", "3"],
        ["decode", str(file), "--site", str(SITE), "--frames", "--json"],
    ):
        command = [sys.executable, "-m", "heliograph_services.cli", *arguments]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=110)
        assert done.returncode == 0, done.stderr
        text = done.stdout
    return [json.loads(line) for line in text.splitlines()]


def test_the_scene_and_the_site_have_every_protocol() -> None:
    assert {beacon.protocol for beacon in SCENARIO.beacons} == set(names())


def test_every_beacon_is_identified_at_its_place_and_nobody_else(out: list[dict[str, Any]]) -> None:
    found = [line for line in out if line["type"] == "identification"]
    assert {line["beacon"] for line in found} == {beacon.name for beacon in SCENARIO.beacons}
    assert all(line["change"] in {"accepted", "lost"} for line in found)
    protocols = {beacon.name: beacon.protocol for beacon in SCENARIO.beacons}
    for line in found:
        assert line["protocol"] == protocols[line["beacon"]]
        assert line["frames_used"] >= 1
        assert line["margin"] > 20.0  # e^-20 is the chance of 2e-9 that the runner-up was sent
    # Eight lights in two rows of four, each near its own place.
    columns = {"crane": 196, "mixer": 492, "gate": 788, "marker": 1084, "hum": 195, "logger": 492, "gaps": 788}
    for line in found:
        x_px = columns.get(line["beacon"], 1084)
        assert abs(line["x_px"] - x_px) < 75
        assert abs(line["y_px"] - (129 if line["beacon"] in {"crane", "mixer", "gate", "marker"} else 590)) < 60


def test_every_frame_holds_what_its_beacon_sends(out: list[dict[str, Any]]) -> None:
    payloads = defaultdict(set)
    for line in out:
        if line["type"] == "frame":
            payloads[line["protocol"]].add(line["payload"])
    for beacon in SCENARIO.beacons:
        if beacon.protocol == "packet":
            assert payloads["packet"] == {9}
        elif beacon.payload is not None:
            assert payloads[beacon.protocol] == {beacon.payload}
        else:
            assert beacon.text is not None
            assert payloads[beacon.protocol] <= {ord(letter) for letter in beacon.text}


def test_every_text_is_read_without_an_error(out: list[dict[str, Any]]) -> None:
    texts = defaultdict(list)
    for line in out:
        if line["type"] == "message":
            texts[line["beacon"]].append(line["text"])
    sent = {beacon.name: beacon.text for beacon in SCENARIO.beacons if beacon.text}
    assert set(texts) == set(sent)
    lines = sent.pop("logger").splitlines()
    assert sorted(texts.pop("logger")) == sorted(lines)
    for name, text in sent.items():
        read = "".join(texts[name])
        assert len(read) > 150
        assert read in text * 50
