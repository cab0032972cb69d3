"""Identity takes equal frames in a row; the score is Algorithm 1 with a candidate."""

from __future__ import annotations

from math import comb, log

import numpy as np
import pytest

from heliograph.link.acceptance import CHANCE, MISSING, Acceptance, Evidence, Place, evidence_of, frames_needed
from heliograph.link.codebook import load
from heliograph.link.contract import LinkFrame
from heliograph.link.frames import CyclicCode, bits_of, seed11_code
from heliograph.link.likelihood import BEST, OTHER, SCORE, VERDICT_FIELDS, decide, slot
from heliograph.link.paper import Score

FRAME_US = 11_000


class Track:
    """Frames at their places, 11 bits of 1 ms each."""

    def __init__(self, evidence: Evidence | None = None) -> None:
        self.acceptance = Acceptance(4, 11, 1000.0, evidence)
        self.slot = 11

    def sends(self, *payloads: int | None, lock: int = 1, score: float = 0.9) -> list[bool]:
        changed = []
        for payload in payloads:
            t_us = self.slot * 1000
            self.acceptance.heard(t_us)
            if payload is None:
                self.acceptance.refuse()
            else:
                frame = LinkFrame(t_us, payload, score, 5.0)
                changed.append(self.acceptance.frame(frame, Place(lock, self.slot)))
            self.slot += 11
        return changed

    @property
    def payload(self) -> int | None:
        identity = self.acceptance.identity()
        return None if identity is None else identity.payload


@pytest.mark.parametrize(
    ("code", "k"), [(seed11_code(), 4), (load("code18d4").code(), 4), (load("code20d4").code(), 3)]
)
def test_the_frames_needed_keep_chance_below_1e_10_a_bit_position(code: CyclicCode, k: int) -> None:
    assert frames_needed(code) == k
    sphere = 1 + code.bits if code.distance == 4 else 1
    once = sphere / 2.0**code.bits
    words = len(code.words) - len(code.twins)
    assert words * once**k * comb(2 * k - 1, k - 1) < CHANCE


def test_four_equal_frames_in_a_row_are_an_identity_and_three_are_none() -> None:
    track = Track()
    track.sends(42, 42, 42)
    assert track.payload is None
    track.sends(42)
    identity = track.acceptance.identity()
    assert identity is not None
    assert (identity.payload, identity.frames_used, identity.margin) == (42, 4, 20.0)
    assert identity.since_us == identity.t_us == 44_000
    assert identity.confidence == pytest.approx(0.9999)
    track.sends(42)
    identity = track.acceptance.identity()
    assert identity is not None
    assert (identity.frames_used, identity.since_us, identity.t_us) == (5, 44_000, 55_000)


def test_a_frame_of_another_payload_breaks_the_row_and_a_lost_one_does_not() -> None:
    broken = Track()
    broken.sends(42, 42, 42, 5, 42)
    assert broken.payload is None
    lost = Track()
    lost.sends(42, None, 42, None, 42, None, None, 42)
    assert lost.payload == 42
    spread = Track()
    spread.sends(42, None, 42, None, 42, None, None, None, 42)
    assert spread.payload is None


CODES = [seed11_code(), load("code18d4").code(), load("code20d4").code()]
CLEAR, DOUBTFUL = 0.996, 0.6


@pytest.mark.parametrize("code", CODES, ids=lambda code: code.name)
def test_clear_frames_are_evidence_enough_as_soon_as_there_are_as_many_as_needed(code: CyclicCode) -> None:
    evidence = evidence_of(code)
    # A clear frame: all 2^n words but its own are out of the question.
    odds = 2.0**code.bits / len(code.words) * (1.0 - OTHER) / OTHER
    assert evidence.of(odds / (1.0 + odds)) == pytest.approx(evidence.most)
    assert frames_needed(code) * (0.97 * evidence.most + log(1.0 - MISSING)) > evidence.needed


def test_weak_frames_must_be_more_and_lost_ones_count_against_them() -> None:
    evidence = evidence_of(seed11_code())
    for frames, score, payload in (
        ([42] * 4, CLEAR, 42),
        ([42, None, 42, 42, 42], CLEAR, 42),
        ([42, None, 42, None, 42, 42], CLEAR, None),
        ([42, None, 42, None, 42, 42, 42], CLEAR, 42),
        ([42] * 12, DOUBTFUL, None),
        ([42] * 14, DOUBTFUL, 42),
        ([42, None, None] * 100, DOUBTFUL, None),
    ):
        track = Track(evidence)
        track.sends(*frames, score=score)
        assert track.payload == payload, (frames, score)


