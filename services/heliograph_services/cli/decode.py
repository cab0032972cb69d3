"""`heliograph decode FILE`: read a recording with the cores of a running site, in one process.

What it prints is what the processes of a site publish for the same recording in lockstep.
"""

from __future__ import annotations

import argparse
import sys
import textwrap
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from heliograph.core import Core
from heliograph.errors import ConfigError, FileError, by_name
from heliograph.link.modulations import LISTED_ONLY
from heliograph.messages import Frames, Identification, Message, Tracks
from heliograph.shell.config import resolve
from heliograph.shell.site import ServiceEntry, Site, load_site
from heliograph.streams import Events
from heliograph.units import BIT_RATE_MAX, BIT_RATE_MIN
from heliograph_services.cli.lines import dump, for_people, lines_of
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.services import config_type
from heliograph_services.decoder.config import AUTO, DecoderConfig

ConfigT = TypeVar("ConfigT", bound=msgspec.Struct)
# The window of a step; larger ones save overhead, and the result does not depend on it.
_WINDOW_US: Final = 10_000
_COLUMNS: Final = 80  # of a terminal
# Each bit must be seen whole by one image at least, wherever the images lie: the paper's 250 bit/s at 200 images a
# second want a camera that is synchronised.
SCANS_A_BIT: Final = 2.0


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    made = argparse.ArgumentParser(prog="heliograph decode", description="Read a recording of blinking beacons.")
    made.add_argument(
        "file",
        metavar="FILE",
        help="AEDAT4, EVT2/EVT3 RAW, DAT, ES, CSV, NPZ (of events, or of images) or a MATLAB beacon recording",
    )
    made.add_argument(
        "--protocol", default=None, metavar="NAME|auto", help="seed11 (default), another modulation, or auto: all"
    )
    made.add_argument("--bit-rate", default=None, metavar="N|auto", help="bits a second; auto finds it (default)")
    made.add_argument(
        "--receiver",
        default=None,
        metavar="NAME",
        help="default; to compare: paper, binning (seed11), wang2022 (uart), and with _tuned",
    )
    made.add_argument(
        "--option", action="append", default=[], metavar="KEY=VALUE", help="of the protocol, e.g. parity=paper_text"
    )
    made.add_argument("--frames", action="store_true", help="print every accepted frame too")
    made.add_argument("--links", action="store_true", help="print how well each track is read, once a second")
    made.add_argument("--json", action="store_true", help="one JSON object a line")
    made.add_argument("--site", metavar="FILE", help="a site file: names of beacons, and settings of the services")
    made.add_argument("--camera", default=None, metavar="NAME", help="which camera of the site (default: its only one)")
    made.add_argument("--camera-file", default=None, metavar="FILE", help="intrinsics and mount, for bearings")
    made.add_argument("--width", type=int, default=None, metavar="PX", help="where the file does not say it")
    made.add_argument("--height", type=int, default=None, metavar="PX", help="where the file does not say it")
    made.add_argument("--format", default=None, metavar="NAME", help="where the name of the file does not tell it")
    return made


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    arguments = parser().parse_args(argv)
    started = time.monotonic()
    stream, pipeline, cores = build(arguments)
    tally = Tally()
    for step in stream:
        for message in pipeline.feed(step.messages):
            tally.take(message)
            for line in lines_of(message, frames=arguments.frames, links=arguments.links):
                print(dump(line) if arguments.json else for_people(line), flush=True)
        tally.steps(step.messages)
    if pipeline.waiting:
        raise FileError(f"{arguments.file}: the stream ended with {pipeline.waiting} inputs unread")
    if tally.duration_us == 0 and tally.events == 0:
        raise FileError(f"{arguments.file}: no events in it")
    summary = tally.summary([stream, *cores], time.monotonic() - started)
    summary["hint"] = _hint(summary, arguments)
    print(dump(summary) if arguments.json else _for_people(summary), file=sys.stdout)
    return 0


