"""One run of a study: a scenario through source, tracker and decoder in lockstep, scored by the metrics sink.

The receivers see what processes on a bus would see (`cli.pipeline`); the truth goes to the sink alone.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from heliograph.core import Core
from heliograph.messages import Message, Tracks
from heliograph.streams import Events
from heliograph.truth import Truth
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.service import MetricsSink
from heliograph_services.metrics_sink.summary import Summary, summarise
from heliograph_services.tracker.config import TrackerConfig

ConfigT = TypeVar("ConfigT", bound=msgspec.Struct)
_WINDOW_US: Final = 10_000


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
    """

    scenario: str
    seed: int
    duration_s: float
    decoder: Mapping[str, Any] = field(default_factory=dict)
    tracker: Mapping[str, Any] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a run: the sink's summary, and how much there was to see."""

    summary: Summary
    events: int
    tracks: int
    counters: dict[str, int]


def run(setting: Setting) -> Outcome:
    """Run a setting.

    Raises:
        ConfigError: the scenario or a setting is wrong.
        FileError: a file of the scenario cannot be read.
    """
    from heliograph_services.decoder.__main__ import SERVICE as DECODER  # noqa: PLC0415 - compiles on import
    from heliograph_services.event_source.stream import open_stream  # noqa: PLC0415
    from heliograph_services.tracker.core import make_core  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="heliograph-study-") as folder:
        scenario = setting.scenario
        if "\n" in scenario:
            path = Path(folder) / "scenario.toml"
            path.write_text(scenario, encoding="utf-8")
            scenario = str(path)
        given: dict[str, Any] = {
            "backend": "simulated",
            "scenario": scenario,
            "seed": setting.seed,
            "window_us": _WINDOW_US,
        }
        given |= {"duration_s": setting.duration_s, **setting.source}
        stream = open_stream(_made(EventSourceConfig, given), ONE_PROCESS)
        tracker: Core = make_core(_made(TrackerConfig, setting.tracker), ONE_PROCESS)
        decoder: Core = DECODER.make(_made(DecoderConfig, setting.decoder), ONE_PROCESS)
        pipeline = Pipeline(tracker, decoder)
        sink = MetricsSink(MetricsSinkConfig(file=str(Path(folder) / "study.sqlite")), ONE_PROCESS)
        events, names = 0, set[str]()
        for step in stream:
            truths: list[Message] = [message for message in step.messages if isinstance(message, Truth)]
            events += sum(len(message.batch) for message in step.messages if isinstance(message, Events))
            for message in [*truths, *pipeline.feed(step.messages)]:
                if isinstance(message, Tracks):
                    names.update(message.track)
                sink.feed(message)
        sink.close()
        return Outcome(
            summarise(Path(folder) / "study.sqlite"), events, len(names), dict(stream.counters) | dict(decoder.counters)
        )


def _made(kind: type[ConfigT], given: Mapping[str, Any]) -> ConfigT:
    return msgspec.convert(dict(given), kind, strict=False)
