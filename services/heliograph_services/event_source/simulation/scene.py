"""Events of a scenario, in steps of 10 ms. Each step depends on scenario, seed and its own number alone.

An LED is a disc: the pixels whose centres lie within `radius_px` of its own. Three things make events:

- an edge: every pixel of the disc sends `events_per_edge` events of the new polarity, the k-th (from 0) at
  ``t = t_edge + latency + k spacing + N(0, jitter)``, never before the edge;
- motion of a lit disc, from one instant to the next (edges, and every millisecond): a pixel that it has reached sends
  an ON, one that it has left an OFF, some time between the two;
- noise: Poisson in time, uniform over the sensor, either polarity.

Random numbers come from Philox with the key (seed, step), so that no cutting of the stream changes them.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch, concatenate
from heliograph_services.event_source.simulation.emitter import Emitter, emitter_of
from heliograph_services.event_source.simulation.scenario import Scenario

STEP_US: Final = 10_000
# The fastest beacon allowed moves 10 px in a millisecond, one of the demo's at most .3.
MOTION_US: Final = 1_000
# Between two events of a pixel after one edge. Recordings of real beacons show edges spread over 72 to 285 us with
# 1.5 to 3.8 hundred events over the blob; three events of a pixel over 50 us are of that kind.
SPACING_US: Final = 25.0
# Events of a step lie in it or in the next one: no latency reaches further than this behind its cause.
LATEST_US: Final = STEP_US - 1

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Scene:
    """Generates the events of a scenario step by step.

    Args:
        scenario: what is to be seen.
        seed: of all that is random.

    Raises:
        ConfigError: a beacon cannot send what it is to send.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario = scenario
        self.emitters: list[Emitter] = [emitter_of(spec) for spec in scenario.beacons]
        self._seed = seed

    def caused(self, step: int) -> EventBatch:
        """Return the events whose causes lie in [step, step + 1) * STEP_US, in no order.

        Their own times lie between the step's beginning and the end of the next.
        """
        random = np.random.Generator(np.random.Philox(key=np.array([self._seed, step], np.uint64)))
        t0_us = step * STEP_US
        parts = [self._noise(t0_us, random)]
        for i in range(len(self.emitters)):
            parts += self._beacon(i, t0_us, random)
        return self._on_sensor(concatenate(parts))

    def _beacon(self, i: int, t0_us: int, random: np.random.Generator) -> list[EventBatch]:
        emitter, spec = self.emitters[i], self.scenario.beacons[i]
        edge_us, edge_on = emitter.edges(t0_us, t0_us + STEP_US)
        grid_us = np.arange(t0_us, t0_us + STEP_US + 1, MOTION_US, dtype=np.float64)
        instants = np.sort(np.concatenate([grid_us, edge_us]))
        x_px, y_px = spec.path.at(instants)
        # The square of pixels that holds the disc at two instants in a row.
        reach = np.maximum(np.abs(np.diff(x_px)), np.abs(np.diff(y_px))).max()
        half = int(np.ceil(spec.radius_px + reach)) + 1
        side = np.arange(-half, half + 1)
        dx, dy = (d.ravel() for d in np.meshgrid(side, side))
        at_edge = np.searchsorted(instants, edge_us)
        return [
            self._edge_events(edge_us, edge_on, x_px[at_edge], y_px[at_edge], dx, dy, i, random),
            self._motion_events(instants, emitter, x_px, y_px, dx, dy, spec.radius_px, random),
        ]

    def _edge_events(
        self, edge_us: Floats, edge_on: npt.NDArray[np.bool_], x_px: Floats, y_px: Floats, dx: Ints, dy: Ints, i: int,
        random: np.random.Generator,
    ) -> EventBatch:  # fmt: skip
        spec = self.scenario.beacons[i]
        x, y, covered = _disc(x_px, y_px, x_px, y_px, dx, dy, spec.radius_px)
        edge, place = np.nonzero(covered)
        fewest, most = spec.events_per_edge
        counts = random.integers(fewest, most + 1, len(edge))
        first = np.cumsum(counts) - counts
        k = np.arange(int(counts.sum())) - np.repeat(first, counts)
        edge, place = np.repeat(edge, counts), np.repeat(place, counts)
        delay_us = self.scenario.latency_us + k * SPACING_US
        delay_us += random.standard_normal(len(k)) * self.scenario.jitter_us
        t_us = edge_us[edge] + np.clip(delay_us, 0.0, LATEST_US)
        return _batch(t_us, x[edge, place], y[edge, place], edge_on[edge])

    def _motion_events(
        self, instants: Floats, emitter: Emitter, x_px: Floats, y_px: Floats, dx: Ints, dy: Ints, radius_px: float,
        random: np.random.Generator,
    ) -> EventBatch:  # fmt: skip
        x, y, before = _disc(x_px[:-1], y_px[:-1], x_px[:-1], y_px[:-1], dx, dy, radius_px)
        _, _, after = _disc(x_px[1:], y_px[1:], x_px[:-1], y_px[:-1], dx, dy, radius_px)
        # No edge lies between two instants, so the light in the middle is the light throughout.
        lit = emitter.lit((instants[:-1] + instants[1:]) / 2)
        interval, place = np.nonzero((before != after) & lit[:, None])
        when = random.random(len(interval))
        t_us = instants[interval] + when * (instants[interval + 1] - instants[interval])
        t_us += min(self.scenario.latency_us, LATEST_US - MOTION_US)
        return _batch(t_us, x[interval, place], y[interval, place], after[interval, place])

    def _noise(self, t0_us: int, random: np.random.Generator) -> EventBatch:
        n = int(random.poisson(self.scenario.noise_hz * STEP_US / 1e6))
        t_us = t0_us + random.random(n) * STEP_US
        x = random.integers(0, self.scenario.width, n)
        y = random.integers(0, self.scenario.height, n)
        return _batch(t_us, x, y, random.random(n) < 0.5)

    def _on_sensor(self, batch: EventBatch) -> EventBatch:
        # Coordinates left of or above the sensor have wrapped to the end of uint16.
        good = (batch.x_px < self.scenario.width) & (batch.y_px < self.scenario.height)
        return EventBatch(batch.t_us[good], batch.x_px[good], batch.y_px[good], batch.on[good])


