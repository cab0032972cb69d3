"""The system as real processes, its tracker behind a radio link: what a client on the camera's host hears.

On the camera's host: a router, the event source, which plays a recording at real time, the decoder, and the client.
Elsewhere the tracker, whose only way to that router is a `radio.ShapedLink`, or none at all, for comparison. Shared
memory is off: what the tracker hears and says crosses the link. Camera time is mapped to the host's clock by the source
itself: it sends no batch before the wall clock has come to the batch's end, so the least difference between a message's
`mono_ns` and its `t_us` is where camera time 0 lies.

What is *published* across the link is counted by the client, which hears it without the link: all records that the
tracker reads or writes, each with its envelope, its key and its encoding, as they are handed to Zenoh. What *crossed*
is the proxy's own count of the same time, with all that Zenoh adds.
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from heliograph.errors import BusError
from heliograph.keys import parse
from heliograph.messages import Frames, Health, Identification, Message, Tracks
from heliograph.shell.bus import Bus, connected
from heliograph.shell.inbox import Sample
from heliograph.shell.links import client_config
from heliograph.shell.process import Stop
from heliograph.shell.site import BusLinks, load_site
from heliograph.wire import SCHEMAS, Header, encoding_of
from heliograph_services.cli.plan import holding, plan_of
from heliograph_services.cli.studies.radio import ShapedLink
from heliograph_services.cli.supervision import Supervised, SupervisionError

SITE: Final = "evaluate"
CAMERA_HOST: Final = """site = "evaluate"
host = "camera"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
shared_memory = false
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "event_source"
backend = "recording"
file = "{file}"
tick_us = {tick_us}
onsets_us = {onsets_us}
onsets_bit_rate_max = {most}
[[service]]
kind = "decoder"
protocol = "{protocol}"
bit_rate = {bit_rate}
window_us = {window_us}
"""
TRACKERS_HOST: Final = """site = "evaluate"
host = "ground"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
shared_memory = false
[[service]]
kind = "tracker"
"""
# As deploy/sites/onboard.toml, the site with a radio, has them (a test).
TICK_US: Final = 5_000
ONSETS_US: Final = 20_000
WINDOW_US: Final = 5_000
# A site says what its radio carries of onsets; the rest is for what else crosses, and for bursts.
ONSETS_SHARE: Final = 0.8
# What the tracker reads; what it writes is known by its sender.
_READ: Final = frozenset({"onsets", "status"})
_HEARD: Final = ("onsets", "status", "tracks", "flow", "health", "progress", "ids", "frames")
_AWAITED: Final = frozenset({"tracker", "decoder"})
_LOOK_S: Final = 0.25
# Two services start in 5 s on idle cores; with kernels to be compiled on a loaded machine in a minute.
_START_S: Final = 120.0
# After the source: the decoder's last window, and what is under way on the slowest link.
_DRAIN_S: Final = 1.5


@dataclass(frozen=True, slots=True)
class Link:
    """A radio link, each way, and when it is cut.

    Args:
        bit_rate: bit/s.
        delay_s: beside the time that the bits take.
        cut_at_s: camera time; inf: never.
        cut_s: for so long.
    """

    bit_rate: float
    delay_s: float
    cut_at_s: float = math.inf
    cut_s: float = 0.0


@dataclass(slots=True)
class Heard:
    """What the client heard; arrivals by the host's monotonic clock, in seconds.

    Args:
        origin_s: where camera time 0 lies on that clock.
        late_s: how much later than real time the source sent each onsets message.
        frames: all messages, each with its arrival.
        tracks: arrival and `as_of_us`.
        identities: arrival and state.
        published: bytes that were handed over for the link, from the client's first onsets message on.
        records: how many.
        crossed: bytes that the proxy passed, likewise; 0 without a link.
        refused: samples that were no records.
        dropped: service -> messages that its full queues dropped, as it said last.
        decoder_share: when, and of a core in the second before, as the decoder says.
    """

    origin_s: float = math.inf
    late_s: list[float] = field(default_factory=list)
    frames: list[tuple[float, Frames]] = field(default_factory=list)
    tracks: list[tuple[float, int]] = field(default_factory=list)
    identities: list[tuple[float, Identification]] = field(default_factory=list)
    published: int = 0
    records: int = 0
    crossed: int = 0
    refused: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    decoder_share: list[tuple[float, float]] = field(default_factory=list)

    def take(self, sample: Sample, header: Header, message: Message) -> None:
        """Keep a record."""
        arrived_s = sample.arrived_ns / 1e9
        if message.SCHEMA == "onsets":
            self.late_s.append(header.mono_ns / 1e9 - header.t_us / 1e6)
            self.origin_s = min(self.origin_s, self.late_s[-1])
        if math.isfinite(self.origin_s) and (message.SCHEMA in _READ or header.source.startswith("tracker/")):
            self.published += len(sample.payload) + len(sample.key) + len(encoding_of(message))
            self.records += 1
        if isinstance(message, Frames):
            self.frames.append((arrived_s, message))
        elif isinstance(message, Tracks):
            self.tracks.append((arrived_s, message.as_of_us))
        elif isinstance(message, Identification):
            self.identities.append((arrived_s, message))
        elif isinstance(message, Health):
            of = [n for name, n in message.counters.items() if name.startswith("dropped: ")]
            self.dropped[message.service] = sum(of)
            if message.service == "decoder":
                self.decoder_share.append((header.mono_ns / 1e9, message.cpu_share))


def play(file: Path, protocol: str, bit_rate: float, link: Link | None, folder: Path) -> Heard:
    """Play a recording through the processes.

    Args:
        file: the recording (NPZ).
        protocol: of its beacons.
        bit_rate: of its beacons.
        link: between the tracker and the camera's host; None: they are on one.
        folder: for site files and logs.

    Raises:
        SupervisionError: a process failed, or does not start; says what it wrote last.
        BusError: the recording does not end.
    """
    port = _free_port()
    with ExitStack() as held:
        radio = None if link is None else ShapedLink(port, link.bit_rate, link.delay_s)
        if radio is not None:
            held.callback(radio.close)
        most = 0.0 if link is None else ONSETS_SHARE * link.bit_rate
        texts = {
            "camera": CAMERA_HOST.format(
                port=port, file=file, protocol=protocol, bit_rate=bit_rate, most=most,
                tick_us=TICK_US, onsets_us=ONSETS_US, window_us=WINDOW_US,
            ),
            "ground": TRACKERS_HOST.format(port=port if radio is None else radio.port),
        }  # fmt: skip
        hosts = [held.enter_context(_host(folder, name, text)) for name, text in texts.items()]
        dialled = BusLinks(connect=(f"tcp/127.0.0.1:{port}",), shared_memory=False)
        with connected(client_config(dialled), SITE, "client/study", Stop()) as bus:
            if bus is None:  # no stop is given
                raise BusError("the study's client was stopped")
            return _listen(bus, hosts, radio, link)


@contextmanager
def _host(folder: Path, name: str, text: str) -> Iterator[Supervised]:
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    # Whoever is not ready to see the source's first second would miss it.
    host = Supervised(holding(plan_of(load_site(path), folder), "event_source"))
    host.start(follow_parent=True)
    with host:
        yield host


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


class _Scissors:
    """Cuts a link once, at its time."""

    def __init__(self, radio: ShapedLink | None, link: Link | None) -> None:
        self._radio = radio
        at_s, for_s = (math.inf, 0.0) if link is None else (link.cut_at_s, link.cut_s)
        self._due_s = [at_s, at_s + for_s]

    def look(self, at_s: float) -> None:
        """Cut, or restore, when its camera time has come."""
        if self._radio is None or not self._due_s or at_s < self._due_s[0]:
            return
        if len(self._due_s) == 2:
            self._radio.cut()
        else:
            self._radio.restore()
        del self._due_s[0]


def _listen(bus: Bus, hosts: list[Supervised], radio: ShapedLink | None, link: Link | None) -> Heard:
    """Start the source when all are warm, and keep what is heard until it has ended."""
    heard = Heard()
    inbox = bus.subscribe({name: SCHEMAS[name] for name in _HEARD})
    warm: set[str] = set()

    def note(text: str, present: bool) -> None:
        found = parse(text)
        if found is not None and present:
            warm.add(found.parts[0])

    bus.watch("live", note)
    scissors = _Scissors(radio, link)
    before = 0
    released = False
    looked = time.monotonic()
    until = looked + _START_S
    while (now := time.monotonic()) < until:
        sample = inbox.get(0.02)
        if sample is not None:
            if radio is not None and math.isinf(heard.origin_s):
                before = radio.bytes_passed
            opened = bus.open(sample)
            heard.refused += opened is None
            if opened is not None:
                heard.take(sample, *opened)
        scissors.look(now - heard.origin_s)
        if now - looked < _LOOK_S:
            continue
        looked = now
        ended = _look(hosts)
        if not released and warm >= _AWAITED:
            hosts[0].release()
            released, until = True, math.inf
        elif ended and math.isinf(until):
            until = now + _DRAIN_S
    if not released:
        raise BusError(f"tracker and decoder were not ready within {_START_S:g} s; is this machine overloaded?")
    heard.crossed = 0 if radio is None else radio.bytes_passed - before
    return heard


def _look(hosts: list[Supervised]) -> bool:
    """Return whether the source has ended well.

    Raises:
        SupervisionError: a process failed.
    """
    ended = False
    for host in hosts:
        states = host.states()
        if not states:
            raise SupervisionError("the supervisor ended")
        for state in states:
            if (state.state in {"backoff", "fatal", "exited"} and not state.ended_well) or state.restarts:
                said = host.last_line(state.name) or "it wrote nothing"
                raise SupervisionError(f"{state.name} failed ({state.state}): {said}")
            ended |= state.ended_well
    return ended
