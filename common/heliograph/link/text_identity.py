"""When a track is a text beacon, and what may be said until then.

A *good* character has the right start, parity and stop bits, decided on likelihood (`uart_lock.is_good`). In random
bits at the right clock, eleven bits in a row are one with the chance 2^-4. After idle time the beginning may be chosen,
by the bit and by the sub-bin: of a light that changes at random every 1.3 bits, half of such characters were good, so
they are worth 1/2. A run of good characters is worth the product; the track is a text beacon when it falls below 1e-12
(ten characters one right after another: 16^-10 = 9e-13), so that the chance stays below 1e-10 a bit position although a
run may begin at any of several sub-bins.

That holds where bits are clear. In weak light the likeliest character may be good although other words fit as well:
random bits of six events a change made good characters in one of three places, not of sixteen. So a character also
costs its doubt, the nats by which all 2^11 words together exceed it (`heliograph.link.uart_words.any_word`)::

    16 L(c) / sum_w L(w)        its sum over the 128 characters has a mean of 1 over random bits

and the product over a run exceeds 1e12 with a chance of at most 1e-12 (Ville's inequality), however weak the light.
Bits of no character end a run, however few: who may skip some at will soon finds a character.

Where a character follows another at once, it also comes on time, while another
light's lie anywhere in the 13 sub-bins in which they are looked for. So an offset of e sub-bins costs::

    min(0, ln(13 N(e; 0, 1.5^2))) = min(0, 1.24 - e^2 / 4.5)        nats; nothing up to 2.4 sub-bins

A slow light is another matter: where it seldom changes, stop bits are right by themselves (a lamp that goes on and off
at random, 12 ms each on average, made 30 good characters in a row at 1000 bit/s). So a run is also weighed against
the chain of bits that suits it best: bit b follows bit a with the chance p_ab, taken from the run's own n_ab (start to
last stop bit, k characters)::

    worth = m ln 2 + min(m ln 8 + (k - m) ln 2, sum_ab n_ab ln(1 / p_ab) - k ln 128) - offsets and doubt

with p_ab = n_ab / (n_a0 + n_a1) and m characters one right after another. The first in the brackets is the rule above;
the second is the likelihood ratio of "any of 128 characters" to the best chain, never more than to the true one: any
such source exceeds 1e12 with a chance of at most 1e-12 (Ville's inequality). Busy text loses next to nothing by it.

A periodic signal is no news, however long: a lamp, or a cyclic code (`seed11` at the same bit rate), reads as a few
characters over and over (100 Hz at 504 bit/s as six, N 1 s g and two more). So the last twelve characters of the run
must hold eight different ones. Until all that holds, characters are held back; then they are released at once.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from math import exp, log, pi, sqrt
from typing import Final

from heliograph.errors import Refusal, Refusals
from heliograph.link.contract import Identity, LinkFrame, Text, Verdict
from heliograph.link.uart_follow import Decision
from heliograph.link.uart_layout import CHARACTER_BITS, CHARACTERS, TIME_FILL, character_bits
from heliograph.units import US_PER_S

WORTH_NEEDED: Final = log(1e12)
WORTH: Final = log(8.0)  # of a good character whose start is given
WORTH_AT_ONCE: Final = log(2.0)  # more, if it starts right after the one before
WORTH_AFTER_IDLE: Final = log(2.0)
# Recordings and synthetic text keep within .1 to 1 sub-bins; a character is looked for within 6 (uart_follow.REACH).
OFFSET_SIGMA: Final = 1.5
OFFSET_FREE: Final = log(13.0 / (OFFSET_SIGMA * sqrt(2.0 * pi)))
# Of the windows of an English text 88 % hold 8 or more: it waits .7 characters on average, 5 at the 95th percentile.
NEWS_NEEDED: Final = 8
NEWS_OF: Final = 12
HELD_MAX: Final = 64  # characters; the oldest of a longer wait are let go, and counted

# Of the last 20 decisions: so many refused, and the track is no text any more, or the framing is lost.
WATCHED: Final = 20
REFUSED_MAX: Final = 10
REFUSED_MAX_NEW: Final = 5  # as long as the track is not accepted: noise that passed for text is let go soon

# The paper's score (its Algorithm 1), with the floor that lets a valid track recover.
SCORE_START: Final = 10
SCORE_MAX: Final = 20
SCORE_MIN: Final = -10
GAIN: Final = 2
LOSS: Final = 1
# A valid track may be silent for 2 s or five characters, whichever is longer; a new one must have said something by
# the time that the cold start has seen all that it keeps (64 characters).
SILENCE_US: Final = 2 * US_PER_S
SILENCE_CHARACTERS: Final = 5
NEW_US: Final = 300_000
NEW_CHARACTERS: Final = 64
# A lit LED that idles supports its identity without a word, for so long.
IDLE_SUPPORT_US: Final = 60 * US_PER_S


def _steps_of(code: int) -> tuple[int, ...]:
    bits = character_bits(code)
    pairs = [2 * a + b for a, b in pairwise(bits)]
    return tuple(pairs.count(pair) for pair in range(4))


# How often 00, 01, 10 and 11 follow each other in each character.
STEPS: Final = tuple(_steps_of(code) for code in range(CHARACTERS))


def probability(margin: float) -> float:
    """Return the chance that a character with this margin (nats to the runner-up) is right."""
    return 1.0 / (1.0 + exp(-min(max(margin, 0.0), 700.0)))


class RunWorth:
    """What a run of good characters is worth as a witness of text, in nats (see the module)."""

    def __init__(self) -> None:
        self._characters = 0
        self._at_once = 0
        self._late = 0.0  # what offsets and doubt cost
        self._steps = [0, 0, 0, 0]

    def add(self, code: int, *, after_idle: bool, offset: float = 0.0, doubt: float = 0.0) -> None:
        """Take the run's next character, found so many sub-bins off its clock, and in such doubt."""
        self._characters += 1
        self._late -= max(doubt, 0.0)
        if not after_idle:
            self._at_once += 1
            self._late += min(0.0, OFFSET_FREE - 0.5 * (offset / OFFSET_SIGMA) ** 2)
        self._steps = [n + more for n, more in zip(self._steps, STEPS[code], strict=True)]

    @property
    def most(self) -> float:
        """What the run would be worth among random bits at the right clock."""
        after_idle = self._characters - self._at_once
        return self._at_once * (WORTH + WORTH_AT_ONCE) + after_idle * WORTH_AFTER_IDLE + self._late

    @property
    def value(self) -> float:
        """The worth of the run; it may be negative."""
        n00, n01, n10, n11 = self._steps
        chain = _surprise(n00, n01) + _surprise(n10, n11) - self._characters * log(CHARACTERS)
        return min(self.most, self._at_once * WORTH_AT_ONCE + chain + self._late)


