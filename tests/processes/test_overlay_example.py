"""The example that draws: boxes where beacons are, on the images of their camera; and against a real router."""

from __future__ import annotations

import importlib.util
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
import pytest

from heliograph.messages import Identification
from heliograph.shell.bus import Bus, connected
from heliograph.shell.links import client_config, router_config
from heliograph.shell.process import Stop
from heliograph.shell.site import BusLinks, RouterLinks
from heliograph.streams import Image
from support.records import every_record

PIL = pytest.importorskip("PIL.Image", reason="the example needs pillow")
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "overlay.py"
GREY = np.full((48, 64), 90, np.uint8)


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("overlay", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def image(t_us: int = 100_000, camera: str = "cam0") -> Image:
    return Image(camera=camera, stream="5eed", t_us=t_us, grey=GREY)


def who(**changes: Any) -> Identification:
    record = next(r for r in every_record() if isinstance(r, Identification))
    return msgspec.structs.replace(record, x_px=30.0, y_px=25.0, vx_px_s=100.0, **changes)


def drawn(example: ModuleType, records: list[Identification], seen: Image) -> Any:
    """Return (48, 64) bool, where the picture is no longer the image; the line of text at its top left out."""
    overlay = example.Overlay()
    for record in records:
        overlay.take(record.to_body())
    picture = np.asarray(overlay.draw(seen.to_body()))
    assert picture.shape == (48, 64, 3)
    changed = (picture != GREY[..., None]).any(axis=2)
    changed[:14] = False
    return changed


def test_a_box_stands_about_the_beacon_where_it_has_got_to(example: ModuleType) -> None:
    now = drawn(example, [who()], image(100_000))
    assert now[16:35, 21].all()
    assert now[16:35, 39].all()
    assert not now[17:34, 22:39].any()
    later = drawn(example, [who()], image(120_000))
    assert later[16:35, 23].all()  # 100 px/s for 20 ms
    assert later[16:35, 41].all()


def test_what_is_lost_stale_or_of_another_camera_is_not_drawn(example: ModuleType) -> None:
    assert not drawn(example, [who(), who(lost=True, change="lost")], image()).any()
    assert not drawn(example, [who()], image(2_000_000)).any()
    assert not drawn(example, [who(camera="cam1")], image()).any()


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{s.getsockname()[1]}"


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    links = BusLinks(connect=(endpoint,))
    with (
        connected(router_config(RouterLinks(listen=(endpoint,)), links), "yard", "router/h", Stop()),
        connected(client_config(links), "yard", "decoder/a", Stop()) as made,
    ):
        assert made is not None
        yield made


@pytest.mark.processes
def test_it_writes_a_picture_of_what_comes_by(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLE), str(tmp_path / "out"), endpoint]
    client = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert client.stdout is not None
    with client.stdout as said:
        try:
            ready: list[Any] = []
            for k in range(1000):  # until it has subscribed; a minute at most
                bus.publish(who(t_us=k))
                bus.publish(image(k))
                ready, _, _ = select.select([said], [], [], 0.06)
                if ready:
                    break
            assert ready, "no picture was written"
            path = Path(said.readline().strip())
        finally:
            client.send_signal(signal.SIGINT)
            client.wait(timeout=20)
    with PIL.open(path) as picture:
        assert picture.size == (64, 48)
        assert picture.mode == "RGB"
