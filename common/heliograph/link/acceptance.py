"""When frames are an identity, and what a track is: new, valid or invalid.

Identity. It takes k equal frames, none of another payload between them, a whole number of frames apart and, where no
evidence is weighed (below), within SPAN k - 1 frame lengths. Chance that random bits at the right rate do this, a bit
position, with W words of n bits and t errors corrected (s = 1 + n if t = 1, else 1)::

    W s / 2^n * (s / 2^n)^(k-1) * binomial(2k - 1, k - 1)

    seed11    W 48, s 1,  k 4: 48/2048 * 2048^-3 * 35           = 9.6e-11
    code18d4  W 169, s 19, k 3: 169 19/2^18 (19/2^18)^2 * 10    = 6.4e-10, k 4: 1.6e-13
    code20d4  W 522, s 21, k 3: 522 21/2^20 (21/2^20)^2 * 10    = 4.2e-11

k is the least for which it stays below 1e-10 (seed11 four, code18d4 four, code20d4 three). That counts clear bits.
Where light is weak a likely word beats the true bits: of random bits seen with three events a change one window in nine
passes for a word of seed11, not one in 43, and four equal ones come hundreds of times as often. So a row of a cyclic
code must also be evidence enough, against random bits. A frame of score s bears witness of, in the terms of
`heliograph.link.likelihood`::

    e = ln (L(w) / Z) >= ln(s / (1 - s)) + ln(W OTHER / (1 - OTHER))        at most n ln 2

    A <- max(A + g ln MISSING, 0) + e + ln(1 - MISSING)        g frames were lost since the row's last frame
    A >= ln(W / 1e-10)

Over random bits, however weak, the mean of L(w) / Z is 1 for each w, so exp A, begun at any place, is a non-negative
supermartingale: it ever exceeds W / 1e-10 for one of W words with a chance of at most 1e-10 (Ville's inequality). Of
clear frames it takes the same four, one lost between them or none: 4 (7.6 - .3) - 1.4 = 27.9 of 26.9 nats.

Equal frames are witnesses one by one against random bits, but not against a light that repeats itself: that makes them
equal whatever it is. So the edges of a cyclic word must also keep one phase over it (`heliograph.link.one_phase`).

A new payload must do the same to replace the old one, with no frame below SURE; until then its frames count as
PAYLOAD_CHANGED.

Status, the paper's Algorithm 1: score +2 for a frame of the candidate (the first payload seen; the accepted one, once
there is one), -1 for a refused frame; valid at SCORE_MAX, invalid at 0 or below, which forgets identity and candidate.
Ours: while nothing is accepted a sound frame of another payload, at its proper place, earns 1. Random bits pass there
once in 43 frames, so they rise from 10 to 20 with a chance of 42^-10, and a beacon that changes its payload with every
frame still counts as one. Silence is no refusal but has a time-out of its own; confidence_min is -10, so that an
invalid track can recover.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import comb, log
from typing import Final

from heliograph.link.contract import Identity, LinkFrame, Verdict
from heliograph.link.frames import CyclicCode
from heliograph.link.likelihood import OTHER
from heliograph.units import US_PER_S

# Chance of a false identity in random bits, a bit position: at 5 kbit/s once in 23 days of one blinker.
CHANCE: Final = 1e-10
# k equal frames may be spread over this many times k frames: at a MAR of one half it still gets there.
SPAN: Final = 2

SCORE_START: Final = 10
SCORE_MAX: Final = 20
SCORE_MIN: Final = -10
GAIN: Final = 2
GAIN_OTHER: Final = 1
# Silence after which a track is invalid: an occlusion of two seconds is survived by a valid one.
DELAY_VALID_US: Final = 2_000_000
DELAY_NEW_US: Final = 300_000
DELAY_FRAMES: Final = 5
# What makes one frame of a light doubtful does the same to the next: four at .6 are not 1 - .4^4. Nine in ten, as for
# learning (`heliograph.link.alignment`).
SURE: Final = 0.9
# No confidence is 1: foreign light that repeats a word of the code is believed.
CONFIDENCE_TOP: Final = 0.9999


def frames_needed(code: CyclicCode) -> int:
    """Return the least k for which the chance of k equal frames in random bits stays below `CHANCE`."""
    words = len(code.words) - len(code.twins)
    space = 2.0**code.bits
    sphere = 1 + code.bits if code.distance >= 3 else 1
    k = 2
    while words * sphere / space * (sphere / space) ** (k - 1) * comb(SPAN * k - 1, k - 1) > CHANCE:
        k += 1
    return k


# A frame in four lost: at less, a row of weak light has no hole; at more, four clear frames are no longer enough.
MISSING: Final = 0.25
_LOST: Final = log(MISSING)
_CAME: Final = log(1.0 - MISSING)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What frames of a cyclic code are worth against random bits, in nats (see the module).

    Args:
        at_even: of a frame of score 1/2.
        most: of any frame.
        needed: of a row.
    """

    at_even: float
    most: float
    needed: float

    def of(self, score: float) -> float:
        """Return what a frame of this score bears witness of."""
        return self.most if score >= 1.0 else min(self.at_even + log(score / (1.0 - score)), self.most)


def evidence_of(code: CyclicCode) -> Evidence:
    """Return what frames of the code are worth."""
    words = len(code.words)
    return Evidence(
        at_even=log(words * OTHER / (1.0 - OTHER)),
        most=code.bits * log(2.0),
        needed=log((words - len(code.twins)) / CHANCE),
    )


