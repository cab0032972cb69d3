"""Sound records in absurd order: the decoder neither raises nor publishes what its readers would refuse."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.core import Context
from heliograph.events import EventBatch
from heliograph.messages import TIME_LIMIT_US, WINDOW_LIMIT_US, Message, Progress, Tracks
from heliograph.streams import Events
from heliograph.wire import Refused, header_for, pack, unpack
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from support.blinkers import Disc, messages, pulse_only, scene, still, tracks

DISC = Disc(5, still(20, 20))
SCENE = messages(scene([DISC], 0, 300_000, 64, 48, noise_hz=1e4), 0, 300_000, range(0, 300_000, 10_000), 64, 48)

times = st.one_of(st.integers(0, 400_000), st.integers(-TIME_LIMIT_US, TIME_LIMIT_US))
numbers = st.one_of(st.floats(-5, 70), st.floats(-1e12, 1e12))
lengths = st.one_of(st.integers(0, 20_000), st.integers(0, WINDOW_LIMIT_US))


@st.composite
def absurd_tracks(draw: st.DrawFn) -> Message:
    n = draw(st.integers(0, 6))
    column = st.lists(numbers, min_size=n, max_size=n)
    size = st.lists(st.one_of(st.floats(0, 20), st.floats(0, 1e12)), min_size=n, max_size=n)
    return Tracks(
        camera=draw(st.sampled_from(["cam0", "cam0", "cam0", "cam1"])),
        as_of_us=draw(times),
        period_us=draw(st.sampled_from([1, 100_000, WINDOW_LIMIT_US])),
        track=[f"{draw(st.sampled_from('ab'))}-{i}" for i in range(n)],
        born_us=draw(st.lists(times, min_size=n, max_size=n)),
        seen_us=draw(st.lists(times, min_size=n, max_size=n)),
        x_px=draw(column),
        y_px=draw(column),
        vx_px_s=draw(column),
        vy_px_s=draw(column),
        x_var_px2=draw(size),
        x_vx_cov_px2_s=draw(column),
        vx_var_px2_s2=draw(size),
        y_var_px2=draw(size),
        y_vy_cov_px2_s=draw(column),
        vy_var_px2_s2=draw(size),
        radius_px=draw(size),
        size_px=draw(size),
        polarity=[0.0] * n,
        status=["new"] * n,
    )


@st.composite
def absurd_events(draw: st.DrawFn) -> Message:
    t0_us = draw(times)
    width, height = draw(st.sampled_from([(64, 48), (64, 48), (1, 1), (4096, 2), (7, 9)]))
    return Events(
        camera="cam0",
        stream=draw(st.sampled_from(["s", "s", "t"])),
        width=width,
        height=height,
        t0_us=t0_us,
        t1_us=min(t0_us + draw(lengths), TIME_LIMIT_US),
        batch=EventBatch.empty(),
        end=draw(st.booleans()),
    )


inputs = st.one_of(
    absurd_tracks(),
    absurd_events(),
    st.sampled_from(SCENE),
    st.just(tracks(100_000, [("a-0", DISC, 0)])),
    st.just(Progress(camera="cam0", service="tracker", t_us=5)),
)


@settings(max_examples=150)
@given(st.lists(inputs, max_size=30), st.booleans(), st.integers(0, 29))
def test_no_order_of_sound_records_makes_the_decoder_raise(stream: list[Message], lockstep: bool, begin: int) -> None:
    decoder = DecoderCore(
        DecoderConfig(protocol="pulse", backlog_events=5_000), Context("d", "b", lockstep=lockstep), "", pulse_only
    )
    for message in (*SCENE[:begin], *stream):
        sent = unpack(pack(header_for(message, source="s", boot="b", seq=0, mono_ns=0, wall_ns=0), message))
        assert not isinstance(sent, Refused)
        decoder.ready(sent[1])
        out = decoder.feed(sent[1])
        out += decoder.tick(message.time_us)
        assert len(out) <= 2_000
        for one in out:
            back = unpack(pack(header_for(one, source="s", boot="b", seq=0, mono_ns=0, wall_ns=0), one))
            assert not isinstance(back, Refused), back.detail
    assert decoder.gauges["backlog_events"] <= 5_000
