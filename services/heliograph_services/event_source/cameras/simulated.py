"""The simulated camera: a scene of `simulation/`, with its truth, from time 0 on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from heliograph.camera import Intrinsics
from heliograph.core import Context
from heliograph.events import EventBatch, concatenate
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.cameras.windows import Cutter, naming_is_complete, stream_name
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.simulation.scenario import load_scenario
from heliograph_services.event_source.simulation.scene import STEP_US, Scene, SceneStream
from heliograph_services.event_source.simulation.truth import truth_of

# A scene that sends nothing in its first second is named by its size alone.
_NAMING_STEPS: Final = US_PER_S // STEP_US
# The truth goes out once for so much time, at the end of a window: one a window of 2 ms would be 400 kB/s on the bus.
TRUTH_PERIOD_US: Final = 50_000


class SimulatedCamera:
    """A camera that sees a scenario.

    Args:
        config: scenario, seed, duration_s, window_us, camera.
        context: not used: a scene is the same in every process.

    Raises:
        ConfigError: the scenario does not exist, or is none.
    """

    def __init__(self, config: EventSourceConfig, context: Context) -> None:  # noqa: ARG002 - see the class
        self._config = config
        scenario = load_scenario(config.scenario)
        self.width, self.height = scenario.width, scenario.height
        self.intrinsics: Intrinsics | None = None
        self._scene = Scene(scenario, config.seed)
        self.stream = stream_name(self.width, self.height, self._first_events())

    def close(self) -> None:
        """Do nothing: a scene holds nothing."""

    def windows(self) -> Iterator[Window]:
        """Yield the windows of the scene (`contract.Camera`); without duration_s they never end."""
        stream = SceneStream(self._scene)
        cutter = Cutter(self._config.window_us, 0)
        # Whole windows, at least as long as the duration; 0, which none is numbered, where it has no end.
        windows = -(-round(self._config.duration_s * US_PER_S) // self._config.window_us)
        given = 0
        told_us = 0  # the truth is out before this time
        while True:
            batch = stream.next()
            for t0_us, t1_us, events in cutter.push(batch, stream.until_us):
                given += 1
                end = given == windows
                truth = None
                if t1_us - told_us >= TRUTH_PERIOD_US or end:
                    truth = truth_of(self._scene, self._config.camera, told_us, t1_us)
                    told_us = t1_us
                yield Window(t0_us, t1_us, events, self.stream, truth=truth, end=end)
                if end:
                    return

    def _first_events(self) -> EventBatch:
        stream = SceneStream(self._scene)
        found = [EventBatch.empty()]
        for _ in range(_NAMING_STEPS):
            found.append(stream.next())
            first = concatenate(found)
            if naming_is_complete(first):
                break
        return concatenate(found)
