"""A camera and the source's core tied together: an iteration of steps, without a clock; who runs it keeps the pace."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import msgspec

from heliograph import onset_dipoles, onsets
from heliograph.core import Context
from heliograph.messages import Message
from heliograph_services.event_source.cameras import open_camera
from heliograph_services.event_source.cameras.contract import Camera
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.core import CameraInfo, SourceCore

# Every step of a lockstep costs a round trip to all services; results do not depend on its length.
LOCKSTEP_WINDOW_US: Final = 10_000


@dataclass(frozen=True, slots=True)
class Step:
    """What happened until t1_us, as records ready to be sent; `end`: nothing follows."""

    t1_us: int
    messages: list[Message]
    end: bool


class SourceStream:
    """The steps of a camera; to be iterated once.

    Args:
        camera: opened; closed when the iteration ends or is given up.
        core: what makes records of its windows; its refusals, counters and gauges are the stream's.
        whole: a step a window; otherwise two: its events, which do not wait for the making of the rest, and the rest.
    """

    def __init__(self, camera: Camera, core: SourceCore, *, whole: bool = True) -> None:
        self.camera = camera
        self._whole = whole
        self.core = core
        self.refusals = core.refusals
        self.counters = core.counters
        self.gauges = core.gauges

    def __iter__(self) -> Iterator[Step]:
        try:
            for window in self.camera.windows():
                if self._whole:
                    yield Step(window.t1_us, self.core.feed(window), window.end)
                    continue
                for k, messages in enumerate(self.core.parts(window)):
                    yield Step(window.t1_us, messages, end=window.end and k == 1)
        finally:
            self.close()

    def close(self) -> None:
        """Let go of the camera."""
        self.camera.close()


def lockstep_window_us(config: EventSourceConfig) -> int:
    """Return the window of a lockstep source: whole messages of onsets, so that a tracker finishes all of a step."""
    return -(-max(config.window_us, LOCKSTEP_WINDOW_US) // config.onsets_us) * config.onsets_us


def open_stream(config: EventSourceConfig, context: Context) -> SourceStream:
    """Return the stream of a configuration: camera open, kernels warm.

    Raises:
        ConfigError: a setting is wrong.
        FileError: the recording cannot be read.
    """
    if context.lockstep:
        config = msgspec.structs.replace(config, window_us=lockstep_window_us(config))
    camera = open_camera(config, context)
    onsets.warm()
    onset_dipoles.warm()
    return SourceStream(camera, SourceCore(config, CameraInfo(camera.width, camera.height)), whole=context.lockstep)


def steps(config: EventSourceConfig, context: Context) -> Iterator[Step]:
    """Yield the steps of a configuration; raises as `open_stream`."""
    yield from open_stream(config, context)
