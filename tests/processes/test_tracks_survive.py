"""Tracks and identities outlive a decoder that dies, onsets that are lost, and a camera's clock that jumps."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from heliograph.messages import Health, Identification
from heliograph_services.event_source.config import EventSourceConfig
from support.fed import fed
from support.feeder import Feeder, five
from support.processes import Collector, Host
from support.scene import listed_beacons

pytestmark = pytest.mark.processes

SITES = Path(__file__).parents[2] / "deploy" / "sites"
TEXT, NAMES = listed_beacons(SITES / "laptop.toml")
# Text needs ten characters and a rest before them; four beacons with IDs are enough, and quicker.
WITH_ID = NAMES - {"gate"}
JUMP_US = 100_000_000


SERVICES = f"""
[[service]]
kind = "tracker"
[[service]]
kind = "decoder"
{TEXT}
"""


class Run(NamedTuple):
    """Tracker and decoder as processes, a client, and the test as their source."""

    host: Host
    heard: Collector
    feeder: Feeder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    kinds = ["tracker", "decoder"]
    with fed(tmp_path_factory.mktemp("survival"), "survival", SERVICES, kinds, ["ids", "health"]) as (host, heard, bus):
        heard.until(lambda h: set(kinds) <= services(h), "tracker and decoder")
        yield Run(host, heard, Feeder(bus, five()))


def services(heard: Collector) -> set[str]:
    return {m.service for m in list(heard.messages["health"]) if isinstance(m, Health)}


def states(heard: Collector, after: int) -> list[Identification]:
    return [m for m in list(heard.messages["ids"])[after:] if isinstance(m, Identification)]


def names(heard: Collector, after: int) -> dict[str, str]:
    """Return the last track of each beacon that was identified in the messages after the first so many."""
    return {m.beacon: m.track for m in states(heard, after) if not m.lost and m.beacon in WITH_ID}


def counted(heard: Collector, service: str, name: str, at_least: int) -> None:
    """Wait for a service's counter."""

    def value(h: Collector) -> int:
        reports = [m for m in list(h.messages["health"]) if isinstance(m, Health) and m.service == service]
        return reports[-1].counters.get(name, 0) if reports else 0

    heard.until(lambda h: value(h) >= at_least, f"{service} to count {at_least} of {name!r}")


def test_tracks_keep_names_and_identities_through_lost_onsets_and_a_new_decoder(run: Run) -> None:
    host, heard, feeder = run
    feeder.play(1.5)
    before = names(heard, 0)
    assert before.keys() == WITH_ID

    at = len(heard.messages["ids"])
    # A target at 570 px/s2 is 11 px off its prediction by then.
    feeder.play(0.2, lose={"onsets"})
    feeder.play(0.6)
    assert feeder.lost == 200_000 // EventSourceConfig().onsets_us
    assert names(heard, at) == before
    assert not [m for m in states(heard, at) if m.lost and m.beacon in WITH_ID]
    counted(heard, "tracker", "missing: onsets", feeder.lost)

    host.kill("decoder")
    feeder.play(0.5)
    at = len(heard.messages["ids"])
    host.start("decoder")
    feeder.until(lambda: names(heard, at).keys() == WITH_ID, "the new decoder")
    assert names(heard, at) == before


@pytest.mark.parametrize(("jump_us", "reason"), [(JUMP_US, "time jumps"), (-JUMP_US // 2, "time runs backwards")])
def test_a_clock_that_jumps_is_counted_and_everything_is_identified_again(run: Run, jump_us: int, reason: str) -> None:
    host, heard, feeder = run
    at = len(heard.messages["ids"])
    feeder.until(lambda: names(heard, at).keys() == WITH_ID, "all beacons")
    before = len(heard.messages["ids"])
    feeder.shift_us += jump_us
    feeder.until(lambda: {m.beacon for m in states(heard, before) if m.lost} >= WITH_ID, f"the loss of all: {reason}")
    lost = len(heard.messages["ids"])
    feeder.until(lambda: names(heard, lost).keys() == WITH_ID, f"all beacons again: {reason}")
    counted(heard, "tracker", f"refused: {reason}", 1)
    counted(heard, "decoder", f"refused: {reason}", 1)
    assert sorted(host.alive()) == ["decoder", "router", "tracker"]