def build(arguments: argparse.Namespace) -> tuple[Any, Pipeline, list[Core]]:
    """Return the opened stream, the pipeline, and its cores.

    Raises:
        ConfigError: a setting is wrong.
        FileError: the file cannot be read.
    """
    # Not at the top: numba takes most of a second that a wrong argument need not pay.
    from heliograph_services.decoder import core as decoder  # noqa: PLC0415
    from heliograph_services.decoder.__main__ import SERVICE as DECODER  # noqa: PLC0415
    from heliograph_services.event_source.cameras.image_file import holds_images, images_hz  # noqa: PLC0415
    from heliograph_services.event_source.stream import open_stream  # noqa: PLC0415
    from heliograph_services.tracker import core as tracker  # noqa: PLC0415

    site = load_site(arguments.site) if arguments.site else Site(path="flags")
    camera = arguments.camera or _only_camera(site)
    source_given = {"file": arguments.file, "width": arguments.width, "height": arguments.height}
    images = holds_images(Path(arguments.file))
    backend = "images" if images else "recording"
    source_given |= {"format": arguments.format, "backend": backend, "window_us": _WINDOW_US, "loop": False}
    source_config = _settings("event_source", site, camera, source_given)
    tracker_config = _settings("tracker", site, camera, {})
    stream = open_stream(source_config, ONE_PROCESS)
    decoder_given = _decoder_given(arguments)
    if images:
        decoder_given["scan_rate_hz"] = images_hz(Path(arguments.file))
    decoder_config = _settings("decoder", site, camera, decoder_given)
    for line in _advice(decoder_config):
        print(f"heliograph decode: {line}", file=sys.stderr)
    tracker.warm()
    decoder.warm()
    cores: list[Core] = [tracker.make_core(tracker_config, ONE_PROCESS), DECODER.make(decoder_config, ONE_PROCESS)]
    return stream, Pipeline(*cores), cores


