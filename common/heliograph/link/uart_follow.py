"""Following a text beacon, character by character: decision, clock and response in one loop.

State: the sub-bin p at which the next character may begin, the bit length, the context of the bit before, the learned
response. Three ways to go on, each of which waits for exactly the sub-bins that it reads:

* NEXT: a character begins within 3/8 bit of p, or (after idle time) within 10 sub-bins of where a start bit first
  became likely. If it explains its 11 bits as well as any word would, it is decided.
* SPAN: otherwise 26 bits from p on are explained as a whole by characters, idle time and junk, and only what comes
  first is believed. So an end of the text, a part of a bit of idle time, or an occlusion does not cost the framing.
* IDLE: while nothing happens, look for a start bit.

Where bits are of no character, the places of the characters before them are kept: a SPAN believes one at another place
only for more (`uart_paths`), until the LED idles.

Clock: a PI loop on each decided character's offset. It is found against the learned response (o, sub-bins,
interpolated), which moves with what is learned: by c - c_0, the centre of the learned changes of level against that at
the beginning. Both together are the offset against where the clock began; of the response's way, the part that is more
than the noise of single events (overdispersion F; in weak light a cold start's few events tell no c_0)::

    e = o + (1 - 1 / F) (c - c_0)        p += K_P e        bit += K_I e / 11

Without it response and clock drift together, behind scans of nearly half a bit by half a bit within seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from heliograph.errors import Refusal
from heliograph.link.step_response import SUB_BINS, Counts
from heliograph.link.uart_layout import CHARACTER_BITS, IDLE_CONTEXT
from heliograph.link.uart_lock import CLOCK_MAX, WORDS, Lock, is_good
from heliograph.link.uart_paths import IDLE, explain
from heliograph.link.uart_words import any_word, near, skip_idle, slots_of

REACH: Final = 6  # 3/8 bit: the clock is held to a few sub-bins; half a bit would let in the neighbouring framing
REACH_AFTER_IDLE: Final = 10
SPAN_BITS: Final = 26
IDLE_STEP: Final = 4 * SUB_BINS
# Loop gains a character: with .15 the phase settles in 7 characters, the rate in about 100.
K_P: Final = 0.15
K_I: Final = 0.01
ALL_LIT: Final = (1 << CHARACTER_BITS) - 1
# What NEXT decides at once; the rest is looked at in its surroundings.
SURE_DEFICIT: Final = 8.0
# What is released although it is no good witness: odds of 7 to 1 among characters, and at most one bit against it.
RELEASE_MARGIN: Final = 2.0
RELEASE_DEFICIT: Final = 20.0
# Of a character's changes of level, the share that events must have told.
SEEN_LEAST: Final = 2.0 / 3.0


class Mode(Enum):
    """How the follower goes on."""

    NEXT = "next"
    SPAN = "span"
    IDLE = "idle"


@dataclass(frozen=True, slots=True)
class Decision:
    """What became of eleven bits.

    Args:
        start: sub-bin at which they begin (a part of it counts).
        end: where they end.
        code: the character, or None where refused.
        refusal: why; None where decided.
        good: a witness of text (`uart_lock.is_good`).
        after_idle: it did not follow another character at once.
        margin: nats to the runner-up.
        offset: where it was found, against its clock, in sub-bins.
        events: number of events in its bits.
        after_junk: bits of no character lie before it, too few to be told.
        doubt: log-likelihood (nats) of all words of 11 bits together over the character's; 0 where that is clear.
    """

    start: float
    end: float
    code: int | None
    refusal: Refusal | None
    good: bool
    after_idle: bool
    margin: float
    offset: float
    events: int
    doubt: float = 0.0
    after_junk: bool = False


def reason(word: int, events: int, events_per_transition: float) -> Refusal:
    """Return why eleven bits are no character."""
    if events < events_per_transition / 2:
        return Refusal.OCCLUSION
    if word & 3 != 3:
        return Refusal.STOP_BITS
    if (word >> 2).bit_count() & 1:
        return Refusal.PARITY
    return Refusal.WEAK


class Follower:
    """Decides the characters of a track whose response is known.

    Args:
        found: what the cold start found.
        start: sub-bin of the first character.
    """

    def __init__(self, found: Lock, start: int) -> None:
        self.response = found.response
        self.response.admit_losses()
        self.response.refresh()
        self.position = float(start)
        self.bit_bins = found.bit_bins
        self._slots = slots_of(found.bit_bins)
        self._before = IDLE_CONTEXT
        self._mode = Mode.NEXT
        self._after_idle = True
        self._after_junk = False
        self._level_known = False
        self._reach = REACH
        self._centre = self.response.change_centre()
        self._frame = np.nan  # a sub-bin at which a character would begin, from the last one; nan after idle time
        self._path = np.empty((SPAN_BITS * SUB_BINS, 2), np.int64)

    @property
    def lit(self) -> bool:
        """Whether the LED is thought to idle, lit."""
        return self._mode is Mode.IDLE and self._level_known

    def need(self) -> int:
        """Return how far the sub-bins must be known for the next step."""
        start = round(self.position)
        if self._mode is Mode.NEXT:
            return start + self._reach + int(self._slots[-1]) + SUB_BINS
        return start + (SPAN_BITS * SUB_BINS if self._mode is Mode.SPAN else IDLE_STEP + SUB_BINS)

    def step(self, counts: Counts, base: int) -> Decision | None:
        """Go on by one step; the sub-bins before `need` must be known. Return a decision, if one was made.

        Args:
            counts: (n, 2) int32.
            base: number of the first row.
        """
        if self._mode is Mode.NEXT:
            return self._next(counts, base, SURE_DEFICIT)
        if self._mode is Mode.SPAN:
            return self._span(counts, base)
        self._idle(counts, base)
        return None

    def _idle(self, counts: Counts, base: int) -> None:
        start = round(self.position) - base
        at = skip_idle(counts, start, start + IDLE_STEP, self.response.tables)
        self.position = float(at + base)
        self._after_idle = True
        if at < start + IDLE_STEP:
            self.position += SUB_BINS // 2
            self._mode, self._reach = Mode.NEXT, REACH_AFTER_IDLE

    def _next(self, counts: Counts, base: int, deficit_max: float) -> Decision | None:
        start = round(self.position)
        offset, code, likelihood, second, free, word, refined = near(
            counts, start - base, self._reach, self._slots, self._before, self.response.tables
        )
        seen, unseen = self._seen(counts, start + offset - base, int(WORDS[code]), ahead=deficit_max == np.inf)
        # Where all bits are rather lit, the LED may idle: in weak light DEL is hardly less likely than that.
        if free - likelihood > deficit_max or ((word == ALL_LIT or unseen) and deficit_max < np.inf):
            self._mode = Mode.SPAN
            if self._reach != REACH:
                self.position -= SUB_BINS // 2
                self._reach = REACH
            return None
        margin = likelihood - second
        others = any_word(counts, start + offset - base, self._slots, self._before, self.response.tables)
        error = refined + start - self.position
        self._steer(error)
        begin = self.position
        at = round(begin) - base
        events = int(counts[at : at + int(self._slots[-1]) + SUB_BINS].sum())
        good = seen >= SEEN_LEAST and not unseen and is_good(likelihood, second, free)
        sure = margin >= RELEASE_MARGIN and free - likelihood <= RELEASE_DEFICIT
        released = good or (seen >= SEEN_LEAST and not unseen and sure)
        if released:
            self._learn(counts, at, int(WORDS[code]), good=good and seen == 1.0)
        after_idle, after_junk = self._after_idle, self._after_junk
        self._after_junk = False
        self._move(begin + CHARACTER_BITS * self.bit_bins, int(WORDS[code]) & IDLE_CONTEXT)
        self._level_known = not unseen
        return Decision(
            start=begin,
            end=begin + CHARACTER_BITS * self.bit_bins,
            code=code if released else None,
            refusal=None if released else reason(word, events, self.response.events_per_transition),
            good=good,
            after_idle=after_idle,
            margin=margin,
            offset=offset if after_idle else error,
            events=events,
            doubt=others - likelihood,
            after_junk=after_junk,
        )

    def _move(self, position: float, before: int) -> None:
        self.position = self._frame = position
        self._before = before
        self._mode, self._reach, self._after_idle = Mode.NEXT, REACH, False
        self._level_known = True

    def _steer(self, error: float) -> None:
        if self._after_idle:
            self.position += error
            return
        error += (1.0 - 1.0 / self.response.f) * (self.response.change_centre() - self._centre)
        bit_bins = self.bit_bins + K_I * error / CHARACTER_BITS
        self.bit_bins = min(max(bit_bins, SUB_BINS * (1 - CLOCK_MAX)), SUB_BINS * (1 + CLOCK_MAX))
        self._slots = slots_of(self.bit_bins)
        self.position += K_P * error

    def _seen(self, counts: Counts, at: int, word: int, *, ahead: bool) -> tuple[float, bool]:
        """Return the share of a character's changes that were seen, and whether the LED may have gone dark in it.

        Where its last rise was lost, only a fall after the stop bits tells that it was there; `ahead` says that the bit
        after the character may be looked at.
        """
        changes, lost, last = self.response.changes(counts, at, self._slots, word, self._before)
        if last and ahead:
            slots = np.append(self._slots, round(CHARACTER_BITS * self.bit_bins))
            _, _, last = self.response.changes(counts, at, slots, word << 1, self._before)
        return 1.0 - lost / changes, last

    def _learn(self, counts: Counts, at: int, word: int, *, good: bool) -> None:
        self.response.count(counts, at, self._slots, word, self._before)
        self.response.follow_glow(counts, at, self._slots, word, self._before)
        if good:
            self.response.forget()
            self.response.measure(counts, at, self._slots, word, self._before)
            self.response.learn(counts, at, self._slots, word, self._before)
        self.response.refresh()

    def _span(self, counts: Counts, base: int) -> Decision | None:
        start, n = round(self.position), SPAN_BITS * SUB_BINS
        response = self.response
        steps = explain(
            counts, start - base, n, self._slots, self._before, response.tables, self._path, self._frame - start
        )
        path = self._path[:steps]
        characters = np.flatnonzero(path[:, 1] >= 0)
        first = int(characters[0]) if len(characters) else steps
        idle = int(np.count_nonzero(path[:first, 1] == IDLE))
        junk = (first - idle) * SUB_BINS
        at = int(path[first, 0]) if first < steps else n - (CHARACTER_BITS + 1) * SUB_BINS
        if at <= REACH and first < steps:
            self.position = float(start + at)
            return self._next(counts, base, np.inf)
        self._after_idle = True
        if junk or idle >= 4 * SUB_BINS:
            self._before = IDLE_CONTEXT
        else:
            ones = idle // SUB_BINS
            self._before = ((self._before << ones) | ((1 << ones) - 1)) & IDLE_CONTEXT
        self.position = float(start + at)
        if first == steps and not junk:
            self._mode, self._frame = Mode.IDLE, np.nan
        elif first < steps:
            self._mode = Mode.NEXT
        self._after_junk |= junk > 0
        if junk < CHARACTER_BITS * SUB_BINS // 2:
            return None
        self._level_known = False
        events = int(counts[start - base : start - base + at].sum())
        why = reason(0x7FF if events else 0, events, response.events_per_transition)
        return Decision(start, self.position, None, why, False, True, 0.0, 0.0, events)
