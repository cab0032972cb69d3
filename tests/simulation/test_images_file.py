"""Files of images as a camera: changes against plain rules, damaged files, and a beacon read from pictures of it."""

from __future__ import annotations

import contextlib
import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.core import Context
from heliograph.errors import ConfigError, FileError, Refusal, Refusals
from heliograph.events import EventBatch, concatenate
from heliograph_services.cli import decode
from heliograph_services.event_source.cameras import open_camera
from heliograph_services.event_source.cameras.changes import (
    ImageChanges,
    Reference,
    Scale,
    events_of,
    values_of,
)
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.cameras.formats.npz import write_npz
from heliograph_services.event_source.cameras.image_file import ImageFile, write_images
from heliograph_services.event_source.config import EventSourceConfig

Grey = npt.NDArray[np.uint8]
ALONE = Context(instance="tests", boot="00c0ffee", lockstep=False)


def blinking(n: int, width: int = 8, height: int = 6) -> list[tuple[int, Grey]]:
    """Return images of a square of 2 x 2 pixels that is lit in every second one."""
    images = []
    for k in range(n):
        grey = np.full((height, width), 40, np.uint8)
        grey[2:4, 3:5] = 40 if k % 2 else 200
        images.append((1_000 + 5_000 * k, grey))
    return images


def written(folder: Path, images: list[tuple[int, Grey]]) -> Path:
    path = folder / "images.npz"
    height, width = images[0][1].shape
    assert write_images(path, width, height, images) == len(images)
    return path


def windows(path: Path, **settings: Any) -> list[Window]:
    camera = open_camera(EventSourceConfig(backend="images", file=str(path), **settings), ALONE)
    try:
        return list(camera.windows())
    finally:
        camera.close()


def events(found: list[Window]) -> EventBatch:
    return concatenate([window.batch for window in found])


def refused(found: list[Window]) -> Refusals:
    total = Refusals()
    for window in found:
        total.update(window.refused)
    return total


def plain_changes(images: list[int], threshold: float, scale: Scale, limit: int, reference: Reference) -> list[int]:
    """Return the events of one pixel, image by image, by the rules as they are written."""

    def f(grey: int) -> float:
        if scale == "linear":
            return float(grey)
        return grey * math.log(20) / 20 if grey < 20 else math.log(grey)

    kept, found = f(images[0]), []
    for grey in images[1:]:
        change = f(grey) - kept
        steps = 0
        while abs(change) > threshold and steps + 1 <= abs(change) / threshold + 1e-9:
            steps += 1
        n = min(limit, steps)
        found.append(n if change > 0 else -n)
        if reference == "last" or (reference == "changed" and n) or steps > limit:
            kept = f(grey)
        elif reference == "step":
            kept += math.copysign(n * threshold, change)
    return found


@given(
    st.lists(st.integers(0, 255), min_size=2, max_size=30),
    st.sampled_from([0.2, 0.37, 3.3, 10.1]),
    st.sampled_from(["log", "linear"]),
    st.integers(1, 5),
    st.sampled_from(["step", "changed", "last"]),
)
def test_changes_are_counted_as_the_rules_say(
    images: list[int], threshold: float, scale: Scale, limit: int, reference: Reference
) -> None:
    changes = ImageChanges(threshold, scale, limit, reference)
    found = [changes.feed(np.full((2, 3), grey, np.uint8)) for grey in images]
    assert found[0] is None
    counts = [c for c in found[1:] if c is not None]
    assert all((c == c[0]).all() and len(c) == 6 for c in counts)
    assert [int(c[0]) for c in counts] == plain_changes(images, threshold, scale, limit, reference)


def test_a_level_of_grey_is_never_more_than_a_step_in_the_dark() -> None:
    steps = np.diff(values_of("log"))
    assert steps.min() > 0.0
    assert steps.max() == pytest.approx(math.log(20) / 20)


def test_a_difference_of_the_threshold_itself_is_no_event_as_in_the_plugin() -> None:
    changes = ImageChanges(10.0, "linear", 1, "changed")
    changes.feed(np.array([[100, 100, 100]], np.uint8))
    counts = changes.feed(np.array([[110, 111, 89]], np.uint8))
    assert counts is not None
    assert counts.tolist() == [0, 1, -1]


