"""What the decoder owes to its streams: order, bounds, and independence of how they are cut."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.core import Context
from heliograph.errors import Refusal
from heliograph.events import EventBatch
from heliograph.messages import Frames, Identification, Message, Status, Tracks
from heliograph.site import Beacon
from heliograph.streams import Events
from heliograph.wire import pack_body
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from support.blinkers import Disc, messages, pulse_only, scene, straight, tracks

LOCKSTEP = Context(instance="decoder", boot="b0", lockstep=True)
LIVE = Context(instance="decoder", boot="b0", lockstep=False)
BEACONS = (
    Beacon(name="crane", protocol="pulse", payload=5, bit_rate=100, options={"says": 1}),
    Beacon(name="lift", protocol="pulse", payload=2, bit_rate=100, options={"says": 1}),
)
END_US = 700_000
ONE = Disc(5, straight(20, 30, 150, 20))
TWO = Disc(2, straight(140, 90, -120, -10), radius_px=2.0)
EVENTS = scene([ONE, TWO], 0, END_US, 160, 120)
ROWS = [("s-0", ONE, 0), ("s-1", TWO, 40_000)]


def core(context: Context = LOCKSTEP, **settings_: object) -> DecoderCore:
    return DecoderCore(DecoderConfig(beacons=BEACONS, **settings_), context, modulation_of=pulse_only)  # type: ignore[arg-type]


def lockstep(decoder: DecoderCore, inputs: Iterable[Message]) -> list[Message]:
    """Feed events as the shell does in lockstep, with an ideal tracker that waits for the decoder's status."""
    out: list[Message] = []
    newest_us = 0
    for message in inputs:
        while not decoder.ready(message):
            newest_us += 100_000
            rows = [row for row in ROWS if row[2] < newest_us]
            out += decoder.feed(tracks(newest_us, rows, vx_px_s=15.0))
        out += decoder.feed(message)
    return out


def bodies(out: Iterable[Message]) -> list[bytes]:
    return [pack_body(message) for message in out]


REFERENCE = bodies(lockstep(core(), messages(EVENTS, 0, END_US, range(0, END_US, 10_000))))


@settings(max_examples=25)
@given(st.lists(st.integers(1, END_US - 1), max_size=40))
def test_any_cut_of_the_events_gives_the_same_bytes(cuts: list[int]) -> None:
    # No message may span more than a jump or outrun the tracks by which it is decoded.
    fixed = range(0, END_US, 100_000)
    assert bodies(lockstep(core(), messages(EVENTS, 0, END_US, [*fixed, *cuts]))) == REFERENCE


def test_the_reference_run_reads_both_beacons() -> None:
    out = lockstep(core(), messages(EVENTS, 0, END_US, range(0, END_US, 10_000)))
    states = [one for one in out if isinstance(one, Identification)]
    assert {(one.track, one.beacon) for one in states if one.change == "accepted"} == {
        ("s-0", "crane"),
        ("s-1", "lift"),
    }
    assert sum(len(one.t_us) for one in out if isinstance(one, Frames)) >= 2 * END_US // 10_000 - 8


def test_events_on_the_watermark_are_decoded_once() -> None:
    batch = scene([ONE], 0, 300_000, 160, 120)
    middle = len(batch) // 2
    cut_us = int(batch.t_us[middle])
    shared = [
        Events(camera="cam0", stream="s", width=160, height=120, t0_us=a, t1_us=b, batch=part, end=last)
        for a, b, part, last in (
            (0, cut_us, batch.part(0, middle + 1), False),
            (cut_us, 300_000, batch.part(middle + 1, len(batch)), True),
        )
    ]
    whole = messages(batch, 0, 300_000, [])
    results = []
    for inputs in (shared, whole):
        decoder = core(LIVE)
        decoder.feed(tracks(0, [("s-0", ONE, 0)]))
        results.append(bodies(out for message in inputs for out in decoder.feed(message)))
    assert results[0] == results[1]


def test_tracks_count_one_period_after_their_instant_and_events_wait_for_them() -> None:
    decoder = core()
    inputs = messages(EVENTS, 50_000, END_US, range(50_000, END_US, 10_000), end=False)
    by_end = {message.t1_us: message for message in inputs if isinstance(message, Events)}
    before = decoder.feed(by_end[60_000])
    # First event time 50 ms: counts as tracks of 0, so events up to 200 ms need none.
    assert decoder.ready(by_end[200_000])
    assert not decoder.ready(by_end[210_000])
    decoder.feed(tracks(100_000, ROWS))
    assert decoder.ready(by_end[300_000])
    assert not decoder.ready(by_end[310_000])
    before += [out for t1_us in range(70_000, 200_001, 10_000) for out in decoder.feed(by_end[t1_us])]
    assert [one.track for one in before if isinstance(one, Status)] == [[], []]
    after = [out for t1_us in range(210_000, 300_001, 10_000) for out in decoder.feed(by_end[t1_us])]
    assert [(one.as_of_us, one.track) for one in after if isinstance(one, Status)] == [(300_000, ["s-0", "s-1"])]