@pytest.mark.parametrize("events", [1.0, 3.0, 20.0])
def test_random_bits_bear_no_more_evidence_than_chance_however_weak_the_light(events: float) -> None:
    code, rng, n = seed11_code(), np.random.default_rng(5), 11
    words = np.array([bits_of(word, n) for word in code.words], np.uint8)
    evidence = evidence_of(code)
    levels = rng.integers(0, 2, 30_000)
    mean = np.full((4, 2), 0.3)
    mean[1, 1] += events
    mean[2, 0] += events
    seen = rng.poisson(mean[2 * levels[:-1] + levels[1:]])
    ring = np.empty((len(seen), 4))
    for row, counts in zip(ring, seen, strict=True):
        slot(np.asarray((counts * np.log(mean) - mean).sum(axis=1)), row)
    verdict, worth = np.empty(VERDICT_FIELDS), np.zeros(len(code.words))
    windows = len(ring) - n
    for first in range(windows):
        decide(ring, first, words, 0.5, verdict)
        worth[int(verdict[BEST])] += np.exp(evidence.of(float(verdict[SCORE])))
    # The mean of L(w) / Z is 1 for each word, whether it is the best or not.
    assert worth.sum() / windows / len(code.words) < 1.05


def test_frames_at_another_bit_position_or_of_another_lock_are_no_row() -> None:
    slipped = Track()
    slipped.sends(42, 42)
    slipped.slot += 1
    slipped.sends(42, 42)
    assert slipped.payload is None
    relocked = Track()
    relocked.sends(42, 42)
    relocked.sends(42, 42, lock=2)
    assert relocked.payload is None


def test_a_new_payload_must_win_four_frames_and_each_is_told() -> None:
    track = Track()
    track.sends(42, 42, 42, 42, 42)
    assert track.sends(5, 5, 5) == [True, True, True]
    assert track.payload == 42
    assert track.sends(5) == [True]
    assert track.payload == 5
    assert track.sends(5) == [False]


def test_doubtful_frames_make_an_identity_but_replace_none() -> None:
    track = Track()
    track.sends(42, 42, 42, 42, score=0.6)
    assert track.payload == 42
    assert track.sends(5, 5, 5, 5, 5, 5, score=0.6) == [True] * 6
    assert track.payload == 42
    # Nor do three sure ones with a doubtful one among the last four.
    track.sends(5, 5, 5)
    assert track.payload == 42
    track.sends(5)
    assert track.payload == 5


def test_the_status_follows_algorithm_1() -> None:
    track = Track()
    assert track.acceptance.verdict(0) == "new"
    track.sends(42, 42, 42, 42)
    assert (track.acceptance.score, track.acceptance.status) == (18, "new")
    track.sends(42)
    assert (track.acceptance.score, track.acceptance.status) == (20, "valid")
    track.sends(*[None] * 19)
    assert (track.acceptance.score, track.acceptance.status, track.payload) == (1, "valid", 42)
    track.sends(None)
    assert (track.acceptance.status, track.payload) == ("invalid", None)
    assert not track.acceptance.forgotten(track.slot * 1000)
    track.sends(*[None] * 10)
    assert track.acceptance.forgotten(track.slot * 1000)
    track.sends(*[42] * 15)
    assert track.acceptance.status == "valid"
    assert track.payload == 42


def test_silence_ends_a_valid_track_after_two_seconds_and_a_new_one_after_three_tenths() -> None:
    new, valid = Track(), Track()
    new.sends(42)
    valid.sends(*[42] * 5)
    heard = 11_000
    assert new.acceptance.verdict(heard + 300_000) == "new"
    assert new.acceptance.verdict(heard + 300_001) == "invalid"
    assert valid.acceptance.verdict(5 * heard + 2_000_000) == "valid"
    assert valid.acceptance.verdict(5 * heard + 2_000_001) == "invalid"


def test_a_beacon_with_a_new_payload_in_every_frame_is_no_noise() -> None:
    track = Track()
    track.sends(*[i % 48 for i in range(20)])
    assert track.acceptance.status == "valid"
    assert track.payload is None


def _random_tracks(candidate_rule: bool, tracks: int, seed: int) -> int:
    """Return how many tracks of random words turn valid under the paper's score."""
    code = seed11_code()
    passes: dict[int, list[int]] = {}
    for word in range(2048):
        turned = {((word << by) | (word >> (11 - by))) & 2047 for by in range(11)}
        passes[word] = sorted(p for p, each in enumerate(code.words) if each in turned)
    # 48 words with 11 rotations and 8 cyclic words that read as two: 30 % of all.
    assert sum(bool(found) for found in passes.values()) == 48 * 11 + 8 * 11
    rng = np.random.default_rng(seed)
    valid = 0
    for _ in range(tracks):
        score = Score()
        while score.status == "new":
            found = passes[int(rng.integers(2048))]
            if not candidate_rule:
                score.candidate = None
            score.update(found[0] if found else None)
        valid += score.status == "valid"
    return valid


def test_no_track_of_random_bits_turns_valid_in_20000() -> None:
    assert _random_tracks(candidate_rule=True, tracks=20_000, seed=3) == 0


def test_without_a_candidate_a_quarter_of_them_would() -> None:
    assert 0.2 < _random_tracks(candidate_rule=False, tracks=2000, seed=4) / 2000 < 0.3