def test_the_events_of_an_image_stand_by_rows_each_as_often_as_it_was_crossed() -> None:
    batch = events_of(np.array([0, 2, 0, -1, 0, 1], np.int16), 77, 3)
    assert list(zip(batch.x_px, batch.y_px, batch.on, strict=True)) == [
        (1, 0, True), (1, 0, True), (0, 1, False), (2, 1, True),
    ]  # fmt: skip
    assert batch.t_us.tolist() == [77] * 4


def test_a_file_is_read_as_numpy_reads_it_and_is_the_same_twice(tmp_path: Path) -> None:
    images = blinking(7)
    path = written(tmp_path, images)
    first = path.read_bytes()
    with np.load(path) as arrays:
        assert arrays["images"].shape == (7, 6, 8)
        assert arrays["t_us"].tolist() == [t for t, _ in images]
        assert (arrays["images"] == np.stack([grey for _, grey in images])).all()
    assert written(tmp_path, images).read_bytes() == first
    assert not list(tmp_path.glob("*.part"))


def test_a_blinking_square_becomes_events_at_the_times_of_the_images(tmp_path: Path) -> None:
    found = windows(written(tmp_path, blinking(5)), window_us=1000, image_threshold=0.5)
    batch = events(found)
    # ln(200 / 40) = 1.61: three thresholds, in four pixels, at four changes.
    assert len(batch) == 3 * 4 * 4
    assert sorted(set(batch.t_us.tolist())) == [6_000, 11_000, 16_000, 21_000]
    assert not batch.on[batch.t_us == 6_000].any()
    assert batch.on[batch.t_us == 11_000].all()
    assert set(zip(batch.x_px.tolist(), batch.y_px.tolist(), strict=True)) == {(x, y) for x in (3, 4) for y in (2, 3)}
    assert found[-1].end
    assert not refused(found)


def test_settings_of_the_comparison_are_those_of_the_source(tmp_path: Path) -> None:
    path = written(tmp_path, blinking(3))
    assert len(events(windows(path, image_scale="linear", image_threshold=50.0))) == 3 * 4 * 2
    assert len(events(windows(path, image_scale="linear", image_threshold=50.0, image_max_events=1))) == 4 * 2
    assert len(events(windows(path, loop=True, duration_s=0.03))) > len(events(windows(path)))


def test_an_npz_of_numpy_compressed_or_not_is_read_too(tmp_path: Path) -> None:
    times, greys = zip(*blinking(4), strict=True)
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "n.npz", images=np.stack(greys), t_us=np.array(times))
        assert len(events(windows(tmp_path / "n.npz"))) > 0


def test_an_image_whose_time_does_not_rise_is_refused_and_the_rest_is_played(tmp_path: Path) -> None:
    images = blinking(6)
    images[3] = (images[2][0], images[3][1])
    found = windows(written(tmp_path, images), window_us=1000)
    assert refused(found) == {Refusal.TIME_BACKWARDS: 1}
    # Its neighbours are both lit, so that nothing changes where it is missing.
    assert sorted(set(events(found).t_us.tolist())) == [6_000, 11_000, 26_000]


def test_a_time_beyond_every_clock_is_refused(tmp_path: Path) -> None:
    images = blinking(5)
    images[4] = (2**60, images[4][1])
    assert refused(windows(written(tmp_path, images))) == {Refusal.TIME_JUMP: 1}


