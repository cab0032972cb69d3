"""A recording as a camera: the grid, silence, loops, limits and jumps of the clock."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from heliograph.camera import parse
from heliograph.errors import ConfigError, Refusal
from heliograph.events import EventBatch
from heliograph.streams import Events
from heliograph.wire import pack_body
from heliograph_services.event_source.cameras import CAMERAS, names, open_camera
from heliograph_services.event_source.cameras.formats.npz import write_npz
from heliograph_services.event_source.cameras.recording import JUMP_US
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import steps
from support.recordings import HEIGHT, LIVE, LOCKSTEP, WIDTH, events_of, messages_of, opened, random_events

EXAMPLE = Path(__file__).parents[2] / "deploy" / "sites" / "cameras" / "example.toml"


def recording(folder: Path, times_us: list[int]) -> Path:
    z = np.zeros(len(times_us), np.uint16)
    path = folder / "r.npz"
    write_npz(path, WIDTH, HEIGHT, [EventBatch(np.array(times_us, np.int64), z, z, z == 0)])
    return path


def test_windows_lie_on_the_grid_of_the_clock_and_cover_silence(tmp_path: Path) -> None:
    path = recording(tmp_path, [-3_500, 12_000, 13_999, 14_000, 50_001])
    windows = list(opened(path, LIVE).camera.windows())
    assert windows[0].t0_us == -4_000
    assert windows[-1].t1_us == 52_000
    assert all(a.t1_us == b.t0_us == a.t0_us + 2_000 for a, b in pairwise(windows))
    assert [len(w.batch) for w in windows if len(w.batch)] == [1, 2, 1, 1]
    assert all(((w.batch.t_us >= w.t0_us) & (w.batch.t_us < w.t1_us)).all() for w in windows)
    assert [w.end for w in windows] == [False] * (len(windows) - 1) + [True]


def test_the_same_recording_is_the_same_stream_of_bytes(tmp_path: Path) -> None:
    path = tmp_path / "r.npz"
    write_npz(path, WIDTH, HEIGHT, [random_events()])
    first, second = ([pack_body(m) for m in messages_of(opened(path))] for _ in range(2))
    assert first == second
    config = EventSourceConfig(file=str(path))
    assert [pack_body(m) for step in steps(config, LOCKSTEP) for m in step.messages] == first


def test_in_lockstep_every_step_is_whole_messages_of_onsets(tmp_path: Path) -> None:
    path = recording(tmp_path, [0, 100_000])
    for step in opened(path, LOCKSTEP, window_us=700):
        assert {message.time_us for message in step.messages} == {step.t1_us}


def test_a_loop_goes_on_in_time_without_end(tmp_path: Path) -> None:
    path = recording(tmp_path, [5_500, 6_000, 9_100])
    stream = iter(opened(path, LIVE, loop=True))
    times: list[int] = []
    taken = [next(stream) for _ in range(2 * 9)]
    for step in taken:
        times += events_of(step.messages).t_us.tolist()
        assert not step.end
    assert times == [t + shift for shift in (0, 6_000, 12_000) for t in (5_500, 6_000, 9_100)]
    assert taken[-1].t1_us == 4_000 + 9 * 2_000
    stream.close()  # type: ignore[attr-defined]  # a generator


def test_a_duration_ends_the_stream_at_its_time(tmp_path: Path) -> None:
    path = recording(tmp_path, list(range(1_000_500, 1_100_000, 500)))
    for loop in (False, True):
        all_steps = list(opened(path, LIVE, duration_s=0.01, loop=loop))
        assert all_steps[-1].end
        assert all_steps[-1].t1_us == 1_010_000
        assert events_of([m for s in all_steps for m in s.messages]).t_us.tolist() == list(
            range(1_000_500, 1_010_000, 500)
        )


def test_a_jump_of_the_clock_begins_a_new_stream_and_is_counted(tmp_path: Path) -> None:
    years = 30 * 365 * 86_400 * 1_000_000
    path = recording(tmp_path, [0, 1_000, years, years + 1_000])
    stream = opened(path, LIVE)
    all_steps = list(stream)
    assert list(dict.fromkeys(step.t1_us for step in all_steps)) == [2_000, years // 2_000 * 2_000 + 2_000]
    names_seen = [m.stream for s in all_steps for m in s.messages if isinstance(m, Events)]
    assert len(set(names_seen)) == 2
    assert stream.refusals == {Refusal.TIME_JUMP: 1}


def test_a_silence_of_less_than_a_minute_is_no_jump(tmp_path: Path) -> None:
    stream = opened(recording(tmp_path, [0, JUMP_US - 1]), LIVE, window_us=1_000_000)
    assert [step.t1_us for step in stream][-1] == JUMP_US
    assert stream.refusals == {}


def test_the_camera_file_must_fit_the_sensor(tmp_path: Path) -> None:
    path = recording(tmp_path, [0])
    with pytest.raises(ConfigError, match="is for 640x480, the camera has 320x240"):
        opened(path, camera_file=str(EXAMPLE))
    fitting = tmp_path / "camera.toml"
    text = EXAMPLE.read_text().replace("width = 640", f"width = {WIDTH}").replace("height = 480", f"height = {HEIGHT}")
    fitting.write_text(text)
    assert opened(path, camera_file=str(fitting)).camera.intrinsics == parse(text).intrinsics
    with pytest.raises(ConfigError, match="No such file"):
        opened(path, camera_file=str(tmp_path / "absent.toml"))


def test_backends_are_a_table_and_an_unknown_one_is_named() -> None:
    assert set(CAMERAS) <= set(names())
    with pytest.raises(ConfigError, match=r"backend must be one of recording, simulated.*not 'telescope'"):
        open_camera(EventSourceConfig(backend="telescope"), LIVE)
