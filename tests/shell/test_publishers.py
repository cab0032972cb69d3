"""Keys that a process publishes on are let go of when they are over."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import msgspec
import pytest
import zenoh

from heliograph.keys import key_of
from heliograph.messages import Identification, Link
from heliograph.qos import PROFILES
from heliograph.shell import bus as bus_module
from heliograph.shell.bus import Bus, open_session
from heliograph.shell.links import router_config
from heliograph.shell.site import BusLinks, RouterLinks
from heliograph.wire import encoding_of, unpack
from support.processes import free_port
from support.records import every_record

pytestmark = pytest.mark.processes


@pytest.fixture
def session() -> Iterator[zenoh.Session]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    opened = open_session(
        router_config(RouterLinks(listen=(endpoint,)), BusLinks(connect=(endpoint,), shared_memory=False))
    )
    assert opened is not None
    with opened:
        yield opened


def test_a_track_unheard_for_a_minute_gives_up_its_key_and_one_still_heard_keeps_its_numbering(
    session: zenoh.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [1000.0]
    monkeypatch.setattr(
        bus_module, "time", SimpleNamespace(monotonic_ns=lambda: int(now_s[0] * 1e9), time_ns=lambda: int(1e18))
    )
    first = next(record for record in every_record() if isinstance(record, Identification))
    tracks = [msgspec.structs.replace(first, track=f"5eed-{n}") for n in range(4)]
    keys = [key_of("site", track) for track in tracks]
    bus = Bus(session, "site", "decoder/main")
    for at_s, n in ((0, 0), (0, 1), (50, 1), (61, 2), (100, 1), (125, 3)):
        now_s[0] = 1000.0 + at_s
        bus.publish(tracks[n])
    held = dict(bus._seq)
    bus.close()
    assert held == {keys[1]: 3, keys[3]: 1}


def test_link_quality_of_a_track_is_heard_though_its_key_is_never_declared(session: zenoh.Session) -> None:
    record = next(record for record in every_record() if isinstance(record, Link))
    key_text = key_of("site", record)
    assert PROFILES["link"].history == 0
    with session.declare_subscriber(key_text, zenoh.handlers.FifoChannel(4)) as heard:
        bus = Bus(session, "site", "decoder/main")
        bus.publish(record)
        bus.publish(record)
        samples = [heard.recv(), heard.recv()]
        held = [publisher.zenoh for publisher in bus._publishers.values()]
        bus.close()
    opened = [unpack(sample.payload.to_bytes()) for sample in samples]
    assert [one[1] for one in opened if isinstance(one, tuple)] == [record, record]
    assert [one[0].seq for one in opened if isinstance(one, tuple)] == [0, 1]
    assert str(samples[0].encoding) == encoding_of(record)
    assert not any(isinstance(one, zenoh.Publisher) for one in held)
