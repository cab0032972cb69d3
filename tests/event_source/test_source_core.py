"""Windows become records: nothing lost, nothing twice, the same however they are cut."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import ConfigError, Refusal
from heliograph.events import EventBatch, concatenate
from heliograph.messages import Message
from heliograph.streams import Events, Onsets
from heliograph.wire import pack_body
from heliograph_services.event_source import core as source_core
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.cameras.windows import Cutter, stream_name
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.core import CameraInfo, SourceCore
from support.recordings import HEIGHT, WIDTH, events_of, onsets_of, random_events

BATCH = random_events(5_000, 0.1, start_us=-30_000)


def feed_all(config: EventSourceConfig, batch: EventBatch, cuts: list[int] | None = None) -> list[Message]:
    """Return the records of a batch that reaches the cutter in pieces."""
    core = SourceCore(config, CameraInfo(WIDTH, HEIGHT))
    cutter = Cutter(config.window_us, int(batch.t_us[0]))
    edges = [0, *sorted(cuts or []), len(batch)]
    windows = []
    for a, b in pairwise(edges):
        part = batch.part(a, b)
        windows += list(cutter.push(part, int(part.t_us[-1]) if b > a else cutter.t0_us))
    windows.append(cutter.rest())
    out: list[Message] = []
    for i, (t0_us, t1_us, part) in enumerate(windows):
        out += core.feed(Window(t0_us, t1_us, part, "s", end=i == len(windows) - 1))
    return out


@pytest.mark.parametrize("tick_us", [500, 1_000, 5_000])
def test_onsets_are_the_same_if_counted_tick_by_tick_or_a_message_at_once(
    tick_us: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def bodies(counted_at: int) -> list[bytes]:
        monkeypatch.setattr(source_core, "COUNTED_AT", counted_at)
        config = EventSourceConfig(window_us=500, tick_us=tick_us)
        return [pack_body(m) for m in feed_all(config, BATCH) if isinstance(m, Onsets)]

    assert bodies(0) == bodies(100) == bodies(10**9)


def test_the_events_of_a_window_do_not_wait_for_what_else_is_made_of_it() -> None:
    batch = BATCH.part(0, int(np.searchsorted(BATCH.t_us, -20_000)))
    window = Window(-30_000, -20_000, batch, "s")
    core, whole = (SourceCore(EventSourceConfig(), CameraInfo(WIDTH, HEIGHT)) for _ in range(2))
    parts = core.parts(window)
    assert [m.SCHEMA for m in next(parts)] == ["events"]
    assert core.counters["onsets"] == 0
    assert [m.SCHEMA for m in next(parts)] == ["onsets"]
    assert [m.SCHEMA for m in whole.feed(window)] == ["events", "onsets"]
    assert core.counters == whole.counters


@given(st.lists(st.integers(0, len(BATCH)), max_size=8), st.sampled_from([700, 2_000, 10_000]))
@settings(max_examples=20)
def test_any_cut_of_the_input_gives_the_same_records(cuts: list[int], window_us: int) -> None:
    config = EventSourceConfig(window_us=window_us)
    assert [pack_body(m) for m in feed_all(config, BATCH, cuts)] == [pack_body(m) for m in feed_all(config, BATCH)]


@pytest.mark.parametrize("window_us", [500, 2_000, 3_333, 10_000, 1_000_000])
@pytest.mark.parametrize("onsets_us", [5_000, 20_000])
def test_events_and_onsets_do_not_depend_on_the_window(window_us: int, onsets_us: int) -> None:
    messages = feed_all(EventSourceConfig(window_us=window_us, onsets_us=onsets_us), BATCH)
    events = events_of(messages)
    assert np.array_equal(events.t_us, BATCH.t_us)
    assert np.array_equal(events.x_px, BATCH.x_px)
    assert onsets_of(messages) == onsets_of(feed_all(EventSourceConfig(window_us=5_000), BATCH))


def test_every_record_passes_its_own_checks_and_says_where_it_ends() -> None:
    messages = feed_all(EventSourceConfig(max_events=40), BATCH)
    for message in messages:
        again = type(message).from_body(message.to_body())
        assert pack_body(again) == pack_body(message)
    for kind in (Events, Onsets):
        ours = [m for m in messages if isinstance(m, kind)]
        assert all(a.t1_us == b.t0_us for a, b in pairwise(ours))
        assert [m.end for m in ours] == [False] * (len(ours) - 1) + [True]


def test_a_large_window_is_split_and_its_watermarks_hold_back_no_event() -> None:
    # Many events share a time, also where the cut falls.
    t_us = np.repeat(np.array([100, 100, 150], np.int64), 10)
    zeros = np.zeros(30, np.uint16)
    batch = EventBatch(t_us, zeros, zeros, np.ones(30, np.bool_))
    core = SourceCore(EventSourceConfig(max_events=7), CameraInfo(WIDTH, HEIGHT))
    parts = [m for m in core.feed(Window(0, 2_000, batch, "s")) if isinstance(m, Events)]
    assert [len(m.batch) for m in parts] == [7, 7, 7, 7, 2]
    assert parts[-1].t1_us == 2_000
    for earlier, later in pairwise(parts):
        assert earlier.batch.t_us[-1] <= earlier.t1_us <= later.batch.t_us[0]


def test_windows_without_events_still_beat() -> None:
    core = SourceCore(EventSourceConfig(window_us=5_000, onsets_us=10_000), CameraInfo(1, 1))
    messages = [m for k in range(3) for m in core.feed(Window(k * 5_000, (k + 1) * 5_000, EventBatch.empty(), "s"))]
    assert [(m.SCHEMA, m.time_us) for m in messages] == [
        ("events", 5_000), ("events", 10_000), ("onsets", 10_000), ("events", 15_000),
    ]  # fmt: skip


def test_onsets_travel_once_in_their_own_period_on_the_grid_of_the_clock() -> None:
    messages = feed_all(EventSourceConfig(window_us=2_000, onsets_us=20_000), BATCH)
    ends = [m.t1_us for m in messages if isinstance(m, Onsets)]
    assert [t % 20_000 for t in ends[:-1]] == [0] * (len(ends) - 1)
    assert [b - a for a, b in pairwise(ends[:-1])] == [20_000] * (len(ends) - 2)
    with pytest.raises(ConfigError, match="multiple of tick_us"):
        EventSourceConfig(onsets_us=7_500)


def test_the_end_completes_the_tick_it_lies_in() -> None:
    one = EventBatch(
        np.array([11_500, 11_501], np.int64), np.zeros(2, np.uint16), np.zeros(2, np.uint16), np.ones(2, np.bool_)
    )
    core = SourceCore(EventSourceConfig(tick_us=5_000), CameraInfo(1, 1))
    messages = core.feed(Window(10_000, 12_000, one, "s", end=True))
    assert [(m.SCHEMA, m.time_us) for m in messages] == [("events", 12_000), ("onsets", 15_000)]
    assert onsets_of(messages) == [(10_000, 0, 0, 2, 0)]


def test_a_window_before_the_last_is_refused_and_a_new_stream_is_not() -> None:
    core = SourceCore(EventSourceConfig(), CameraInfo(1, 1))
    core.feed(Window(10**15, 10**15 + 2_000, EventBatch.empty(), "a"))
    assert core.feed(Window(0, 2_000, EventBatch.empty(), "a")) == []
    assert core.refusals == {Refusal.TIME_BACKWARDS: 1}
    again = core.feed(Window(-4_000, -2_000, EventBatch.empty(), "b"))
    assert [(m.SCHEMA, m.time_us) for m in again] == [("events", -2_000)]
    # A jump of thirty years leads to records that pass, of four ticks and no more.
    jumped = core.feed(Window(10**15, 10**15 + 20_000, EventBatch.empty(), "c"))
    times = [type(m).from_body(m.to_body()).time_us - 10**15 for m in jumped]
    assert times == [20_000, 10_000, 20_000]


@pytest.mark.parametrize("window_us", [1_000, 7_000, 40_000, 200_000])
def test_what_is_thinned_does_not_depend_on_the_windows(window_us: int) -> None:
    rng = np.random.default_rng(3)
    n, until_us = 60_000, 200_000
    x, y = (rng.integers(0, 8, n) + 40 * rng.integers(0, 5, n) for _ in range(2))
    batch = EventBatch(
        np.sort(rng.integers(0, until_us, n)), x.astype(np.uint16), y.astype(np.uint16), rng.random(n) < 0.5
    )

    def bodies(length_us: int) -> tuple[list[bytes], dict[str, int]]:
        core = SourceCore(EventSourceConfig(onsets_bit_rate_max=1e6), CameraInfo(240, 240))
        out: list[bytes] = []
        for t0_us in range(0, until_us, length_us):
            t1_us = min(t0_us + length_us, until_us)
            part = batch.part(*np.searchsorted(batch.t_us, [t0_us, t1_us]).tolist())
            messages = core.feed(Window(t0_us, t1_us, part, "s", end=t1_us == until_us))
            out += [pack_body(m) for m in messages if isinstance(m, Onsets)]
        return out, {name: count for name, count in core.counters.items() if name.startswith("onset")}

    found, counters = bodies(window_us)
    assert (found, counters) == bodies(10_000)
    assert len(found) == 20
    assert counters["onsets_thinned_lights"] + counters["onsets_thinned_edges"] > 0
    assert counters["onsets_bytes"] <= 1e6 / 8 * 0.2 * 1.1


def test_the_open_gate_thins_nothing() -> None:
    rng = np.random.default_rng(4)
    place = rng.permutation(64 * 64).astype(np.uint16)
    batch = EventBatch(np.zeros(len(place), np.int64), place % 64, place // 64, rng.random(len(place)) < 0.5)
    core = SourceCore(EventSourceConfig(gate="open", onsets_bit_rate_max=1e6), CameraInfo(64, 64))
    core.feed(Window(0, 10_000, batch, "s", end=True))
    assert core.counters["onsets"] == 64 * 64


def test_a_stream_is_named_by_its_size_and_first_events_alone() -> None:
    name = stream_name(WIDTH, HEIGHT, BATCH)
    assert name == stream_name(WIDTH, HEIGHT, BATCH.part(0, 4_096))
    assert name != stream_name(WIDTH + 1, HEIGHT, BATCH)
    assert name != stream_name(WIDTH, HEIGHT, BATCH.part(1, len(BATCH)))
    assert stream_name(1, 1, EventBatch.empty()) == stream_name(1, 1, concatenate([]))


def test_every_setting_has_a_description() -> None:
    for field in msgspec.inspect.type_info(EventSourceConfig).fields:  # type: ignore[attr-defined]
        assert isinstance(field.type, msgspec.inspect.Metadata), field.name
        assert (field.type.extra_json_schema or {}).get("description"), field.name
