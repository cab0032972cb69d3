"""Damaged recordings: one line, or a counted refusal; never a traceback, or a dead process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heliograph.errors import ConfigError, FileError, Refusal
from heliograph.events import EventBatch
from heliograph_services.event_source.cameras.formats.npz import write_npz
from support.recordings import HEIGHT, WIDTH, events_of, messages_of, opened, random_events, write_every_format

BATCH = random_events(12_000, 0.2)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_every_format(tmp_path_factory.mktemp("sound"), BATCH)


def evt2(times: list[int], x_px: int = 5) -> bytes:
    words = []
    for t in times:
        words += [(8 << 28) | (t >> 6), (1 << 28) | ((t & 63) << 22) | (x_px << 11) | 7]
    return np.array(words, "<u4").tobytes()


RAW_HEAD = b"% evt 2.0\n% geometry 320x240\n% end\n"


def refused(path: Path, **settings: Any) -> str:
    """Return the one line with which a file is refused."""
    with pytest.raises(FileError) as caught:
        messages_of(opened(path, **settings))
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text


@pytest.mark.parametrize("suffix", ["aedat4", "raw", "dat", "es", "csv", "npz", "mat", "xyz"])
def test_missing_and_empty_files_are_refused(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    assert "No such file" in refused(path)
    path.touch()
    assert "empty" in refused(path)
    assert "directory" in refused(tmp_path)


def test_no_file_at_all_is_a_mistake_of_the_configuration() -> None:
    with pytest.raises(ConfigError, match="file must name a recording"):
        opened("")


def test_files_that_are_not_what_their_name_says_are_refused(tmp_path: Path) -> None:
    for name in ("a.aedat4", "a.es", "a.npz", "a.mat"):
        (tmp_path / name).write_bytes(b"certainly something else" * 10)
        assert "it begins with" in refused(tmp_path / name)
    (tmp_path / "a.dat").write_bytes(b"certainly something else" * 10)
    assert "no DAT file" in refused(tmp_path / "a.dat")
    (tmp_path / "a.xyz").write_bytes(b"certainly something else" * 10)
    assert "unknown format" in refused(tmp_path / "a.xyz")
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file")
    assert "7.3" in refused(tmp_path / "a.mat")


def test_a_raw_file_without_a_size_is_refused_unless_it_is_given(tmp_path: Path) -> None:
    path = tmp_path / "a.raw"
    path.write_bytes(b"% evt 2.0\n% end\n" + evt2([100, 200]))
    assert "size of its sensor" in refused(path)
    assert events_of(messages_of(opened(path, width=320, height=240))).t_us.tolist() == [100, 200]
    path.write_bytes(RAW_HEAD + evt2([100, 200]))
    assert "the file says 320x240, the settings say 640x480" in refused(path, width=640, height=480)
    with pytest.raises(ConfigError, match="together"):
        opened(path, width=640)


def test_a_raw_file_of_an_unknown_or_unread_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.raw"
    path.write_bytes(b"% geometry 320x240\n% end\n" + evt2([100]))
    assert "which EVT" in refused(path)
    assert len(events_of(messages_of(opened(path, format="evt2")))) == 1
    path.write_bytes(b"% evt 2.1\n% geometry 320x240\n% end\n" + evt2([100]))
    assert "EVT 2.1 is not read" in refused(path)


def test_a_file_without_events_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.raw"
    path.write_bytes(RAW_HEAD)
    assert "no events in it" in refused(path)
    write_npz(tmp_path / "a.npz", WIDTH, HEIGHT, [])
    assert "no events in it" in refused(tmp_path / "a.npz")


@pytest.mark.parametrize("kind", ["a.aedat4", "three.raw", "two.raw", "d.dat", "c.csv"])
def test_a_file_cut_in_a_record_yields_what_came_before_and_says_so(
    kind: str, files: list[Path], tmp_path: Path
) -> None:
    sound = next(path for path in files if path.name == kind)
    data = sound.read_bytes()
    path = tmp_path / kind
    cut = len(data) // 2 | 1
    if kind == "c.csv":
        cut = data.index(b"\n", cut) - 5
    path.write_bytes(data[:cut])
    stream = opened(path)
    events = events_of(messages_of(stream))
    assert len(BATCH) // 5 < len(events) < len(BATCH)
    assert np.array_equal(events.t_us, BATCH.t_us[: len(events)])
    assert sum(stream.refusals.values()) == 1
    assert set(stream.refusals) <= {Refusal.TRUNCATED, Refusal.DAMAGED}


def test_an_aedat4_cut_in_its_header_is_refused(files: list[Path], tmp_path: Path) -> None:
    data = files[0].read_bytes()
    path = tmp_path / "a.aedat4"
    for cut in (14, 17, 40, 200):
        path.write_bytes(data[:cut])
        assert "header" in refused(path)


def test_a_few_events_out_of_order_are_dropped_and_counted(tmp_path: Path) -> None:
    times = list(range(1_000, 31_000, 10))
    times[1_000] = 990  # far too early
    times[2_000] = 30_900  # far too late: it costs itself, not the thousand behind it
    path = tmp_path / "a.raw"
    path.write_bytes(RAW_HEAD + evt2(times))
    stream = opened(path)
    kept = events_of(messages_of(stream)).t_us.tolist()
    assert kept == [t for i, t in enumerate(times) if i not in {1_000, 2_000}]
    assert stream.refusals == {Refusal.UNORDERED: 2}


@pytest.mark.parametrize("suffix", ["raw", "dat", "csv", "npz"])
def test_a_file_whose_time_runs_backwards_is_refused_and_the_place_named(suffix: str, tmp_path: Path) -> None:
    times = list(range(9_000, 6_000, -30)) + list(range(10_000, 13_000, 30))
    path = tmp_path / f"a.{suffix}"
    if suffix == "raw":
        path.write_bytes(RAW_HEAD + evt2(times))
    elif suffix == "dat":
        pairs = np.array([[t, 5 | (7 << 14)] for t in times], "<u4")
        path.write_bytes(b"% Width 320\n% Height 240\n\x0c\x08" + pairs.tobytes())
    elif suffix == "csv":
        path.write_text("t,x@320,y@240,on\n" + "".join(f"{t},5,7,1\n" for t in times))
    else:
        z = np.zeros(len(times), np.uint16)
        write_npz(path, WIDTH, HEIGHT, [EventBatch(np.array(times), z, z, z > 0)])
    assert "time runs backwards at 99 of 200 events, first 8970 us after 9000 us" in refused(path)


def test_events_off_the_sensor_and_beyond_time_cost_themselves_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = ["t,x@320,y@240,on", "10,1,2,1", "20,320,2,1", "20,1,-1,1", "30,70000,1,1", f"{2**60},1,1,1", "40,1,2,0"]
    path.write_text("\n".join(lines))
    stream = opened(path)
    assert events_of(messages_of(stream)).t_us.tolist() == [10, 40]
    assert stream.refusals == {Refusal.OFF_SENSOR: 3, Refusal.TIME_JUMP: 1}


def test_headers_that_ask_for_the_moon_allocate_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_npz(path, WIDTH, HEIGHT, [BATCH.part(0, 100)])
    # Every array says the same length, a million million.
    path.write_bytes(path.read_bytes().replace(b"(100,), }       ", b"(900000000000,)}"))
    assert "no NPZ file" in refused(path) or "no events in it" in refused(path)
    path = tmp_path / "a.raw"
    path.write_bytes(b"% evt 2.0\n% geometry 99999x99999\n% end\n" + evt2([1]))
    assert "at most 4096" in refused(path)


def test_pickled_arrays_are_never_opened(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, t=np.array([{"a": 1}], object), x=np.zeros(1, int), y=np.zeros(1, int), on=np.zeros(1, bool))
    assert "t must be a row of whole numbers" in refused(path, width=1, height=1)


FUZZ = """
import random, sys, warnings
from pathlib import Path
from heliograph.errors import HeliographError
from support.recordings import opened
warnings.simplefilter("error")
folder, rounds = Path(sys.argv[1]), int(sys.argv[2])
for sound in sorted(folder.iterdir()):
    data = sound.read_bytes()
    for i in range(rounds):
        r = random.Random(i)
        damaged = bytearray(data)
        if i % 4 == 0:
            damaged = damaged[: r.randrange(len(data))]
        else:
            for _ in range(r.choice([1, 3, 20])):
                damaged[r.randrange(len(data) if i % 2 else 900)] = r.randrange(256)
        path = folder.parent / ("damaged" + sound.suffix)
        path.write_bytes(damaged)
        try:
            for n, step in enumerate(opened(path)):
                for message in step.messages:
                    type(message).from_body(message.to_body())
                if n > 2_000:
                    break
        except HeliographError as error:
            assert "\\n" not in str(error)
print("alive")
"""


def test_mutated_files_of_every_format_kill_no_process(files: list[Path], tmp_path: Path) -> None:
    # In a process of its own: a library may not only raise, but panic or abort.
    folder = tmp_path / "sound"
    folder.mkdir()
    for path in files:
        (folder / path.name).write_bytes(path.read_bytes())
    tests = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", FUZZ, str(folder), "25"],
        cwd=tests, capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "alive\n", "")
