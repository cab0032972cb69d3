"""A scenario as a stream of events: the parts of the simulation tied together, without a clock.

For each chunk of lights (20 ms) and each interval between two views within it: pixels, then the read-out. Everything
lies on absolute times, so that who asks in what portions changes nothing. A sensor of the kind `images` compares
images instead (`ground.images.ImageCamera`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from heliograph.events import EventBatch
from heliograph.truth import Fidelity
from heliograph_services.event_source.simulation.contract import (
    CHUNK_US,
    Background,
    Drive,
    Labels,
    LightChunk,
    Readout,
)
from heliograph_services.event_source.simulation.ground.images import Exposure, ImageCamera, Picture, Pictures
from heliograph_services.event_source.simulation.ground.views import GroundBackground
from heliograph_services.event_source.simulation.lights import drive_of
from heliograph_services.event_source.simulation.lights.chunk import Lights
from heliograph_services.event_source.simulation.pixel.array import PixelArray
from heliograph_services.event_source.simulation.readout.presets import Sensor, load_preset, readout_of
from heliograph_services.event_source.simulation.world.spec import Scenario
from heliograph_services.event_source.simulation.world.world import World

# Of the images for people: long enough that a blinking LED glows.
IMAGE_EXPOSURE_US: Final = 10_000.0


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """The next events of a stream, and what caused each; there are no more before until_us. Images, where wanted."""

    batch: EventBatch
    labels: Labels
    until_us: int
    pictures: tuple[Picture, ...] = ()


class _Engine(Protocol):
    """What turns a chunk of lights into events."""

    counters: dict[str, int]

    def pieces(self, chunk: LightChunk) -> Iterator[Piece]:
        """Yield the events of the chunk's time."""
        ...


class _Images:
    """Images that are compared."""

    def __init__(self, camera: ImageCamera) -> None:
        self._camera = camera
        self.counters = camera.counters

    def pieces(self, chunk: LightChunk) -> Iterator[Piece]:
        for part in self._camera.pieces(chunk):
            yield Piece(part.batch, part.labels, part.until_us)


class _Pixels:
    """Pixels that work on their own, and a read-out behind them."""

    def __init__(self, background: Background, pixels: PixelArray, readout: Readout) -> None:
        self._background = background
        self._pixels = pixels
        self._readout = readout
        self.counters = readout.counters

    def pieces(self, chunk: LightChunk) -> Iterator[Piece]:
        t0_us = chunk.t0_us
        while t0_us < chunk.t0_us + CHUNK_US:
            t1_us = self._background.next_us(t0_us)
            view0, view1 = self._background.view(t0_us), self._background.view(t1_us)
            events = self._pixels.interval(t0_us, t1_us, view0, view1, chunk)
            batch, labels = self._readout.feed(events, float(t1_us))
            yield Piece(batch, labels, self._readout.until_us)
            t0_us = t1_us


class SceneStream:
    """The events of a scenario in order of time; to be read once.

    Args:
        scenario: checked by the loader.
        seed: of all that is random.
        fidelity: "full", or "live": a coarser rendering of the surroundings.
        image_hz: images a second of the view, for people; 0: none.
        await_edges: called before each chunk of lights with its end: waits for who drives lights from outside.

    Raises:
        ConfigError: the sensor is none, or a light cannot send what it is to send.
        FileError: a file of edges cannot be read.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        fidelity: Fidelity = "full",
        image_hz: float = 0.0,
        await_edges: Callable[[int], None] | None = None,
    ) -> None:
        camera = scenario.camera
        self.sensor: Sensor = load_preset(camera.sensor, camera.mode, camera.override)
        self.fidelity: Fidelity = fidelity
        self.world = World(scenario, self.sensor.width, self.sensor.height, self.sensor.pitch_um, seed)
        self.drives: list[Drive] = [
            *(drive_of(spec, seed, i) for i, spec in enumerate(self.world.beacons)),
            *(drive_of(spec, seed, i) for i, spec in enumerate(self.world.clutter, len(self.world.beacons))),
        ]
        self._lights = Lights(self.drives, self.world)
        self._engine = self._engine_of(seed)
        self._t0_us = 0
        self._await_edges = await_edges
        self._pictures = self._pictures_at(image_hz) if image_hz else None

    @property
    def counters(self) -> dict[str, int]:
        """What the read-out lost, by reason."""
        return self._engine.counters

    def __iter__(self) -> Iterator[Piece]:
        """Yield the pieces without end."""
        until_us = 0
        while True:
            if self._await_edges is not None:
                self._await_edges(self._t0_us + CHUNK_US)
            where = self.world.chunk_geometry(self._t0_us)
            chunk = self._lights.chunk(self._t0_us, (where.x_px, where.y_px, where.sigma_px, where.flux_w_m2))
            self._t0_us += CHUNK_US
            if self._pictures is not None:
                taken = tuple(self._pictures.feed(chunk))
                # Without events, which the read-out may still hold: it says nothing new of how far they go.
                yield Piece(EventBatch.empty(), np.empty(0, np.int16), until_us, taken)
            for piece in self._engine.pieces(chunk):
                until_us = piece.until_us
                yield piece

    def _pictures_at(self, image_hz: float) -> Pictures:
        # A view of its own, and a coarse one: the pixels' views lie at other times.
        background = GroundBackground(self.world, self.sensor.pixel.dark_w_m2, "live")
        return Pictures(background, self.sensor.pixel.dark_w_m2, Exposure(image_hz, IMAGE_EXPOSURE_US))

    def _engine_of(self, seed: int) -> _Engine:
        background = GroundBackground(self.world, self.sensor.pixel.dark_w_m2, self.fidelity)
        if self.sensor.kind == "images":
            return _Images(ImageCamera(self.sensor, background, self.world, seed))
        pixels = PixelArray(self.sensor.pixel, self.sensor.width, self.sensor.height, seed, background.view(0))
        return _Pixels(background, pixels, readout_of(self.sensor, seed))