def _decoder_given(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of the decoder that the command line gives, None for those that it leaves alone."""
    bit_rate = arguments.bit_rate
    if bit_rate is None and not arguments.site:
        # A recording's rate need not be known. A site says its own.
        bit_rate = AUTO
    return {
        "receiver": arguments.receiver,
        "camera_file": arguments.camera_file,
        "protocol": arguments.protocol,
        "bit_rate": _bit_rate(bit_rate),
        "options": _options(arguments.option),
    }


def _advice(config: DecoderConfig) -> list[str]:
    """Return what is likely to fail, a line each: bits that are shorter than two images (scans) of the camera."""
    most = config.scan_rate_hz / SCANS_A_BIT
    if not most:
        return []
    # Frequencies have a rule of their own, which is an error.
    listed = [
        (f"beacon {beacon.name}: bit_rate", beacon.bit_rate)
        for beacon in config.beacons
        if beacon.protocol not in LISTED_ONLY
    ]
    if not config.beacons and not isinstance(config.bit_rate, str) and config.protocol not in LISTED_ONLY:
        listed = [("bit_rate", config.bit_rate)]
    return [
        f"{name} should be at most {most:g} with {config.scan_rate_hz:g} images a second, not {rate:g}"
        for name, rate in listed
        if rate > most
    ]


def _only_camera(site: Site) -> str:
    cameras = [entry.settings.get("camera", "cam0") for entry in site.service if entry.kind == "event_source"]
    if len(set(cameras)) > 1:
        raise ConfigError(f"{site.path}: --camera must say which of {', '.join(sorted(set(cameras)))}")
    return cameras[0] if cameras else "cam0"


def _settings(kind: str, site: Site, camera: str, given: dict[str, Any]) -> Any:
    """Return the settings that a site has for this camera's process, with what the command line gives on top."""
    settings: dict[str, Any] = {}
    for entry in site.service:
        if entry.kind == kind and entry.settings.get("camera", "cam0") == camera:
            settings = dict(entry.settings)
    settings |= {"camera": camera} | {name: value for name, value in given.items() if value is not None}
    entry = ServiceEntry(kind=kind, instance=kind, settings=settings)
    config, _ = resolve(config_type(kind), entry, site, {}, {})
    return config


def _bit_rate(text: str | None) -> float | str | None:
    if text is None or text == "auto":
        return text
    try:
        bit_rate = float(text)
    except ValueError:
        raise ConfigError(f"--bit-rate must be a number or auto, not {text!r}") from None
    if not BIT_RATE_MIN <= bit_rate <= BIT_RATE_MAX:
        raise ConfigError(f"--bit-rate must be in [{BIT_RATE_MIN:g}, {BIT_RATE_MAX:g}] or auto, not {text}")
    return bit_rate


def _options(pairs: list[str]) -> dict[str, str | int] | None:
    options: dict[str, str | int] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise ConfigError(f"--option must be KEY=VALUE, not {pair!r}")
        options[name] = int(value) if value.lstrip("-").isdigit() else value
    return options or None


class Tally:
    """Adds up what the summary tells."""

    def __init__(self) -> None:
        self.events = 0
        self.duration_us = 0
        self._first_us: int | None = None
        self._tracks: set[str] = set()
        self._frames = 0
        self._refused: Counter[str] = Counter()
        self._identified: dict[str, set[str]] = {}
        self._duplicates: dict[str, set[str]] = {}
        self._characters = 0

    def steps(self, messages: list[Message]) -> None:
        """Take what the source sent."""
        for message in messages:
            if isinstance(message, Events):
                self.events += len(message.batch)
                self._first_us = message.t0_us if self._first_us is None else self._first_us
                self.duration_us = message.t1_us - self._first_us

    def take(self, message: Message) -> None:
        """Take what a core published."""
        if isinstance(message, Tracks):
            self._tracks.update(message.track)
        elif isinstance(message, Frames):
            self._frames += len(message.t_us)
            self._refused.update(message.refused)
        elif isinstance(message, Identification) and message.change in {"accepted", "changed"}:
            self._identified.setdefault(message.beacon, set()).add(message.track)
        elif isinstance(message, Identification) and message.change == "duplicate":
            self._duplicates.setdefault(message.beacon, set()).update([message.track, *message.duplicates])

    def summary(self, parts: list[Any], wall_s: float) -> dict[str, Any]:
        """Return the last line.

        Args:
            parts: what counts refusals of its own besides the frames: the stream and the tracker (the decoder's are
                in `Frames.refused` already).
            wall_s: how long it all took.
        """
        source, tracker, decoder = parts
        return {
            "type": "summary",
            "events": self.events,
            "duration_us": self.duration_us,
            "tracks": len(self._tracks),
            "frames": self._frames,
            "refused": dict(sorted(self._refused.items())),
            "refused_input": by_name(source.refusals),
            "refused_targets": by_name(tracker.refusals),
            "refused_by_decoder": by_name(decoder.refusals),
            "identifications": {name: sorted(tracks) for name, tracks in sorted(self._identified.items())},
            "duplicates": {name: sorted(tracks) for name, tracks in sorted(self._duplicates.items())},
            "wall_s": round(wall_s, 3),
        }


def _hint(summary: dict[str, Any], arguments: argparse.Namespace) -> str | None:
    """Return what to try where nothing was identified; None where something was."""
    if summary["identifications"]:
        return None
    if not summary["tracks"]:
        return "no light blinks in it"
    if arguments.site:
        return "none of the site's beacons was identified: try without --site"
    if arguments.bit_rate not in {None, AUTO}:
        return f"nothing was identified at {arguments.bit_rate} bit/s: try --bit-rate auto"
    if arguments.protocol != AUTO:
        return f"nothing was identified as {arguments.protocol or 'seed11'}: try --protocol auto"
    return "nothing was identified in any protocol"


def _for_people(summary: dict[str, Any]) -> str:
    seconds = summary["duration_us"] / 1e6
    refused = ", ".join(f"{n} {name}" for name, n in summary["refused"].items()) or "none"
    beacons = ", ".join(summary["identifications"]) or "none"
    read = f"{summary['events']} events in {seconds:.3f} s, read in {summary['wall_s']} s"
    counts = f"{summary['tracks']} tracks; {summary['frames']} frames"
    paragraphs = [f"{read}; {counts}", f"refused: {refused}", f"identified: {beacons}"]
    paragraphs += [f"{name} is sent at {len(at)} places" for name, at in summary["duplicates"].items()]
    paragraphs += [summary["hint"]] if summary["hint"] else []
    return "\n".join(textwrap.fill(text, _COLUMNS, subsequent_indent="  ") for text in paragraphs)
