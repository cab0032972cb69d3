"""Tracker and decoder say the same whether the truth is on the bus, absent or falsified."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import zenoh

from heliograph.keys import key
from heliograph.shell.links import client_config
from heliograph.shell.site import BusLinks
from heliograph.truth import Truth
from heliograph.wire import pack
from support.processes import free_port
from support.records import every_record, header_of
from support.replay import SERVICES, in_one_process, recording, site, through_processes
from support.scene import Scene

pytestmark = pytest.mark.processes

# As the scene of the fixture: the same seed and duration, but live from the simulator, which tells the truth.
SIMULATED = 'backend = "simulated"\nscenario = "five"\nduration_s = 3.0'


@contextlib.contextmanager
def lies(port: int) -> Iterator[None]:
    """Publish false truths of the camera as fast as a liar may: other places, other payloads, other beacons."""
    truth = next(record for record in every_record() if isinstance(record, Truth))
    end = threading.Event()
    config = client_config(BusLinks(connect=(f"tcp/127.0.0.1:{port}",), shared_memory=False))

    def run() -> None:
        with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
            n = 0
            while not end.wait(0.002):
                t0_us = 10_000 * (n % 300)
                lie = msgspec.structs.replace(
                    truth,
                    t0_us=t0_us,
                    t1_us=t0_us + 10_000,
                    frame_payload=[n % 64],
                    edge_us=truth.edge_us + t0_us,
                    edge_on=~truth.edge_on,
                )
                session.put(key("replay", "truth", "cam0"), pack(header_of(lie, n), lie))
                n += 1

    liar = threading.Thread(target=run)
    liar.start()
    try:
        yield
    finally:
        end.set()
        liar.join()


def test_the_truth_present_absent_or_falsified_changes_nothing(scene: Scene, tmp_path: Path) -> None:
    port = free_port()
    told = through_processes(tmp_path, site(port, SIMULATED, "", scene.beacons), port, SERVICES)
    port = free_port()
    lied = through_processes(tmp_path, site(port, SIMULATED, "", scene.beacons), port, SERVICES, lambda: lies(port))
    port = free_port()
    (tmp_path / "absent.toml").write_text(site(port, recording(scene.path), "", scene.beacons))
    absent = in_one_process(tmp_path / "absent.toml")
    assert len(absent["frames/"]) > 100
    assert told == absent
    assert lied == absent
