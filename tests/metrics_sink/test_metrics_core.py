"""The core beyond its score: order of arrival, lateness, floods, absurd times."""

from __future__ import annotations

import random

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from heliograph.core import Context
from heliograph.errors import Refusal
from heliograph.messages import Frames, Health, Message
from heliograph.wire import pack_body
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.core import CAMERAS_LIMIT, MetricsCore
from heliograph_services.metrics_sink.rows import HealthRow, Row
from heliograph_services.metrics_sink.timeline import STALE_LIMIT
from support.truth_scenes import Said, Sent, state, tracks, truth

CONTEXT = Context(instance="metrics_sink", boot="b0", lockstep=False)
SETTLE_US = 2_000_000
UNTIL_US = 5_000_000


def core_of(max_waiting: int = 100_000) -> MetricsCore:
    return MetricsCore(MetricsSinkConfig(file="", settle_us=SETTLE_US, max_waiting=max_waiting), CONTEXT)


def feed_all(core: MetricsCore, messages: list[Message]) -> tuple[list[Message], list[Row]]:
    out: list[Message] = []
    for message in messages:
        out += core.feed(message)
    out += core.close()
    return out, core.take_rows()


def scene() -> list[Message]:
    pair = [Sent(hidden=((1_500_000, 2_200_000),)), Sent(name="gate", protocol="uart", x_px=300.0, payload=97)]
    said = Said(refused={"parity": 1}).all_of(pair[0], UNTIL_US).all_of(pair[1], UNTIL_US, "t-1")
    states = [state(50_000)] + [state(t, "refreshed", since_us=50_000) for t in range(100_000, UNTIL_US, 100_000)]
    messages: list[Message] = [*truth(pair, UNTIL_US, 20_000), *said.messages(20_000), *states]
    messages += [tracks(t) for t in range(100_000, UNTIL_US, 100_000)]
    return sorted(messages, key=lambda message: message.time_us)


SCENE = scene()
IN_ORDER, ROWS_IN_ORDER = feed_all(core_of(), SCENE)


@given(st.integers(0, 2**32 - 1), st.integers(0, SETTLE_US - 50_000))
def test_the_order_of_arrival_within_the_horizon_does_not_matter(seed: int, spread_us: int) -> None:
    """Each message is late by up to the spread; the camera's first comes first, since it sets the clock."""
    chance = random.Random(seed)
    rest = sorted(SCENE[1:], key=lambda message: message.time_us + chance.randint(0, spread_us))
    out, rows = feed_all(core_of(), [SCENE[0], *rest])
    assert [pack_body(message) for message in out] == [pack_body(message) for message in IN_ORDER]
    assert final(rows) == final(ROWS_IN_ORDER)


def final(rows: list[Row]) -> list[str]:
    """Each key's last row: what the store would hold."""
    newest: dict[str, Row] = {}
    for row in rows:
        names = ("camera", "epoch", "t0_us", "name", "track", "first_us", "beacon", "began_us", "service", "pid")
        newest[type(row).__name__ + "|".join(str(getattr(row, name, "")) for name in names)] = row
    return sorted(map(repr, newest.values()))


def test_seconds_come_whole_and_in_order_while_the_stream_runs() -> None:
    core = core_of()
    out: list[Message] = []
    for message in SCENE:
        out += core.feed(message)
    assert [message.time_us for message in out] == [1_000_000, 2_000_000]
    assert [message.time_us for message in core.close()] == [3_000_000, 4_000_000, 5_000_000]


def test_what_comes_after_its_second_is_settled_is_counted_as_late() -> None:
    core = core_of()
    for message in SCENE:
        core.feed(message)
    core.feed(state(500_000, "refreshed", since_us=50_000))
    assert core.counters["late"] == 1
    assert sum(m.counters.get("cam0/late", 0) for m in core.close()) == 1  # type: ignore[attr-defined]


@given(st.integers(0, 2**32 - 1), st.integers(SETTLE_US, 2 * UNTIL_US))
def test_however_late_each_frame_is_counted_once(seed: int, spread_us: int) -> None:
    chance = random.Random(seed)
    out, _ = feed_all(core_of(), sorted(SCENE, key=lambda message: message.time_us + chance.randint(0, spread_us)))
    n = sum(len(message.t_us) for message in SCENE if isinstance(message, Frames))
    found = [m.counters.get(f"cam0/{name}", 0) for m in out for name in ("frames", "late_frames")]  # type: ignore[attr-defined]
    assert sum(found) == n


