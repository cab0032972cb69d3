"""Every format yields exactly the events that another program wrote."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import faery
import numpy as np
import pytest

from heliograph.errors import FileError, Refusal
from heliograph.events import EventBatch
from heliograph_services.event_source.cameras.formats.npz import write_npz
from support.recordings import (
    BY_FAERY,
    HEIGHT,
    WIDTH,
    events_of,
    messages_of,
    opened,
    random_events,
    sorted_within_times,
    write_by_faery,
    write_every_format,
)

# Longer than the 16.8 s after which the time of EVT 3 wraps, with an event in every few ms, as cameras have them.
LONG = random_events(60_000, 40.0, start_us=1_000_000, seed=3)


def same(a: EventBatch, b: EventBatch) -> bool:
    a, b = sorted_within_times(a), sorted_within_times(b)
    pairs = ((a.t_us, b.t_us), (a.x_px, b.x_px), (a.y_px, b.y_px), (a.on, b.on))
    return all(np.array_equal(left, right) for left, right in pairs)


@pytest.mark.parametrize("name", BY_FAERY)
def test_what_faery_writes_is_read_event_by_event(name: str, tmp_path: Path) -> None:
    path = write_by_faery(tmp_path / name, LONG, BY_FAERY[name])
    stream = opened(path, window_us=1_000_000)
    assert (stream.camera.width, stream.camera.height) == (WIDTH, HEIGHT)
    messages = messages_of(stream)
    assert same(events_of(messages), LONG)
    assert stream.refusals == {}


def test_npz_is_read_as_we_and_as_numpy_write_it(tmp_path: Path) -> None:
    batch = random_events()
    ours, theirs = tmp_path / "ours.npz", tmp_path / "theirs.npz"
    assert write_npz(ours, WIDTH, HEIGHT, [batch.part(0, 7), batch.part(7, 7), batch.part(7, len(batch))]) == len(batch)
    loaded = np.load(ours, allow_pickle=False)
    assert loaded["t"].dtype == np.int64
    assert loaded["on"].dtype == np.bool_
    assert (int(loaded["width"]), int(loaded["height"])) == (WIDTH, HEIGHT)
    arrays = {"t": loaded["t"], "x": loaded["x"].astype(">i4"), "y": loaded["y"], "on": loaded["on"].astype(np.int8)}
    np.savez_compressed(theirs, width=WIDTH, height=HEIGHT, **arrays)
    for path in (ours, theirs):
        assert same(events_of(messages_of(opened(path))), batch)
    again = tmp_path / "again.npz"
    write_npz(again, WIDTH, HEIGHT, [batch])
    assert again.read_bytes() == ours.read_bytes()


def test_all_formats_of_the_same_events_are_the_same_stream(tmp_path: Path) -> None:
    # Of one time, RAW may store rows together: one event a time leaves no choice.
    batch = random_events(2_000, 0.2)
    first = np.flatnonzero(np.diff(batch.t_us, prepend=batch.t_us[0] - 1))
    batch = EventBatch(batch.t_us[first], batch.x_px[first], batch.y_px[first], batch.on[first])
    names = {opened(path).camera.stream for path in write_every_format(tmp_path, batch)}
    assert len(names) == 1


def test_evt3_vectors_are_read_bit_by_bit(tmp_path: Path) -> None:
    # By hand from the specification: time 0x001002; a row of 12 + 8 pixels from x = 10 on, three set in each word.
    words = [0x8001, 0x6002, 0x0007, 0x3800 | 10, 0x4000 | 0b100000000011, 0x5000 | 0b10000001]
    path = tmp_path / "v.raw"
    path.write_bytes(b"% evt 3.0\n% geometry 64x32\n% end\n" + np.array(words, "<u2").tobytes())
    batch = events_of(messages_of(opened(path)))
    assert batch.x_px.tolist() == [10, 11, 21, 22, 29]
    assert set(batch.t_us.tolist()) == {0x1002}
    assert set(batch.y_px.tolist()) == {7}
    assert batch.on.all()


def test_evt2_words_are_read_bit_by_bit(tmp_path: Path) -> None:
    words = [(8 << 28) | 3, (1 << 28) | (5 << 22) | (9 << 11) | 4, (0 << 28) | (6 << 22) | (8 << 11) | 3]
    path = tmp_path / "v.raw"
    path.write_bytes(b"% evt 2.0\n% geometry 64x32\n% end\n" + np.array(words, "<u4").tobytes())
    batch = events_of(messages_of(opened(path)))
    assert batch.t_us.tolist() == [3 * 64 + 5, 3 * 64 + 6]
    assert list(zip(batch.x_px.tolist(), batch.y_px.tolist(), batch.on.tolist(), strict=True)) == [
        (9, 4, True),
        (8, 3, False),
    ]


def test_dat_time_goes_on_behind_its_wrap(tmp_path: Path) -> None:
    path = tmp_path / "w.dat"
    times = [2**32 - 2, 2**32 - 1, 0, 5]
    data = b"".join(struct.pack("<II", t, 5 | (7 << 14) | (1 << 28)) for t in times)
    path.write_bytes(b"% Version 2\n% Width 320\n% Height 240\n\x0c\x08" + data)
    assert events_of(messages_of(opened(path))).t_us.tolist() == [2**32 - 2, 2**32 - 1, 2**32, 2**32 + 5]


@pytest.mark.parametrize(
    ("text", "given"),
    [
        ("t,x@320,y@240,on\n10,1,2,1\n20,3,4,0\n", {}),
        ("10,1,2,1\n20,3,4,0\n", {"width": 320, "height": 240}),
        ("x;y;timestamp;p\n1;2;10;1\n3;4;20;-1", {"width": 320, "height": 240}),
        ("t x y polarity\r\n10 1 2 1\r\n\r\n20 3 4 0\r\n", {"width": 320, "height": 240}),
        ("t,x@320,y@240,on\n10,1,2,1\nbroken\n20,3,4,0\n15,1\n", {}),
    ],
)
def test_csv_is_read_in_every_dress(text: str, given: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "e.csv"
    path.write_bytes(text.encode())
    stream = opened(path, **given)
    batch = events_of(messages_of(stream))
    rows = zip(batch.t_us.tolist(), batch.x_px.tolist(), batch.y_px.tolist(), batch.on.tolist(), strict=True)
    assert list(rows) == [(10, 1, 2, True), (20, 3, 4, False)]
    assert stream.refusals == ({Refusal.DAMAGED: 2} if "broken" in text else {})


def test_a_surplus_in_one_line_of_csv_does_not_fill_the_lack_of_another(tmp_path: Path) -> None:
    path = tmp_path / "e.csv"
    path.write_text("t,x@320,y@240,on\n10,1,2,1,20\n3,4,0\n30,5,6,1\n")
    stream = opened(path)
    assert events_of(messages_of(stream)).t_us.tolist() == [30]
    assert stream.refusals == {Refusal.DAMAGED: 2}


def matlab(path: Path, **arrays: object) -> Path:
    scipy_io = pytest.importorskip("scipy.io", reason="MATLAB files need the extra `matlab`")
    scipy_io.savemat(path, arrays)
    return path


def test_a_matlab_beacon_recording_has_one_pixel(tmp_path: Path) -> None:
    times = np.array([[1.0000004, 1.0000016, 1.5, 1.5, np.nan]])
    path = matlab(tmp_path / "b.mat", event=np.array([[1.0, -1.0, 1.0, 0.0, 1.0]]), event_t=times)
    stream = opened(path)
    assert (stream.camera.width, stream.camera.height) == (1, 1)
    batch = events_of(messages_of(stream))
    assert batch.t_us.tolist() == [1_000_000, 1_000_002, 1_500_000]
    assert batch.on.tolist() == [True, False, True]
    assert stream.refusals == {Refusal.DAMAGED: 2}


def test_a_matlab_file_without_its_arrays_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no array 'event_t'"):
        opened(matlab(tmp_path / "b.mat", event=np.ones(3)))
    with pytest.raises(FileError, match="equally long"):
        opened(matlab(tmp_path / "b.mat", event=np.ones(3), event_t=np.ones(4)))


@pytest.mark.data
def test_the_real_beacon_recordings_are_read_whole(beacon_data: Path) -> None:
    pytest.importorskip("scipy", reason="MATLAB files need the extra `matlab`")
    for name, n in (("504hz_100m.mat", 1_504_474), ("3125hz_30m.mat", 1_107_543)):
        stream = opened(beacon_data / name)
        assert len(events_of(messages_of(stream))) == n
        assert stream.refusals == {}


@pytest.mark.data
def test_a_real_evt3_recording_is_read_as_faery_reads_it(scene_data: Path) -> None:
    path = scene_data / "mains_flicker_640x480_evt3.raw"
    ours = events_of(messages_of(opened(path)))
    theirs = np.concatenate(list(faery.events_stream_from_file(path)))
    assert len(ours) == 343_474
    assert np.array_equal(ours.t_us, theirs["t"].astype(np.int64))
    assert np.array_equal(ours.x_px, theirs["x"])
    assert np.array_equal(ours.y_px, theirs["y"])
    assert np.array_equal(ours.on, theirs["on"])


def test_settings_and_help_load_neither_numba_nor_faery() -> None:
    program = (
        "import sys, heliograph_services.event_source.config;"
        "sys.exit(len({'numba', 'faery', 'scipy'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
