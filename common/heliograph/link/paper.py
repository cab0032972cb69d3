"""The paper's own receiver, as published where it is definite, and as paper-notes resolve it where it is not.

Polarity (section 2.2.3), in windows of one nominal bit on an absolute grid: P = (N_on - N_off) / (N_on + N_off)::

    P >= 0.5    the LED went on:  append n zeros, t_t <- t_c
    P <= -0.5   the LED went off: append n ones,  t_t <- t_c
    otherwise   it moved
    n = max(1, round((t_c - t_t) f))      the paper prints (t_c - t_t) / f, which has no unit of a count

A window of fewer events than a cluster needs has no target, so no polarity; a window that says again what the last
transition said is none: an LED that is on cannot go on. (Without these two, a pixel's slow OFF response or two events
of noise in a dark bit add bits of their own, and real pixels are hardly read at any rate.)
The first transition only sets t_t. A gap longer than the longest legal run is an occlusion: the sequence is cleared.
Once for every 11 new bits the last 11 are rotated to the start code 1110 and the parity is checked. Both edges of a
short bit in one window cancel and are lost, as published.

Algorithm 1, once for each of these checks: score +2 if valid, else -1; start 10, max 20, min 0; valid at 20, invalid at
0, forgotten at min or after 0.5 s without a transition. Valid means: start code, parity, and the payload of the
*candidate*, which is the first payload seen, already while the track is new. Without a candidate (any payload counts)
a track of random bits becomes valid with probability 0.25.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict
from heliograph.link.frames import CyclicCode, rotations
from heliograph.units import US_PER_S, bit_us

POLARITY: Final = 0.5
# The polarity is that of a target, and a target has events enough for a cluster (the paper: 5 to 30).
MIN_EVENTS: Final = 5
SCORE_START: Final = 10
SCORE_MAX: Final = 20
SCORE_MIN: Final = 0
GAIN: Final = 2
DELAY_MAX_US: Final = 500_000


@dataclass(frozen=True, slots=True)
class PaperParameters:
    """What of the windows can be tuned; the defaults are the paper's, as `paper-notes` settle them.

    Args:
        window_bits: length of a window, in nominal bits.
        polarity: least |P| of a transition, above 0.
        min_events: fewer events in a window are no target.

    Raises:
        ValueError: a number is out of range.
    """

    window_bits: float = 1.0
    polarity: float = POLARITY
    min_events: int = MIN_EVENTS

    def __post_init__(self) -> None:
        if not 1e-3 <= self.window_bits <= 1e3:
            raise ValueError(f"window_bits must be in [0.001, 1000], not {self.window_bits:g}")
        if not 0.0 < self.polarity <= 1.0:
            raise ValueError(f"polarity must be in (0, 1], not {self.polarity:g}")
        if self.min_events < 1:
            raise ValueError(f"min_events must be at least 1, not {self.min_events}")


PUBLISHED: Final = PaperParameters()
# The setting of 37 that reads most over 39 scenes of the studies' kinds (still, moving, sun; bench/tune_others.py), on
# development seeds: .83 of the frames against .62 as published. Shorter windows need no luck with a bit's phase.
TUNED: Final = PaperParameters(window_bits=0.35, min_events=2)


class Score:
    """Algorithm 1 with the candidate rule."""

    def __init__(self) -> None:
        self.score = SCORE_START
        self.status: Verdict = "new"
        self.candidate: int | None = None

    def update(self, payload: int | None) -> bool:
        """Take one check's payload (None: not valid); return whether it earned."""
        if self.candidate is None:
            self.candidate = payload
        earned = payload is not None and payload == self.candidate
        self.score = min(max(self.score + (GAIN if earned else -1), SCORE_MIN), SCORE_MAX)
        if self.score >= SCORE_MAX:
            self.status = "valid"
        elif self.score <= 0:
            # Invalid and forgotten in one step, since the paper's confidence_min is 0: what follows is a new track.
            self.status = "invalid"
            self.candidate = None
        return earned


