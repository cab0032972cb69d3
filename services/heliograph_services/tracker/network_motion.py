"""Motion from the flow network, as the tracker asks for it.

The pyramid is fed with each message. At the multiples P of `REFRESH_US` within it the surroundings are fitted; what
they carry at a time t is the newest fit of P <= t that is sure enough and no older than `HELD_US`. All grids are
absolute, so nothing depends on how the stream was cut.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.flow import Flow
from heliograph.messages import Message
from heliograph.streams import Onsets
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.flow.kernel import make_runtime
from heliograph_services.tracker.flow.network import FlowNetwork
from heliograph_services.tracker.flow.pyramid import FlowPyramid, FlowSamples
from heliograph_services.tracker.flow.settings import FlowSettings
from heliograph_services.tracker.flow.spikes import Runtime
from heliograph_services.tracker.flow.surroundings import Motion as Surroundings
from heliograph_services.tracker.motion import CONFIDENCE_LEAST, Motion, NoMotion

Floats = npt.NDArray[np.float64]

# A camera that turns round within .2 s at 200 px/s changes its motion by 2000 px/s2: 100 px/s in this.
REFRESH_US: Final = 50_000
# Over a gap of texture the last motion is better than none; later the camera may do something else.
HELD_US: Final = 300_000
# The errors of discs and textures at a confidence above the least are 2 to 25 % and, at the slowest scale, 10 px/s.
ERROR_SHARE: Final = 0.25
ERROR_PX_S: Final = 10.0
# A light's front lies on its rim; noise and the pooling of the coarsest scale move it by so much.
RIM_PX: Final = 3.0
_INT16: Final = np.iinfo(np.int16)


class NetworkMotion:
    """The motion of one stream.

    Args:
        pyramid: of the stream.
        config: settings of the tracker.
    """

    def __init__(self, pyramid: FlowPyramid, config: TrackerConfig) -> None:
        self._pyramid = pyramid
        self._camera = config.camera
        self._period_us = config.period_us
        self._samples_limit = config.flow_samples
        self._carries = config.prediction == "both"
        self._fits: deque[tuple[int, Surroundings]] = deque()
        self._samples: deque[FlowSamples] = deque()
        self._records: list[Message] = []

    def feed(self, onsets: Onsets) -> None:
        """Take the stream's next onsets."""
        samples = self._pyramid.feed(onsets)
        for at_us in _multiples(onsets.t0_us, onsets.t1_us, REFRESH_US) if self._carries else ():
            fit = self._pyramid.surroundings(at_us)
            if fit is not None and fit.confidence >= CONFIDENCE_LEAST:
                self._fits.append((at_us, fit))
        while self._fits and onsets.t0_us - self._fits[0][0] > HELD_US + REFRESH_US:
            self._fits.popleft()
        if self._samples_limit:
            self._samples += samples
            for at_us in _multiples(onsets.t0_us, onsets.t1_us, self._period_us):
                self._records.append(self._record(at_us))

    def velocities(self, x_px: Floats, y_px: Floats, radius_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return what the network sees at places; see `motion.Motion`."""
        seen = self._pyramid.at_places(x_px, y_px, radius_px + RIM_PX, t_us)
        known = seen[:, 2] >= CONFIDENCE_LEAST
        velocity = np.where(known[:, None], seen[:, :2], 0.0)
        return velocity, np.where(known, ERROR_PX_S**2 + ERROR_SHARE**2 * (velocity**2).sum(axis=1), np.inf)

    def carried(self, x_px: Floats, y_px: Floats, t_us: int) -> tuple[Floats, Floats]:
        """Return the motion of the surroundings; see `motion.Motion`."""
        for at_us, fit in reversed(self._fits):
            if at_us <= t_us and t_us - at_us <= HELD_US:
                return np.stack(fit.along(x_px, y_px), axis=1), np.full(len(x_px), fit.confidence)
        return np.zeros((len(x_px), 2)), np.zeros(len(x_px))

    def take(self) -> list[Message]:
        """Return the records made since the last call, one a period."""
        records, self._records = self._records, []
        return records

    def _record(self, at_us: int) -> Flow:
        """Return the record of a period, and drop its samples."""
        mine: list[FlowSamples] = []
        while self._samples and self._samples[0].t_us <= at_us:
            mine.append(self._samples.popleft())
        columns = [
            np.concatenate([getattr(samples, name) for samples in mine]) if mine else np.empty(0)
            for name in ("x_px", "y_px", "vx_px_s", "vy_px_s")
        ]
        # Evenly over the period and the view, whatever their number: no chance, no heap in one corner.
        n = len(columns[0])
        chosen = np.linspace(0, n - 1, min(n, self._samples_limit)).astype(np.int64)
        place = [np.clip(np.rint(c[chosen]), 0, np.iinfo(np.uint16).max).astype(np.uint16) for c in columns[:2]]
        speed = [np.clip(np.rint(c[chosen]), _INT16.min, _INT16.max).astype(np.int16) for c in columns[2:]]
        fit = self._pyramid.surroundings(at_us)
        known = (fit.vx_px_s, fit.vy_px_s, fit.omega_rad_s, fit.zoom_s, fit.x_px, fit.y_px) if fit else (0.0,) * 6
        vx, vy, omega, zoom, x, y = (round(value, 4) + 0.0 for value in known)
        return Flow(
            camera=self._camera,
            as_of_us=at_us,
            period_us=self._period_us,
            confidence=round(fit.confidence, 3) if fit else 0.0,
            vx_px_s=vx,
            vy_px_s=vy,
            omega_rad_s=omega,
            zoom_s=zoom,
            centre_x_px=x,
            centre_y_px=y,
            x_px=place[0],
            y_px=place[1],
            sample_vx_px_s=speed[0],
            sample_vy_px_s=speed[1],
        )


def _multiples(t0_us: int, t1_us: int, step_us: int) -> range:
    """Return the multiples of a step in (t0, t1]."""
    return range((t0_us // step_us + 1) * step_us, t1_us + 1, step_us)


def settings_of(config: TrackerConfig) -> FlowSettings:
    """Return the flow's settings of a tracker's."""
    if config.flow_reading == "paper":
        return FlowSettings.literal(config.flow_l_tau, config.period_us)
    return FlowSettings(l_tau=config.flow_l_tau)


def make_with(runtime: Callable[[FlowNetwork, int, int], Runtime], config: TrackerConfig, first: Onsets) -> Motion:
    """Return the motion of the stream that these onsets are the first of, its networks run by a runtime.

    One pixel has no motion.
    """
    if first.width == first.height == 1:
        return NoMotion()
    pyramid = FlowPyramid(
        settings_of(config),
        width=first.width,
        height=first.height,
        tick_us=first.tick_us,
        pool_px=first.pool_px,
        runtime=runtime,
    )
    return NetworkMotion(pyramid, config)


def make(config: TrackerConfig, first: Onsets) -> Motion:
    """Return the motion of a stream by the fastest exact runtime; see `make_with`."""
    return make_with(make_runtime, config, first)
