"""A recording through separate processes yields what `heliograph decode` yields in one, byte for byte, each time."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from support.processes import Collector, Host, collecting, free_port
from support.scene import Scene

pytestmark = pytest.mark.processes

SERVICES = ["tracker", "decoder", "metrics_sink", "event_source"]
WANTED = ["frames", "ids", "messages", "progress"]


def site(port: int, file: Path, decoder: str, beacons: str = "") -> str:
    return f"""
site = "replay"
lockstep = true
[bus]
connect = ["tcp/127.0.0.1:{port}"]
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "event_source"
backend = "recording"
file = "{file}"
window_us = 10000
wait_for = ["tracker", "decoder"]
[[service]]
kind = "tracker"
[[service]]
kind = "decoder"
{decoder}
[[service]]
kind = "metrics_sink"
file = "metrics-{port}.sqlite"
{beacons}
"""


def through_processes(folder: Path, text: str, port: int, order: list[str]) -> dict[str, list[bytes]]:
    """Return what the processes publish, by schema and track."""
    host = Host(folder, f"site{port}", text, [])
    try:
        with collecting(port, "replay", WANTED) as heard:
            for kind in order:
                host.start(kind)
            heard.until(decoder_is_done, "the decoder to finish", 110)
            assert host.wait("event_source") == 0, host.log("event_source")
        statuses = host.close()
        assert statuses == dict.fromkeys(statuses, 0), "\n".join(host.log(kind) for kind in statuses)
        return heard.bodies("frames", "ids", "messages")
    finally:
        host.close()


def decoder_is_done(heard: Collector) -> bool:
    done = [m for m in heard.messages["progress"] if getattr(m, "service", "") == "decoder" and getattr(m, "done", 0)]
    # What the decoder published before its last word may still be on the way: it has another priority.
    return bool(done) and any(getattr(m, "lost", False) for m in heard.messages["ids"])


def decoded(*arguments: str) -> list[dict[str, object]]:
    command = [sys.executable, "-m", "heliograph_services.cli", "decode", *arguments, "--json", "--frames"]
    out = subprocess.run(command, check=True, capture_output=True, text=True, timeout=110).stdout
    return [json.loads(line) for line in out.splitlines()]


def in_one_process(config_site: Path) -> dict[str, list[bytes]]:
    """Return what the pipeline publishes for a site's recording, by schema and track."""
    script = """
import sys, json
from heliograph_services.cli.decode import build, parser
from heliograph.wire import pack_body
from heliograph.shell.site import load_site
site = load_site(sys.argv[1])
file = next(e.settings["file"] for e in site.service if e.kind == "event_source")
stream, pipeline, cores = build(parser().parse_args([file, "--site", sys.argv[1]]))
found = {}
for step in stream:
    for message in pipeline.feed(step.messages):
        if message.SCHEMA in ("frames", "ids", "messages"):
            track = getattr(message, "track", "")
            name = f"{message.SCHEMA}/{track if isinstance(track, str) else ''}"
            found.setdefault(name, []).append(pack_body(message).hex())
print(json.dumps(found))
"""
    command = [sys.executable, "-c", script, str(config_site)]
    out = subprocess.run(command, check=True, capture_output=True, text=True, timeout=110).stdout
    return {name: [bytes.fromhex(body) for body in bodies] for name, bodies in json.loads(out).items()}


def test_the_scene_through_processes_is_the_scene_in_one_process_whatever_the_order_of_starts(
    scene: Scene, tmp_path: Path
) -> None:
    port = free_port()
    text = site(port, scene.path, "", scene.beacons)
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
    text = site(port, beacon_data / name, f'protocol = "uart"\nbit_rate = {rate}')
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