def test_live_uses_the_newest_tracks_at_once() -> None:
    decoder = core(LIVE)
    inputs = messages(EVENTS, 0, END_US, range(0, END_US, 10_000), end=False)
    assert all(decoder.ready(message) for message in inputs)
    decoder.feed(inputs[0])
    decoder.feed(tracks(5_000, ROWS[:1]))
    decoder.feed(inputs[1])
    assert decoder.gauges["tracks"] == 1


def test_a_status_is_sent_for_every_period_after_the_frames_before_it() -> None:
    out = lockstep(core(), messages(EVENTS, 0, END_US, range(0, END_US, 7_000)))
    assert [one.as_of_us for one in out if isinstance(one, Status)] == list(range(100_000, END_US + 1, 100_000))
    reached_us = 0
    for one in out:
        if isinstance(one, Frames):
            assert one.t0_us >= reached_us
        if isinstance(one, Status):
            reached_us = one.as_of_us


def test_frames_are_ordered_by_time_then_track() -> None:
    out = lockstep(core(), messages(EVENTS, 0, END_US, range(0, END_US, 10_000)))
    for one in out:
        if isinstance(one, Frames):
            rows = list(zip(one.t_us, one.track, strict=True))
            assert rows == sorted(rows)


def quiet(t0_us: int, t1_us: int, **other: object) -> Events:
    fields = {"camera": "cam0", "stream": "s", "width": 160, "height": 120} | other
    return Events(t0_us=t0_us, t1_us=t1_us, batch=EventBatch.empty(), **fields)  # type: ignore[arg-type]


def followed() -> tuple[DecoderCore, int]:
    """Return a live core that holds two identities, and its watermark."""
    decoder = core(LIVE)
    decoder.feed(tracks(0, ROWS))
    for message in messages(EVENTS, 0, 400_000, range(0, 400_000, 10_000), end=False):
        decoder.feed(message)
    assert decoder.gauges["identities"] == 2
    return decoder, 400_000


def lost(out: list[Message]) -> list[str]:
    return sorted(one.track for one in out if isinstance(one, Identification) and one.lost)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (quiet(380_000, 390_000), Refusal.TIME_BACKWARDS),
        (quiet(400_000, 2_000_000), Refusal.TIME_JUMP),
        (quiet(400_000, 410_000, camera="cam1"), Refusal.OTHER_CAMERA),
        (
            Events(
                camera="cam0", stream="s", width=160, height=120, t0_us=400_000, t1_us=401_000, batch=EVENTS.part(0, 9)
            ),
            Refusal.UNORDERED,
        ),
    ],
)  # fmt: skip
def test_a_message_out_of_place_is_refused_and_nothing_is_lost(message: Events, reason: Refusal) -> None:
    decoder, now_us = followed()
    assert decoder.feed(message) == []
    assert decoder.refusals[reason] == 1
    out = decoder.feed(quiet(now_us, now_us + 10_000))
    assert lost(out) == []
    assert [one.refused for one in out if isinstance(one, Frames)] == [{reason.value: 1}]


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (quiet(0, 10_000), Refusal.TIME_BACKWARDS),
        (quiet(5_000_000, 5_010_000), Refusal.TIME_JUMP),
        (quiet(2**52, 2**52 + 10_000), Refusal.TIME_JUMP),
        (quiet(400_000, 410_000, width=200), Refusal.OTHER_GEOMETRY),
        (quiet(400_000, 410_000, stream="t"), None),
    ],
)
def test_a_stream_that_begins_anew_ends_all_identities(message: Events, reason: Refusal | None) -> None:
    decoder, _ = followed()
    out = decoder.feed(message)
    assert lost(out) == ["s-0", "s-1"]
    assert decoder.gauges["tracks"] == 0
    assert dict(decoder.refusals) == ({reason: 1} if reason else {})
    # And it decodes as a fresh one would.
    shifted = messages(EVENTS, 0, 400_000, range(0, 400_000, 10_000), stream="u", end=False)
    decoder.feed(shifted[0])
    decoder.feed(tracks(0, ROWS))
    for one in shifted[1:]:
        decoder.feed(one)
    assert decoder.gauges["identities"] == 2


def test_after_a_jump_in_lockstep_nobody_waits_for_tracks_of_the_other_time() -> None:
    decoder = core()
    lockstep(decoder, messages(EVENTS, 0, 300_000, range(0, 300_000, 10_000), end=False))
    assert decoder.ready(quiet(50_000_000, 50_010_000))
    assert decoder.ready(quiet(0, 10_000, stream="t"))
    assert not decoder.ready(quiet(50_000_000, 50_210_000))


def test_the_end_ends_every_identity_and_the_next_stream_begins_anew() -> None:
    decoder = core()
    out = lockstep(decoder, messages(EVENTS, 0, END_US, range(0, END_US, 10_000)))
    assert lost(out) == ["s-0", "s-1"]
    assert bodies(lockstep(decoder, messages(EVENTS, 0, END_US, range(0, END_US, 10_000)))) == REFERENCE


