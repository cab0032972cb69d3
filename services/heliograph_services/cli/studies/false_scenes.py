"""Whole scenes for the study of false alarms: the recorded one, the scenario `clutter`, and crowds."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from heliograph.events import EventBatch, concatenate
from heliograph.messages import Data as Said
from heliograph.messages import Frames, Identification, Message, Tracks
from heliograph.streams import Events
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.heard import Signal, heard
from heliograph_services.cli.studies.running import Setting, opened, run
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import make_core as make_decoder
from heliograph_services.decoder.routing import HEART_OF
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.simulation.world.load import load_scenario, site_beacons
from heliograph_services.event_source.stream import SourceStream, open_stream
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core as make_tracker

SCENES = Path(__file__).parents[5] / "shared" / "data" / "scenes"
RECORDED = "mains_flicker_640x480_evt3.raw"
# A square with fewer events in its two seconds has no light in it.
EVENTS_LEAST = 300


def is_recorded() -> bool:
    """Return whether the recorded scene is there."""
    return (Path(os.environ.get("HELIOGRAPH_SCENE_DATA", SCENES)) / RECORDED).is_file()


def recorded() -> SourceStream:
    """Open the recorded scene.

    Raises:
        FileError: it is not there (HELIOGRAPH_SCENE_DATA names its folder).
    """
    file = Path(os.environ.get("HELIOGRAPH_SCENE_DATA", SCENES)) / RECORDED
    return open_stream(
        EventSourceConfig(backend="recording", file=str(file), window_us=10_000, loop=False), ONE_PROCESS
    )


def scene_whole(configs: dict[str, DecoderConfig]) -> dict[str, Any]:
    """Return what decoders say of the recorded scene, behind one tracker, which hears what the first one says."""
    first, *others = configs.items()
    pipeline = Pipeline(make_tracker(TrackerConfig(), ONE_PROCESS), make_decoder(first[1], ONE_PROCESS))
    decoders = {name: make_decoder(config, ONE_PROCESS) for name, config in others}
    out = {name: _Tally() for name in configs}
    tracks = set[str]()
    duration_us = 0
    for step in recorded():
        messages = pipeline.feed(step.messages)
        out[first[0]].take(messages)
        told = [message for message in messages if isinstance(message, Tracks)]
        tracks.update(name for message in told for name in message.track)
        events = [message for message in step.messages if isinstance(message, Events)]
        duration_us += sum(message.t1_us - message.t0_us for message in events)
        for name, decoder in decoders.items():
            for message in [*told, *events]:
                out[name].take(decoder.feed(message))
    seconds = duration_us * 1e-6
    rows = {name: tally.row(seconds, len(tracks)) for name, tally in out.items()}
    return {"seconds": round(seconds, 3), "tracks": len(tracks), "readers": rows}


class _Tally:
    """Counts what a decoder publishes."""

    def __init__(self) -> None:
        self._told: list[dict[str, Any]] = []
        self._frames = 0

    def take(self, messages: list[Message]) -> None:
        """Take what it published."""
        for message in messages:
            if isinstance(message, Identification) and message.change in {"accepted", "changed"}:
                self._told.append({"light": message.track, "identities": [message.beacon], "text": ""})
            elif isinstance(message, Said):
                self._told.append({"light": message.track, "identities": [], "text": message.text or "data"})
            elif isinstance(message, Frames):
                self._frames += len(message.t_us)

    def row(self, seconds: float, tracks: int) -> dict[str, Any]:
        """Return the counts."""
        return {"heard_s": seconds, "candidates": tracks, "frames": self._frames, "told": self._told, "cpu_s": 0.0}


def scene_regions(side_px: int) -> list[tuple[str, Signal]]:
    """Return the squares of the recorded scene that hold light, each as a track that is all heart."""
    batches: list[EventBatch] = []
    for step in recorded():
        batches += [message.batch for message in step.messages if isinstance(message, Events)]
    whole = concatenate(batches)
    t0_us, t1_us = int(whole.t_us[0]), int(whole.t_us[-1])
    square = whole.y_px.astype(np.int64) // side_px * 10_000 + whole.x_px // side_px
    order = np.argsort(square, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(square[order])) + 1)
    return [
        (
            f"square {square[part[0]] % 10_000}, {square[part[0]] // 10_000} of {side_px} px",
            Signal(whole.t_us[part] - t0_us, whole.on[part], np.full(len(part), HEART_OF, np.uint8), 0, t1_us - t0_us),
        )
        for part in parts
        if len(part) >= EVENTS_LEAST
    ]


def _heard(scenario: str, seconds: float, seed: int) -> list[tuple[str, Signal]]:
    setting = Setting(scenario, seed, seconds, source={"fidelity": "live"})
    with opened(setting, Path()) as stream:
        signals = heard(step.messages for step in stream)
    return [(f"{scenario} track {i}", signal) for i, signal in enumerate(signals) if signal.until_us > signal.from_us]


def clutter(seconds: float, seed: int) -> list[tuple[str, Signal]]:
    """Return what a decoder hears of the scenario `clutter`."""
    return _heard("clutter", seconds, seed)


def crowd_heard(seconds: float, seed: int) -> list[tuple[str, Signal]]:
    """Return what a decoder hears of a crowd."""
    return _heard("crowd", seconds, seed)


def crowd(seconds: float, seed: int) -> dict[str, Any]:
    """Return how a crowd is named by the whole system."""
    beacons = msgspec.to_builtins(site_beacons(load_scenario("crowd")))
    outcome = run(Setting("crowd", seed, seconds, {"beacons": beacons}, source={"fidelity": "live"}))
    accuracy, summary = outcome.summary.accuracy, outcome.summary
    if accuracy is None:
        raise RuntimeError("the crowd has no truth")
    return {
        "tracks": outcome.tracks,
        "sightings": len(summary.sightings),
        "identified": sum(summary.identified.values()),
        "frames": summary.frames,
        "false_alarms": accuracy.false_alarms,
        "confusions": accuracy.confusions,
        "received": {"right": accuracy.mar_received.right, "n": accuracy.mar_received.n},
    }
