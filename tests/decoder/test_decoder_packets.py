"""A beacon of packets through the decoder: its name as identification, its messages one record each."""

from __future__ import annotations

from heliograph.core import Context
from heliograph.messages import Data, Identification
from heliograph.site import Beacon
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from support.blinkers import Disc, coded, still, tracks
from support.decoding import HEIGHT, WIDTH, run

BIT_RATE = 2000
END_US = 1_500_000


def test_messages_are_published_whole_and_apart_under_the_beacons_name() -> None:
    from heliograph.link.modulations.packet import Packet  # noqa: PLC0415 - named like nothing else here

    lines = ["one", "two, in two fragments", "three"]
    bits = [bit for i, line in enumerate(lines) for bit in Packet().message(line, 9, i)]
    place = still(100.5, 80.5)
    batch = coded(place, 3.0, bits, 1e6 / BIT_RATE, END_US, WIDTH, HEIGHT, seed=3)
    buoy = Beacon(name="buoy", protocol="packet", payload=9, bit_rate=BIT_RATE)
    core = DecoderCore(DecoderConfig(beacons=(buoy,)), Context(instance="d", boot="0", lockstep=False))
    told = [(t, tracks(t, [("t0", Disc(0, place), 0)])) for t in range(0, END_US, 100_000)]
    out = run(core, batch, told, END_US)
    data = [message for message in out if isinstance(message, Data)]
    # The round repeats and, of three messages, each is a repeat of one just heard: said once, but all are said.
    assert sorted(message.text or "" for message in data) == sorted(lines)
    assert {message.beacon for message in data} == {"buoy"}
    first = next(message for message in out if isinstance(message, Identification))
    assert (first.beacon, first.payload, first.protocol) == ("buoy", 9, "packet")
