"""Fast protocols side by side in one site: each light is named for what it sends, by the simulator's own edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from heliograph.link.contract import Text
from heliograph.site import Beacon
from heliograph_services.cli.studies.asynchronous import AsyncPixels, events
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import TrackLinks
from heliograph_services.event_source.simulation.lights import drive_of
from heliograph_services.event_source.simulation.world.checks import check_tables
from heliograph_services.event_source.simulation.world.spec import BeaconSpec, Scenario, Still

HERE = Still(at_m=(0.0, 0.0, 0.0))
SAYS = "the quick brown fox; "
SENT: dict[str, dict[str, Any]] = {
    "marker": {"protocol": "pulse_interval", "bit_rate": 5_000.0, "payload": 77},
    "wide": {"protocol": "pulse_interval", "bit_rate": 5_000.0, "payload": 70_000, "options": {"bits": 20}},
    "hum": {"protocol": "frequency", "bit_rate": 3_000.0, "payload": 1_500},
    "high": {"protocol": "frequency", "bit_rate": 16_400.0, "payload": 8_200},
    "fast": {"protocol": "ook_fast", "bit_rate": 60_000.0, "text": SAYS},
    "gaps": {"protocol": "event_interval", "bit_rate": 100_000.0, "text": SAYS},
}
BEACONS = tuple(
    Beacon(
        name=name,
        protocol=fields["protocol"],
        bit_rate=fields["bit_rate"],
        payload=fields.get("payload"),
        options=fields.get("options", {}),
    )
    for name, fields in SENT.items()
)


@pytest.mark.parametrize("name", SENT)
def test_every_light_of_a_site_is_named_by_its_own_link(name: str) -> None:
    spec = BeaconSpec(name=name, path=HERE, clock_ppm=150.0, **SENT[name])
    check_tables(Scenario(beacons=(spec,)), "here")
    at_us, levels = drive_of(spec, seed=0, index=0).changes(0.0, 300_000.0)
    light = AsyncPixels(pixels=40, jitter_us=3.0, refractory_us=2.0, noise_hz=1e3)
    t_us, on = events(at_us, levels > 0.5, light, np.random.default_rng(0))
    plan = LinkPlan(DecoderConfig(beacons=BEACONS))
    links = TrackLinks(plan)
    depth = np.full(len(t_us), 255, np.uint8)
    text, held = "", set()
    for until_us in range(5_000, 300_001, 5_000):
        own = slice(*np.searchsorted(t_us, (until_us - 5_000, until_us)))
        for one in links.feed(t_us[own], on[own], depth[own], until_us):
            text += one.item.text or "" if isinstance(one.item, Text) else ""
        accepted = links.accepted(until_us)
        if accepted is not None:
            held.add(plan.name(accepted.link, accepted.identity.payload))
    known = name if SENT[name].get("payload") is not None else SENT[name]["protocol"]
    assert held <= {known, name}
    assert held
    if "text" in SENT[name]:
        assert SAYS * 3 in text
