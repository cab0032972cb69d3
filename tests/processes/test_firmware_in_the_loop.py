"""Text typed at the command line comes out of the decoder: firmware, light, camera, tracker and decoder in between."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from heliograph.beacons import BeaconState
from heliograph.messages import Data
from support.processes import PATIENCE_S, Collector, Host, collecting, free_port
from support.virtual_beacon import beacon_process, program

pytestmark = pytest.mark.processes

LOOP = Path(__file__).parents[2] / "firmware" / "loop"
TEXT = "the crane is clear. "
SERVICES = ["event_source", "tracker", "decoder", "beacon_controller"]


def told(heard: Collector) -> str:
    """Return the texts so far, joined."""
    return "".join(m.text or "" for m in list(heard.messages["messages"]) if isinstance(m, Data))


def is_ready(heard: Collector) -> bool:
    """Return whether the camera looks, and the beacon obeys and has been set."""
    states = [m for m in list(heard.messages["beacon"]) if isinstance(m, BeaconState)]
    if not states or not all(heard.messages[name] for name in ("onsets", "tracks", "status")):
        return False
    # Until the camera looks, the beacon may have to wait for room in the FIFO, and so be silent.
    last = states[-1]
    return last.link == "ready" and last.reported is not None and last.reported.protocol == "uart"


def beacon(site: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `heliograph beacon ACTION SITE ...`."""
    command = [sys.executable, "-m", "heliograph_services.cli", "beacon", arguments[0], str(site), *arguments[1:]]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=PATIENCE_S)


def test_text_typed_at_beacon_send_arrives_as_a_message(tmp_path: Path) -> None:
    program(tmp_path / "build")
    fifo, line = tmp_path / "gate.edges", tmp_path / "gate.tty"
    os.mkfifo(fifo)
    scene = tmp_path / "scene.toml"
    scene.write_text((LOOP / "scene.toml").read_text().replace("run/gate.edges", str(fifo)))
    port = free_port()
    text = (LOOP / "site.toml").read_text().replace("127.0.0.1:7444", f"127.0.0.1:{port}")
    text = text.replace("firmware/loop/scene.toml", str(scene)).replace("run/gate.tty", str(line))
    with beacon_process(tmp_path / "build", "--pty", str(line), "--edges", str(fifo), "--uid", "00000000000000a1"):
        host = Host(tmp_path, "loop", text, SERVICES)
        try:
            with collecting(port, "loop", ["messages", "beacon", "onsets", "tracks", "status"]) as heard:
                heard.until(is_ready, "a beacon that obeys")
                armed = beacon(host.path, "arm", "gate", "--lease", "120")
                assert armed.returncode == 0, armed.stderr
                assert armed.stdout.startswith("gate: arm applied")
                sent = beacon(host.path, "send", "gate", TEXT, "--times", "4")
                assert sent.returncode == 0, sent.stderr
                heard.until(lambda h: TEXT in told(h), "the text")
            assert sorted(host.alive()) == sorted(["router", *SERVICES])
            listed = beacon(host.path, "list")
            assert "gate         ready" in listed.stdout
            refused = beacon(host.path, "set", "gate", "--bit-rate", "9000")
            assert (refused.returncode, "bit_rate must be in [50, 5000]" in refused.stdout) == (1, True)
        finally:
            host.close()
