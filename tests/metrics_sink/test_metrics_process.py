"""The sink as a process: what goes over the bus is in the file, and on the bus again."""

from __future__ import annotations

import http.client
import sqlite3
from pathlib import Path

import pytest

from heliograph.messages import Metrics
from heliograph_services.metrics_sink.store import SqliteStore
from heliograph_services.metrics_sink.summary import summarise
from support.processes import Host, collecting, free_port
from support.truth_scenes import Said, Sent, state, truth

SITE = """
site = "sink"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "metrics_sink"
file = "kept/metrics.sqlite"
"""
UNTIL_US = 3_000_000


@pytest.mark.processes
def test_a_stream_on_the_bus_is_scored_published_and_kept(tmp_path: Path) -> None:
    port = free_port()
    host = Host(tmp_path, "sink", SITE.format(port=port), ["metrics_sink"])
    beacon = Sent()
    messages = [*truth([beacon], UNTIL_US), *Said().all_of(beacon, UNTIL_US).messages(), state(60_000)]
    messages.sort(key=lambda message: message.time_us)
    try:
        with collecting(port, "sink", ["metrics", "health"]) as heard:
            # The first health report comes after the subscriptions.
            heard.until(lambda h: any(m.service == "metrics_sink" for m in h.messages["health"]), "the sink")  # type: ignore[attr-defined]
            for message in messages:
                heard.bus.publish(message)
            # Nothing follows: it is the health reports by which the sink notices, and finishes what waits.
            heard.until(lambda h: len(h.messages["metrics"]) == 3, "three seconds")
            found = [message for message in heard.messages["metrics"] if isinstance(message, Metrics)]
        assert [message.t1_us for message in found] == [1_000_000, 2_000_000, 3_000_000]
        assert sum(message.counters["cam0/right/seed11"] for message in found) == 272
        assert host.close() == {"metrics_sink": 0, "router": 0}
    finally:
        host.close()
    kept = summarise(tmp_path / "kept" / "metrics.sqlite")
    assert kept.accuracy is not None
    assert (kept.accuracy.mar_visible.right, kept.accuracy.mar_visible.n) == (226, 226)
    assert kept.identified == {"crane": 1}


@pytest.mark.processes
def test_prometheus_is_answered_on_loopback(tmp_path: Path) -> None:
    port, page_port = free_port(), free_port()
    site = SITE.format(port=port) + f"prometheus_port = {page_port}\n"
    host = Host(tmp_path, "sink", site, ["metrics_sink"])
    try:
        with collecting(port, "sink", ["health"]) as heard:
            heard.until(lambda h: len(h.messages["health"]) > 2, "the sink's reports")
        status, kind, page = got(page_port, "/metrics")
        assert (status, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
        assert 'heliograph_process_up{service="metrics_sink",instance="metrics_sink"} 1' in page.splitlines()
        assert got(page_port, "/")[0] == 404
        # A second sink that wants the same port says so in one line, and ends.
        (tmp_path / "second").mkdir()
        second = Host(tmp_path / "second", "sink", site, ["metrics_sink"], router=False)
        try:
            assert second.wait("metrics_sink") == 2
            assert (
                second.log("metrics_sink")
                .splitlines()[-1]
                .startswith(f"ConfigError: prometheus_port must be free on 127.0.0.1, {page_port} is not: ")
            )
        finally:
            second.close()
    finally:
        host.close()


def got(port: int, path: str) -> tuple[int, str, str]:
    """Return status, content type and body of a page of the loopback."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, answer.headers["Content-Type"], answer.read().decode()
    finally:
        connection.close()


@pytest.mark.processes
def test_a_file_that_is_none_of_ours_ends_the_start_with_one_line(tmp_path: Path) -> None:
    port = free_port()
    path = tmp_path / "kept" / "metrics.sqlite"
    path.parent.mkdir()
    SqliteStore(path).close()
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("UPDATE meta SET version = 1")
    connection.close()  # what is in the log beside it goes into the file
    old = path.read_bytes()
    for content, word in ((b"\x00\x17 broken " * 999, "not a metrics file"), (old, "metrics of version 1")):
        for stale in path.parent.iterdir():
            stale.unlink()
        path.write_bytes(content)
        host = Host(tmp_path, "sink", SITE.format(port=port), ["metrics_sink"], router=False)
        try:
            assert host.wait("metrics_sink") == 2
            last = host.log("metrics_sink").splitlines()[-1]
            assert last.startswith("FileError: ")
            assert word in last
        finally:
            host.close()
        assert path.read_bytes() == content
