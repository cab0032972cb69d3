"""The supervisor with programs of the tests' own: what is started, what is started again, and what is left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from heliograph.errors import ConfigError
from heliograph.shell.site import load_site, site_of
from heliograph_services.cli import supervise
from heliograph_services.cli.plan import Plan, Program, ini_of, last_line, plan_of, program_name
from heliograph_services.cli.supervision import Supervised, SupervisionError

FOREVER = "import signal, sys; signal.sigwait({signal.SIGTERM}); sys.exit(0)"
SITE = """
site = "yard"
host = "mast"
[router]
listen = ["tcp/127.0.0.1:7447"]
[[service]]
kind = "event_source"
instance = "cam0"
[[service]]
kind = "decoder"
"""


def plan(folder: Path, *scripts: tuple[str, str, str]) -> Plan:
    """Return a plan of (name, kind, Python text)."""
    return Plan("t", folder / "t", tuple(Program(n, k, n, (sys.executable, "-c", text)) for n, k, text in scripts))


def until(condition: Callable[[], object], what: str, timeout_s: float = 20.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, f"waited for {what}"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def supervised(tmp_path: Path) -> Iterator[Callable[..., Supervised]]:
    made: list[Supervised] = []

    def make(*scripts: tuple[str, str, str]) -> Supervised:
        made.append(Supervised(plan(tmp_path, *scripts)))
        return made[-1]

    yield make
    for each in made:
        each.stop()


def test_a_site_file_becomes_one_program_a_process_the_router_first(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(SITE, encoding="utf-8")
    made = plan_of(load_site(path), tmp_path / "run")
    assert [p.name for p in made.programs] == ["router", "event_source.cam0", "decoder"]
    assert made.folder == tmp_path / "run" / "yard-mast"
    assert made.programs[1].command[1:] == (
        "-m", "heliograph_services.event_source", "--site", str(path), "--instance", "cam0",
    )  # fmt: skip
    assert made.programs[0].command[1:] == ("-m", "heliograph.shell.router", "--site", str(path))


def test_a_site_without_a_process_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nothing to start"):
        plan_of(site_of({"site": "s"}, "empty.toml"), tmp_path)


def test_a_run_folder_too_long_for_a_socket_is_refused_before_anything_starts(tmp_path: Path) -> None:
    site = site_of({"service": [{"kind": "decoder"}]}, "s.toml")
    with pytest.raises(ConfigError, match="choose --run-dir"):
        plan_of(site, tmp_path / ("x" * 90))


def test_percent_signs_are_doubled_and_comment_signs_refused(tmp_path: Path) -> None:
    made = plan(tmp_path / "50%", ("a", "decoder", "pass"))
    assert "50%%/t/a.log" in ini_of(made, tmp_path)
    with pytest.raises(ConfigError, match="line end"):
        ini_of(plan(tmp_path / "x ;y", ("a", "decoder", "pass")), tmp_path)


def test_a_name_with_a_colon_gets_a_file_name_of_its_own() -> None:
    assert program_name("decoder", "a:b") != program_name("decoder", "a.b")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", ""),
        ("a\nb\n\n", "b"),
        ('{"message": "no such file", "level": "error"}\n', "no such file"),
        ("[1]\n", "[1]"),
    ],
)
def test_the_last_line_of_a_log_is_told_in_its_own_words(tmp_path: Path, text: str, line: str) -> None:
    (tmp_path / "log").write_text(text, encoding="utf-8")
    assert last_line(tmp_path / "log") == line


def test_processes_start_are_seen_and_stop(supervised: Callable[..., Supervised]) -> None:
    s = supervised(("one", "decoder", FOREVER), ("two", "tracker", FOREVER))
    assert s.states() == []
    s.start(follow_parent=False)
    states = s.wait_running()
    assert [(x.name, x.state, x.restarts) for x in states] == [("one", "running", 0), ("two", "running", 0)]
    pids = [x.pid for x in states]
    assert all(alive(pid) for pid in pids)
    assert s.stop() is True
    assert not any(alive(pid) for pid in pids)
    assert s.stop() is False
    assert s.states() == []


def test_running_twice_is_refused_and_the_first_goes_on(supervised: Callable[..., Supervised], tmp_path: Path) -> None:
    s = supervised(("one", "decoder", FOREVER))
    s.start(follow_parent=False)
    pid = s.wait_running()[0].pid
    with pytest.raises(SupervisionError, match="running already"):
        Supervised(s.plan).start(follow_parent=False)
    assert s.states()[0].pid == pid


def test_a_killed_process_comes_back_and_its_restart_is_counted(supervised: Callable[..., Supervised]) -> None:
    s = supervised(("one", "tracker", FOREVER))
    s.start(follow_parent=False)
    first = s.wait_running()[0]
    os.kill(first.pid, signal.SIGKILL)
    until(lambda: s.states()[0].restarts == 1 and s.states()[0].state == "running", "the restart")
    assert s.states()[0].pid != first.pid


def test_a_process_that_does_not_start_is_named_with_the_last_line_it_wrote(
    supervised: Callable[..., Supervised],
) -> None:
    s = supervised(("good", "tracker", FOREVER), ("bad", "decoder", "import sys; sys.exit('bit_rate must be over 0')"))
    s.start(follow_parent=False)
    with pytest.raises(SupervisionError, match=r"bad did not start .*: bit_rate must be over 0"):
        s.wait_running()


def test_a_source_whose_recording_ends_at_once_is_not_played_again(supervised: Callable[..., Supervised]) -> None:
    s = supervised(("source", "event_source", "pass"), ("other", "decoder", FOREVER))
    s.start(follow_parent=False)
    source = s.wait_running()[0]
    assert (source.state, source.exit_status, source.restarts, source.ended_well) == ("exited", 0, 0, True)


def test_a_source_with_a_wrong_setting_is_not_started_again(supervised: Callable[..., Supervised]) -> None:
    s = supervised(("source", "event_source", "import sys; print('no file x', file=sys.stderr); sys.exit(2)"))
    s.start(follow_parent=False)
    with pytest.raises(SupervisionError, match=r"source did not start .*no file x"):
        s.wait_running()
    assert s.states()[0].restarts == 0


def test_what_a_killed_supervisor_left_is_cleaned_away(supervised: Callable[..., Supervised]) -> None:
    s = supervised(("one", "decoder", FOREVER))
    s.start(follow_parent=False)
    child = s.wait_running()[0].pid
    os.kill(s.supervisor_pid(), signal.SIGKILL)
    until(lambda: not s.supervisor_pid(), "the end of the supervisor")
    assert (s.plan.folder / "sock").exists()
    assert s.states() == []
    os.kill(child, signal.SIGKILL)  # this one, unlike ours, does not end with its parent
    s.start(follow_parent=False)
    assert s.wait_running()[0].state == "running"


def test_nothing_outlives_a_killed_parent_that_asked_for_it(tmp_path: Path) -> None:
    text = (
        "import sys, time; from pathlib import Path; from heliograph_services.cli.plan import Plan, Program;"
        "from heliograph_services.cli.supervision import Supervised;"
        f"s = Supervised(Plan('t', Path({str(tmp_path / 't')!r}), (Program('a', 'decoder', 'a',"
        f" (sys.executable, '-c', {FOREVER!r})),)));"
        "s.start(follow_parent=True); pid = s.wait_running()[0].pid; print(s.supervisor_pid(), pid, flush=True);"
        "time.sleep(100)"
    )
    parent = subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    with parent.stdout:
        pids = [int(word) for word in parent.stdout.readline().split()]
    assert len(pids) == 2
    parent.kill()
    parent.wait()
    until(lambda: not any(alive(pid) for pid in pids), "the end of both")


def test_status_says_which_process_is_down_and_in_its_exit_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "site.toml"
    path.write_text(SITE, encoding="utf-8")
    assert supervise.run(["status", str(path), "--run-dir", str(tmp_path / "run")]) == 1
    assert "not running" in capsys.readouterr().out
    assert supervise.run(["down", str(path), "--run-dir", str(tmp_path / "run")]) == 0
    assert "was not running" in capsys.readouterr().err


def test_the_table_shows_every_process_in_aligned_columns(supervised: Callable[..., Supervised]) -> None:
    s = supervised(("a-long-name", "decoder", FOREVER), ("b", "event_source", "pass"))
    s.start(follow_parent=False)
    lines = supervise.table(s.wait_running()).splitlines()
    assert lines[0].split() == ["process", "pid", "state", "uptime", "restarts"]
    assert "exited (0)" in lines[2]
    assert lines[1].index("running") == lines[2].index("exited")


def test_up_down_and_status_drive_a_real_router(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], free_endpoint: str
) -> None:
    path = tmp_path / "site.toml"
    path.write_text(f'site = "s"\nhost = "h"\n[router]\nlisten = ["{free_endpoint}"]\n', encoding="utf-8")
    where = [str(path), "--run-dir", str(tmp_path / "run")]
    try:
        assert supervise.run(["up", *where]) == 0
        assert "1 processes run" in capsys.readouterr().err
        assert supervise.run(["status", *where, "--json"]) == 0
        row = json.loads(capsys.readouterr().out)
        assert (row["type"], row["name"], row["state"], row["restarts"]) == ("process", "router", "running", 0)
        with pytest.raises(SupervisionError, match="running already"):
            supervise.run(["up", *where])
    finally:
        assert supervise.run(["down", *where]) == 0
    assert not alive(row["pid"])


def test_an_occupied_port_is_told_in_one_line(tmp_path: Path, free_endpoint: str) -> None:
    path = tmp_path / "site.toml"
    path.write_text(f'site = "s"\nhost = "h"\n[router]\nlisten = ["{free_endpoint}"]\n', encoding="utf-8")
    other = tmp_path / "other.toml"
    other.write_text(f'site = "s"\nhost = "i"\n[router]\nlisten = ["{free_endpoint}"]\n', encoding="utf-8")
    run_dir = ["--run-dir", str(tmp_path / "run")]
    try:
        supervise.run(["up", str(path), *run_dir])
        with pytest.raises(SupervisionError, match=r"router did not start .*cannot open the bus") as caught:
            supervise.run(["up", str(other), *run_dir])
        assert "\n" not in str(caught.value)
    finally:
        supervise.run(["down", str(path), *run_dir])
    assert supervise.run(["status", str(other), *run_dir]) == 1