def test_silence_finishes_what_waits() -> None:
    core = core_of()
    for message in SCENE:
        core.feed(message)
    assert core.tick(UNTIL_US + SETTLE_US // 2) == []
    assert [m.time_us for m in core.tick(UNTIL_US + 2 * SETTLE_US)] == [3_000_000, 4_000_000, 5_000_000]
    assert core.gauges["waiting"] == 0


def test_a_time_centuries_ahead_costs_one_restart_and_the_stream_goes_on() -> None:
    core = core_of()
    half = len(SCENE) // 2
    damaged = msgspec.structs.replace(tracks(100_000), as_of_us=2**52)
    out, _ = feed_all(core, [*SCENE[:half], damaged, *SCENE[half:]])
    assert core.refusals[Refusal.TIME_JUMP] == 1
    assert core.refusals[Refusal.TIME_BACKWARDS] == 1
    frames = sum(m.counters.get("cam0/frames", 0) for m in out)  # type: ignore[attr-defined]
    # What the other topics send until the damaged one is back in time is stale: a tenth of a second at most.
    sent = sum(len(m.t_us) for m in SCENE if isinstance(m, Frames))
    assert sent - 25 <= frames <= sent


def test_a_stranger_who_sends_one_absurd_time_cannot_hold_the_clock() -> None:
    """The truth is nobody's in this stream but the stranger's: the others outvote it."""
    core = core_of()
    honest = [m for m in SCENE if m.SCHEMA != "truth"]
    stranger = msgspec.structs.replace(truth([Sent()], 10_000)[0], t0_us=2**52 - 10_000, t1_us=2**52)
    half = len(honest) // 2
    out, _ = feed_all(core, [*honest[:half], stranger, *honest[half:]])
    frames = sum(m.counters.get("cam0/frames", 0) for m in out)  # type: ignore[attr-defined]
    sent = sum(len(m.t_us) for m in honest if isinstance(m, Frames))
    assert frames >= sent - 4 * STALE_LIMIT
    assert core.counters["late"] <= 2 * STALE_LIMIT


def test_a_recording_that_is_played_again_is_counted_again() -> None:
    """The source wraps first; what the decoder still had to say of the old pass is stale, not a third stream."""
    core = core_of()
    straggler = Said().add(UNTIL_US - 5_000, track="old").messages()[0]
    _, rows = feed_all(core, [*SCENE, *SCENE[:1], straggler, *SCENE[1:]])
    assert {getattr(row, "epoch", 0) for row in rows} == {0, 1}
    assert core.counters["late"] == 1


def test_a_flood_is_bounded_and_counted() -> None:
    core = core_of(max_waiting=1000)
    said = Said()
    for i in range(3000):
        said.add(500_000 + i, track=f"t-{i}")
    for message in said.messages(100):
        core.feed(message)
    assert core.gauges["waiting"] <= 1000
    assert core.counters["dropped"] >= 2000
    core.close()
    assert core.gauges["waiting"] == 0


def test_invented_cameras_are_refused_beyond_a_limit() -> None:
    core = core_of()
    for i in range(CAMERAS_LIMIT + 5):
        core.feed(tracks(100_000, camera=f"cam{i}"))
    assert core.gauges["cameras"] == CAMERAS_LIMIT
    assert core.refusals[Refusal.OTHER_CAMERA] == 5


def test_invented_beacons_share_a_counter_beyond_a_limit() -> None:
    core = core_of()
    for i in range(10_000):
        core.feed(state(100_000, beacon=f"b{i}", track=f"t{i}"))
    names = {name for m in core.close() for name in m.counters}  # type: ignore[attr-defined]
    assert len(names) < 5000
    assert "cam0/identified/other" in names


def test_health_keeps_the_newest_value_of_each_process() -> None:
    core = core_of()
    for n in (1, 1, 5):
        core.feed(health(n))
    rows = [row for row in core.take_rows() if isinstance(row, HealthRow) and row.name == "missing: events"]
    assert [row.value for row in rows] == [1.0, 5.0]


def health(missing: int) -> Health:
    return Health(
        service="decoder",
        instance="decoder",
        pid=7,
        state="running",
        uptime_s=1.0,
        input_age_s=None,
        cpu_share=0.1,
        counters={"missing: events": missing},
        gauges={},
    )
