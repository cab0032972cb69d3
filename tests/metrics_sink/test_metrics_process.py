"""The sink as a process: what goes over the bus is in the file, and on the bus again."""

from __future__ import annotations

import http.client
import resource
import sqlite3
import threading
import time
from pathlib import Path

import pytest

from heliograph.messages import Health, Metrics
from heliograph_services.metrics_sink.store import SqliteStore
from heliograph_services.metrics_sink.summary import summarise
from support.processes import Collector, Host, collecting, free_port
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


def reports(heard: Collector) -> list[Health]:
    """Return what the sink has said of itself so far."""
    return [m for m in heard.messages["health"] if isinstance(m, Health) and m.service == "metrics_sink"]


def received_before_the_last_commit(heard: Collector) -> int:
    """Return how many messages of frames the sink had taken at a report after which it has committed again."""
    rows = [(each.counters["store: rows"], each.counters.get("received: frames", 0)) for each in reports(heard)]
    return max((taken for written, taken in rows if written < rows[-1][0]), default=0)


@pytest.mark.processes
def test_a_killed_sink_has_lost_at_most_its_last_second(tmp_path: Path) -> None:
    """Frames at 500 a second; killed in the midst of it, all that it had counted before its last commit are there.

    A commit comes once a second; the last of these seconds have not settled when it is killed.
    """
    port = free_port()
    host = Host(tmp_path, "sink", SITE.format(port=port), ["metrics_sink"])
    sent: list[int] = [0]
    try:
        with collecting(port, "sink", ["health"]) as heard:
            heard.until(lambda h: len(reports(h)) > 0, "the sink")
            began_s = time.monotonic()
            for message in Said().all_of(Sent(frame_us=2_000), 4_000_000).messages(20_000):
                heard.bus.publish(message)
                sent.append(sent[-1] + len(message.t_us))
                paced(began_s + len(sent) * 0.02)
            heard.until(lambda h: received_before_the_last_commit(h) > 0, "a commit after a report")
            host.kill("metrics_sink")
            safe = sent[received_before_the_last_commit(heard)]
    finally:
        host.close()
    kept = summarise(tmp_path / "kept" / "metrics.sqlite")
    assert 0 < safe <= kept.frames <= sent[-1]


def paced(until_s: float) -> None:
    """Let time pass, as a camera does."""
    threading.Event().wait(max(0.0, until_s - time.monotonic()))


@pytest.mark.processes
def test_a_disk_that_fills_up_is_told_survived_and_caught_up_with(tmp_path: Path) -> None:
    """The kernel refuses what would make a file larger (a quota): rows wait, and are written when there is room."""
    port = free_port()
    host = Host(tmp_path, "sink", SITE.format(port=port), ["metrics_sink"])
    path = tmp_path / "kept" / "metrics.sqlite"

    def counters(h: Collector) -> dict[str, int]:
        mine = reports(h)
        return mine[-1].counters if mine else {}

    try:
        with collecting(port, "sink", ["health"]) as heard:
            heard.until(lambda h: counters(h).get("store: rows", 0) > 0, "the first rows")
            pid = host.processes["metrics_sink"].pid
            _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (4_096, hard))
            messages = [*truth([Sent()], UNTIL_US), *Said().all_of(Sent(), UNTIL_US).messages()]
            for message in sorted(messages, key=lambda each: each.time_us):
                heard.bus.publish(message)
            heard.until(lambda h: counters(h).get("store: disk failures", 0) > 1, "failures")
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
            failures = counters(heard)["store: disk failures"]
            assert failures > 0
            # It still reads the bus, and says what waits; the next reports say that nothing does.
            before = counters(heard)["store: rows"]
            heard.until(lambda h: counters(h)["store: rows"] > before, "rows on the disk again")
        assert host.close() == {"metrics_sink": 0, "router": 0}
        assert host.log("metrics_sink").count("rows wait in memory") == 1
        assert "written again" in host.log("metrics_sink")
    finally:
        host.close()
    kept = summarise(path)
    assert (kept.frames, kept.seconds) == (272, 3)
    assert kept.accuracy is not None
    assert kept.accuracy.mar_visible.n == 226


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