class PaperReceiver:
    """The paper's receiver of one track (`heliograph.link.contract.Receiver`).

    Its frames carry no likelihood: score 1.0 and margin 0.0. Its identity is Algorithm 1's: the candidate of a valid
    track.

    Args:
        code: seed11; or another cyclic code, whose rotations then tell where a word begins.
        bit_rate: nominal bits a second, taken as exact.
        parameters: of its windows.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, code: CyclicCode, bit_rate: float, parameters: PaperParameters = PUBLISHED) -> None:
        self.refusals: Refusals = Counter()
        self._code = code
        self._bit_us = bit_us(bit_rate)
        self._window_us = parameters.window_bits * self._bit_us
        self._window_bits = parameters.window_bits
        self._polarity = parameters.polarity
        self._min_events = parameters.min_events
        self._payloads = {word: payload for payload, word in enumerate(code.words)}
        self._until_us: int | None = None
        self._window: int | None = None  # number of the open window
        self._signed = 0
        self._events = 0
        self._transition: int | None = None  # window of the last transition
        self._lit: bool | None = None  # the LED since then
        self._heard_us: int | None = None
        self._bits: deque[int] = deque(maxlen=code.bits)
        self._new_bits = 0
        self._score = Score()
        self._identity: Identity | None = None
        self._recent: deque[tuple[int, bool]] = deque(maxlen=8192)

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take the events before until_us (see the contract)."""
        if self._until_us is not None and until_us < self._until_us:
            self.refusals[Refusal.TIME_BACKWARDS] += 1
            return []
        self._until_us = until_us
        out: list[LinkFrame | Text] = []
        if len(t_us):
            if self._heard_us is None:
                self._heard_us = int(t_us[0])
            self._take(t_us, on, out)
        if self._window is not None and until_us >= (self._window + 1) * self._window_us:
            self._close(out)
        return out

    def flush(self) -> list[LinkFrame | Text]:
        """Close the open window; the stream has ended."""
        out: list[LinkFrame | Text] = []
        if self._window is not None:
            self._close(out)
        return out

    def identity(self) -> Identity | None:
        """Return the candidate of a valid track, or None."""
        return self._identity

    def verdict(self, now_us: int) -> Verdict:
        """Return Algorithm 1's status at now_us."""
        if self._heard_us is not None and now_us - self._heard_us > DELAY_MAX_US:
            return "invalid"
        return self._score.status

    def quality(self, now_us: int) -> LinkQuality:
        """Return the share of valid checks in the last second; the paper measures nothing else."""
        newest = [ok for t_us, ok in self._recent if now_us - US_PER_S < t_us <= now_us]
        mar = sum(newest) / len(newest) if newest else None
        return LinkQuality(US_PER_S / self._bit_us, None, None, None, None, mar)

    def _take(self, t_us: Times, on: Flags, out: list[LinkFrame | Text]) -> None:
        numbers: npt.NDArray[np.int64] = np.floor(t_us / self._window_us).astype(np.int64)
        starts = np.flatnonzero(np.concatenate([np.ones(1, np.bool_), np.diff(numbers) != 0]))
        signed = np.add.reduceat(np.where(on, 1, -1), starts)
        events = np.diff(np.concatenate([starts, [len(numbers)]]))
        for number, sum_, count in zip(numbers[starts].tolist(), signed.tolist(), events.tolist(), strict=True):
            if self._window is not None and number != self._window:
                self._close(out)
            self._window = number
            self._signed += sum_
            self._events += count

    def _close(self, out: list[LinkFrame | Text]) -> None:
        """Judge the open window by its polarity."""
        window, events, polarity = self._window, self._events, self._signed / self._events
        self._window, self._signed, self._events = None, 0, 0
        if window is None or events < self._min_events or abs(polarity) < self._polarity:
            return
        self._heard_us = int((window + 1) * self._window_us)
        on = polarity > 0
        if on is self._lit:
            return
        self._lit = on
        before, self._transition = self._transition, window
        if before is None:
            return
        n = max(1, round((window - before) * self._window_bits))
        if n > self._code.longest_run:
            self.refusals[Refusal.OCCLUSION] += 1
            self._bits.clear()
            self._new_bits = 0
            return
        for _ in range(n):
            self._bits.append(0 if on else 1)
            self._new_bits += 1
            if self._new_bits >= self._code.bits:
                self._new_bits = 0
                self._check(out)

    def _check(self, out: list[LinkFrame | Text]) -> None:
        """Look for a frame in the last 11 bits."""
        t_us = self._heard_us or 0
        payload = self._decoded()
        self._recent.append((t_us, payload is not None))
        known = self._score.candidate
        earned = self._score.update(payload)
        if payload is not None:
            if known is not None and not earned:
                self.refusals[Refusal.PAYLOAD_CHANGED] += 1
            out.append(LinkFrame(t_us, payload, 1.0, 0.0))
        if self._score.status != "valid":
            self._identity = None
        elif earned and payload is not None:
            used = 1 if self._identity is None else self._identity.frames_used + 1
            since_us = t_us if self._identity is None else self._identity.since_us
            self._identity = Identity(payload, since_us, t_us, used, 0.0, self._score.score / SCORE_MAX)

    def _decoded(self) -> int | None:
        """Return the payload of the last 11 bits, or None and the reason counted."""
        word = 0
        for bit in self._bits:
            word = (word << 1) | bit
        n = self._code.bits
        start, start_bits = self._code.start
        framed = [turned for turned in rotations(word, n) if turned >> (n - start_bits) == start]
        payloads = {self._payloads[turned] for turned in framed if turned in self._payloads}
        if len(payloads) == 1 and not payloads & self._code.twins.keys():
            return payloads.pop()
        if payloads:
            self.refusals[Refusal.AMBIGUOUS] += 1
        else:
            self.refusals[Refusal.PARITY if framed else Refusal.NO_START_CODE] += 1
        return None
