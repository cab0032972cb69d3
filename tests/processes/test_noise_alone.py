"""Noise alone, up to 10 million events a second, is nobody: no track becomes valid, and what is too much is counted."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

import pytest

from heliograph.messages import Health, Identification, Tracks
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import make_core as make_decoder
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core as make_tracker
from support.fed import fed
from support.feeder import Feeder
from support.noise import noise
from support.processes import Collector

# Below it no window is skipped as a flood: most births under way.
DENSE_HZ, WORST_HZ = 3e6, 1e7
SERVICES = """
[[service]]
kind = "tracker"
[[service]]
kind = "decoder"
bit_rate = 2000
"""


@pytest.mark.parametrize(("events_hz", "camera_s"), [(DENSE_HZ, 1.0), (WORST_HZ, 1.0)])
def test_no_track_of_noise_becomes_valid(events_hz: float, camera_s: float) -> None:
    tracker, decoder = (
        make_tracker(TrackerConfig(), ONE_PROCESS),
        make_decoder(DecoderConfig(bit_rate=2000.0), ONE_PROCESS),
    )
    pipeline = Pipeline(tracker, decoder)
    seen = 0
    for step in takewhile(lambda step: step.t1_us <= camera_s * 1e6, noise(events_hz, seed=5)):
        for message in pipeline.feed(step.messages):
            assert not isinstance(message, Identification)
            if isinstance(message, Tracks):
                seen += 1
                assert "valid" not in message.status
    assert seen == camera_s * 10


@pytest.mark.processes
def test_processes_live_through_ten_million_events_a_second_and_count_what_they_leave_out(tmp_path: Path) -> None:
    kinds = ["tracker", "decoder"]
    with fed(tmp_path, "noise", SERVICES, kinds, ["ids", "tracks", "health"]) as (host, heard, bus):
        heard.until(lambda h: all(reports(h, one) for one in kinds), "tracker and decoder")
        # What the bus loses last shows by what comes after it: half a calm second.
        Feeder(bus, noise(WORST_HZ, seed=6, calm_from_us=1e6)).play(1.5)
        for service, schema in (("tracker", "onsets"), ("decoder", "events")):
            sent = bus.published[schema]
            heard.until(lambda h, s=service, m=schema, n=sent: idle(h, s) and accounted(h, s, m) == n, service)  # type: ignore[misc]
        assert heard.messages["ids"] == []
        words = {word for m in heard.messages["tracks"] if isinstance(m, Tracks) for word in m.status}
        assert words <= {"new", "invalid"}
        assert sorted(host.alive()) == ["decoder", "router", "tracker"]


def reports(heard: Collector, service: str) -> list[Health]:
    return [m for m in list(heard.messages["health"]) if isinstance(m, Health) and m.service == service]


def idle(heard: Collector, service: str) -> bool:
    """Return whether nothing waits for the service's core."""
    return reports(heard, service)[-1].gauges["queue"] == 0


def accounted(heard: Collector, service: str, schema: str) -> int:
    """Return how many messages the service has taken, or knows that it has not."""
    counters = reports(heard, service)[-1].counters
    lost = max(counters.get(f"missing: {schema}", 0), counters.get(f"dropped: {schema}", 0))
    return counters.get(f"received: {schema}", 0) + lost
