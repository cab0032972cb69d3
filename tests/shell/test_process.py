"""Manners of a process: signals, parents, operators' mistakes; seen on real processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from heliograph.shell.process import EXIT_FORCED, PARENT_VARIABLE, Stop
from support.processes import PATIENCE_S, collecting, free_port

pytestmark = pytest.mark.processes


def script(text: str) -> list[str]:
    return [sys.executable, "-c", textwrap.dedent(text)]


def tracker(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "heliograph_services.tracker", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_second_signal_ends_a_process_that_does_not_heed_the_first() -> None:
    stubborn = subprocess.Popen(
        script("""
            import signal
            from heliograph.shell.run import guarded
            def work(stop):
                print("ready", flush=True)
                while not stop:
                    stop.wait(60)
                print("heard", flush=True)
                while True:
                    signal.pause()
            guarded(work)
        """),
        stdout=subprocess.PIPE,
        text=True,
    )
    assert stubborn.stdout is not None
    assert stubborn.stdout.readline() == "ready\n"
    stubborn.send_signal(signal.SIGTERM)
    assert stubborn.stdout.readline() == "heard\n"
    stubborn.send_signal(signal.SIGINT)
    assert stubborn.wait(PATIENCE_S) == EXIT_FORCED
    stubborn.stdout.close()


def test_a_signal_within_any_line_of_a_wait_is_heeded() -> None:
    # The handler runs at each line, in turn, of all Python code that a wait goes through, what it calls included.
    done = subprocess.run(
        script("""
            import signal, sys
            from heliograph.shell.process import Stop
            waits = 0
            while True:
                stop, lines = Stop(), 0
                def tracer(frame, event, arg):
                    global lines
                    if event == "line":
                        lines += 1
                        if lines == waits + 1:
                            stop._on_signal(signal.SIGTERM, frame)
                    return tracer
                sys.settrace(tracer)
                heard = stop.wait(0.03)
                sys.settrace(None)
                assert heard == (lines > waits), (heard, lines, waits)
                if not heard:
                    break
                waits += 1
            print(waits)
        """),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    assert int(done.stdout) >= 4


def test_a_child_ends_when_its_parent_is_killed() -> None:
    parent = subprocess.Popen(
        script(f"""
            import os, subprocess, sys
            child = "import signal; from heliograph.shell.process import end_with_parent; end_with_parent();" \\
                    "print(__import__('os').getpid(), flush=True); signal.pause()"
            os.environ["{PARENT_VARIABLE}"] = "1"
            subprocess.Popen([sys.executable, "-c", child]).wait()
        """),
        stdout=subprocess.PIPE,
        text=True,
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    handle = os.pidfd_open(child)
    parent.kill()
    parent.wait()
    # The pipe's other end is the child's: it closes when the child has ended.
    assert parent.stdout.read() == ""
    parent.stdout.close()
    os.close(handle)


def test_a_service_waits_for_a_router_and_still_stops_when_told() -> None:
    waiting = subprocess.Popen(
        script(f"""
            from heliograph.shell import bus
            from heliograph.shell.run import guarded
            from heliograph.shell.links import client_config
            from heliograph.shell.site import BusLinks
            def work(stop):
                print("ready", flush=True)
                config = client_config(BusLinks(connect=("tcp/127.0.0.1:{free_port()}",)))
                with bus.connected(config, "s", "t/t", stop) as connection:
                    return 0 if connection is None else 1
            raise SystemExit(guarded(work))
        """),
        stdout=subprocess.PIPE,
        text=True,
    )
    assert waiting.stdout is not None
    assert waiting.stdout.readline() == "ready\n"
    waiting.terminate()
    assert waiting.wait(PATIENCE_S) == 0
    waiting.stdout.close()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "ConfigError: give --site FILE"),
        (["--site", "absent.toml"], "absent.toml: No such file"),
        (["--connect", "tcp/10.1.1.1:7447"], "leaves this host"),
        (["--connect", "nowhere"], "endpoint must look like tcp/127.0.0.1:7447, not 'nowhere'"),
        (["--connect", "tcp/127.0.0.1:1", "--period-us", "soon"], "--period-us: Expected `int`"),
    ],
)
def test_an_operators_mistake_is_one_line_and_status_2(arguments: list[str], told: str) -> None:
    process = tracker(*arguments)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert told in errors
    assert len(errors.strip().splitlines()) == 1


def test_a_service_that_starts_before_its_router_joins_it(tmp_path: Path) -> None:
    port = free_port()
    path = tmp_path / "site.toml"
    path.write_text(
        f'site = "s"\n[bus]\nconnect = ["tcp/127.0.0.1:{port}"]\n[router]\nlisten = ["tcp/127.0.0.1:{port}"]\n'
        '[[service]]\nkind = "tracker"\n'
    )
    service = tracker("--site", str(path))
    router = subprocess.Popen([sys.executable, "-m", "heliograph.shell.router", "--site", str(path)], stderr=-3)
    try:
        with collecting(port, "s", ["health"]) as heard:
            heard.until(lambda h: bool(h.messages["health"]), "the tracker's health")
    finally:
        service.terminate()
        router.terminate()
        service.communicate()
        assert (service.returncode, router.wait()) == (0, 0)


def test_what_is_there_when_a_process_is_warm_is_no_longer_searched_for_garbage() -> None:
    looked_at = subprocess.run(
        script("""
            import gc
            from heliograph.shell.process import keep_out_of_collections
            kept = [[] for _ in range(1000)]
            keep_out_of_collections()
            print(gc.get_freeze_count() > 1000, len(gc.get_objects()) < 100)
        """),
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE_S,
    )
    assert looked_at.stdout.split() == ["True", "True"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a matter of Linux")
def test_a_process_that_wakes_promptly_and_its_threads_have_no_timer_slack() -> None:
    code = (
        "import pathlib, threading\n"
        "from heliograph.shell.process import wake_promptly\n"
        "wake_promptly()\n"
        "read = lambda: print(pathlib.Path(f'/proc/{threading.get_native_id()}/timerslack_ns').read_text().strip())\n"
        "read()\n"
        "threading.Thread(target=read).start()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["1", "1"]


def test_a_short_wait_for_a_stop_sees_one_that_came() -> None:
    stop = Stop()
    assert not stop.wait(0.001)
    stop.set()
    assert stop.wait(0.001)
