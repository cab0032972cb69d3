"""Crossings with the decoder in the loop: the same scenes as raw events, through source, tracker and decoder.

Each change of an ideal pixel is an event within the step in which it happens, and again with probability .3; the
decoder lists both beacons, and reads who is who. In lockstep, as a recording is read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from heliograph.core import Context
from heliograph.events import EventBatch
from heliograph.messages import Tracks
from heliograph.site import Beacon
from heliograph_services.cli.pipeline import Pipeline
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import make_core as make_decoder
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.core import CameraInfo, SourceCore
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core
from support.crossings import WORDS, Crossing, Kind, crossing, verdict
from support.onset_scenes import US, Scene

WINDOW_US = 10_000
PAYLOADS = (42, 21, 37, 51)


def windows(scene: Scene, seconds: float) -> Iterator[Window]:
    """Yield a scene's events, sorted by time; steps are 100 us."""
    rng = np.random.default_rng(scene.seed)
    scene = replace(scene, step_us=100)
    before = [np.empty(0, np.int64) for _ in scene.discs]
    last = int(seconds * 1e6) // WINDOW_US
    for k in range(last):
        t0_us = k * WINDOW_US
        times, pixels, ons = [], [], []
        for d, disc in enumerate(scene.discs):
            steps = np.arange(t0_us, t0_us + WINDOW_US, scene.step_us, dtype=np.int64)
            for t_us, lit in zip(steps.tolist(), disc.lit(steps).tolist(), strict=True):
                bright = scene.cover(disc, t_us * US) if lit else np.empty(0, np.int64)
                if len(bright) + len(before[d]) == 0:
                    continue
                for on, changed in (
                    (True, np.setdiff1d(bright, before[d], assume_unique=True)),
                    (False, np.setdiff1d(before[d], bright, assume_unique=True)),
                ):
                    pixel = changed[rng.random(len(changed)) < scene.seen]
                    pixel = np.concatenate([pixel, pixel[rng.random(len(pixel)) < 0.3]])
                    times.append(t_us + rng.integers(0, scene.step_us, len(pixel)))
                    pixels.append(pixel)
                    ons.append(np.full(len(pixel), on))
                before[d] = bright
        n = rng.poisson(scene.noise_hz * WINDOW_US * US)
        times.append(rng.integers(t0_us, t0_us + WINDOW_US, n))
        pixels.append(rng.integers(0, scene.width * scene.height, n))
        ons.append(rng.random(n) < 0.5)
        order = np.argsort(np.concatenate(times), kind="stable")
        y_px, x_px = np.divmod(np.concatenate(pixels)[order], scene.width)
        at_us, lit_up = np.concatenate(times)[order], np.concatenate(ons)[order]
        batch = EventBatch(at_us, x_px.astype(np.uint16), y_px.astype(np.uint16), lit_up)
        yield Window(t0_us, t0_us + WINDOW_US, batch, "scene", end=k == last - 1)


def told_apart(each: Crossing) -> Crossing:
    """Return the crossing with two different words."""
    a, b = each.scene.discs
    if a.word == b.word:
        b = replace(b, word=WORDS[(WORDS.index(b.word) + 1) % len(WORDS)])
    return replace(each, scene=replace(each.scene, discs=(a, b)))


def outcome_read(each: Crossing, **settings: object) -> str:
    """Return what became of the names, as `crossings.outcome` does, where the decoder reads both beacons."""
    beacons = tuple(
        Beacon(name=f"b{i}", protocol="seed11", bit_rate=disc.bit_rate, payload=PAYLOADS[WORDS.index(disc.word)])
        for i, disc in enumerate(each.scene.discs)
    )
    context = Context("0", "b00t", lockstep=True)
    tracker = make_core(TrackerConfig(**settings), context)  # type: ignore[arg-type]
    joined = Pipeline(tracker, make_decoder(DecoderConfig(beacons=beacons), context))
    source = SourceCore(EventSourceConfig(), CameraInfo(each.scene.width, each.scene.height))
    published: list[Tracks] = []
    for window in windows(each.scene, 2 * each.half_s):
        published += [m for m in joined.feed(source.feed(window)) if isinstance(m, Tracks)]
    return verdict(each, published)


def outcomes_read(seeds: Iterable[int], kind: Kind, **settings: object) -> Counter[str]:
    """Return how many crossings ended in which way."""
    return Counter(outcome_read(told_apart(crossing(seed, kind)), **settings) for seed in seeds)