def _disc(
    x_px: Floats, y_px: Floats, base_x_px: Floats, base_y_px: Floats, dx: Ints, dy: Ints, radius_px: float
) -> tuple[Ints, Ints, npt.NDArray[np.bool_]]:
    """Return columns, rows and cover, (centres, places) each, of the squares of pixels about the bases."""
    x = np.floor(base_x_px).astype(np.int64)[:, None] + dx[None, :]
    y = np.floor(base_y_px).astype(np.int64)[:, None] + dy[None, :]
    covered = (x - x_px[:, None]) ** 2 + (y - y_px[:, None]) ** 2 <= radius_px**2
    return x, y, covered


def _batch(t_us: Floats, x: Ints, y: Ints, on: npt.NDArray[np.bool_]) -> EventBatch:
    return EventBatch(np.floor(t_us).astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), on)


class SceneStream:
    """The events of a scene in order of time.

    Args:
        scene: where they come from.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._step = 0
        self._late = EventBatch.empty()

    @property
    def until_us(self) -> int:
        """The time before which all events have been given."""
        return self._step * STEP_US

    def next(self) -> EventBatch:
        """Return the events of the next step, sorted by time; of equal times, in an order that never changes."""
        batch = concatenate([self._late, self._scene.caused(self._step)])
        self._step += 1
        order = np.argsort(batch.t_us, kind="stable")
        batch = EventBatch(batch.t_us[order], batch.x_px[order], batch.y_px[order], batch.on[order])
        stop = int(np.searchsorted(batch.t_us, self.until_us))
        self._late = batch.part(stop, len(batch))
        return batch.part(0, stop)
