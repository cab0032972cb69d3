"""`heliograph decode` as its user meets it: what it prints, and how it refuses."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heliograph.events import EventBatch
from heliograph_services.cli.__main__ import main
from heliograph_services.event_source.cameras.formats.npz import write_npz
from support.recordings import BY_FAERY, HEIGHT, WIDTH, random_events, write_by_faery

DOCUMENTED = {
    "identification": {
        "t_us", "camera", "track", "protocol", "beacon", "x_px", "y_px", "bearing", "confidence", "margin",
        "frames_used",
    },
    "message": {"t_us", "camera", "track", "protocol", "text"},
    "frame": {"t_us", "camera", "track", "protocol", "beacon", "payload", "x_px", "y_px", "confidence"},
    "link": {"t_us", "camera", "track", "bit_rate", "snr_db", "jitter_us", "clock_ppm", "mar_estimate"},
    "summary": {"events", "duration_us", "tracks", "frames", "refused", "identifications", "wall_s"},
}  # fmt: skip


def process(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "heliograph_services.cli", *map(str, arguments)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=110)


def heliograph(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the command here: what a process would print, without its seconds of imports."""
    out, err = io.StringIO(), io.StringIO()
    told = [str(one) for one in arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(told)
    return subprocess.CompletedProcess(told, status, out.getvalue(), err.getvalue())


def lines(done: subprocess.CompletedProcess[str]) -> list[dict[str, Any]]:
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "five.npz"
    assert heliograph("simulate", "five", "-o", path, "--duration", "2", "--seed", "3").returncode == 0
    return path


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_by_faery(tmp_path_factory.mktemp("sound") / "a.aedat4", random_events(), BY_FAERY["a.aedat4"])


def one_line_and_status_2(done: subprocess.CompletedProcess[str], told: str) -> None:
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert told in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


def test_every_documented_line_carries_its_fields(scene: Path) -> None:
    site = Path(__file__).parents[2] / "deploy" / "sites" / "laptop.toml"
    out = lines(process("decode", scene, "--site", site, "--frames", "--links", "--json"))
    assert {line["type"] for line in out} == set(DOCUMENTED)
    for line in out:
        assert line.keys() >= DOCUMENTED[line["type"]]
    assert [line["type"] for line in out].count("summary") == 1
    assert out[-1]["type"] == "summary"
    assert set(out[-1]["identifications"]) == {"crane", "lift", "truck", "mixer", "gate"}


def test_a_camera_file_gives_identifications_their_bearing(scene: Path) -> None:
    sites = Path(__file__).parents[2] / "deploy" / "sites"
    camera = sites / "cameras" / "example.toml"
    out = lines(heliograph("decode", scene, "--site", sites / "laptop.toml", "--camera-file", camera, "--json"))
    bearings = [line["bearing"] for line in out if line["type"] == "identification"]
    assert len(bearings) >= 5
    assert all(abs(sum(v * v for v in bearing) - 1) < 1e-4 for bearing in bearings)
    assert all(bearing[2] > 0.5 for bearing in bearings)


def test_without_a_site_beacons_are_named_by_protocol_and_payload(scene: Path) -> None:
    out = lines(heliograph("decode", scene, "--protocol", "seed11", "--bit-rate", "1000", "--json"))
    assert set(out[-1]["identifications"]) == {"seed11:42", "seed11:21", "seed11:51"}


def test_for_people_no_line_is_wider_than_eighty_columns(scene: Path) -> None:
    done = heliograph("decode", scene, "--protocol", "seed11", "--bit-rate", "1000")
    assert done.returncode == 0
    assert max(len(line) for line in done.stdout.splitlines()) <= 80


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    one_line_and_status_2(process("decode", tmp_path / "none.aedat4"), "none.aedat4")


def test_an_empty_file_is_one_line(tmp_path: Path) -> None:
    for name in ("e.aedat4", "e.raw", "e.dat", "e.es", "e.csv", "e.npz", "e.mat"):
        path = tmp_path / name
        path.write_bytes(b"")
        one_line_and_status_2(heliograph("decode", path), name)


def test_a_raw_file_without_a_size_is_one_line_that_says_what_to_give(tmp_path: Path) -> None:
    path = write_by_faery(tmp_path / "three.raw", random_events(), BY_FAERY["three.raw"])
    raw = path.read_bytes()
    header = [line for line in raw.split(b"\n") if line.startswith(b"%")]
    body = raw[sum(len(line) + 1 for line in header) :]
    kept = [b"% evt 3.0", b"% end"]
    path.write_bytes(b"\n".join(kept) + b"\n" + body)
    one_line_and_status_2(heliograph("decode", path), "set width and height")
    summary = lines(heliograph("decode", path, "--width", str(WIDTH), "--height", str(HEIGHT), "--json"))[-1]
    assert summary["events"] > 0


def test_a_truncated_recording_is_read_as_far_as_it_goes_and_counted(sound: Path, tmp_path: Path) -> None:
    whole = lines(heliograph("decode", sound, "--json"))[-1]
    cut = tmp_path / "cut.aedat4"
    cut.write_bytes(sound.read_bytes()[: sound.stat().st_size * 2 // 3])
    summary = lines(heliograph("decode", cut, "--json"))[-1]
    assert 0 < summary["events"] < whole["events"]
    assert summary["refused_input"] == {"file ends in the middle of a record": 1}


def test_a_recording_of_which_nothing_can_be_read_is_one_line(sound: Path, tmp_path: Path) -> None:
    cut = tmp_path / "head.aedat4"
    cut.write_bytes(sound.read_bytes()[:200])
    one_line_and_status_2(heliograph("decode", cut), "head.aedat4")


def test_times_that_run_backwards_are_one_line_that_names_the_place(tmp_path: Path) -> None:
    batch = random_events(5000)
    path = tmp_path / "back.npz"
    write_npz(path, WIDTH, HEIGHT, [EventBatch(batch.t_us[::-1].copy(), batch.x_px, batch.y_px, batch.on)])
    one_line_and_status_2(heliograph("decode", path), "back")


def test_a_few_events_out_of_order_are_dropped_and_counted(tmp_path: Path) -> None:
    batch = random_events(5000)
    t_us = batch.t_us.copy()
    t_us[[100, 2000]] -= 200_000
    path = tmp_path / "few.npz"
    write_npz(path, WIDTH, HEIGHT, [EventBatch(t_us, batch.x_px, batch.y_px, batch.on)])
    summary = lines(heliograph("decode", path, "--json"))[-1]
    assert summary["events"] == 4998
    assert summary["refused_input"] == {"events out of order": 2}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--protocol", "morse"], "'morse'"),
        (["--bit-rate", "fast"], "--bit-rate must be a number or auto, not 'fast'"),
        (["--bit-rate", "0.2", "--protocol", "seed11"], "--bit-rate must be in [1, 100000] or auto, not 0.2"),
        (["--protocol", "seed11", "--bit-rate", "1000", "--receiver", "magic"], "magic"),
        (["--option", "parity"], "--option must be KEY=VALUE, not 'parity'"),
        (["--protocol", "seed11", "--bit-rate", "1000", "--option", "parity=odd"], "parity"),
        (["--site", "absent.toml"], "absent.toml"),
        (["--camera-file", "absent.toml"], "absent.toml"),
    ],
)
def test_a_wrong_argument_is_one_line(scene: Path, arguments: list[str], told: str) -> None:
    one_line_and_status_2(heliograph("decode", scene, *arguments), told)


def test_a_scene_of_no_beacons_gives_none(tmp_path: Path) -> None:
    path = tmp_path / "empty.npz"
    assert heliograph("simulate", "empty", "-o", path, "--duration", "1").returncode == 0
    for protocol in ("seed11", "code", "uart"):
        summary = lines(heliograph("decode", path, "--protocol", protocol, "--bit-rate", "1000", "--json"))[-1]
        assert summary["events"] > 1000
        assert summary["identifications"] == {}


@pytest.mark.data
def test_the_real_scene_without_a_beacon_gives_no_identification(scene_data: Path) -> None:
    file = scene_data / "mains_flicker_640x480_evt3.raw"
    for rate in ("1000", "1320", "2640"):  # 11 and 22 times the mains' 120 Hz: a lamp is then a whole word
        summary = lines(heliograph("decode", file, "--protocol", "seed11", "--bit-rate", rate, "--json"))[-1]
        assert summary["identifications"] == {}
        assert summary["events"] == 343_474


def test_events_of_one_pixel_are_one_track(tmp_path: Path) -> None:
    t_us = np.arange(0, 400_000, 500, dtype=np.int64)
    zeros = np.zeros(len(t_us), np.uint16)
    path = tmp_path / "pixel.npz"
    write_npz(path, 1, 1, [EventBatch(t_us, zeros, zeros, np.arange(len(t_us)) % 2 == 0)])
    assert lines(heliograph("decode", path, "--json"))[-1]["tracks"] == 1
