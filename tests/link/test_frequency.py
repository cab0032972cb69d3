"""`frequency`: a beacon is known by how often it blinks, and a lamp elsewhere is nobody."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import ConfigError, Refusal
from heliograph.link.contract import edges_of
from heliograph.link.modulations import MODULATIONS, modulation, tried
from heliograph.link.modulations.frequency import Frequency, resolution_hz
from heliograph.site import Beacon
from heliograph.units import bit_us
from heliograph_services.cli.studies.asynchronous import AsyncPixels, events
from heliograph_services.cli.studies.strangers import nobody, others, sent, square
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.link_plan import LinkPlan
from support.async_lights import Read, read

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "frequency.json").read_text())
LIGHT = AsyncPixels(pixels=20, jitter_us=8.0, noise_hz=2e3, delay_off_us=5.0)


def blinking(f_hz: float, seconds_s: float, light: AsyncPixels = LIGHT, seed: int = 0, duty: float = 0.5) -> Any:
    return events(*square(f_hz, seconds_s, duty), light, np.random.default_rng(seed))


def listened(f_hz: int, t_us: Any, on: Any) -> Read:
    return read(modulation("frequency").receiver(2.0 * f_hz), t_us, on, window_us=5_000)


@pytest.mark.parametrize("vector", VECTORS["sent"], ids=lambda v: str(v["payload"]))
def test_a_frame_is_sent_as_worked_out_by_hand(vector: dict[str, Any]) -> None:
    bits = modulation("frequency").encode(vector["payload"])
    assert "".join(map(str, bits)) == vector["on_air"]
    at_us, levels = edges_of(bits, 0.0, bit_us(vector["bit_rate"]))
    assert at_us[:3] == pytest.approx(vector["first_edges_us"], abs=1e-3)
    assert levels[:3].tolist() == [True, False, True]


@pytest.mark.parametrize("f_hz", VECTORS["allowed"])
def test_an_allowed_frequency_can_be_sent(f_hz: int) -> None:
    assert len(modulation("frequency").encode(f_hz)) == 64


@pytest.mark.parametrize("f_hz", VECTORS["refused"])
def test_a_frequency_of_the_mains_or_out_of_range_is_refused_by_value(f_hz: int) -> None:
    with pytest.raises(ValueError, match=str(f_hz)):
        modulation("frequency").encode(f_hz)
    with pytest.raises(ValueError, match=str(f_hz)):
        modulation("frequency").receiver(2.0 * f_hz)


@pytest.mark.parametrize("vector", VECTORS["resolution"], ids=lambda v: str(v["low"]))
def test_the_resolution_is_as_worked_out_by_hand(vector: dict[str, Any]) -> None:
    assert resolution_hz(vector["low"], vector["high"], 0.005) == pytest.approx(vector["hz"], rel=1e-3)


@pytest.mark.parametrize("f_hz", [117, 130, 530, 930, 1000, 2500, 8000, 10_000])
def test_a_beacon_is_known_after_two_windows_wherever_its_clock_stands(f_hz: int) -> None:
    for off in (-0.004, 0.0, 0.004):
        got = listened(f_hz, *blinking(f_hz * (1.0 + off), max(0.2, 100 / f_hz)))
        assert got.identity is not None, off
        assert got.identity.payload == f_hz
        assert set(got.payloads) == {f_hz}


def test_the_markers_of_tu_wien_are_told_apart() -> None:
    markers = (8000, 8200, 8400, 8600)
    for sends in markers:
        t_us, on = blinking(sends, 0.2)
        known = [f_hz for f_hz in markers if listened(f_hz, t_us, on).identity is not None]
        assert known == [sends]


@settings(max_examples=12, deadline=None)
@given(st.lists(st.integers(1, 200_000), max_size=12))
def test_any_split_of_the_stream_gives_the_same_frames(cuts: list[int]) -> None:
    t_us, on = blinking(2500.0, 0.2, AsyncPixels(pixels=5, jitter_us=30.0, noise_hz=1e4, loss=0.2))
    kind = modulation("frequency")
    assert read(kind.receiver(5000.0), t_us, on, cuts) == read(kind.receiver(5000.0), t_us, on)


def test_harmonics_and_subharmonics_are_nobody() -> None:
    f_hz = 1500
    for factor in (1 / 5, 1 / 4, 1 / 3, 1 / 2, 2 / 3, 2.0, 3.0, 4.0, 5.0, 7.0):
        for duty in (0.5, 0.35):
            t_us, on = blinking(f_hz * factor, 0.3, duty=duty)
            assert listened(f_hz, t_us, on).identity is None, (factor, duty)


@pytest.mark.parametrize("off", [-0.05, -0.02, -0.01, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("f_hz", [130, 1500, 8200])
def test_a_lamp_beyond_the_tolerance_is_nobody(f_hz: int, off: float) -> None:
    assert listened(f_hz, *blinking(f_hz * (1.0 + off) + np.sign(off) * 2.0, 0.7)).identity is None


def test_noise_lamps_and_blinkers_of_random_bits_are_nobody() -> None:
    for f_hz in (130, 1500, 8200):
        for label, t_us, on in nobody(2.0 * f_hz, 0.6, f_hz):
            if label == "lamp of bit rate / 2":
                continue  # this very frequency
            assert listened(f_hz, t_us, on).identity is None, (f_hz, label)


def test_no_light_of_another_protocol_is_anybody() -> None:
    for label, t_us, on in others("frequency", MODULATIONS, 5000.0, 0.3, 0):
        assert listened(2500, t_us, on).identity is None, label


def test_a_codebook_word_that_nearly_alternates_is_nobody() -> None:
    code = modulation("code", codebook="code20d4")
    words = [code.encode(payload) for payload in range(522)]
    edges = [sum(a != b for a, b in zip(w, (*w[1:], w[0]), strict=True)) for w in words]
    word = words[int(np.argmax(edges))]
    assert listened(2500, *sent(word * 80, 5000.0, LIGHT, 0)).identity is None


def test_a_lamp_of_the_mains_beside_a_beacon_in_one_region_does_not_hide_it() -> None:
    beacon_t, beacon_on = blinking(2500.0, 0.3)
    lamp_t, lamp_on = blinking(100.0, 0.3, AsyncPixels(pixels=10, jitter_us=1000.0))
    t_us = np.concatenate([beacon_t, lamp_t])
    order = np.argsort(t_us, kind="stable")
    got = listened(2500, t_us[order], np.concatenate([beacon_on, lamp_on])[order])
    assert got.identity is not None


def listed(*rows: tuple[str, int | None, float], **settings_: Any) -> Callable[[], LinkPlan]:
    beacons = tuple(Beacon(name=n, protocol="frequency", payload=p, bit_rate=r) for n, p, r in rows)
    return lambda: LinkPlan(DecoderConfig(beacons=beacons, **settings_))


@pytest.mark.parametrize(
    ("rows", "settings_", "named"),
    [
        ([("a", 8000, 16000.0), ("b", 8100, 16200.0)], {}, "a and b: .* at least 120 Hz apart, not 100"),
        ([("a", 8000, 16000.0), ("b", 8000, 16000.0)], {}, "not 0"),
        ([("a", 600, 1200.0)], {}, "beacon a: .*multiple of 100 Hz.*not 600"),
        ([("a", 354, 708.0)], {}, "multiple of 120 Hz.*not 354, near 360"),
        ([("a", 8000, 8000.0)], {}, r"bit_rate must be 16000 .*not 8000"),
        ([("a", None, 8000.0)], {}, "frequency in Hz, not missing"),
        ([("a", 2600, 5200.0)], {"scan_rate_hz": 5000.0}, r"at most 2500 Hz \(half the scan rate.*not 2600"),
        ([("a", 50, 100.0)], {}, r"\[100, 10000\] Hz, not 50"),
    ],
)
def test_a_site_that_cannot_be_read_is_refused_in_one_line(rows: Any, settings_: Any, named: str) -> None:
    with pytest.raises(ConfigError, match=named) as refused:
        listed(*rows, **settings_)()
    assert "\n" not in str(refused.value)


def test_a_site_of_many_frequencies_is_accepted() -> None:
    plan = listed(("a", 8000, 16000.0), ("b", 8200, 16400.0), ("c", 930, 1860.0), scan_rate_hz=20_000.0)()
    assert [plan.name(i, f_hz) for i, f_hz in enumerate((8000, 8200, 930))] == ["a", "b", "c"]


def test_auto_does_not_try_what_any_lamp_speaks() -> None:
    assert "frequency" not in tried()
    with pytest.raises(ConfigError, match="bit_rate must be a number with protocol frequency, not 'auto'"):
        LinkPlan(DecoderConfig(protocol="frequency", bit_rate="auto"))


def test_a_glare_and_silence_are_survived() -> None:
    receiver = Frequency().receiver(5000.0)
    t_us = np.full(500_000, 1000, np.int64)
    assert receiver.feed(t_us, np.ones(len(t_us), np.bool_), 60_000) == []
    assert receiver.feed(np.empty(0, np.int64), np.empty(0, np.bool_), 10_000_000) == []
    assert sum(receiver.refusals.values()) == 1
    receiver.feed(np.array([5], np.int64), np.ones(1, np.bool_), 10_000_001)
    assert receiver.refusals[Refusal.TIME_BACKWARDS] == 1
    assert receiver.verdict(10_000_001) == "invalid"


@pytest.mark.parametrize("tolerance", [0, 21, "x"])
def test_a_tolerance_out_of_range_is_refused_by_name(tolerance: Any) -> None:
    with pytest.raises(ValueError, match=r"tolerance_permille .*\[1, 20\]"):
        modulation("frequency", tolerance_permille=tolerance)


def test_the_quality_tells_frequency_and_jitter() -> None:
    receiver = modulation("frequency").receiver(5000.0)
    t_us, on = blinking(2505.0, 0.2, AsyncPixels(pixels=20, jitter_us=10.0))
    read(receiver, t_us, on)
    quality = receiver.quality(int(t_us[-1]))
    assert quality.bit_rate == pytest.approx(5010.0, abs=1.0)
    assert quality.jitter_us == pytest.approx(10.0, rel=0.2)
    assert quality.events_per_transition == pytest.approx(20.0, rel=0.05)