@dataclass(frozen=True, slots=True)
class Place:
    """Where a frame lies: the lock of the clock under which it was read, and its last slot, counted from that lock."""

    lock: int
    slot: int


class Acceptance:
    """Follows a track's frames; holds its identity and status.

    Args:
        needed: equal frames that make an identity.
        bits: of a frame.
        bit_rate: nominal bits a second.
        evidence: of a cyclic code's frames; None where equal frames within the span are enough.
    """

    def __init__(self, needed: int, bits: int, bit_rate: float, evidence: Evidence | None = None) -> None:
        self._needed = needed
        self._evidence = evidence
        self._nats = 0.0
        self._bits = bits
        frame_us = bits * US_PER_S / bit_rate
        self._delay_valid_us = max(DELAY_VALID_US, DELAY_FRAMES * frame_us)
        self._delay_new_us = max(DELAY_NEW_US, DELAY_FRAMES * frame_us)
        self._row: deque[tuple[LinkFrame, Place]] = deque(maxlen=needed)
        self._identity: Identity | None = None
        self._candidate: int | None = None
        self._heard_us: int | None = None
        self.score = SCORE_START
        self.status: Verdict = "new"
        self.held_back = False  # whether the newest frame would have made an identity, were its row on the grid

    def heard(self, t_us: int) -> None:
        """Note light: the first event, a transition; silence is counted from the newest."""
        if self._heard_us is None or t_us > self._heard_us:
            self._heard_us = t_us

    def refuse(self) -> None:
        """Note a refused frame."""
        self._move(-1)

    def frame(self, frame: LinkFrame, place: Place, *, on_grid: bool = True) -> bool:
        """Note an accepted frame; return whether its payload differs from the identity's.

        Args:
            frame: as it was read.
            place: of it.
            on_grid: whether the edges of its row keep one phase (`heliograph.link.one_phase`), where that is known.
        """
        self.held_back = False
        known = self._identity
        if known is not None and frame.t_us - known.t_us > self._delay_valid_us:
            known = None
            self._forget()
        if self._candidate is None:
            self._candidate = frame.payload
        other = 0 if known is not None else GAIN_OTHER
        self._move(GAIN if frame.payload == self._candidate else other)
        self._append(frame, place)
        if known is not None and known.payload == frame.payload:
            self._support(known, frame)
            return False
        if len(self._row) == self._needed and self._enough(place):
            if not on_grid:
                self.held_back = True
                return known is not None
            frames = [each for each, _ in self._row]
            if known is not None and min(each.score for each in frames) < SURE:
                return True
            margin = sum(each.margin for each in frames)
            self._identity = Identity(frame.payload, frame.t_us, frame.t_us, self._needed, margin, _confidence(frames))
            self._candidate = frame.payload
        return known is not None

    def identity(self) -> Identity | None:
        """Return the accepted identity, or None."""
        return self._identity

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        return "invalid" if self._silent(now_us) else self.status

    def forgotten(self, now_us: int) -> bool:
        """Return whether Algorithm 1 would delete the track: score at confidence_min, or silent too long."""
        return self._silent(now_us) or self.score <= SCORE_MIN

    def _silent(self, now_us: int) -> bool:
        delay_us = self._delay_valid_us if self.status == "valid" else self._delay_new_us
        return self._heard_us is not None and now_us - self._heard_us > delay_us

    def _move(self, by: int) -> None:
        score = self.score + by
        if score >= SCORE_MAX:
            self.score, self.status = SCORE_MAX, "valid"
            return
        self.score = max(score, SCORE_MIN)
        if score <= 0:
            self.status = "invalid"
            self._forget()

    def _forget(self) -> None:
        self._identity = None
        self._candidate = None
        self._row.clear()

    def _append(self, frame: LinkFrame, place: Place) -> None:
        """Go on with the row, or begin it anew."""
        row, nats = self._row, 0.0
        if row:
            before, at = row[-1]
            frames, rest = divmod(place.slot - at.slot, self._bits)
            if rest or before.payload != frame.payload or at.lock != place.lock:
                row.clear()
            else:
                nats = max(self._nats + (frames - 1) * _LOST, 0.0)
        if self._evidence is not None:
            nats += self._evidence.of(frame.score) + _CAME
        self._nats = nats
        row.append((frame, place))

    def _enough(self, place: Place) -> bool:
        """Return whether as many equal frames as are needed, the newest at this place, are an identity."""
        if self._evidence is not None:
            return self._nats >= self._evidence.needed
        return (place.slot - self._row[0][1].slot) // self._bits <= SPAN * self._needed - 1

    def _support(self, known: Identity, frame: LinkFrame) -> None:
        row = self._row
        confidence = _confidence([each for each, _ in row]) if len(row) == self._needed else known.confidence
        used, margin = known.frames_used + 1, known.margin + frame.margin
        self._identity = Identity(known.payload, known.since_us, frame.t_us, used, margin, confidence)


def _confidence(frames: list[LinkFrame]) -> float:
    """Return the probability that not all of the equal frames are wrong."""
    misses = 1.0
    for each in frames:
        misses *= 1.0 - each.score
    return min(1.0 - misses, CONFIDENCE_TOP)
