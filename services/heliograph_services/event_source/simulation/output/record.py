"""A scenario, recorded: from its name to the files that it leaves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Final, Protocol

import msgspec
import numpy as np

from heliograph.errors import ConfigError
from heliograph.events import EventBatch, concatenate
from heliograph.truth import Fidelity, Truth
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.image_file import write_images
from heliograph_services.event_source.cameras.windows import naming_is_complete, stream_name
from heliograph_services.event_source.simulation.contract import CHUNK_US, Drive, Labels, LightChunk
from heliograph_services.event_source.simulation.ground.images import Exposure, pictures
from heliograph_services.event_source.simulation.ground.views import GroundBackground
from heliograph_services.event_source.simulation.lights.chunk import Lights
from heliograph_services.event_source.simulation.output.plot import Picture
from heliograph_services.event_source.simulation.output.truth import Truths
from heliograph_services.event_source.simulation.output.write import Run, Step, Written, write_files, write_truth
from heliograph_services.event_source.simulation.readout.numbers import ImageNumbers
from heliograph_services.event_source.simulation.stream import Piece, SceneStream
from heliograph_services.event_source.simulation.world.load import load_scenario
from heliograph_services.event_source.simulation.world.spec import Scenario

# As a camera tells the truth on the bus; a recording's truth says the same.
TRUTH_PERIOD_US: Final = 50_000
# A recording lasts whole windows of so much.
GRAIN_US: Final = 10_000
# A scene that sends nothing in its first second is named by its size alone.
_NAMING_US: Final = US_PER_S
# Of the truth; what is written to files belongs to no site.
_CAMERA: Final = "cam0"


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What is to be recorded.

    Args:
        scenario: name of a built-in scenario, or the path of a file.
        out: the NPZ file.
        truth: where the truth goes; None: nowhere.
        plot: where a picture goes; None: nowhere.
        seed: of all that is random.
        duration_s: rounded up to GRAIN_US.
        fidelity: of the surroundings.
        labels: whether the NPZ tells what made each event.
        images_hz: images instead of events, so many a second; 0: events.
        sensor: instead of the scenario's; empty: as it says.
        mode: instead of the scenario's; empty: as it says, or the sensor's default where that is another.
    """

    scenario: str
    out: Path
    truth: Path | None = None
    plot: Path | None = None
    seed: int = 0
    duration_s: float = 10.0
    fidelity: Fidelity = "full"
    labels: bool = False
    images_hz: float = 0.0
    sensor: str = ""
    mode: str = ""

    @property
    def duration_us(self) -> int:
        """The recording's length."""
        return -(-round(self.duration_s * US_PER_S) // GRAIN_US) * GRAIN_US


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a recording holds: of events or of images, and what the read-out lost, by reason."""

    run: Run
    events: int
    images: int
    frames: int
    lost: dict[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A stretch of a recording (`write.Step`)."""

    t1_us: int
    batch: EventBatch
    labels: Labels
    truth: Truth
    end: bool


class Outside(Protocol):
    """Who drives lights from outside (`cameras.senders.Senders`)."""

    def follow(self, drives: Sequence[Drive]) -> None:
        """Take the streams among a scene's drives."""
        ...

    def wait(self, until_us: int) -> None:
        """Wait until they are known up to a time."""
        ...


def record(order: Order, outside: Outside, progress: Callable[[float], None] | None = None) -> Recorded:
    """Record a scenario.

    Args:
        order: what is to be recorded.
        outside: waits for edges from outside.
        progress: is told how many seconds are done.

    Raises:
        ConfigError: the scenario is none, or the order contradicts itself.
        FileError: a file cannot be read or written.
    """
    if not order.duration_s > 0:
        raise ConfigError(f"duration must be positive, not {order.duration_s:g} s")
    if order.images_hz and (order.labels or order.plot):
        raise ConfigError("labels and a picture are made of events, not of images")
    scene = SceneStream(_scenario(order), order.seed, order.fidelity, await_edges=outside.wait)
    outside.follow(scene.drives)
    if order.images_hz:
        return _images(order, scene, outside, progress)
    pieces = iter(scene)
    first = list(_until_named(pieces))
    stream = stream_name(
        scene.sensor.width, scene.sensor.height, concatenate([EventBatch.empty(), *(piece.batch for piece in first)])
    )
    run = _run(order, scene, stream)
    picture = None if order.plot is None else Picture(order.plot, run, scene.world)

    def watch(step: Step) -> None:
        if picture is not None:
            picture.watch(step)
        if progress is not None:
            progress(step.t1_us / US_PER_S)

    cuts = steps_of(chain(first, pieces), _truths(scene), order.duration_us)
    written: Written = write_files(run, cuts, order.out, order.truth, labels=order.labels, watch=watch)
    if picture is not None:
        picture.save()
    lost = {name.removeprefix("lost: "): n for name, n in scene.counters.items() if name.startswith("lost") and n}
    return Recorded(run, written.events, 0, written.frames, lost)


def steps_of(pieces: Iterable[Piece], truths: Truths, duration_us: int) -> Iterator[Cut]:
    """Yield a stream's events and its truth in stretches of TRUTH_PERIOD_US, the last one as long as is left."""
    batches: list[EventBatch] = [EventBatch.empty()]
    labels: list[Labels] = [np.empty(0, np.int16)]
    t0_us = 0
    for piece in pieces:
        batches.append(piece.batch)
        labels.append(piece.labels)
        while piece.until_us >= (t1_us := min(t0_us + TRUTH_PERIOD_US, duration_us)):
            batch, cause = concatenate(batches), np.concatenate(labels)
            stop = int(np.searchsorted(batch.t_us, t1_us))
            end = t1_us == duration_us
            yield Cut(t1_us, batch.part(0, stop), cause[:stop], truths.window(t0_us, t1_us), end)
            if end:
                return
            batches, labels = [batch.part(stop, len(batch))], [cause[stop:]]
            t0_us = t1_us


def _images(order: Order, scene: SceneStream, outside: Outside, progress: Callable[[float], None] | None) -> Recorded:
    sensor, duration_us = scene.sensor, order.duration_us
    exposure = Exposure(order.images_hz)
    if isinstance(sensor.readout, ImageNumbers):
        numbers = sensor.readout
        exposure = Exposure(
            order.images_hz, numbers.exposure_us, numbers.grey_per_w_m2, numbers.background_grey
        )  # fmt: skip
    lights = Lights(scene.drives, scene.world)

    def chunks() -> Iterator[LightChunk]:
        t0_us = 0
        while True:
            outside.wait(t0_us + CHUNK_US)
            where = scene.world.chunk_geometry(t0_us)
            yield lights.chunk(t0_us, (where.x_px, where.y_px, where.sigma_px, where.flux_w_m2))
            t0_us += CHUNK_US
            if progress is not None:
                progress(min(t0_us, duration_us) / US_PER_S)

    background = GroundBackground(scene.world, sensor.pixel.dark_w_m2, scene.fidelity)
    taken = pictures(background, sensor.pixel.dark_w_m2, exposure, chunks(), duration_us)
    images = write_images(order.out, sensor.width, sensor.height, taken)
    run = _run(order, scene, stream_name(sensor.width, sensor.height, EventBatch.empty()))
    truths = _truths(scene)
    bounds = range(0, duration_us, TRUTH_PERIOD_US)
    frames = write_truth(
        run, (truths.window(t0, min(t0 + TRUTH_PERIOD_US, duration_us)) for t0 in bounds), order.truth
    )  # fmt: skip
    return Recorded(run, 0, images, frames, {})


def _scenario(order: Order) -> Scenario:
    scenario = load_scenario(order.scenario)
    camera = scenario.camera
    if order.sensor and order.sensor != camera.sensor:
        # Modes and overrides are those of another sensor's preset.
        camera = msgspec.structs.replace(camera, sensor=order.sensor, mode="", override={})
    if order.mode:
        camera = msgspec.structs.replace(camera, mode=order.mode)
    return msgspec.structs.replace(scenario, camera=camera)


def _until_named(pieces: Iterator[Piece]) -> Iterator[Piece]:
    """Yield pieces until they name the stream, as a camera that plays the file names it."""
    found = EventBatch.empty()
    for piece in pieces:
        yield piece
        found = concatenate([found, piece.batch])
        if naming_is_complete(found) or piece.until_us >= _NAMING_US:
            return


def _run(order: Order, scene: SceneStream, stream: str) -> Run:
    lens = scene.world.scenario.camera.lens
    return Run(
        scenario=order.scenario,
        seed=order.seed,
        fidelity=order.fidelity,
        stream=stream,
        duration_us=order.duration_us,
        sensor=scene.sensor,
        focal_mm=lens.focal_mm,
        f_number=lens.f_number,
        beacons=scene.world.beacons,
    )


def _truths(scene: SceneStream) -> Truths:
    return Truths(scene.world, scene.drives, _CAMERA, scene.sensor.name, scene.fidelity)
