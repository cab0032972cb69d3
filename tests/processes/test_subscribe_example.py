"""The example client against a real router: started late, it sees who is there, and then who comes and goes."""

from __future__ import annotations

import ast
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from heliograph.messages import Change, Identification
from heliograph.shell.bus import Bus, connected
from heliograph.shell.links import client_config, router_config
from heliograph.shell.process import Stop
from heliograph.shell.site import BusLinks, RouterLinks
from support.records import every_record

pytestmark = pytest.mark.processes
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "subscribe.py"


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{s.getsockname()[1]}"


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    links = BusLinks(connect=(endpoint,))
    with (
        connected(router_config(RouterLinks(listen=(endpoint,)), links), "yard", "router/h", Stop()),
        connected(client_config(links), "yard", "decoder/a", Stop()) as made,
    ):
        assert made is not None
        yield made


def state(track: str, beacon: str, change: Change = "refreshed", *, lost: bool = False) -> Identification:
    record = next(r for r in every_record() if isinstance(r, Identification))
    return msgspec.structs.replace(record, track=track, beacon=beacon, change=change, lost=lost)


def test_started_late_it_prints_the_last_state_of_each_track_and_then_follows(bus: Bus, endpoint: str) -> None:
    for _ in range(5):
        bus.publish(state("5eed-0", "crane"))
    bus.publish(state("5eed-1", "lift"))
    client = subprocess.Popen([sys.executable, str(EXAMPLE), endpoint], stdout=subprocess.PIPE, text=True)
    assert client.stdout is not None
    with client.stdout as said:
        try:
            there = {said.readline(), said.readline()}
            assert there == {"crane 12.5 20.25 refreshed\n", "lift 12.5 20.25 refreshed\n"}
            bus.publish(state("5eed-1", "lift", "lost", lost=True))
            assert said.readline() == "lift 12.5 20.25 lost\n"
            bus.publish(state("5eed-2", "gate", "accepted"))  # on a key that nobody had declared before
            assert said.readline() == "gate 12.5 20.25 accepted\n"
        finally:
            client.send_signal(signal.SIGINT)
            client.wait(timeout=20)


def test_it_has_at_most_15_lines_and_needs_only_zenoh_and_msgpack() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 15
    names = {a.name.partition(".")[0] for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Import) for a in n.names}
    assert names == {"json", "sys", "msgpack", "zenoh"}
    assert not [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.ImportFrom)]
