"""Tracks and light that are wrong: nothing is invented, what can be read is, and every refusal has a name."""

from __future__ import annotations

import re
import resource
from pathlib import Path

import msgspec
import numpy as np
import pytest

from heliograph.errors import Refusal
from heliograph.events import EventBatch
from heliograph.link.modulations.seed11 import Seed11
from heliograph.messages import Data, Frames, Identification, Message, Status, Tracks
from heliograph.site import Beacon
from heliograph.streams import Events
from heliograph.wire import Refused, header_for, pack, unpack
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from support.blinkers import Disc, coded, merged, scene, still, tracks
from support.decoding import LIVE, core, run, states
from support.hostile import hostile
from support.lone_lights import SENT, heard

WIDTH, HEIGHT = 320, 240
END_US = 1_000_000
PLACE = still(100.5, 80.5)
CRANE = Beacon(name="crane", protocol="seed11", payload=42, bit_rate=1_000)
ROWS = [("a-0", Disc(0, PLACE), 0)]


# ---- light -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.5, 2.0])
@pytest.mark.parametrize("protocol", SENT)
def test_a_bit_rate_wrong_by_half_reads_nothing_and_a_right_one_reads_it(protocol: str, ratio: float) -> None:
    told = SENT[protocol].bit_rate
    wrong = heard(protocol, told, told * ratio, duration_s=8_000 / told)
    assert (wrong.identities, wrong.text, wrong.frames) == (set(), "", 0)
    right = heard(protocol, told * ratio, told * ratio, duration_s=8_000 / told)
    assert right.identities
    assert right.frames


def stuck(x_px: int, y_px: int, every_us: int, end_us: int = END_US) -> EventBatch:
    """Return a pixel that fires again as soon as it may, brighter and darker in turn."""
    n = end_us // every_us
    return EventBatch(
        np.arange(n, dtype=np.int64) * every_us,
        np.full(n, x_px, np.uint16),
        np.full(n, y_px, np.uint16),
        np.arange(n) % 2 == 0,
    )


def of_the_beacon() -> EventBatch:
    return coded(PLACE, 3.0, list(Seed11().encode(42)), 1_000.0, END_US, WIDTH, HEIGHT, seed=0)


def followed(config: DecoderConfig, *parts: EventBatch) -> tuple[DecoderCore, list[Message]]:
    decoder = DecoderCore(config, LIVE)
    told = [(t_us, tracks(t_us, ROWS)) for t_us in range(0, END_US, 100_000)]
    return decoder, run(decoder, merged(list(parts)), told, END_US, (WIDTH, HEIGHT))


# At 50,000 events a second in the heart of a light of 28 pixels, which is all that a link of 1 kbit/s hears, the lock
# takes longer.
@pytest.mark.parametrize(("every_us", "at_least"), [(20, 70), (100, 85), (1_000, 85)])
def test_a_stuck_pixel_on_a_beacon_hardly_costs_a_frame(every_us: int, at_least: int) -> None:
    _, out = followed(DecoderConfig(beacons=(CRANE,)), of_the_beacon(), stuck(101, 80, every_us))
    assert [one.beacon for one in states(out, "accepted")] == ["crane"]
    payloads = [payload for one in out if isinstance(one, Frames) for payload in one.payload]
    assert payloads == [42] * len(payloads)
    assert len(payloads) >= at_least  # of 90 frames sent


def test_a_hot_row_through_a_beacon_costs_nothing() -> None:
    row = [stuck(x_px, 80, 1_000 + x_px) for x_px in range(0, WIDTH, 2)]
    _, out = followed(DecoderConfig(beacons=(CRANE,)), of_the_beacon(), *row)
    assert [one.beacon for one in states(out, "accepted", "changed")] == ["crane"]


@pytest.mark.parametrize("every_us", [50, 500, 5_000])
def test_a_stuck_pixel_alone_is_no_beacon_in_any_protocol(every_us: int) -> None:
    for config in (
        DecoderConfig(protocol="auto", bit_rate="auto"),
        DecoderConfig(protocol="auto", bit_rate=min(1e6 / every_us, 20_000.0)),
    ):
        _, out = followed(config, stuck(101, 80, every_us))
        assert not [one for one in out if isinstance(one, (Identification, Data))]
        assert not [one for one in out if isinstance(one, Frames) and one.t_us]


# ---- tracks ------------------------------------------------------------------------------------------------------


NUMBERS = ["x_px", "y_px", "vx_px_s", "vy_px_s", "radius_px", "x_var_px2", "x_vx_cov_px2_s", "vx_var_px2_s2"]


@pytest.mark.parametrize("column", NUMBERS)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_tracks_with_what_is_no_number_are_refused_and_what_is_followed_stays(column: str, value: float) -> None:
    disc = Disc(5, still(100, 100))
    decoder = core()
    told = [(t_us, tracks(t_us, [("a-0", disc, 0)])) for t_us in range(0, 300_000, 100_000)]
    bad = msgspec.structs.replace(tracks(150_000, [("a-0", disc, 0)]), **{column: [value]})
    out = run(decoder, scene([disc], 0, 400_000, WIDTH, HEIGHT), [*told, (150_000, bad)], 400_000, (WIDTH, HEIGHT))
    assert decoder.refusals == {Refusal.BAD_BODY: 1}
    assert [one.change for one in states(out, "accepted", "changed", "lost")] == ["accepted"]
    sent = unpack(pack(header_for(bad, source="s", boot="b", seq=0, mono_ns=0, wall_ns=0), bad))
    assert isinstance(sent, Refused)
    assert sent.reason is Refusal.BAD_BODY


