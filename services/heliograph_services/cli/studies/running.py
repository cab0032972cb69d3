"""One run of a study: a scenario through source, tracker and decoder in lockstep, scored by the metrics sink.

The receivers see what processes on a bus would see (`cli.pipeline`); the truth goes to the sink alone. Who reads is
one of READERS: `ours` is tracker and decoder; `told` the decoder with the truth in the tracker's place; `genie` the
receivers along the true paths (`genie`). `episode` gives several of them the very same events, and keeps what they
said; whether others listen changes nothing for any of them.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import msgspec

from heliograph.core import Core
from heliograph.messages import Frames, Identification, Message, Tracks
from heliograph.streams import Events
from heliograph.truth import Truth
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.genie import Genie, ToldTracker
from heliograph_services.cli.studies.paths import TruePaths, true_paths
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import SourceStream
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.service import MetricsSink
from heliograph_services.metrics_sink.summary import Summary, summarise
from heliograph_services.tracker.config import TrackerConfig

ConfigT = TypeVar("ConfigT", bound=msgspec.Struct)
Reader = Literal["ours", "told", "genie"]
READERS: Final[tuple[Reader, ...]] = ("ours", "told", "genie")
_WINDOW_US: Final = 10_000
# The truth is told to the decoder so often.
TOLD_US: Final = 1_000


@dataclass(frozen=True, slots=True)
class Setting:
    """What is run.

    Args:
        scenario: the text of a scenario file, or the name of a built-in one.
        seed: of the simulation.
        duration_s: of camera time.
        decoder: settings of the decoder (`protocol`, `bit_rate`, `receiver` ...).
        tracker: settings of the tracker.
        source: settings of the source (`fidelity` ...).
        reader: who reads, see the module.
    """

    scenario: str
    seed: int
    duration_s: float
    decoder: Mapping[str, Any] = field(default_factory=dict)
    tracker: Mapping[str, Any] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)
    reader: Reader = "ours"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a run: the sink's summary, and how much there was to see."""

    summary: Summary
    events: int
    tracks: int
    counters: dict[str, int]


@dataclass(slots=True)
class Said:
    """What one reader published, in its order, and the CPU time that it took.

    Args:
        frames: all messages.
        tracks: all messages.
        states: identities, each with the time up to which the camera had sent events when it was published.
        cpu_s: of this reader alone.
    """

    frames: list[Frames] = field(default_factory=list)
    tracks: list[Tracks] = field(default_factory=list)
    states: list[tuple[int, Identification]] = field(default_factory=list)
    cpu_s: float = 0.0

    def take(self, messages: Sequence[Message], now_us: int) -> None:
        """Keep what studies look at."""
        for message in messages:
            if isinstance(message, Frames):
                self.frames.append(message)
            elif isinstance(message, Tracks):
                self.tracks.append(message)
            elif isinstance(message, Identification):
                self.states.append((now_us, message))


@dataclass(frozen=True, slots=True)
class Episode:
    """What really was, and what each reader said of it.

    Args:
        paths: of the beacons.
        truths: the windows of the truth.
        said: by reader.
        events: how many there were.
        source_cpu_s: what simulating, gating and pooling took.
        seconds: of camera time.
    """

    paths: TruePaths
    truths: list[Truth]
    said: dict[Reader, Said]
    events: int
    source_cpu_s: float
    seconds: float