def _surprise(n: int, m: int) -> float:
    """Return the nats of n and m things in a given order, their shares taken from themselves."""
    return sum(k * log((n + m) / k) for k in (n, m) if k)


class TextIdentity:
    """Judges the decisions of one track.

    Args:
        refusals: where refused characters are counted.
        bit_us: nominal length of a bit.
    """

    def __init__(self, refusals: Refusals, bit_us: float) -> None:
        self._refusals = refusals
        self._character_us = CHARACTER_BITS * bit_us
        self._begun_us: int | None = None
        self._since_us: int | None = None
        self._support_us: int | None = None  # end of the newest good character, or of the idle time after it
        self._spoken_us: int | None = None  # end of the newest good character
        self._held: deque[LinkFrame] = deque()
        self._worth = RunWorth()
        self._run: deque[int] = deque(maxlen=NEWS_OF)
        self._frames = 0
        self._margin = 0.0
        self._watched: deque[float] = deque(maxlen=WATCHED)  # chance of being right; 0: refused
        self._score = SCORE_START

    @property
    def accepted(self) -> bool:
        """Whether the track is a text beacon."""
        return self._since_us is not None

    @property
    def worth(self) -> float:
        """What the run is worth, in nats; `WORTH_NEEDED` and news make an identity."""
        return self._worth.value

    def begin(self, t_us: int) -> None:
        """Take note of the track's first event."""
        if self._begun_us is None:
            self._begun_us = t_us

    def take(self, decision: Decision, end_us: int) -> list[LinkFrame | Text]:
        """Judge a decision; return what it releases."""
        if self._spoken_us is not None and end_us - self._spoken_us > IDLE_SUPPORT_US:
            self.drop()
        if decision.refusal is not None:
            self._refusals[decision.refusal] += 1
        chance = 0.0 if decision.code is None else probability(decision.margin)
        self._watched.append(chance)
        if decision.good and decision.code is not None:
            self._good(decision, decision.code, end_us)
        else:
            self._score = max(self._score - LOSS, SCORE_MIN)
            self._worth = RunWorth()
            self._run.clear()
        if decision.code is None:
            return []
        self._held.append(LinkFrame(end_us, decision.code, chance, decision.margin))
        if not self.accepted:
            if self._worth.value < WORTH_NEEDED or self._news() < NEWS_NEEDED:
                self._let_go()
                return []
            self._since_us = end_us
        return self._release(end_us)

    def _release(self, end_us: int) -> list[LinkFrame | Text]:
        out: list[LinkFrame | Text] = list(self._held)
        text = "".join(chr(frame.payload) for frame in self._held if frame.payload != TIME_FILL)
        self._held.clear()
        if text:
            out.append(Text(t_us=end_us, text=text, data=None))
        return out

    def _let_go(self) -> None:
        if len(self._held) > HELD_MAX:
            self._held.popleft()
            is_periodic = self._worth.most >= WORTH_NEEDED and self._news() < NEWS_NEEDED
            self._refusals[Refusal.PERIODIC if is_periodic else Refusal.WEAK] += 1

    def _news(self) -> int:
        """Return how many different ones the run's last characters are."""
        return len(set(self._run))

    def _good(self, decision: Decision, code: int, end_us: int) -> None:
        self._score = min(self._score + GAIN, SCORE_MAX)
        if decision.after_junk:
            self._worth = RunWorth()
            self._run.clear()
        self._worth.add(code, after_idle=decision.after_idle, offset=decision.offset, doubt=decision.doubt)
        self._run.append(code)
        self._frames += 1
        self._margin += decision.margin
        self._spoken_us = self._support_us = end_us

    def idle(self, until_us: int) -> None:
        """Take note that the LED idles, lit."""
        if self._spoken_us is not None and self._support_us is not None:
            self._support_us = max(self._support_us, min(until_us, self._spoken_us + IDLE_SUPPORT_US))

    def bad(self) -> bool:
        """Return whether too many of the last decisions were refused."""
        refused = sum(chance == 0.0 for chance in self._watched)
        return refused >= (REFUSED_MAX if self.accepted else REFUSED_MAX_NEW)

    def drop(self) -> None:
        """Take the identity back, and begin anew."""
        self._since_us = None
        self._held.clear()
        self._worth = RunWorth()
        self._run.clear()
        self._frames = 0
        self._margin = 0.0
        self._watched.clear()

    def identity(self) -> Identity | None:
        """Return the accepted identity, or None."""
        if self._since_us is None or self._support_us is None:
            return None
        return Identity(
            payload=None,
            since_us=self._since_us,
            t_us=self._support_us,
            frames_used=self._frames,
            margin=self._margin,
            confidence=sum(self._watched) / max(len(self._watched), 1),
        )

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        if self._score <= SCORE_MIN:
            return "invalid"
        if self.accepted:
            limit = max(SILENCE_US, SILENCE_CHARACTERS * self._character_us)
        else:
            limit = max(NEW_US, NEW_CHARACTERS * self._character_us)
        since_us = self._support_us if self._support_us is not None else self._begun_us
        if since_us is not None and now_us - since_us > limit:
            return "invalid"
        return "valid" if self.accepted else "new"
