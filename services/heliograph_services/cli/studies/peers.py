"""Other people's decoders in the studies: events in, frames out (docs/compare.md).

A peer is made once for a scene by a factory, `MODULE:NAME` on the command line, which is told what ours is told:
protocol and nominal bit rate. It is fed with the camera's events, a window at a time, and returns the frames that it
reads: when each ended, its payload, and where the beacon was. It finds its beacons itself; a frame at the wrong place
is an insertion. `paper` is the example: the paper's receiver, behind our tracker.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from heliograph.errors import ConfigError
from heliograph.messages import Frames, Message
from heliograph.streams import Events
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.core import CameraInfo, SourceCore
from heliograph_services.tracker.config import TrackerConfig


@dataclass(frozen=True, slots=True)
class Told:
    """What a decoder is told of a scene.

    Args:
        protocol: of all its beacons.
        bit_rate: of all, nominal; the beacons' clocks are off by up to 400 ppm.
    """

    protocol: str
    bit_rate: float


@dataclass(frozen=True, slots=True)
class Read:
    """A frame that was read.

    Args:
        t_us: camera time at which it ended.
        payload: its data bits as a number; of text, the character's code.
        x_px: the beacon's centre then.
        y_px: likewise.
    """

    t_us: int
    payload: int
    x_px: float
    y_px: float


class Peer(Protocol):
    """A decoder that can be compared."""

    def feed(self, events: Events) -> Iterable[Read]:
        """Take the events of [t0_us, t1_us), sorted by time; return the frames that are decided.

        Args:
            events: of a camera of width x height pixels: batch.t_us (n,) int64, x_px and y_px (n,) uint16, on (n,)
                bool; `end` with the last ones. Windows follow each other without a gap; n may be 0.
        """


Factory = Callable[[Told], Peer]


def is_peer(arm: str) -> bool:
    """Return whether an arm's name is that of a peer."""
    return ":" in arm


def factory_of(name: str) -> Factory:
    """Return the factory of MODULE:NAME.

    Raises:
        ConfigError: there is no such module, or nothing that can be called of that name in it.
    """
    module, _, made = name.partition(":")
    try:
        found = getattr(import_module(module), made, None)
    except ImportError as error:
        raise ConfigError(f"a peer must be MODULE:NAME of a factory, not {name!r}: {error}") from None
    if not callable(found):
        raise ConfigError(f"a peer must be MODULE:NAME of a factory, not {name!r}: no {made!r} in {module}")
    factory: Factory = found
    return factory


class Plugged:
    """A peer in the place of tracker and decoder.

    Args:
        name: MODULE:NAME.
        told: of the scene.
    """

    def __init__(self, name: str, told: Told) -> None:
        self._peer = factory_of(name)(told)
        self._protocol = told.protocol

    def feed(self, messages: Sequence[Message]) -> list[Message]:
        """Take a step of the source; return the frames as ours are."""
        out: list[Message] = []
        for message in messages:
            if not isinstance(message, Events):
                continue
            read = sorted(self._peer.feed(message), key=lambda one: one.t_us)
            n = len(read)
            if n:
                out.append(
                    Frames(
                        camera=message.camera,
                        t0_us=message.t0_us,
                        t1_us=message.t1_us,
                        t_us=[one.t_us for one in read],
                        track=["peer"] * n,
                        protocol=[self._protocol] * n,
                        beacon=[None] * n,
                        payload=[one.payload for one in read],
                        x_px=[one.x_px for one in read],
                        y_px=[one.y_px for one in read],
                        score=[1.0] * n,
                    )
                )
        return out


class PaperPeer:
    """The paper's receiver behind our tracker, plugged in like any other: events alone come in.

    Args:
        told: of the scene.
    """

    def __init__(self, told: Told) -> None:
        from heliograph_services.decoder.core import make_core as make_decoder  # noqa: PLC0415 - compiles on import
        from heliograph_services.tracker.core import make_core as make_tracker  # noqa: PLC0415

        config = DecoderConfig(protocol=told.protocol, bit_rate=told.bit_rate, receiver="paper")
        self._pipeline = Pipeline(make_tracker(TrackerConfig(), ONE_PROCESS), make_decoder(config, ONE_PROCESS))
        self._source: SourceCore | None = None

    def feed(self, events: Events) -> list[Read]:
        """See `Peer`."""
        if self._source is None:
            self._source = SourceCore(EventSourceConfig(), CameraInfo(events.width, events.height))
        window = Window(events.t0_us, events.t1_us, events.batch, events.stream, end=events.end)
        frames = [one for one in self._pipeline.feed(self._source.feed(window)) if isinstance(one, Frames)]
        return [Read(*row) for one in frames for row in zip(one.t_us, one.payload, one.x_px, one.y_px, strict=True)]


def paper(told: Told) -> Peer:
    """Make the example."""
    return PaperPeer(told)
