"""Whatever comes over the wire, the tracker answers, counts and keeps its bounds; and it starts light."""

from __future__ import annotations

import subprocess
import sys

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace as changed

from heliograph.core import Context
from heliograph.errors import ConfigError, Refusal
from heliograph.messages import Status
from heliograph.streams import Onsets
from heliograph.wire import Refused, pack, unpack
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core
from support.mutate import mutations
from support.onset_scenes import Disc, Scene, line
from support.records import header_of

SCENE = Scene((Disc(line(60, 60)), Disc(line(200, 120, 50, 0))), noise_hz=2e4, seed=5)


def test_damaged_onsets_and_statuses_never_raise_and_the_stream_goes_on() -> None:
    core = make_core(TrackerConfig(max_tracks=8), Context("0", "b00t", False))
    onsets = list(SCENE.onsets(1.0))
    status = Status(
        camera="cam0", as_of_us=500_000, track=["b00t-0"], status=["invalid"], accepted_us=[-1], identity=["seed11/42"]
    )  # fmt: skip
    read = 0
    for i, sound in enumerate(onsets):
        # The sound messages come in between, as they do when one sender is mad.
        for message in (sound, status):
            for payload in mutations(message, 8, seed=i):
                outcome = unpack(payload)
                if isinstance(outcome, Refused):
                    continue
                read += 1
                core.ready(outcome[1])
                for answer in core.feed(outcome[1]):
                    assert not isinstance(unpack(pack(header_of(answer), answer)), Refused)
        core.feed(changed(sound, end=False))
    assert read > 50
    assert sum(core.refusals.values()) > 0
    again = [m for o in SCENE.onsets(1.0) for m in core.feed(changed(o, stream="fresh"))]
    assert len(again) == 11  # ten periods, and the births between two
    assert len(again[-1].track) == 2  # type: ignore[attr-defined]


def test_lockstep_takes_damaged_statuses_too() -> None:
    core = make_core(TrackerConfig(), Context("0", "b00t", True))
    status = Status(
        camera="cam0", as_of_us=0, track=["scene-0"], status=["valid"], accepted_us=[-1], identity=["seed11/42"]
    )
    for i, sound in enumerate(SCENE.onsets(0.5)):
        for payload in mutations(status, 20, seed=i):
            outcome = unpack(payload)
            if not isinstance(outcome, Refused):
                core.feed(outcome[1])
        core.ready(sound)
        core.feed(sound)
    assert core.counters["tracks_published"] > 0


def test_a_far_pixel_that_wraps_in_sixteen_bits_is_refused_on_the_wire() -> None:
    far = changed(
        next(iter(SCENE.onsets(0.005))),
        pool_px=64,
        tick=np.zeros(1, np.uint16),
        x_px=np.array([1025], np.uint16),  # 1025 * 64 = 65600, which is 64 in 16 bits
        y_px=np.zeros(1, np.uint16),
        on_count=np.ones(1, np.uint8),
        off_count=np.zeros(1, np.uint8),
    )
    outcome = unpack(pack(header_of(far), far))
    assert isinstance(outcome, Refused)
    assert outcome.reason is Refusal.BAD_BODY


def test_targets_by_the_thousand_are_bounded() -> None:
    core = make_core(TrackerConfig(max_tracks=50, confirm_hits=1), Context("0", "b00t", False))
    yy, xx = np.mgrid[0:700, 0:1200]
    dots = ((xx % 30) - 10) ** 2 + ((yy % 30) - 10) ** 2 <= 4
    y_px, x_px = (a.astype(np.uint16) for a in np.nonzero(dots))
    count = np.full(len(x_px), 3, np.uint8)
    out = []
    for k in range(40):
        out += core.feed(
            Onsets(
                camera="cam0", stream="dots", width=1280, height=720, t0_us=k * 5000, t1_us=(k + 1) * 5000,
                tick_us=5000, pool_px=1, tick=np.zeros(len(x_px), np.uint16),
                x_px=x_px, y_px=y_px, on_count=count, off_count=count,
            )
        )  # fmt: skip
    assert len(out[-1].track) == 50  # type: ignore[attr-defined]
    assert core.gauges["births"] <= 50
    assert core.counters["births_over_limit"] > 0


def test_a_stream_with_a_giant_sensor_and_no_events_costs_nothing_to_follow() -> None:
    core = make_core(TrackerConfig(), Context("0", "b00t", False))
    nothing = np.empty(0, np.uint16)
    for i in range(50):
        core.feed(
            Onsets(
                camera="cam0", stream=f"s{i}", width=4096, height=4096, t0_us=0, t1_us=5000, tick_us=5000, pool_px=1,
                tick=nothing, x_px=nothing, y_px=nothing, on_count=nothing.astype(np.uint8),
                off_count=nothing.astype(np.uint8),
            )
        )  # fmt: skip
    assert core.counters["streams"] == 50


# -- settings --


@pytest.mark.parametrize(
    "wrong",
    [
        {"eps_px": 0.5}, {"cluster_window_us": 200_000}, {"period_us": 0}, {"min_roundness": 1.5}, {"shape": "square"},
        {"max_tracks": 0}, {"unknown": 1}, {"camera": "a/b"}, {"cost": "l3"},
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(wrong, TrackerConfig)


def test_settings_that_contradict_each_other_are_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="min_pixels must be at most max_pixels = 10, not 20"):
        TrackerConfig(min_pixels=20, max_pixels=10)
    with pytest.raises(ConfigError, match="quarantine_us"):
        TrackerConfig(quarantine_us=9_000_000)


def test_defaults_lie_within_their_own_ranges() -> None:
    assert msgspec.convert(msgspec.to_builtins(TrackerConfig()), TrackerConfig) == TrackerConfig()


def test_reading_the_settings_loads_neither_numba_nor_the_solver() -> None:
    code = "import sys, heliograph_services.tracker.config; print(sorted({'numba', 'lap', 'zenoh'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_tracker_loads_none_of_its_oracles() -> None:
    # scipy is not among them: numba itself looks whether it is there.
    code = (
        "import sys, heliograph_services.tracker.core as c; c.warm();"
        "print(sorted({'sklearn', 'filterpy', 'torch', 'zenoh'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
