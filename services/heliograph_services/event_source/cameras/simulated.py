"""The simulated camera: a scenario of `simulation/`, with its truth, from time 0 on."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import chain
from typing import Final

import numpy as np

from heliograph.camera import Intrinsics
from heliograph.core import Context
from heliograph.events import EventBatch, concatenate
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.cameras.senders import Senders
from heliograph_services.event_source.cameras.windows import Cutter, naming_is_complete, stream_name
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.simulation.contract import Labels
from heliograph_services.event_source.simulation.ground.images import Picture, view_image
from heliograph_services.event_source.simulation.output.truth import Truths
from heliograph_services.event_source.simulation.stream import Piece, SceneStream
from heliograph_services.event_source.simulation.world.load import load_scenario

# A scene that sends nothing in its first second is named by its size alone.
_NAMING_US: Final = US_PER_S
# The truth goes out once for so much time, at the end of a window: one a window of 2 ms would be 400 kB/s on the bus.
TRUTH_PERIOD_US: Final = 50_000


class SimulatedCamera:
    """A camera that sees a scenario.

    Args:
        config: scenario, seed, fidelity, duration_s, window_us, image_hz, camera.
        context: not used: a scene is the same in every process.

    Raises:
        ConfigError: the scenario does not exist, or is none.
        FileError: a file of edges cannot be read.
    """

    def __init__(self, config: EventSourceConfig, context: Context) -> None:  # noqa: ARG002 - see the class
        self._config = config
        self._senders = Senders()
        self.scene = SceneStream(
            load_scenario(config.scenario), config.seed, config.fidelity, config.image_hz, self._senders.wait
        )
        self._senders.follow(self.scene.drives)
        self._truths = Truths(
            self.scene.world, self.scene.drives, config.camera, self.scene.sensor.name, config.fidelity
        )
        self.width, self.height = self.scene.sensor.width, self.scene.sensor.height
        self.intrinsics: Intrinsics | None = None
        self._pieces = iter(self.scene)
        self._first = deque(self._until_named())
        self.stream = stream_name(self.width, self.height, concatenate([piece.batch for piece in self._first]))

    def close(self) -> None:
        """Let go of the files and terminals that drive lights."""
        self._senders.close()

    def windows(self) -> Iterator[Window]:
        """Yield the windows of the scene (`contract.Camera`); without duration_s they never end."""
        cutter = Cutter(self._config.window_us, 0)
        # Whole windows, at least as long as the duration; 0, which none is numbered, where it has no end.
        windows = -(-round(self._config.duration_s * US_PER_S) // self._config.window_us)
        given = 0
        told_us = 0  # the truth is out before this time
        causes = _Causes()
        images: deque[Picture] = deque()
        for piece in chain(_drained(self._first), self._pieces):
            causes.put(piece.labels)
            images.extend(piece.pictures)
            for t0_us, t1_us, events in cutter.push(piece.batch, piece.until_us):
                given += 1
                end = given == windows
                truth = None
                if t1_us - told_us >= TRUTH_PERIOD_US or end:
                    truth = self._truths.window(told_us, t1_us)
                    told_us = t1_us
                image = None
                while images and images[0].t_us <= t1_us:
                    image = view_image(images.popleft(), self._config.camera, self.stream)
                yield Window(
                    t0_us,
                    t1_us,
                    events,
                    self.stream,
                    truth=truth,
                    labels=causes.take(len(events)),
                    image=image,
                    refused=self._senders.refused(),
                    end=end,
                )
                if end:
                    return

    def _until_named(self) -> Iterator[Piece]:
        found = [EventBatch.empty()]
        for piece in self._pieces:
            yield piece
            found = [concatenate([*found, piece.batch])]
            if naming_is_complete(found[0]) or piece.until_us >= _NAMING_US:
                return


class _Causes:
    """The causes of events, in their order, given out window by window."""

    def __init__(self) -> None:
        self._held: Labels = np.empty(0, np.int16)

    def put(self, labels: Labels) -> None:
        if len(labels):
            self._held = np.concatenate([self._held, labels])

    def take(self, n: int) -> Labels:
        given, self._held = self._held[:n], self._held[n:]
        return given


def _drained(pieces: deque[Piece]) -> Iterator[Piece]:
    while pieces:
        yield pieces.popleft()