def test_silence_loses_identities_by_the_clock_but_moves_no_time() -> None:
    decoder, now_us = followed()
    assert decoder.tick(now_us + 500_000) == []
    assert lost(decoder.tick(now_us + 3_000_000)) == ["s-0", "s-1"]
    assert decoder.tick(2**53) == []
    rest = messages(EVENTS, now_us, END_US, range(0, END_US, 10_000), end=False)
    states = [one for message in rest for one in decoder.feed(message) if isinstance(one, Identification)]
    assert {one.track for one in states if one.change == "accepted"} == {"s-0", "s-1"}


def absurd(as_of_us: int, **columns: list[float]) -> Tracks:
    row: dict[str, list[float]] = {
        "x_px": [20.0], "y_px": [30.0], "vx_px_s": [0.0], "vy_px_s": [0.0], "radius_px": [3.0],
    } | columns  # fmt: skip
    n = max(len(column) for column in row.values())
    filled = {name: (column * n)[:n] for name, column in row.items()}
    return Tracks(
        camera="cam0", as_of_us=as_of_us, period_us=100_000, track=[f"x-{i}" for i in range(n)],
        born_us=[-(2**53)] * n, seen_us=[2**53] * n, x_var_px2=[1e12] * n, y_var_px2=[1e12] * n,
        x_vx_cov_px2_s=[-1e12] * n, vx_var_px2_s2=[1e12] * n, y_vy_cov_px2_s=[1e12] * n, vy_var_px2_s2=[1e12] * n,
        size_px=[0.0] * n, polarity=[0.0] * n,
        status=["valid"] * n, **filled,
    )  # fmt: skip


@pytest.mark.parametrize(
    "columns",
    [
        {"x_px": [1e12], "y_px": [-1e12]},
        {"vx_px_s": [1e12], "vy_px_s": [-1e12]},
        {"radius_px": [1e12]},
        {"radius_px": [0.0]},
        {"x_px": [20.0] * 5_000},
        {"x_px": [-1e12, 1e12] * 300, "radius_px": [1e12]},
    ],
)
def test_absurd_tracks_do_no_harm(columns: dict[str, list[float]]) -> None:
    decoder = core(LIVE)
    inputs = messages(EVENTS, 0, 300_000, range(0, 300_000, 10_000), end=False)
    out: list[Message] = []
    for message in inputs[:15]:
        out += decoder.feed(message)
    decoder.feed(absurd(140_000, **columns))
    for message in inputs[15:25]:
        out += decoder.feed(message)
    n = max(len(column) for column in columns.values())
    assert decoder.gauges["tracks"] <= 256
    assert decoder.counters["tracks_dropped"] == max(0, n - 256)
    decoder.feed(tracks(240_000, ROWS))
    for message in inputs[25:]:
        out += decoder.feed(message)
    states = [one for one in out if isinstance(one, Identification)]
    assert {("s-0", "crane"), ("s-1", "lift")} <= {(one.track, one.beacon) for one in states if not one.lost}
    for one in out:
        type(one).from_body(one.to_body())


@pytest.mark.parametrize("as_of_us", [-(2**53), 2**53, 60_000_000])
def test_tracks_of_another_time_are_refused(as_of_us: int) -> None:
    decoder, now_us = followed()
    decoder.feed(absurd(as_of_us))
    decoder.feed(quiet(now_us, now_us + 10_000))
    assert decoder.gauges["identities"] == 2
    assert sum(decoder.refusals.values()) == 1


def test_tracks_that_come_twice_or_from_another_camera_are_refused() -> None:
    decoder, _ = followed()
    decoder.feed(tracks(0, ROWS))
    assert decoder.refusals[Refusal.TIME_BACKWARDS] == 1
    other = tracks(390_000, ROWS)
    decoder.feed(Tracks(**{name: getattr(other, name) for name in other.__struct_fields__} | {"camera": "cam1"}))
    assert decoder.refusals[Refusal.OTHER_CAMERA] == 1


def test_a_sparse_stream_of_long_messages_is_cut_like_a_dense_one() -> None:
    decoder = core(LIVE)
    for k in range(20):
        decoder.feed(quiet(k * 1_000_000, (k + 1) * 1_000_000))
    assert decoder.counters["windows"] == 20 * 1_000
    assert not decoder.refusals


def test_a_pixel_off_the_sensor_is_counted_and_reads_no_foreign_memory() -> None:
    batch = scene([Disc(5, straight(90, 70, 0, 0))], 0, 100_000, 160, 120)
    small = [
        Events(camera="cam0", stream="s", width=64, height=48, t0_us=0, t1_us=100_000, batch=batch),
        quiet(100_000, 200_000, width=64, height=48),
    ]
    decoder = core(LIVE)
    for message in small:
        decoder.feed(message)
    assert decoder.refusals[Refusal.OFF_SENSOR] == len(batch)
