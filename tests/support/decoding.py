"""A decoder of pulse receivers, fed events and Tracks messages in the order of their times."""

from __future__ import annotations

from collections.abc import Iterable

from heliograph.core import Context
from heliograph.events import EventBatch
from heliograph.messages import Identification, Message, Tracks
from heliograph.site import Beacon
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from support.blinkers import messages, pulse_only

LIVE = Context(instance="decoder", boot="b0", lockstep=False)
CRANE = Beacon(name="crane", protocol="pulse", payload=5, bit_rate=100)
LIFT = Beacon(name="lift", protocol="pulse", payload=2, bit_rate=100)
WIDTH, HEIGHT = 640, 480


def core(*beacons: Beacon, **settings: object) -> DecoderCore:
    config = DecoderConfig(beacons=beacons or (CRANE, LIFT), **settings)  # type: ignore[arg-type]
    return DecoderCore(config, LIVE, modulation_of=pulse_only)


def run(
    decoder: DecoderCore,
    batch: EventBatch,
    told: Iterable[tuple[int, Tracks]],
    end_us: int,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> list[Message]:
    """Feed 2 ms of events at a time; each Tracks message as soon as the events have reached its time."""
    waiting = sorted(told, key=lambda one: one[0])
    out: list[Message] = []
    for message in messages(batch, 0, end_us, range(0, end_us, 2_000), *size, end=False):
        while waiting and waiting[0][0] <= message.time_us - 2_000:
            out += decoder.feed(waiting.pop(0)[1])
        out += decoder.feed(message)
    return out


def states(out: Iterable[Message], *changes: str) -> list[Identification]:
    return [one for one in out if isinstance(one, Identification) and (not changes or one.change in changes)]
