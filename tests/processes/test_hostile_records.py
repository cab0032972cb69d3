"""A decoder that is fed ten thousand sound but absurd records names what it refuses, does not grow, and still reads."""

from __future__ import annotations

import json
import re
import resource
from collections import Counter
from pathlib import Path

import pytest
import zenoh

from heliograph.keys import key_of
from heliograph.link.modulations.seed11 import Seed11
from heliograph.messages import Health, Identification, Message
from heliograph.shell.links import client_config
from heliograph.shell.site import BusLinks
from heliograph.wire import encoding_of, header_for, pack
from support.blinkers import Disc, coded, merged, messages, still, tracks
from support.fed import fed
from support.hostile import hostile
from support.processes import Collector, Host

pytestmark = pytest.mark.processes

N = 10_000
END_US = 1_000_000
SERVICES = """
[[service]]
kind = "decoder"
max_tracks = 64
backlog_events = 20000
[[beacon]]
name = "crane"
protocol = "seed11"
payload = 42
bit_rate = 1000
"""


def counters(heard: Collector) -> dict[str, int]:
    reports = [m for m in list(heard.messages["health"]) if isinstance(m, Health) and m.service == "decoder"]
    return reports[-1].counters if reports else {}


def arrived(heard: Collector) -> int:
    return sum(n for name, n in counters(heard).items() if name.partition(": ")[0] in {"received", "dropped"})


class Sender:
    """Publishes records as a source and a tracker would, but never drops one: it waits."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._sent: Counter[str] = Counter()

    def send(self, record: Message) -> None:
        name = record.SCHEMA
        if name not in self._publishers:
            self._publishers[name] = self._session.declare_publisher(
                key_of("hostile", record), congestion_control=zenoh.CongestionControl.BLOCK
            )
        header = header_for(record, source="feeder/0", boot="00c0ffee", seq=self._sent[name], mono_ns=0, wall_ns=0)
        self._publishers[name].put(pack(header, record), encoding=encoding_of(record))
        self._sent[name] += 1


def resident_bytes(heard: Collector) -> int:
    pid = next(m.pid for m in list(heard.messages["health"]) if isinstance(m, Health))
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()


def test_hostile_records_neither_stop_a_decoder_nor_swell_it_and_a_beacon_is_read_after_them(tmp_path: Path) -> None:
    with fed(tmp_path, "hostile", SERVICES, ["decoder"], ["ids", "health", "status"]) as (host, heard, _):
        heard.until(lambda h: bool(counters(h)), "the decoder")
        endpoint = re.search(r"tcp/[0-9.:]+", (tmp_path / "hostile.toml").read_text())
        assert endpoint is not None
        config = client_config(BusLinks(connect=(endpoint.group(),), shared_memory=False))
        with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
            sender = Sender(session)
            abused(host, heard, sender)
            play(heard, sender)
            heard.until(lambda h: any(getattr(m, "beacon", "") == "crane" for m in h.messages["ids"]), "the beacon")
        assert set(host.alive()) == {"decoder", "router"}


def abused(host: Host, heard: Collector, sender: Sender) -> None:
    """Send all hostile records, and see what the decoder says and weighs."""
    records = list(hostile(N))
    for record in records[: N // 5]:
        sender.send(record)
    heard.until(lambda h: arrived(h) >= N // 5, "the first of them")
    before = resident_bytes(heard)
    for record in records[N // 5 :]:
        sender.send(record)
    heard.until(lambda h: arrived(h) >= N, "all of them")
    assert resident_bytes(heard) - before < 50_000_000
    counted = counters(heard)
    for reason in ("time runs backwards", "time jumps", "message body breaks its schema"):
        assert counted[f"refused: {reason}"] > 0
    assert "refused: core refused its input" not in counted, host.log("decoder")
    assert not [m for m in heard.messages["ids"] if isinstance(m, Identification) and not m.lost]


def play(heard: Collector, sender: Sender) -> None:
    """Send a second of one beacon, a tenth after the other, each with the track of its beginning."""
    place = still(60.5, 60.5)
    batch = merged([coded(place, 3.0, list(Seed11().encode(42)), 1_000.0, END_US, 160, 120, seed=1)])
    rows = [("good-0", Disc(0, place), 0)]
    for k, message in enumerate(messages(batch, 0, END_US, range(0, END_US, 100_000), stream="good", end=False)):
        if k:
            sender.send(tracks(k * 100_000, rows))
        sender.send(message)

        def told(heard: Collector, end_us: int = message.time_us) -> bool:
            return any(getattr(m, "as_of_us", -1) == end_us for m in list(heard.messages["status"])[-20:])

        heard.until(told, f"the status of {message.time_us} us")
