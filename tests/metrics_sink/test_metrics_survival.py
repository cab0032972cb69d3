"""The sink as a process whose disk fails, or that is killed: told once, survived, and nothing lost that was committed.

A full and a read-only file system are real ones: the sink starts in a mount namespace of its own, with a small tmpfs
where its file is (permissions alone would not bind root). Its files are reached through /proc/{pid}/root; remounts,
and copies of a database, enter the namespace.
"""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from heliograph.messages import Health, Message
from heliograph.shell.process import PARENT_VARIABLE
from heliograph_services.metrics_sink.summary import summarise
from support.processes import Collector, Host, collecting, free_port
from support.truth_scenes import Said, Sent, truth

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
NAMESPACE = ("unshare", "--map-root-user", "--mount")


def reports(heard: Collector) -> list[Health]:
    """Return what the sink has said of itself so far."""
    return [m for m in heard.messages["health"] if isinstance(m, Health) and m.service == "metrics_sink"]


def counters(heard: Collector) -> dict[str, int]:
    """Return the counters of its newest report."""
    mine = reports(heard)
    return mine[-1].counters if mine else {}


def of_a_scene() -> list[Message]:
    """Return 272 frames in 3 s and their truth, 226 of them scored, in order."""
    messages: list[Message] = [*truth([Sent()], UNTIL_US), *Said().all_of(Sent(), UNTIL_US).messages()]
    return sorted(messages, key=lambda each: each.time_us)


def paced(until_s: float) -> None:
    """Let time pass, as a camera does."""
    threading.Event().wait(max(0.0, until_s - time.monotonic()))


def received_before_the_last_commit(heard: Collector) -> int:
    """Return how many messages of frames the sink had taken at a report after which it has committed again."""
    rows = [(each.counters["store: rows"], each.counters.get("received: frames", 0)) for each in reports(heard)]
    return max((taken for written, taken in rows if written < rows[-1][0]), default=0)


def received_by_the_file(path: Path) -> int:
    """Return how many messages of frames the sink had taken by the last report of its own that is in the file."""
    with contextlib.closing(sqlite3.connect(path)) as connection:
        row = connection.execute(
            "SELECT value FROM health JOIN name ON name.id = health.name JOIN process ON process.id = health.process"
            " WHERE text = 'received: frames' AND service = 'metrics_sink'"
        ).fetchone()
    return int(row[0]) if row else 0


@pytest.mark.processes
def test_a_killed_sink_has_lost_only_what_came_after_its_last_commit(tmp_path: Path) -> None:
    """Frames at 500 a second; killed in the midst of them. A commit comes once a second (`test_metrics_store`).

    By cause, not by time: what it had counted before a commit, by its reports heard here and by those in the file.
    """
    port = free_port()
    host = Host(tmp_path, "sink", SITE.format(port=port), ["metrics_sink"])
    path = tmp_path / "kept" / "metrics.sqlite"
    sent: list[int] = [0]
    try:
        with collecting(port, "sink", ["health"]) as heard:
            heard.until(lambda h: len(reports(h)) > 0, "the sink")
            began_s = time.monotonic()
            for message in Said().all_of(Sent(frame_us=2_000), 30_000_000).messages(20_000):
                heard.bus.publish(message)
                sent.append(sent[-1] + len(message.t_us))
                paced(began_s + len(sent) * 0.02)
                if len(sent) % 7 == 0 and received_before_the_last_commit(heard) > 100:
                    break
            host.kill("metrics_sink")
            safe = sent[received_before_the_last_commit(heard)]
    finally:
        host.close()
    kept = summarise(path)
    assert 0 < safe <= kept.frames <= sent[-1]
    assert sent[received_by_the_file(path)] <= kept.frames


@pytest.mark.processes
def test_a_quota_that_is_reached_is_told_survived_and_caught_up_with(tmp_path: Path) -> None:
    """The kernel refuses what would make a file larger (RLIMIT_FSIZE): rows wait, until there is room."""
    port = free_port()
    host = Host(tmp_path, "sink", SITE.format(port=port), ["metrics_sink"])
    try:
        with collecting(port, "sink", ["health"]) as heard:
            heard.until(lambda h: counters(h).get("store: rows", 0) > 0, "the first rows")
            pid = host.processes["metrics_sink"].pid
            _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (4_096, hard))
            for message in of_a_scene():
                heard.bus.publish(message)
            heard.until(lambda h: counters(h).get("store: disk failures", 0) > 1, "failures")
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
            # It still reads the bus, and says what waits; the next reports say that nothing does.
            before = counters(heard)["store: rows"]
            heard.until(lambda h: counters(h)["store: rows"] > before, "rows on the disk again")
        assert host.close() == {"metrics_sink": 0, "router": 0}
        assert host.log("metrics_sink").count("rows wait in memory") == 1
        assert "written again" in host.log("metrics_sink")
    finally:
        host.close()
    kept = summarise(tmp_path / "kept" / "metrics.sqlite")
    assert (kept.frames, kept.seconds) == (272, 3)
    assert kept.accuracy is not None
    assert kept.accuracy.mar_visible.n == 226


