"""Edges from outside, as firmware writes them, become events that the real receiver reads."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from heliograph.link.contract import edges_of
from heliograph.messages import Frames
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import make_core as make_decoder
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import open_stream
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core as make_tracker

# Payload 42, worked by hand from the paper: start code, payload, parity.
WORD_42 = (1, 1, 1, 0, 1, 0, 1, 0, 1, 0, 1)
SCENE = """
irradiance_w_m2 = 2.0
[camera]
sensor = "ideal"
path = {{ kind = "still", at_m = [0.0, 0.0, 5.0] }}
[[beacon]]
name = "a"
protocol = "seed11"
bit_rate = 1000
intensity_w_sr = 0.01
edges = "{edges}"
path = {{ kind = "still", at_m = [0.0, 0.0, 0.1] }}
"""


def lines(seconds: float) -> bytes:
    """Return the edges of payload 42, over and over at 1 kbit/s, as firmware logs them."""
    t_us, on = edges_of(WORD_42 * int(seconds * 1_000 / 11), 0.0, 1_000.0)
    return b"t_ns,level\n" + b"".join(b"%d,%d\n" % (t * 1_000, level) for t, level in zip(t_us, on, strict=True))


def read(tmp_path: Path, edges: Path, seconds: float) -> list[int]:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.format(edges=edges))
    source = EventSourceConfig(backend="simulated", scenario=str(path), duration_s=seconds, window_us=10_000)
    stream = open_stream(source, ONE_PROCESS)
    decoder = make_decoder(DecoderConfig(protocol="seed11", bit_rate=1000.0), ONE_PROCESS)
    pipeline = Pipeline(make_tracker(TrackerConfig(), ONE_PROCESS), decoder)
    frames = [m for step in stream for m in pipeline.feed(step.messages) if isinstance(m, Frames)]
    return [payload for message in frames for payload in message.payload]


def test_a_file_of_edges_drives_a_light_that_is_read_frame_by_frame(tmp_path: Path) -> None:
    edges = tmp_path / "edges.csv"
    edges.write_bytes(lines(1.2))
    payloads = read(tmp_path, edges, 1.0)
    assert len(payloads) >= 80
    assert set(payloads) == {42}


def test_a_fifo_is_waited_for_and_gives_the_frames_of_the_file(tmp_path: Path) -> None:
    edges, fifo = tmp_path / "edges.csv", tmp_path / "fifo"
    edges.write_bytes(lines(1.2))
    os.mkfifo(fifo)

    def send() -> None:
        with fifo.open("wb") as sender:
            for line in edges.read_bytes().splitlines(keepends=True):
                sender.write(line)

    firmware = threading.Thread(target=send)
    firmware.start()
    try:
        streamed = read(tmp_path, fifo, 1.0)
    finally:
        firmware.join()
    assert streamed == read(tmp_path, edges, 1.0)
