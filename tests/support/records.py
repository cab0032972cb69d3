"""One record of every schema, the same in every run: what the golden bytes and the mutation tests start from."""

from __future__ import annotations

from typing import Any

import numpy as np

from heliograph.beacons import BeaconCommand, BeaconReply, BeaconState, Settings
from heliograph.events import EventBatch
from heliograph.flow import Flow
from heliograph.messages import (
    Clock,
    Data,
    Frames,
    Health,
    Identification,
    Link,
    Message,
    Metrics,
    Progress,
    Status,
    Tracks,
)
from heliograph.streams import Events, Image, Onsets
from heliograph.truth import Truth
from heliograph.wire import Header, header_for


def header_of(message: Message, seq: int = 7) -> Header:
    """Return a header that is the same in every run."""
    return header_for(message, source="tests/0", boot="00c0ffee", seq=seq, mono_ns=11, wall_ns=13)


def every_record() -> list[Message]:
    """Return one record of every schema."""
    batch = EventBatch(
        np.array([1000, 1000, 1999], np.int64),
        np.array([3, 4, 639], np.uint16),
        np.array([5, 0, 479], np.uint16),
        np.array([True, False, True]),
    )
    window: Any = {"camera": "cam0", "stream": "5eed", "width": 640, "height": 480}
    return [
        Events(**window, t0_us=1000, t1_us=2000, batch=batch, end=False),
        Onsets(
            **window,
            t0_us=0,
            t1_us=10_000,
            tick_us=5000,
            pool_px=1,
            tick=np.array([0, 1, 1], np.uint16),
            x_px=np.array([3, 4, 639], np.uint16),
            y_px=np.array([5, 5, 479], np.uint16),
            on_count=np.array([2, 0, 15], np.uint8),
            off_count=np.array([0, 1, 0], np.uint8),
        ),
        Tracks(
            camera="cam0",
            as_of_us=100_000,
            period_us=100_000,
            track=["5eed-0"],
            born_us=[5000],
            seen_us=[95_000],
            x_px=[12.5],
            y_px=[20.25],
            vx_px_s=[-3.5],
            vy_px_s=[0.0],
            x_var_px2=[0.5],
            x_vx_cov_px2_s=[1.25],
            vx_var_px2_s2=[30.0],
            y_var_px2=[0.5],
            y_vy_cov_px2_s=[1.25],
            vy_var_px2_s2=[30.0],
            radius_px=[3.0],
            size_px=[28.0],
            polarity=[0.25],
            status=["valid"],
        ),
        Status(
            camera="cam0",
            as_of_us=100_000,
            track=["5eed-0"],
            status=["valid"],
            accepted_us=[99_000],
            identity=["seed11/42"],
        ),
        Frames(
            camera="cam0",
            t0_us=95_000,
            t1_us=100_000,
            t_us=[99_000],
            track=["5eed-0"],
            protocol=["seed11"],
            beacon=["crane"],
            payload=[42],
            x_px=[12.5],
            y_px=[20.25],
            score=[0.75],
            refused={"parity": 2},
        ),
        Identification(
            camera="cam0",
            track="5eed-0",
            t_us=100_000,
            since_us=80_000,
            protocol="seed11",
            beacon="crane",
            payload=42,
            x_px=12.5,
            y_px=20.25,
            vx_px_s=-3.5,
            vy_px_s=0.0,
            bearing=(0.0, 0.0, 1.0),
            confidence=0.875,
            margin=41.5,
            frames_used=4,
            change="accepted",
            lost=False,
        ),
        Data(camera="cam0", track="5eed-1", t_us=9, protocol="uart", beacon=None, text="thou art\n", data=None),
        Link(
            camera="cam0",
            track="5eed-0",
            t_us=1_000_000,
            protocol="seed11",
            bit_rate=1000.0,
            snr_db=12.5,
            jitter_us=30.0,
            clock_ppm=-350.0,
            events_per_transition=18.5,
            mar_estimate=0.96875,
        ),
        Progress(camera="cam0", service="decoder", t_us=2000, done=False, published={"frames": 12, "ids": 1}),
        Health(
            service="decoder",
            instance="decoder",
            pid=4711,
            state="running",
            uptime_s=3.5,
            input_age_s=0.002,
            cpu_share=0.25,
            counters={"received: events": 1750},
            gauges={"queue": 1.0},
        ),
        Metrics(
            service="metrics_sink",
            instance="metrics_sink",
            t0_us=0,
            t1_us=1_000_000,
            counters={"frames": 90},
            gauges={"mar": 0.96875},
        ),
        Clock(camera="cam0", t_us=1_000_000, offset_us=1_700_000_000_000_000, drift_ppm=12.5, uncertainty_us=150.0),
        Image(camera="cam0", stream="5eed", t_us=1000, grey=np.array([[0, 100, 255], [7, 7, 7]], np.uint8)),
        Flow(
            camera="cam0",
            as_of_us=100_000,
            period_us=100_000,
            confidence=0.75,
            vx_px_s=201.5,
            vy_px_s=-3.25,
            omega_rad_s=0.5,
            zoom_s=-0.0625,
            centre_x_px=319.5,
            centre_y_px=239.5,
            x_px=np.array([17, 639], np.uint16),
            y_px=np.array([479, 4], np.uint16),
            sample_vx_px_s=np.array([198, -7], np.int16),
            sample_vy_px_s=np.array([0, 410], np.int16),
        ),
        Truth(
            camera="cam0",
            t0_us=0,
            t1_us=10_000,
            sensor="dvxplorer_mini",
            fidelity="full",
            beacon=["crane"],
            protocol=["seed11"],
            x_px=[12.5],
            y_px=[20.25],
            radius_px=[3.0],
            x_m=[1.5],
            y_m=[-2.25],
            z_m=[0.02],
            in_view=[True],
            visible=[True],
            frame_beacon=[0],
            frame_t0_us=[0],
            frame_t1_us=[9000],
            frame_payload=[42],
            frame_x_px=[12.5],
            frame_y_px=[20.25],
            frame_visible=[True],
            edge_beacon=np.zeros(4, np.uint16),
            edge_us=np.array([0.0, 2454.5, 3272.7, 9999.9]),
            edge_on=np.array([True, False, True, False]),
        ),
        *beacon_records(),
    ]


def beacon_records() -> list[Message]:
    """Return one record of every schema that tells of a beacon."""
    wanted = Settings(
        protocol="seed11", options={"parity": "even"}, payload=42, bit_rate=1000.0, power=0.5, armed=True, lease_s=599.5
    )
    return [
        BeaconState(
            name="crane",
            uid="00000000000000a1",
            port="/dev/ttyUSB0",
            link="ready",
            desired=wanted,
            reported=wanted,
            waiting=1,
            boots=2,
            counters={"applied": 7},
            trouble="",
        ),
        BeaconCommand(
            name="crane",
            op="set",
            nonce="000102030405060708090a0b0c0d0e0f",
            issued_ms=1_800_000_000_000,
            expires_ms=1_800_000_020_000,
            payload=42,
            bit_rate=1000.0,
            mac=bytes(range(32)),
        ),
        BeaconReply(
            name="crane",
            nonce="000102030405060708090a0b0c0d0e0f",
            outcome="failed",
            reason="no answer",
            detail="SET was sent 40 times",
            tries=40,
            took_s=3.0,
        ),
    ]