def has_namespaces() -> bool:
    """Return whether this machine lets its users have mounts of their own."""
    if shutil.which("unshare") is None or shutil.which("nsenter") is None:
        return False
    tried = subprocess.run([*NAMESPACE, "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True, check=False)
    return tried.returncode == 0


class SmallDisk:
    """A sink whose folder `kept` is a tmpfs of 1 MiB in a mount namespace of its own, read-only at first."""

    def __init__(self, host: Host) -> None:
        kept = host.folder / "kept"
        kept.mkdir()
        mount = f"mount -t tmpfs -o size=1m,ro tmpfs '{kept}' && exec \"$@\""
        service = ["-m", "heliograph_services.metrics_sink", "--site", str(host.path), "--instance", "metrics_sink"]
        with (host.folder / "sink-metrics_sink.log").open("ab") as log:
            process = subprocess.Popen(
                [*NAMESPACE, "sh", "-c", mount, "sh", sys.executable, *service],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=os.environ | {PARENT_VARIABLE: "1"},
                cwd=host.folder,
            )  # fmt: skip
        host.processes["metrics_sink"] = process
        self._pid, self._kept = process.pid, kept
        self.inside = Path(f"/proc/{process.pid}/root{kept}")

    def remount(self, how: str) -> None:
        """Make it writable (rw)."""
        self._enter("mount", "-o", f"remount,{how}", str(self._kept))

    def fill(self) -> None:
        """Take all the room that is left."""
        with (self.inside / "filler").open("wb", buffering=0) as filler:
            try:
                while True:
                    filler.write(bytes(4096))
            except OSError as error:
                assert error.errno == errno.ENOSPC  # noqa: PT017 - any other is not what is tested

    def empty(self) -> None:
        """Give it back."""
        (self.inside / "filler").unlink()

    def copy(self, name: str, to: Path) -> None:
        """Copy a database out of it. SQLite itself resolves `/proc/PID/root` to `/`, the folder outside: it goes in."""
        script = "import sqlite3, sys; sqlite3.connect(sys.argv[1]).backup(sqlite3.connect(sys.argv[2]))"
        self._enter(sys.executable, "-c", script, str(self._kept / name), str(to))

    def _enter(self, *command: str) -> None:
        enter = ["nsenter", "-t", str(self._pid), "--user", "--preserve-credentials", "--mount"]
        subprocess.run([*enter, *command], check=True, capture_output=True)


@pytest.mark.processes
@pytest.mark.skipif(not has_namespaces(), reason="no mount namespaces for this user")
def test_a_disk_that_is_read_only_and_then_full_is_told_once_each_survived_and_caught_up_with(tmp_path: Path) -> None:
    port = free_port()
    host = Host(tmp_path, "sink", SITE.format(port=port), [])
    disk = SmallDisk(host)
    copy = tmp_path / "copy.sqlite"
    try:
        with collecting(port, "sink", ["health"]) as heard:
            heard.until(lambda h: counters(h).get("store: disk failures", 0) > 1, "a disk that is read-only")
            disk.remount("rw")
            heard.until(lambda h: counters(h).get("store: rows", 0) > 0, "the first rows")
            disk.fill()
            for message in of_a_scene():
                heard.bus.publish(message)
            failed = counters(heard)["store: disk failures"]
            heard.until(lambda h: counters(h)["store: disk failures"] > failed + 1, "a disk that is full")
            disk.empty()
            before = counters(heard)["store: rows"]
            heard.until(lambda h: counters(h)["store: rows"] > before, "rows on the disk again")
            # Its seconds are finished by the next health reports; then the file holds them.
            heard.until(lambda h: counters(h).get("seconds", 0) == 3, "three seconds")
            done = counters(heard)["store: rows"]
            heard.until(lambda h: counters(h)["store: rows"] > done + 10, "and their rows")
            # When it ends, so does its namespace, and the file.
            disk.copy("metrics.sqlite", copy)
            assert counters(heard)["store: rows lost"] == 0
        assert host.close() == {"metrics_sink": 0, "router": 0}
    finally:
        host.close()
    told = [line for line in host.log("metrics_sink").splitlines() if "metrics.sqlite: " in line]
    reasons = ("unable to open database file", "written again", "database or disk is full", "written again")
    assert len(told) == len(reasons), told
    assert all(reason in line for reason, line in zip(reasons, told, strict=True)), told
    kept = summarise(copy)
    assert (kept.frames, kept.seconds) == (272, 3)
    assert kept.accuracy is not None
    assert kept.accuracy.mar_visible.n == 226
