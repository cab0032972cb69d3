"""The decoder with the modulations of the project: one scene of five moving beacons of three protocols."""

from __future__ import annotations

from collections import Counter
from typing import Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.core import Context
from heliograph.errors import ConfigError, Refusal
from heliograph.events import EventBatch
from heliograph.link.modulations import modulation
from heliograph.messages import Data, Frames, Identification, Message
from heliograph.site import Beacon
from heliograph.wire import pack_body
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore, make_core, warm
from support.blinkers import Disc, Path, coded, merged, messages, scene, still, tracks

LOCKSTEP = Context(instance="decoder", boot="b0", lockstep=True)
WIDTH, HEIGHT, BIT_US = 640, 480, 1_000.0
END_US = 1_000_000
TEXT = "shall I compare thee "
BEACONS = (
    Beacon(name="crane", protocol="seed11", payload=42, bit_rate=1_000),
    Beacon(name="lift", protocol="seed11", payload=21, bit_rate=1_000),
    Beacon(name="truck", protocol="seed11", payload=51, bit_rate=1_000),
    Beacon(name="mixer", protocol="code", payload=77, bit_rate=1_000, options={"codebook": "code20d4"}),
    Beacon(name="gate", protocol="uart", bit_rate=1_000),
)


def ellipse(i: int) -> Path:
    def path(s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        # Up to 140 px/s.
        return 80 + 115 * i + 40 * np.sin(1.7 * s + i), 240 + 60 * np.cos(2.0 * s + 2 * i)

    return path


DISCS = [Disc(0, ellipse(i), radius_px=3.0 + 0.3 * i) for i in range(5)]
ROWS = [(f"s-{i}", disc, 30_000) for i, disc in enumerate(DISCS)]


@pytest.fixture(scope="module")
def batch() -> EventBatch:
    parts = [scene([], 0, END_US, WIDTH, HEIGHT, noise_hz=5e4)]
    for i, (beacon, disc) in enumerate(zip(BEACONS, DISCS, strict=True)):
        bits = modulation(beacon.protocol, **beacon.options).encode(TEXT if beacon.payload is None else beacon.payload)
        parts.append(coded(disc.path, disc.radius_px, bits, BIT_US, END_US, WIDTH, HEIGHT, i))
    return merged(parts)


def decode(batch: EventBatch, cuts: list[int], *, known: bool = True) -> list[Message]:
    config = DecoderConfig(beacons=BEACONS) if known else DecoderConfig(protocol="auto")
    decoder = make_core(config, LOCKSTEP)
    out: list[Message] = []
    newest_us = 0
    for message in messages(batch, 0, END_US, [*range(0, END_US, 100_000), *cuts], WIDTH, HEIGHT):
        while not decoder.ready(message):
            newest_us += 100_000
            out += decoder.feed(tracks(newest_us, ROWS, speed=0.95, vx_px_s=4.0))
        out += decoder.feed(message)
    return out


@pytest.fixture(scope="module")
def decoded(batch: EventBatch) -> list[Message]:
    warm()
    return decode(batch, list(range(0, END_US, 10_000)))


def test_every_beacon_is_identified_and_no_frame_is_wrong(decoded: list[Message]) -> None:
    accepted = [one for one in decoded if isinstance(one, Identification) and one.change == "accepted"]
    assert sorted(one.beacon for one in accepted) == ["crane", "gate", "lift", "mixer", "truck"]
    frames: Counter[tuple[str, str | None]] = Counter()
    for one in decoded:
        if isinstance(one, Frames):
            frames.update(zip(one.track, one.beacon, strict=True))
    names = [beacon.name for beacon in BEACONS]
    assert set(frames) == {(f"s-{i}", name) for i, name in enumerate(names)}
    # Born at 30 ms: of 970 bits, all but a frame at either end and one for the clock.
    for i, name in enumerate(names):
        assert frames[f"s-{i}", name] >= 970 // (20 if name == "mixer" else 11) - 4


def test_frames_and_identifications_say_where_the_beacon_is(decoded: list[Message]) -> None:
    for one in decoded:
        rows: list[tuple[int, str, float, float]] = []
        if isinstance(one, Frames):
            rows = list(zip(one.t_us, one.track, one.x_px, one.y_px, strict=True))
        elif isinstance(one, Identification):
            rows = [(one.t_us, one.track, one.x_px, one.y_px)]
        for t_us, track, x_px, y_px in rows:
            x, y = DISCS[int(track[-1])].path(np.array([t_us / 1e6]))
            assert np.hypot(x_px - x[0], y_px - y[0]) < 1.5


def test_the_text_comes_whole(decoded: list[Message]) -> None:
    text = "".join(one.text or "" for one in decoded if isinstance(one, Data))
    assert len(text) > 75
    assert text in TEXT * 10


@settings(max_examples=5)
@given(cuts=st.lists(st.integers(1, END_US - 1), max_size=30))
def test_any_cut_gives_the_same_bytes_with_real_receivers(
    batch: EventBatch, decoded: list[Message], cuts: list[int]
) -> None:
    assert [pack_body(one) for one in decode(batch, cuts)] == [pack_body(one) for one in decoded]


def test_without_a_list_of_beacons_all_protocols_and_rates_are_tried(batch: EventBatch) -> None:
    decoder = make_core(DecoderConfig(protocol="auto", bit_rate="auto"), Context("d", "b", lockstep=False))
    decoder.feed(tracks(0, ROWS))
    out: list[Message] = []
    for message in messages(batch, 0, END_US, range(0, END_US, 10_000), WIDTH, HEIGHT):
        out += decoder.feed(message)
    names = {one.beacon for one in out if isinstance(one, Identification)}
    assert {"seed11:42", "seed11:21", "seed11:51", "code:77"} <= names


def one_beacon(payload: int, listed: int | None, rate: float | Literal["auto"]) -> tuple[DecoderCore, list[Message]]:
    disc = Disc(0, still(50, 50))
    bits = modulation("seed11", periodic="believed").encode(payload)
    batch = coded(disc.path, 3.0, bits, BIT_US, 500_000, 100, 100, 1)
    beacons = () if listed is None else (Beacon(name="odd", protocol="seed11", payload=listed, bit_rate=1_000),)
    decoder = make_core(DecoderConfig(beacons=beacons, bit_rate=rate), Context("d", "b", lockstep=False))
    decoder.feed(tracks(0, [("s-0", disc, 0)]))
    return decoder, [
        one for m in messages(batch, 0, 500_000, range(0, 500_000, 10_000), 100, 100) for one in decoder.feed(m)
    ]


@pytest.mark.parametrize(
    ("listed", "rate", "read", "named"),
    [
        (None, "auto", False, False),
        (42, 1000.0, False, False),
        (7, 1000.0, True, True),
        (None, 1000.0, True, False),
    ],
)
def test_a_square_wave_is_named_where_it_is_listed_and_read_where_nothing_is_but_the_rate(
    listed: int | None, rate: float | Literal["auto"], read: bool, named: bool
) -> None:
    decoder, out = one_beacon(7, listed, rate)
    assert {one.beacon for one in out if isinstance(one, Identification)} == ({"odd"} if named else set())
    assert any(one.payload.count(7) for one in out if isinstance(one, Frames)) == read
    if rate != "auto" and not named:
        assert decoder.refusals[Refusal.PERIODIC] > 10


def test_a_listed_payload_that_cannot_be_told_from_its_twin_is_an_operators_mistake() -> None:
    twin = Beacon(name="odd", protocol="seed11", payload=14, bit_rate=1_000)
    with pytest.raises(ConfigError, match=r"beacon odd: payload 14 cannot be sent: .* reads like 60"):
        make_core(DecoderConfig(beacons=(twin,)), LOCKSTEP)
