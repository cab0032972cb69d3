"""A beacon's LED switches as worked by hand from the paper, at any cut of time."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import ConfigError
from heliograph.link.modulations import modulation
from heliograph_services.event_source.simulation.contract import Drive
from heliograph_services.event_source.simulation.lights import drive_of, safe_frames
from heliograph_services.event_source.simulation.lights.beacon import JITTER_LIMIT, BeaconDrive, Rounds
from heliograph_services.event_source.simulation.world.spec import BeaconSpec, Still

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "edges.json").read_text())["beacons"]
HERE = Still(at_m=(0.0, 0.0, 0.0))


def beacon(seed: int = 0, index: int = 0, **fields: Any) -> Drive:
    given_fields = {"protocol": "seed11", "bit_rate": 1000.0, **fields}
    return drive_of(BeaconSpec(name="b", path=HERE, **given_fields), seed, index)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_edges_are_as_worked_by_hand(vector: dict[str, Any]) -> None:
    names = ("protocol", "options", "payload", "text", "bit_rate", "start_us", "gap_bits", "clock_ppm")
    drive = beacon(**{name: vector[name] for name in names if name in vector})
    t_us, level = drive.changes(0.0, vector["until_us"])
    assert [f"{'+' if on else '-'}" for on in level] == [edge[0] for edge in vector["edges_us"]]
    assert t_us == pytest.approx([float(edge[1:]) for edge in vector["edges_us"]], abs=1e-3)
    assert drive.level(0.0) == vector["before"]


VARIANTS: dict[str, dict[str, Any]] = {
    "fresh": {"fresh": True, "bit_rate": 2_300.0, "jitter_us": 30.0, "clock_ppm": 340.0, "start_us": 777.0},
    "fresh_characters": {"protocol": "uart", "fresh": True, "bit_rate": 3_125.0},
    "fresh_code": {"protocol": "code", "fresh": True, "gap_bits": 3},
    "fast": {"payload": 42, "bit_rate": 100_000.0},
    "slow": {"payload": 42, "bit_rate": 7.0},
    "text": {"protocol": "uart", "text": "thou art\n", "bit_rate": 1_500.0, "gap_bits": 9, "start_us": 317.0},
}


@pytest.mark.parametrize("variant", VARIANTS)
@given(st.lists(st.floats(0.0, 400_000.0), min_size=1, max_size=5))
@settings(max_examples=8, deadline=None)
def test_edges_levels_and_frames_do_not_depend_on_how_time_is_cut(variant: str, cuts: list[float]) -> None:
    fields = VARIANTS[variant]
    until_us = 400_000.0
    bounds = [0.0, *sorted(cuts), until_us]
    whole, parts = beacon(**fields), beacon(**fields)
    t_us, level = whole.changes(0.0, until_us)
    asked = [parts.changes(a, b) for a, b in pairwise(bounds)]
    assert np.array_equal(np.concatenate([t for t, _ in asked]), t_us)
    assert np.array_equal(np.concatenate([lit for _, lit in asked]), level)
    frames = [frame for a, b in pairwise(bounds) for frame in beacon(**fields).frames_ended(a, b)]
    assert frames == whole.frames_ended(0.0, until_us)
    for cut in cuts:
        before = np.flatnonzero(t_us < cut)
        wanted = level[before[-1]] if len(before) else whole.level(0.0)
        assert beacon(**fields).level(cut) == wanted


def test_levels_alternate_and_edges_rise_however_large_the_jitter() -> None:
    drive = beacon(fresh=True, bit_rate=5_000.0, jitter_us=1_000.0)
    t_us, level = drive.changes(0.0, 2e6)
    assert len(t_us) > 4_000
    assert np.diff(t_us).min() >= (1 - 2 * JITTER_LIMIT) * 200.0 - 1e-6
    assert (np.diff(level) != 0).all()


def test_jitter_has_the_spread_that_is_asked_for_and_leaves_the_frames_alone() -> None:
    still, shaken = beacon(payload=42), beacon(payload=42, jitter_us=20.0)
    a, b = still.changes(500_500.0, 2e7 + 500.0)[0], shaken.changes(500_500.0, 2e7 + 500.0)[0]
    off_us = b - a
    assert len(off_us) > 10_000
    assert abs(off_us.mean()) < 5 * 20.0 / np.sqrt(len(off_us))
    assert off_us.std() == pytest.approx(20.0, rel=0.03)
    assert still.frames_ended(0.0, 1e6) == shaken.frames_ended(0.0, 1e6)


def test_seeds_and_beacons_have_numbers_of_their_own() -> None:
    asked = [beacon(seed, index, fresh=True).changes(0.0, 1e6)[0] for seed, index in ((1, 0), (2, 0), (1, 1), (1, 0))]
    assert np.array_equal(asked[0], asked[3])
    assert not np.array_equal(asked[0], asked[1])
    assert not np.array_equal(asked[0], asked[2])


def test_before_its_start_a_beacon_sends_the_same() -> None:
    late, early = beacon(payload=42, start_us=1_100_000.0), beacon(payload=42)
    assert np.array_equal(late.changes(0.0, 1e6)[0], early.changes(0.0, 1e6)[0])
    assert late.frames_ended(0.0, 1e6) == early.frames_ended(0.0, 1e6)


def test_a_text_is_told_character_by_character() -> None:
    text = "thou art\n"
    frames = beacon(protocol="uart", text=text).frames_ended(1.0, 99_001.0)
    assert "".join(chr(frame.payload) for frame in frames) == text
    assert [(frame.t0_us, frame.t1_us) for frame in frames] == [(11e3 * i, 11e3 * (i + 1)) for i in range(9)]


def test_fresh_payloads_are_the_bits_that_are_sent() -> None:
    drive = beacon(fresh=True)
    kind: Any = modulation("seed11")
    frames = drive.frames_ended(0.0, 1e6)
    for frame in frames:
        lit = [int(drive.level(frame.t0_us + (i + 0.5) * 1_000.0)) for i in range(11)]
        assert lit == list(kind.encode(frame.payload))
    assert len({frame.payload for frame in frames}) > 30


@pytest.mark.parametrize(
    ("protocol", "options", "count"),
    [("seed11", {}, 44), ("seed11", {"parity": "paper_text"}, 44), ("code", {}, 522), ("uart", {}, 95)],
)
def test_fresh_payloads_are_all_the_safe_ones_alike(protocol: str, options: dict[str, str], count: int) -> None:
    """44 of seed11: 64 without the 16 ambiguous and the 4 square waves."""
    kind: Any = modulation(protocol, **options)
    frames = safe_frames(kind)
    assert len(frames) == count
    rounds = Rounds.drawn(frames)
    drive = BeaconDrive(rounds, 20_000.0, seed=5)
    sent = [frame.payload for frame in drive.frames_ended(0.0, 4e7)]
    seen, times = np.unique(sent, return_counts=True)
    assert seen.tolist() == [payload for payload, _ in frames]
    # Chi-square of as many classes, five standard deviations wide.
    expected = len(sent) / count
    chi2 = float(((times - expected) ** 2 / expected).sum())
    assert abs(chi2 - (count - 1)) < 5 * np.sqrt(2 * (count - 1))


def test_a_drawn_frame_shorter_than_the_longest_holds_its_last_level() -> None:
    rounds = Rounds.drawn([(7, (1, 0, 1)), (9, (0, 1, 1, 1, 0))])
    drive = BeaconDrive(rounds, 1_000.0, seed=3)
    frames = drive.frames_ended(1.0, 1e5)
    assert {(frame.payload, frame.t1_us - frame.t0_us) for frame in frames} == {(7, 3_000.0), (9, 5_000.0)}
    assert all(frame.t0_us % 5_000.0 == 0.0 for frame in frames)
    short = next(frame for frame in frames if frame.payload == 7)
    assert drive.level(short.t1_us + 1_500.0) == 1.0


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"payload": 14}, "beacon b: payload 14 cannot be sent: with parity even it reads like 60"),
        ({"payload": 64}, r"beacon b: payload must be in \[0, 63\], not 64"),
        ({"protocol": "smoke", "payload": 1}, "protocol must be one of .*, not 'smoke'"),
        ({"protocol": "uart", "payload": 1}, "protocol uart cannot send the payload 1"),
        ({"protocol": "uart", "text": "é"}, "7-bit ASCII"),
        ({"text": "a"}, "beacon b: "),
        ({"payload": 1, "options": {"parity": "odd"}}, "parity must be one of even, paper_text, not 'odd'"),
        ({"payload": 1, "options": {"pairity": "even"}}, "seed11 does not take the options"),
    ],
)
def test_what_cannot_be_sent_is_refused_in_a_line_with_the_encoders_reason(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        beacon(**fields)
    assert "\n" not in str(caught.value)
