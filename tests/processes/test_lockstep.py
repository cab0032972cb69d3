"""A recording through separate processes yields what `heliograph decode` yields in one, byte for byte, each time."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from support.processes import free_port
from support.replay import SERVICES, in_one_process, recording, site, through_processes
from support.scene import Scene

pytestmark = pytest.mark.processes


def decoded(*arguments: str) -> list[dict[str, object]]:
    command = [sys.executable, "-m", "heliograph_services.cli", "decode", *arguments, "--json", "--frames"]
    out = subprocess.run(command, check=True, capture_output=True, text=True, timeout=110).stdout
    return [json.loads(line) for line in out.splitlines()]


def test_the_scene_through_processes_is_the_scene_in_one_process_whatever_the_order_of_starts(
    scene: Scene, tmp_path: Path
) -> None:
    port = free_port()
    text = site(port, recording(scene.path), "", scene.beacons)
    first = through_processes(tmp_path, text, port, SERVICES)
    again = through_processes(tmp_path, text, port, SERVICES[::-1])
    alone = in_one_process(tmp_path / f"site{port}.toml")
    assert len(first["frames/"]) > 100
    assert first == again
    assert first == alone


@pytest.mark.data
@pytest.mark.parametrize(("name", "rate"), [("504hz_100m.mat", 504), ("3125hz_30m.mat", 3125)])
def test_a_real_recording_through_processes_is_the_recording_in_one_process(
    beacon_data: Path, tmp_path: Path, name: str, rate: int
) -> None:
    port = free_port()
    text = site(port, recording(beacon_data / name), f'protocol = "uart"\nbit_rate = {rate}')
    processes = through_processes(tmp_path, text, port, SERVICES)
    alone = in_one_process(tmp_path / f"site{port}.toml")
    assert processes == alone
    assert any(name.startswith("messages/") for name in processes)


@pytest.mark.data
def test_the_sonnet_is_read_without_an_error_from_a_hundred_metres(beacon_data: Path) -> None:
    lines = decoded(str(beacon_data / "504hz_100m.mat"), "--protocol", "uart", "--bit-rate", "504")
    text = "".join(str(line["text"]) for line in lines if line["type"] == "message")
    assert (beacon_data / "sonnet.txt").read_text() in text
    assert lines[-1]["type"] == "summary"


def test_a_supervised_site_prints_the_lines_of_decode_byte_for_byte(scene: Scene, tmp_path: Path) -> None:
    port = free_port()
    path = tmp_path / "site.toml"
    path.write_text(site(port, recording(scene.path), "", scene.beacons))
    command = [sys.executable, "-m", "heliograph_services.cli"]
    listener = subprocess.Popen(
        [*command, "ids", str(path), "--json", "--frames", "--until-end", "--wait"], stdout=subprocess.PIPE
    )
    # A run folder's path must be short enough for a socket in it.
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([*command, "up", str(path), "--until-end", "--run-dir", folder], check=True, timeout=100)
    heard, _ = listener.communicate(timeout=60)
    arguments = ["decode", str(scene.path), "--site", str(path), "--json", "--frames"]
    decoded_lines = subprocess.run([*command, *arguments], check=True, capture_output=True, timeout=100).stdout
    assert heard.count(b"\n") > 500
    assert heard == decoded_lines[: decoded_lines.rindex(b'{"type": "summary"')]