def run(setting: Setting) -> Outcome:
    """Run a setting.

    Raises:
        ConfigError: the scenario or a setting is wrong.
        FileError: a file of the scenario cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="heliograph-study-") as folder, opened(setting, Path(folder)) as stream:
        reader = _reader(setting, setting.reader, stream)
        sink = MetricsSink(MetricsSinkConfig(file=str(Path(folder) / "study.sqlite")), ONE_PROCESS)
        events, names = 0, set[str]()
        for step in stream:
            truths: list[Message] = [message for message in step.messages if isinstance(message, Truth)]
            events += sum(len(message.batch) for message in step.messages if isinstance(message, Events))
            for message in [*truths, *reader.feed(step.messages)]:
                if isinstance(message, Tracks):
                    names.update(message.track)
                sink.feed(message)
        sink.close()
        counters = dict(stream.counters) | dict(reader.decoder.counters)
        return Outcome(summarise(Path(folder) / "study.sqlite"), events, len(names), counters)


def episode(setting: Setting, readers: Sequence[Reader] = ("ours",)) -> Episode:
    """Run a setting before several readers and keep what they said; the setting's own reader does not count.

    Raises:
        ConfigError: the scenario or a setting is wrong.
        FileError: a file of the scenario cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="heliograph-study-") as folder, opened(setting, Path(folder)) as stream:
        listening = {name: _reader(setting, name, stream) for name in readers}
        said: dict[Reader, Said] = {name: Said() for name in readers}
        truths: list[Truth] = []
        events, source_s, began_s = 0, 0.0, time.process_time()
        for step in stream:
            source_s += time.process_time() - began_s
            truths += [message for message in step.messages if isinstance(message, Truth)]
            events += sum(len(message.batch) for message in step.messages if isinstance(message, Events))
            for name, reader in listening.items():
                began_s = time.process_time()
                said[name].take(reader.feed(step.messages), step.t1_us)
                said[name].cpu_s += time.process_time() - began_s
            began_s = time.process_time()
        return Episode(_paths(setting, stream), truths, said, events, source_s, setting.duration_s)


@contextmanager
def opened(setting: Setting, folder: Path) -> Iterator[SourceStream]:
    """Open the stream of a setting; a scenario's text is written to the folder."""
    from heliograph_services.event_source.stream import open_stream  # noqa: PLC0415 - compiles on import

    scenario = setting.scenario
    if "\n" in scenario:
        path = folder / "scenario.toml"
        path.write_text(scenario, encoding="utf-8")
        scenario = str(path)
    given: dict[str, Any] = {"backend": "simulated", "scenario": scenario, "seed": setting.seed}
    given |= {"window_us": _WINDOW_US, "duration_s": setting.duration_s, **setting.source}
    stream = open_stream(_made(EventSourceConfig, given), ONE_PROCESS)
    try:
        yield stream
    finally:
        stream.close()


class _System:
    """A tracker, or the truth in its place, and the decoder."""

    def __init__(self, tracker: Core, decoder: Core) -> None:
        self.decoder = decoder
        self._pipeline = Pipeline(tracker, decoder)

    def feed(self, messages: list[Message]) -> list[Message]:
        return self._pipeline.feed(messages)


class _Genie:
    """The genie alone."""

    def __init__(self, genie: Genie) -> None:
        self.decoder: Core = genie

    def feed(self, messages: list[Message]) -> list[Message]:
        return [out for message in messages for out in self.decoder.feed(message)]


def _reader(setting: Setting, name: Reader, stream: SourceStream) -> _System | _Genie:
    from heliograph_services.decoder.__main__ import SERVICE as DECODER  # noqa: PLC0415 - compiles on import
    from heliograph_services.tracker.core import make_core  # noqa: PLC0415

    if name == "genie":
        return _Genie(Genie(_paths(setting, stream), str(setting.decoder.get("receiver", "default"))))
    decoder = dict(setting.decoder)
    if name == "told":
        # Grids must nest: a message a millisecond needs windows of one.
        config = _made(DecoderConfig, decoder | {"window_us": TOLD_US, "tracker_period_us": TOLD_US})
        return _System(ToldTracker(_paths(setting, stream), config.camera, TOLD_US), DECODER.make(config, ONE_PROCESS))
    tracker: Core = make_core(_made(TrackerConfig, setting.tracker), ONE_PROCESS)
    return _System(tracker, DECODER.make(_made(DecoderConfig, decoder), ONE_PROCESS))


def _paths(setting: Setting, stream: SourceStream) -> TruePaths:
    camera = stream.camera
    if not isinstance(camera, SimulatedCamera):
        raise TypeError(f"a study's camera must be simulated, not {type(camera).__name__}")
    # A decoder may speak of a time a little after the last event.
    return true_paths(camera.scene, round(setting.duration_s * 1e6) + _WINDOW_US)


def _made(kind: type[ConfigT], given: Mapping[str, Any]) -> ConfigT:
    return msgspec.convert(dict(given), kind, strict=False)
