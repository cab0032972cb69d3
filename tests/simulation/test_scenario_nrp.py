"""The paper's receiver before the paper's simulated camera: most frames in view are read, occluders cost the rest."""

from __future__ import annotations

import msgspec
import numpy as np

from heliograph.messages import Frames
from heliograph.truth import Truth
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.instants import Counts, counts_of
from heliograph_services.decoder.__main__ import SERVICE as DECODER
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.simulation.world.load import load_scenario, site_beacons
from heliograph_services.event_source.stream import open_stream
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core

# In the first 10 s hardly anything is hidden yet.
SECONDS = 14.0


def counted(scenario: str, seed: int) -> Counts:
    source = EventSourceConfig(
        backend="simulated", scenario=scenario, seed=seed, fidelity="live", duration_s=SECONDS, window_us=10_000
    )
    beacons = tuple(site_beacons(load_scenario(scenario)))
    decoder = DECODER.make(DecoderConfig(beacons=beacons, receiver="paper"), ONE_PROCESS)
    pipeline = Pipeline(make_core(TrackerConfig(), ONE_PROCESS), decoder)
    truths: list[Truth] = []
    frames: list[Frames] = []
    for step in open_stream(source, ONE_PROCESS):
        truths += [message for message in step.messages if isinstance(message, Truth)]
        frames += [message for message in pipeline.feed(step.messages) if isinstance(message, Frames)]
    return counts_of(truths, frames)


def test_of_the_frames_in_view_the_papers_receiver_reads_about_as_many_as_in_the_papers_table() -> None:
    """The paper: .74 (28 m, 50 bit/s); 14 s of one seed say no more than this."""
    counts = counted("construction_site_nrp", 0)
    assert counts.in_view > 250
    assert 0.6 <= counts.right_in_view / counts.in_view <= 0.85


def test_places_are_compared_at_the_time_of_the_reading() -> None:
    """An image moves 200 px/s; a frame read 100 ms after the sent one ended is 20 px further on."""
    truths: list[Truth] = []
    frames: list[Frames] = []
    for k in range(30):
        ended = k >= 15 and k % 3 == 0
        truths.append(moving(k, ended=ended))
        if ended:
            frames.append(read_late(k))
    assert counts_of(truths, frames) == Counts(in_view=5, right_in_view=5, visible=5, right_visible=5)
    elsewhere = [msgspec.structs.replace(one, y_px=[106.0]) for one in frames]
    assert counts_of(truths, elsewhere).right_visible == 0


def moving(k: int, *, ended: bool) -> Truth:
    """Return the k-th window of 100 ms of a beacon; in it a frame of 11 bits ends, or none."""
    t1_us = 100_000 * (k + 1)
    return Truth(
        camera="cam0",
        t0_us=t1_us - 100_000,
        t1_us=t1_us,
        sensor="nrp",
        fidelity="live",
        beacon=["a"],
        protocol=["seed11"],
        x_px=[20.0 * k],
        y_px=[100.0],
        radius_px=[2.0],
        x_m=[0.0],
        y_m=[0.0],
        z_m=[0.0],
        in_view=[True],
        visible=[True],
        frame_beacon=[0] * ended,
        frame_t0_us=[t1_us - 220_000] * ended,
        frame_t1_us=[t1_us] * ended,
        frame_payload=[42] * ended,
        frame_x_px=[20.0 * k] * ended,
        frame_y_px=[100.0] * ended,
        frame_visible=[True] * ended,
        edge_beacon=np.empty(0, np.uint16),
        edge_us=np.empty(0, np.float64),
        edge_on=np.empty(0, np.bool_),
    )


def read_late(k: int) -> Frames:
    """Return a frame that was read 100 ms after the end of that window, where the beacon is by then."""
    t1_us = 100_000 * (k + 2)
    return Frames(
        camera="cam0",
        t0_us=t1_us - 100_000,
        t1_us=t1_us,
        t_us=[t1_us],
        track=["1-1"],
        protocol=["seed11"],
        beacon=["a"],
        payload=[42],
        x_px=[20.0 * (k + 1)],
        y_px=[100.0],
        score=[1.0],
    )
