"""The same scene as images, and the paper's own simulated camera, which compares them.

An image of the time t has collected light over [t - exposure, t], cut at the scene's beginning::

    grey = min(255, floor(g (surroundings + lights) + 1/2))

with the surroundings in the middle of the exposure (they do not blur), the lights' mean over it (they do), and g in
grey levels per W/m2: given, or such that the surroundings' mean at the beginning has a stated grey, for all of the
scene. There is no noise: a renderer has none.

The camera `nrp` (Neurorobotics Platform, gazebo_dvs_plugin): an event where an image differs from the reference by more
than a threshold of grey levels; at most one a pixel and image; its time stamp is that of its publication.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch
from heliograph.streams import Image
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.changes import Counts, Grey, ImageChanges, events_of
from heliograph_services.event_source.simulation.contract import (
    BACKGROUND,
    CHUNK_US,
    NODE_US,
    Labels,
    LightChunk,
)
from heliograph_services.event_source.simulation.ground.light import add_lights
from heliograph_services.event_source.simulation.ground.views import GroundBackground
from heliograph_services.event_source.simulation.random import READOUT, normals
from heliograph_services.event_source.simulation.readout.numbers import ImageNumbers, Sensor
from heliograph_services.event_source.simulation.world.world import World


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """An image, and where its lights are.

    Args:
        index: the n-th image, from 0.
        t_us: end of its exposure, n / image_hz.
        grey: (height, width) uint8.
        most: (height, width) float64, the grey levels that the strongest light alone has added.
        owner: (height, width) int16, that light's index where most > 0.
    """

    index: int
    t_us: float
    grey: Grey
    most: npt.NDArray[np.float64]
    owner: Labels


@dataclass(frozen=True, slots=True)
class Exposure:
    """How images are taken.

    Args:
        image_hz: images a second, the first at time 0.
        exposure_us: 0: an instant.
        grey_per_w_m2: g; 0: so that the surroundings have background_grey.
        background_grey: mean of the surroundings at time 0.
    """

    image_hz: float
    exposure_us: float = 0.0
    grey_per_w_m2: float = 0.0
    background_grey: float = 100.0


class Pictures:
    """Takes the images of a scene, chunk after chunk of its lights.

    Args:
        background: the surroundings.
        dark_w_m2: of the sensor: the views contain it, images do not.
        exposure: see there.
    """

    def __init__(self, background: GroundBackground, dark_w_m2: float, exposure: Exposure) -> None:
        self._background = background
        self._dark_w_m2 = dark_w_m2
        self._exposure = exposure
        self._chunks: deque[LightChunk] = deque()
        self._next = 0
        self._gain = exposure.grey_per_w_m2
        if not self._gain:
            mean = float(np.exp(background.at(0.0)).mean(dtype=np.float64)) - dark_w_m2
            self._gain = exposure.background_grey / max(mean, 1e-12)

    @property
    def gain(self) -> float:
        """Return g, grey levels per W/m2."""
        return self._gain

    @property
    def next_us(self) -> float:
        """Return the time of the next image."""
        return self._next * US_PER_S / self._exposure.image_hz

    def feed(self, chunk: LightChunk) -> Iterator[Picture]:
        """Yield the images whose exposure ends within the chunk; chunks come one after another from 0 on."""
        self._chunks.append(chunk)
        while self.next_us < chunk.t0_us + CHUNK_US:
            yield self._taken(self._next, self.next_us)
            self._next += 1
        needed_us = self.next_us - self._exposure.exposure_us
        while self._chunks and self._chunks[0].t0_us + CHUNK_US <= min(needed_us, chunk.t0_us + CHUNK_US):
            self._chunks.popleft()

    def _taken(self, index: int, t_us: float) -> Picture:
        begin_us = max(0.0, t_us - self._exposure.exposure_us)
        light = np.exp(self._background.at(0.5 * (begin_us + t_us))).astype(np.float64) - self._dark_w_m2
        most, owner = np.zeros_like(light), np.full(light.shape, BACKGROUND, np.int16)
        for c in self._chunks:
            a_us, b_us = max(begin_us, float(c.t0_us)), min(t_us, float(c.t0_us + CHUNK_US))
            # An instant belongs to the chunk that begins with it; an exposure takes nothing of that one.
            if (a_us < b_us) if begin_us < t_us else (c.t0_us <= t_us < c.t0_us + CHUNK_US):
                add_lights(
                    float(c.t0_us), float(NODE_US), c.x_px, c.y_px, c.sigma_px, c.flux_w_m2, c.level0, c.edge_first,
                    c.edge_us, c.edge_level, a_us, b_us, t_us - begin_us, light, most, owner,
                )  # fmt: skip
        light *= self._gain
        light += 0.5
        most *= self._gain
        return Picture(index, t_us, np.minimum(light, 255.0).astype(np.uint8), most, owner)


def pictures(
    background: GroundBackground, dark_w_m2: float, exposure: Exposure, chunks: Iterable[LightChunk], duration_us: float
) -> Iterator[tuple[int, Grey]]:
    """Yield time (whole us) and image up to a duration, as `cameras.image_file.write_images` takes them."""
    taker = Pictures(background, dark_w_m2, exposure)
    for chunk in chunks:
        for picture in taker.feed(chunk):
            if picture.t_us >= duration_us:
                return
            yield round(picture.t_us), picture.grey
        if taker.next_us >= duration_us:
            return


def view_image(picture: Picture, camera: str, stream: str) -> Image:
    """Return a picture as the record that goes out on the bus."""
    return Image(camera=camera, stream=stream, t_us=round(picture.t_us), grey=picture.grey)


@dataclass(frozen=True, slots=True, eq=False)
class ImageEvents:
    """The events of an image or none, their causes, and a time before which nothing more comes."""

    batch: EventBatch
    labels: Labels
    until_us: int


class ImageCamera:
    """A sensor of the kind `images`, in place of pixels and read-out.

    Args:
        sensor: its readout are `ImageNumbers`.
        background: the surroundings.
        world: not needed but for its size.
        seed: of the time stamps' jitter.

    Raises:
        ValueError: the sensor has event pixels.
    """

    def __init__(self, sensor: Sensor, background: GroundBackground, world: World, seed: int) -> None:
        if not isinstance(sensor.readout, ImageNumbers):
            raise ValueError(f"sensor {sensor.name} must be of the kind images, not {sensor.kind}")
        numbers = sensor.readout
        self.counters: dict[str, int] = {"images": 0, "saturated pixels": 0}
        self._numbers = numbers
        self._width = world.width
        self._seed = seed
        self._pictures = Pictures(
            background,
            sensor.pixel.dark_w_m2,
            Exposure(numbers.image_hz, numbers.exposure_us, numbers.grey_per_w_m2, numbers.background_grey),
        )
        self._changes = ImageChanges(numbers.threshold_grey, "linear", 1, numbers.reference)
        self._last: Picture | None = None
        self._stamp_us = 0

    def pieces(self, chunk: LightChunk) -> Iterator[ImageEvents]:
        """Yield the events of the images that end in a chunk, and at last how far they go."""
        for picture in self._pictures.feed(chunk):
            counts = self._changes.feed(picture.grey)
            self.counters["images"] += 1
            self.counters["saturated pixels"] += int(np.count_nonzero(picture.grey == 255))
            stamp_us = self._stamped(picture)
            if counts is not None:
                batch = events_of(counts, stamp_us, self._width)
                yield ImageEvents(batch, self._causes(counts, picture), stamp_us)
            self._last = picture
        # The next image is published after its own time, and not before the last one was.
        until_us = min(chunk.t0_us + CHUNK_US, math.floor(self._pictures.next_us))
        yield ImageEvents(EventBatch.empty(), np.empty(0, np.int16), max(self._stamp_us, until_us))

    def _stamped(self, picture: Picture) -> int:
        """Return when an image's events are published: never before the image, or the events of the one before."""
        numbers = self._numbers
        jitter_us = 0.0
        if numbers.jitter_us:
            jitter_us = numbers.jitter_us * float(normals(self._seed, READOUT, picture.index)[()])
        delay_us = max(0.0, numbers.delay_us + jitter_us)
        self._stamp_us = max(self._stamp_us, round(picture.t_us + delay_us))
        return self._stamp_us

    def _causes(self, counts: Counts, picture: Picture) -> Labels:
        """Return the light behind each event: the strongest of the two images, where it alone is half a threshold."""
        where = np.flatnonzero(counts)
        most, owner = picture.most.reshape(-1)[where], picture.owner.reshape(-1)[where]
        if self._last is not None:
            before = self._last.most.reshape(-1)[where]
            owner = np.where(before > most, self._last.owner.reshape(-1)[where], owner)
            most = np.maximum(before, most)
        return np.where(most >= 0.5 * self._numbers.threshold_grey, owner, BACKGROUND).astype(np.int16)