def test_a_gap_of_more_than_a_minute_begins_a_new_stream(tmp_path: Path) -> None:
    images = blinking(4)
    images[2:] = [(t + 3_600_000_000, grey) for t, grey in images[2:]]
    found = windows(written(tmp_path, images))
    assert len(found) < 100
    assert len({window.stream for window in found}) == 2


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"t_us": np.arange(3)}, "no array 'images'"),
        ({"images": np.zeros((3, 4, 5), np.uint8)}, "no array 't_us'"),
        ({"images": np.zeros((3, 4, 5)), "t_us": np.arange(3)}, r"images must be \(n, height, width\) uint8"),
        ({"images": np.zeros((3, 4), np.uint8), "t_us": np.arange(3)}, r"images must be \(n, height, width\) uint8"),
        ({"images": np.zeros((3, 4, 5), np.uint8), "t_us": np.arange(3.0)}, r"t_us must be \(n,\) int64"),
        ({"images": np.zeros((3, 4, 5), np.uint8), "t_us": np.arange(4)}, "equally many, not 3 and 4"),
        ({"images": np.zeros((1, 4, 5), np.uint8), "t_us": np.arange(1)}, "at least 2 images, not 1"),
        ({"images": np.zeros((2, 0, 5), np.uint8), "t_us": np.arange(2)}, "1 to 4096 pixels a side"),
        ({"images": np.zeros((2, 1, 4097), np.uint8), "t_us": np.arange(2)}, "1 to 4096 pixels a side"),
        ({"images": np.asfortranarray(np.zeros((3, 4, 5), np.uint8)), "t_us": np.arange(3)}, "by rows"),
        ({"images": np.zeros((3, 4, 5), np.uint8), "t_us": np.arange(3)}, "no events in it"),
    ],
)
def test_what_is_no_file_of_images_is_refused_in_one_line(
    tmp_path: Path, arrays: dict[str, npt.NDArray[Any]], words: str
) -> None:
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)  # type: ignore[arg-type]
    with pytest.raises(FileError, match=words) as caught:
        windows(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_other_files_and_none_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("no zip")
    with pytest.raises(FileError, match="no NPZ file"):
        windows(tmp_path / "text.npz")
    with pytest.raises(FileError, match="No such file"):
        windows(tmp_path / "absent.npz")
    with pytest.raises(ConfigError, match="file must name a recording where backend is images"):
        open_camera(EventSourceConfig(backend="images"), ALONE)


def test_an_image_of_another_size_is_the_callers_mistake(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"an image must be \(6, 8\) uint8"):
        write_images(tmp_path / "a.npz", 8, 6, [(0, np.zeros((8, 6), np.uint8))])
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(FileError, match="No such file"):
        write_images(tmp_path / "absent" / "a.npz", 8, 6, blinking(2))


@given(st.integers(0, 2_000), st.integers(1, 255))
def test_a_damaged_file_is_refused_or_played_and_never_anything_else(
    tmp_path_factory: pytest.TempPathFactory, at: int, change: int
) -> None:
    path = written(tmp_path_factory.mktemp("damage"), blinking(6))
    data = bytearray(path.read_bytes())
    data[at % len(data)] ^= change
    path.write_bytes(data)
    with contextlib.suppress(FileError):
        for _, image, why in ImageFile(path).images():
            assert (image is None) == bool(why)


def test_a_file_cut_short_is_played_up_to_there(tmp_path: Path) -> None:
    path = written(tmp_path, blinking(6))
    with zipfile.ZipFile(path) as archive:
        images, times = archive.read("images.npy"), archive.read("t_us.npy")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("images.npy", images[:-60])
        archive.writestr("t_us.npy", times)
    found = windows(path)
    assert refused(found) == {Refusal.TRUNCATED: 1}
    assert events(found).t_us[-1] == 16_000


def test_a_beacon_is_read_from_images_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Payload 42 at 100 bit/s, 200 images a second: two images a bit, each a picture of the LED's level then."""
    bits = [1, 1, 1, 0, 1, 0, 1, 0, 1, 0, 1]  # 1110 101010 1, as the paper writes it
    y, x = np.mgrid[0:48, 0:64]
    spot = np.exp(-((x - 30.3) ** 2 + (y - 20.6) ** 2) / (2 * 1.6**2))
    images = []
    for k in range(600):
        t_us = 5_000 * k
        lit = bits[int((t_us + 2_300) / 10_000) % len(bits)]
        images.append((t_us, np.minimum(60 + 150 * lit * spot, 255).astype(np.uint8)))
    found = windows(written(tmp_path, images))
    path = tmp_path / "events.npz"
    write_npz(path, 64, 48, [window.batch for window in found])
    assert decode.run([str(path), "--protocol", "seed11", "--bit-rate", "100", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    identified = [line for line in lines if line["type"] == "identification"]
    assert {line["beacon"] for line in identified} == {"seed11:42"}
    assert identified[-1]["x_px"] == pytest.approx(30.3, abs=1.0)
    assert identified[-1]["y_px"] == pytest.approx(20.6, abs=1.0)
