"""Bit rates that nobody told: several likely ones are tried at once, and measured again where none is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from heliograph.errors import Refusal
from heliograph.events import Flags, Times
from heliograph.link.bitrate import likely_bit_rates
from heliograph.link.contract import Text
from heliograph.link.modulations import modulation
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import TrackLinks
from heliograph_services.decoder.measuring import FIRST_US, LIMIT_US, Measure, Measuring
from support.lights import Light, repeated, seen
from support.text_light import edits


def links(protocol: str, measure: Measure) -> tuple[LinkPlan, TrackLinks]:
    plan = LinkPlan(DecoderConfig(protocol=protocol, bit_rate="auto"), measure=measure)
    return plan, TrackLinks(plan)


def hear(track: TrackLinks, t_us: Times, on: Flags, step_us: int = 10_000) -> str:
    """Feed a track window by window; return its text."""
    text, deep = "", np.full(len(t_us), 2, np.uint8)
    until_us = int(t_us[0]) // step_us * step_us
    decided = []
    while until_us <= t_us[-1]:
        until_us += step_us
        i, j = np.searchsorted(t_us, [until_us - step_us, until_us])
        decided += track.feed(t_us[i:j], on[i:j], deep[i:j], until_us)
    decided += track.flush(until_us)
    for one in decided:
        if isinstance(one.item, Text):
            text += one.item.text or ""
    return text


def test_of_several_likely_rates_the_one_that_reads_wins() -> None:
    what = seen(Light(), repeated(modulation("seed11").encode(42), 120), 1000.0, 1)
    plan, track = links("auto", lambda t_us, on: (330.0, 1003.0, 3000.0))
    hear(track, what.t_us, what.on)
    accepted = track.accepted(what.until_us)
    assert accepted is not None
    assert (plan.protocol(accepted.link), accepted.identity.payload) == ("seed11", 42)
    quality = track.quality(accepted.link, what.until_us)
    assert quality is not None
    assert quality.bit_rate == pytest.approx(1000.0, rel=1e-3)


def test_a_rate_at_which_nobody_reads_is_measured_again() -> None:
    what = seen(Light(), repeated(modulation("seed11").encode(42), 450), 1000.0, 1)
    named: list[float] = []

    def measure(t_us: Times, on: Flags) -> tuple[float, ...]:
        named.append(370.0 if not named else 1000.0)
        return (named[-1],)

    _, track = links("seed11", measure)
    hear(track, what.t_us, what.on)
    assert named == [370.0, 1000.0]
    assert track.accepted(what.until_us) is not None


def test_a_track_that_shows_no_rate_is_asked_ever_more_seldom_and_keeps_a_bounded_past() -> None:
    asked: list[int] = []

    def measure(t_us: Times, on: Flags) -> tuple[float, ...]:
        asked.append(int(t_us[-1] - t_us[0]))
        return ()

    measuring = Measuring(measure)
    for k in range(1000):
        t_us = np.arange(k * 10_000, (k + 1) * 10_000, 1000, dtype=np.int64)
        assert measuring.feed(t_us, t_us % 2000 == 0, np.zeros(10, np.uint8), (k + 1) * 10_000) is None
    assert asked[0] <= FIRST_US
    assert len(asked) <= 6 + 10
    assert max(asked) <= 1.5 * LIMIT_US
    assert measuring.refusals[Refusal.NO_CLOCK] >= 4


def test_a_track_in_the_dark_is_not_asked_about() -> None:
    measuring = Measuring(lambda t_us, on: (1000.0,))
    none, flags, deep = np.empty(0, np.int64), np.empty(0, np.bool_), np.empty(0, np.uint8)
    assert all(measuring.feed(none, flags, deep, until) is None for until in range(0, 5_000_000, 100_000))


@pytest.mark.parametrize("lamp", ["mains", "blinker", "noise"])
def test_lamps_blinkers_and_noise_have_no_identity_at_any_rate(lamp: str) -> None:
    rng = np.random.default_rng(3)
    if lamp == "mains":
        at = rng.uniform(0.0, 4.0, 40_000)
        slope = np.cos(2 * np.pi * 100 * at)
        kept = rng.random(len(at)) < np.abs(slope)
        t, on = at[kept], slope[kept] > 0
    elif lamp == "blinker":
        levels = rng.integers(0, 2, 6000)
        edges = np.flatnonzero(np.diff(levels))
        t, on = np.repeat(edges / 1500.0, 12) + rng.exponential(3e-5, 12 * len(edges)), np.repeat(levels[edges + 1], 12)
    else:
        t = rng.uniform(0.0, 4.0, 8000)
        on = rng.random(len(t)) < 0.5
    order = np.argsort(t, kind="stable")
    t_us, polarity = (t[order] * 1e6).astype(np.int64), on[order].astype(np.bool_)
    _, track = links("auto", likely_bit_rates)
    assert hear(track, t_us, polarity) == ""
    assert track.accepted(4_000_000) is None


@pytest.mark.data
@pytest.mark.parametrize(("name", "earlier"), [("504hz_100m.mat", 104), ("3125hz_30m.mat", 302)], ids=["100 m", "30 m"])
@pytest.mark.parametrize(("share", "cer_max"), [(1.0, 0.0), (0.1, 0.01)], ids=["whole", "a tenth of the events"])
def test_the_recordings_are_read_without_being_told_protocol_or_rate(
    beacon_data: Path, name: str, earlier: int, share: float, cer_max: float
) -> None:
    scipy_io = pytest.importorskip("scipy.io", reason="reading MATLAB files needs scipy")
    content = scipy_io.loadmat(beacon_data / name)
    t_us = np.round(content["event_t"].ravel() * 1e6).astype(np.int64)
    order = np.argsort(t_us, kind="stable")
    order = order[np.random.default_rng(0).random(len(order)) < share]
    _, track = links("auto", likely_bit_rates)
    sonnet = (beacon_data / "sonnet.txt").read_text()
    sent = sonnet[-earlier:] + sonnet
    text = hear(track, t_us[order], content["event"].ravel()[order] > 0)
    assert edits(sent, text) <= cer_max * len(sent)
