"""Cold start of the text receiver: from the events alone to the LED's response, the bit clock and the framing.

A stretch of sixteen characters is explained (`uart_paths.explain`) with a parametric response, the response is learned
from that explanation, and again, four times: expectation and maximisation with hard decisions, on short contexts at
first, so that an early mistake is outvoted rather than learned by heart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.link.step_response import SHRINK_BITS, SUB_BINS, Counts, StepResponse
from heliograph.link.turns import turns
from heliograph.link.uart_layout import CHARACTER_BITS, IDLE_CONTEXT, word_table
from heliograph.link.uart_paths import explain
from heliograph.link.uart_words import Slots, near, slots_of

CHARACTER_BINS: Final = CHARACTER_BITS * SUB_BINS
# Ten characters to identify a beacon, and a few that the stretch's ends cut; with 12 a third of the starts fail on the
# recordings' first stretch, and every further one delays the first identification.
LOCK_CHARACTERS: Final = 16
LOCK_BINS: Final = LOCK_CHARACTERS * CHARACTER_BINS
# Weight of the shorter contexts in each round of learning: at first only the last two bits of a context count, so that
# a wrong character is not learned by heart from its own events.
ROUNDS: Final = (400.0, 40.0, 12.0, SHRINK_BITS)
# Fewest good characters after each round. Light that became a lock (17 kinds of text, both recordings with 2 % of their
# events and more) showed 1 to 15, 6 to 15 and 6 to 15 of them; noise, lamps and texture mostly show none after the
# first round, and cost no more than that.
PROMISING: Final = (1, 3, 5)
# Fewer events than this in the stretch (three a character) teach nothing: the LED idles, or is too far away.
LOCK_EVENTS: Final = 3 * LOCK_CHARACTERS
# h of the stretch's turns (`heliograph.link.turns`), in usual swings.
TURN: Final = 1.0 / 3.0
# Of the characters that the stretch can hold: fewer, and it is not text, or not yet. With 6, Poisson noise of two
# events a bit passes now and then.
LOCK_GOOD: Final = 8
# A good character holds a fall and a rise at least. Both recordings with 3 % of their events show 35 turns and more in
# a stretch, lamps and glints at 3 kbit/s mostly fewer than 16: they are not looked at any further.
LOCK_TURNS: Final = 2 * LOCK_GOOD
# A character holds five changes of level on average.
CHANGES: Final = 5.0
CLOCK_MAX: Final = 0.025  # offsets beyond 2.5 % are another bit rate
# Half a bit, a scan of two a bit, and what a character's place errs by.
SLIP_BINS: Final = SUB_BINS // 2 + 2

# A character is good, that is a witness of text, if hardly any other word of 11 bits, and no other character, explains
# its events as well (nats). Where F is right, 4 nats are odds of 55 to 1.
GOOD_DEFICIT: Final = 4.0
GOOD_MARGIN: Final = 4.0


@dataclass(frozen=True, slots=True)
class Lock:
    """What a cold start found.

    Args:
        response: learned from the stretch.
        bit_bins: length of a bit in sub-bins.
        start: sub-bin of the first character, counted from the stretch's beginning.
        good: number of good characters.
    """

    response: StepResponse
    bit_bins: float
    start: int
    good: int


WORDS: Final = word_table()
ON_OFF: Final = np.array([True, False])  # the columns of Counts


def is_good(likelihood: float, second: float, free: float) -> bool:
    """Return whether a character with these log-likelihoods is a witness of text."""
    return free - likelihood <= GOOD_DEFICIT and likelihood - second >= GOOD_MARGIN


def characters_in(counts: Counts, start: int, n: int, slots: Slots, response: StepResponse) -> list[tuple[int, int]]:
    """Return (sub-bin counted from start, code) of the characters that best explain the sub-bins [start, start + n)."""
    path = np.empty((n, 2), np.int64)
    steps = explain(counts, start, n, slots, -1, response.tables, path)
    found = path[:steps]
    return [(int(at), int(code)) for at, code in found[found[:, 1] >= 0]]


def _chained(found: list[tuple[int, int]]) -> Iterator[tuple[int, int, int]]:
    """Yield (sub-bin, code, context of the bit before) of the characters found."""
    end, before = -CHARACTER_BINS, IDLE_CONTEXT
    for at, code in found:
        yield at, code, before if abs(at - end) <= SUB_BINS // 4 else IDLE_CONTEXT
        before = int(WORDS[code]) & IDLE_CONTEXT
        end = at + CHARACTER_BINS


def _learned(
    counts: Counts, start: int, found: list[tuple[int, int]], slots: Slots, response: StepResponse, shrink_bits: float
) -> StepResponse:
    """Return a response learned from these characters alone; F is measured against what was learned."""
    response = response.relearn(shrink_bits)
    for at, code, before in _chained(found):
        response.learn(counts, start + at, slots, int(WORDS[code]), before)
    response.refresh()
    for at, code, before in _chained(found):
        response.measure(counts, start + at, slots, int(WORDS[code]), before)
    response.refresh()
    return response


def _bit_bins(found: list[tuple[int, int]]) -> float:
    """Return the bit length that the distances of neighbours tell, in sub-bins.

    Where two scans are nearly a bit, characters keep the distances of the scans, and slip by one once in a beat of the
    two: so the nominal length is believed where it explains the slips too, and better.
    """
    steps = np.diff([at for at, _ in found])
    own = steps[steps < CHARACTER_BINS + 4] - CHARACTER_BINS
    if len(own) < LOCK_GOOD - 1:
        return float(SUB_BINS)
    # Characters between two that were found may have been lost in a slip.
    slipped = steps - np.round(steps / CHARACTER_BINS) * CHARACTER_BINS
    off = abs(float(slipped[np.abs(slipped) <= SLIP_BINS].sum()))
    if off <= SLIP_BINS and off < abs(float(own.sum())):
        return float(SUB_BINS)
    mean = SUB_BINS + float(own.mean()) / CHARACTER_BITS
    return min(max(mean, SUB_BINS * (1 - CLOCK_MAX)), SUB_BINS * (1 + CLOCK_MAX))


def _count_good(counts: Counts, start: int, found: list[tuple[int, int]], slots: Slots, response: StepResponse) -> int:
    good = 0
    for at, _, before in _chained(found):
        _, _, likelihood, second, free, _, _ = near(counts, start + at, 0, slots, before, response.tables)
        good += is_good(likelihood, second, free)
    return good


def _turns(counts: Counts) -> int:
    """Return how often the light turns in these sub-bins; within one, ON comes first."""
    at, _ = turns(np.repeat(np.tile(ON_OFF, len(counts)), counts.ravel()), TURN, by_first=True, balanced=True)
    return len(at)


def lock(counts: Counts, start: int, n: int) -> Lock | None:
    """Look for text in the sub-bins [start, start + n); n at least LOCK_BINS. Return None if there is none."""
    events = int(counts[start : start + n].sum())
    if events < LOCK_EVENTS or _turns(counts[start : start + n]) < LOCK_TURNS:
        return None
    response = StepResponse(events * CHARACTER_BINS / (n * CHANGES))
    slots = slots_of(SUB_BINS)
    found: list[tuple[int, int]] = []
    good = 0
    for shrink_bits, least in zip(ROUNDS, (*PROMISING, LOCK_GOOD), strict=True):
        found = characters_in(counts, start, n, slots, response)
        if len(found) < LOCK_GOOD:
            return None
        slots = slots_of(_bit_bins(found))
        response = _learned(counts, start, found, slots, response, shrink_bits)
        good = _count_good(counts, start, found, slots, response)
        # What is implausible once stays so: the smallest change of a text is .55 of the mean or more in every round.
        if good < least or not response.plausible():
            return None
    return Lock(response, _bit_bins(found), found[0][0], good)
