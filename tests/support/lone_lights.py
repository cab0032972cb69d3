"""One light of each protocol before an asynchronous sensor, and what the receivers of a site's links make of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from heliograph.errors import Refusals
from heliograph.link.bitrate import likely_bit_rates
from heliograph.link.contract import Text
from heliograph.site import Beacon
from heliograph_services.cli.studies.asynchronous import AsyncPixels, events
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import TrackLinks
from heliograph_services.event_source.simulation.lights import drive_of
from heliograph_services.event_source.simulation.world.spec import BeaconSpec, Still

SAYS: Final = "the quick brown fox jumps over the lazy dog; "
WINDOW_US: Final = 5_000


@dataclass(frozen=True)
class Sent:
    """What a light sends, and at which rate it is usually sent."""

    bit_rate: float
    payload: int | None = None
    text: str | None = None
    options: Mapping[str, str | int] = field(default_factory=dict)


# Rates of which the half and the double can be sent too.
SENT: Final = {
    "seed11": Sent(1_000, 42),
    "code": Sent(1_000, 77, options={"codebook": "code20d4"}),
    "uart": Sent(1_000, text=SAYS),
    "pulse_interval": Sent(5_000, 77),
    "packet": Sent(2_000, 9, text="a message\nand another one\n"),
    "event_interval": Sent(40_000, text=SAYS),
    "ook_fast": Sent(20_000, text=SAYS),
}


@dataclass
class Heard:
    """What was read: names of identities, when the first was accepted, frames, texts joined, refusals."""

    identities: set[str]
    first_us: int | None
    frames: int
    payloads: Counter[tuple[str, int]]
    text: str
    refused: Refusals


def heard(
    protocol: str, told: float, sent: float, duration_s: float, seed: int = 0, config: DecoderConfig | None = None
) -> Heard:
    """Return what a decoder that is told one bit rate reads of a light that sends at another.

    Args:
        protocol: of the light, and of the one beacon that the site lists.
        told: the listed bit rate.
        sent: the light's.
        duration_s: how long it is seen.
        seed: of the sensor's noise.
        config: other settings than of the one listed beacon.
    """
    light = SENT[protocol]
    fields: dict[str, Any] = {"payload": light.payload, "text": light.text, "options": dict(light.options)}
    spec = BeaconSpec(
        name="it", protocol=protocol, bit_rate=sent, clock_ppm=150.0, path=Still(at_m=(0.0, 0.0, 0.0)), **fields
    )
    end_us = round(duration_s * 1e6)
    at_us, levels = drive_of(spec, seed=seed, index=0).changes(0.0, float(end_us))
    pixels = AsyncPixels(pixels=40, jitter_us=3.0, refractory_us=2.0, noise_hz=1e3)
    t_us, on = events(at_us, levels > 0.5, pixels, np.random.default_rng(seed))
    listed = Beacon(name="it", protocol=protocol, bit_rate=told, payload=light.payload, options=dict(light.options))
    plan = LinkPlan(config or DecoderConfig(beacons=(listed,)), measure=likely_bit_rates)
    links = TrackLinks(plan)
    out = Heard(set(), None, 0, Counter(), "", Refusals())
    for until_us in range(WINDOW_US, end_us + WINDOW_US, WINDOW_US):
        own = slice(*np.searchsorted(t_us, (until_us - WINDOW_US, until_us)))
        depth = np.full(own.stop - own.start, 255, np.uint8)
        for one in links.feed(t_us[own], on[own], depth, until_us):
            if isinstance(one.item, Text):
                out.text += one.item.text or ""
            else:
                out.frames += 1
                out.payloads[plan.protocol(one.link), one.item.payload] += 1
        accepted = links.accepted(until_us)
        if accepted is not None:
            out.identities.add(plan.name(accepted.link, accepted.identity.payload))
            out.first_us = until_us if out.first_us is None else out.first_us
        out.refused.update(links.take_refusals())
    return out
