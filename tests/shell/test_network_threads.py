"""Which of Zenoh's threads do what; seen on real processes."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from heliograph.shell.bus import open_session
from heliograph.shell.links import client_config
from heliograph.shell.process import NETWORK_THREADS_VARIABLE
from heliograph.shell.site import BusLinks
from support.processes import PATIENCE_S, Host, free_port

pytestmark = pytest.mark.processes
_SITE = """
site = "s"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
shared_memory = false
[router]
listen = ["tcp/127.0.0.1:{port}"]
"""
_THREADS = """
import pathlib, sys
from heliograph.shell.bus import open_session
from heliograph.shell.links import client_config
from heliograph.shell.site import BusLinks
with open_session(client_config(BusLinks(connect=(sys.argv[1],)), wait=False)) as session:
    list(session.liveliness().get("nobody", timeout=5.0))  # so that something has been sent and read
    names = {path.read_text().strip() for path in pathlib.Path("/proc/self/task").glob("*/comm")}
    print(*sorted(names & {"app-0", "rx-0", "tx-0"}))
"""
# Sixteen of what Zenoh sends at a time (64 KiB), of which two wait for their turn.
_LARGE = 1 << 20


@pytest.fixture
def router(tmp_path: Path) -> Iterator[str]:
    port = free_port()
    host = Host(tmp_path, "s", _SITE.format(port=port), [])
    try:
        assert host.wait_for_log("router", "routing")
        yield f"tcp/127.0.0.1:{port}"
    finally:
        host.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a matter of Linux")
def test_what_arrives_is_waited_for_and_read_by_one_thread_and_sent_by_another(router: str) -> None:
    ours = {k: v for k, v in os.environ.items() if k != NETWORK_THREADS_VARIABLE}
    seen = []
    for environment in (ours, ours | {NETWORK_THREADS_VARIABLE: "(rx: (worker_threads: 1))"}):
        command = [sys.executable, "-c", _THREADS, router]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
        seen.append(done.stdout.split())
    assert seen[0] == ["app-0", "tx-0"]
    assert seen[1] == ["app-0", "rx-0", "tx-0"]  # an operator's own word counts


def test_a_router_forwards_a_message_many_times_larger_than_what_waits_to_be_sent(router: str) -> None:
    config = client_config(BusLinks(connect=(router,), shared_memory=False))
    here, there = open_session(config), open_session(config)
    assert here is not None
    assert there is not None
    sizes: list[int] = []
    came = threading.Event()

    def arrived(sample: zenoh.Sample) -> None:
        sizes.append(len(sample.payload))
        came.set()

    # On a crowded machine one may be dropped, after 50 ms without progress; a router that sends in the thread that
    # reads drops each.
    with here, there, there.declare_subscriber("large", arrived):
        deadline = time.monotonic() + PATIENCE_S
        while not came.wait(0.5) and time.monotonic() < deadline:
            here.put("large", bytes(_LARGE), congestion_control=zenoh.CongestionControl.DROP)
    assert set(sizes) == {_LARGE}
