"""The doctor finds what is wrong, says what to do, and fails only where heliograph would not work."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
from importlib import metadata
from pathlib import Path

import pytest

from heliograph_services.cli import checks, doctor
from heliograph_services.cli.bus_check import round_trip_ms
from heliograph_services.cli.checks import Check

SITE = """
site = "test"
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "tracker"
{more}
"""


def verdicts(found: object) -> list[str]:
    return [check.verdict for check in found]  # type: ignore[attr-defined]


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the question that opens sessions."""
    monkeypatch.setattr(checks, "bus", lambda: iter([Check("bus", "ok", "left out")]))


def test_a_message_goes_through_a_router_on_loopback_and_back() -> None:
    took_ms = round_trip_ms(checks.free_port(), 5.0)
    assert took_ms is not None
    assert took_ms > 0


def test_a_port_that_cannot_be_had_fails_the_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        monkeypatch.setattr(checks, "free_port", lambda: holder.getsockname()[1])
        (check,) = checks.bus()
    assert check.verdict == "fail"
    assert "cannot open the bus" in check.detail
    assert check.advice


def test_a_sound_site_is_ok_and_its_busy_port_is_told(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = holder.getsockname()[1]
        path.write_text(SITE.format(port=port, more=""), encoding="utf-8")
        busy = list(checks.site(str(path)))
    assert [(check.check, check.verdict) for check in busy] == [("site", "ok"), (f"port {port}", "warn")]
    assert verdicts(checks.site(str(path))) == ["ok", "ok"]


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("period_us = -1", "period_us"),
        ("speed = 3", "unknown setting 'speed'"),
        ('[[beacon]]\nname = "a"\nprotocol = "morse"\nbit_rate = 9', "morse"),
        ("[[service]", "not TOML"),
    ],
)
def test_a_wrong_site_fails_with_the_place(tmp_path: Path, more: str, told: str) -> None:
    path = tmp_path / "site.toml"
    path.write_text(SITE.format(port=checks.free_port(), more=more), encoding="utf-8")
    wrong = [check for check in checks.site(str(path)) if check.verdict == "fail"]
    assert len(wrong) == 1
    assert told in wrong[0].detail


def test_every_question_is_asked_and_the_status_follows_the_worst(
    quick: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "site.toml"
    path.write_text(SITE.format(port=checks.free_port(), more=""), encoding="utf-8")
    assert doctor.run([str(path), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    asked = {line["check"].split()[0] for line in lines}
    assert asked == {"python", "packages", "extra", "cores", "disk", "kernel", "clock", "camera", "bus", "site", "port"}
    assert all(line["type"] == "check" and line["verdict"] in {"ok", "warn"} for line in lines)
    assert all(line["advice"] for line in lines if line["verdict"] == "warn")
    assert doctor.run([str(tmp_path / "none.toml")]) == 1
    out = capsys.readouterr().out
    assert "none.toml" in out
    assert out.splitlines()[-1].endswith("1 to mend")


def test_lines_for_people_fit_a_terminal() -> None:
    check = Check("extra tracker", "warn", "absent: " + ", ".join(["package"] * 30), "pip install " + "word " * 30)
    assert all(len(line) <= 80 for line in doctor.line(check).splitlines())


def test_requirements_are_read_by_extra() -> None:
    found = checks.requirements(
        [
            "numpy<3,>=1.26",
            "lapx>=0.5 ; extra == 'tracker'",
            "heliograph[tracker] ; extra == 'all'",
            'pyserial>=3 ; python_version > "3" and extra == "beacon-controller"',
        ]
    )
    assert found == {"": ["numpy"], "tracker": ["lapx"], "beacon-controller": ["pyserial"]}


def test_an_absent_package_of_an_extra_is_no_failure_but_one_of_the_base_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "requires", lambda _: ["nowhere-1", "nowhere-2; extra == 'tracker'"])

    def absent(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(checks, "version", absent)
    assert [(check.check, check.verdict) for check in checks.packages()] == [
        ("packages", "fail"),
        ("extra tracker", "warn"),
    ]


def test_a_cache_that_cannot_be_written_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("", encoding="utf-8")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocker / "cache"))
    (check,) = checks.numba_cache()
    assert check.verdict == "warn"
    assert str(blocker) in check.detail
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert verdicts(checks.numba_cache()) == ["ok"]


@pytest.mark.parametrize(("free", "verdict"), [(10**12, "ok"), (10**9, "warn"), (10**6, "fail")])
def test_the_disk_is_judged_by_what_is_free(monkeypatch: pytest.MonkeyPatch, free: int, verdict: str) -> None:
    total = shutil.disk_usage(Path.cwd())
    monkeypatch.setattr(shutil, "disk_usage", lambda _: total._replace(free=free))
    assert verdicts(checks.disk()) == [verdict]


@pytest.mark.parametrize(
    ("chrony", "systemd", "verdict", "told"),
    [
        ("System time     : 0.000001 seconds fast of NTP time\nLeap status     : Normal\n", None, "ok", "0.000001"),
        ("Leap status     : Not synchronised\n", "yes\n", "warn", "Not synchronised"),
        (None, "yes\n", "ok", "synchronised"),
        (None, "no\n", "warn", "not synchronised"),
        (None, None, "warn", "neither"),
    ],
)
def test_the_clock_is_judged_by_what_keeps_it(
    monkeypatch: pytest.MonkeyPatch, chrony: str | None, systemd: str | None, verdict: str, told: str
) -> None:
    said = {"chronyc": chrony, "timedatectl": systemd}
    monkeypatch.setattr(checks, "_said_by", lambda program, *_: said[program])
    (check,) = checks.clock()
    assert check.verdict == verdict
    assert told in check.detail


def test_a_program_that_fails_or_hangs_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def hangs(*_: object, **__: object) -> None:
        raise subprocess.TimeoutExpired("timedatectl", 5.0)

    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(subprocess, "run", hangs)
    assert verdicts(checks.clock()) == ["warn"]