def jumping(t_us: int) -> Tracks:
    """Return tracks that are elsewhere each time, also off the sensor, beside one that is right."""
    rng = np.random.default_rng(t_us)
    wild = [
        (f"w-{i}", Disc(0, still(*rng.uniform(-200, 500, 2)), radius_px=float(rng.uniform(0.1, 60))), 0)
        for i in range(12)
    ]
    return tracks(t_us, [("a-0", Disc(5, still(100, 100)), 0), *wild])


def overlapping(t_us: int) -> Tracks:
    """Return a dozen tracks on one light."""
    return tracks(t_us, [(f"a-{i}", Disc(5, still(100 + 0.3 * i, 100)), 0) for i in range(12)])


def vanishing(t_us: int) -> Tracks:
    """Return the light's track now and then, each time under another name."""
    k = t_us // 100_000
    return tracks(t_us, [(f"a-{k}", Disc(5, still(100, 100)), 0)] if k % 2 == 0 else [])


@pytest.mark.parametrize("said", [jumping, overlapping, vanishing])
def test_tracks_that_jump_overlap_or_vanish_neither_split_a_beacon_nor_lose_it(said: object) -> None:
    batch = scene([Disc(5, still(100, 100))], 0, 1_500_000, WIDTH, HEIGHT, noise_hz=1e4)
    decoder = core()
    told = [(t_us + 20_000, said(t_us)) for t_us in range(0, 1_500_000, 100_000)]  # type: ignore[operator]
    out = run(decoder, batch, told, 1_500_000, (WIDTH, HEIGHT))
    assert {one.beacon for one in states(out)} == {"crane"}
    for one in out:
        if isinstance(one, Status) and one.as_of_us >= 500_000:
            assert sum(token is not None for token in one.identity) == 1
    held = [one for one in states(out) if one.t_us > 500_000]
    assert all(np.hypot(one.x_px - 100, one.y_px - 100) < 3.0 for one in held)
    assert decoder.counters["duplicates"] == 0


def test_events_off_the_sensor_are_counted_and_the_others_read() -> None:
    disc = Disc(5, still(60, 60))
    batch = merged([scene([disc], 0, 400_000, 640, 480), scene([Disc(2, still(500, 400))], 0, 400_000, 640, 480)])
    decoder = core()
    out = run(decoder, batch, [(20_000, tracks(0, [("a-0", disc, 0)]))], 400_000, (160, 120))
    assert decoder.refusals[Refusal.OFF_SENSOR] == int((batch.x_px >= 160).sum())
    assert [one.beacon for one in states(out, "accepted")] == ["crane"]
    counted = sum(one.refused.get(Refusal.OFF_SENSOR.value, 0) for one in out if isinstance(one, Frames))
    assert counted == decoder.refusals[Refusal.OFF_SENSOR]


# ---- ten thousand of them ----------------------------------------------------------------------------------------


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def test_ten_thousand_hostile_messages_are_refused_by_name_in_bounded_memory() -> None:
    decoder = core(max_tracks=64, backlog_events=20_000)
    messages = list(hostile(10_000))
    grown: list[int] = []
    for k, message in enumerate(messages):
        for one in decoder.feed(message):
            assert not (isinstance(one, Identification) and not one.lost)
        if k % 2_500 == 2_499:
            grown.append(resident_bytes())
    assert max(grown) - grown[0] < 20_000_000
    assert decoder.gauges["tracks"] <= 64
    assert decoder.gauges["backlog_events"] <= 20_000
    assert {Refusal.TIME_BACKWARDS, Refusal.TIME_JUMP, Refusal.OTHER_GEOMETRY, Refusal.OFF_SENSOR} <= set(
        decoder.refusals
    )
    # And it still reads: a new stream with a beacon in it.
    disc = Disc(5, still(60, 60))
    decoder.feed(tracks(10**10, [("z-0", disc, 0)]))
    batch = scene([disc], 10**10, 10**10 + 300_000, 160, 120)
    out: list[Message] = []
    for t_us in range(10**10, 10**10 + 300_000, 10_000):
        first, behind = np.searchsorted(batch.t_us, [t_us, t_us + 10_000])
        out += decoder.feed(
            Events(
                camera="cam0", stream="new", width=160, height=120, t0_us=t_us, t1_us=t_us + 10_000,
                batch=batch.part(int(first), int(behind)),
            )
        )  # fmt: skip
        if t_us == 10**10 + 20_000:
            out += decoder.feed(tracks(10**10 + 10_000, [("z-0", disc, 0)]))
    assert [one.beacon for one in states(out, "accepted")] == ["crane"]


def test_every_reason_for_which_a_decoder_refuses_is_explained_in_its_readme() -> None:
    root = Path(__file__).parents[2]
    decoder = root / "services" / "heliograph_services" / "decoder"
    sources = [*decoder.glob("*.py"), *(root / "common" / "heliograph" / "link").rglob("*.py")]
    used = {name for file in sources for name in re.findall(r"Refusal\.([A-Z_]+)", file.read_text())}
    explained = (decoder / "README.md").read_text()
    assert len(used) > 15
    assert [name for name in sorted(used) if Refusal[name].value not in explained] == []
