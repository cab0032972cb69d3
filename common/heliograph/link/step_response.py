"""What a switched LED looks like in the events, learned from the receiver's own decisions.

Model: in sub-bin j of a bit with context c (the bit and the four before it, `uart_layout`), events of polarity q come
as a Poisson stream with the mean

    lambda[q, c, j]        (events a sub-bin; q = 0: ON, 1: OFF; j = 0 .. 15)

thinned and bunched by the sensor (read-out scans, refractory pixels, saturation), which leaves the mean right and the
variance F times too large. So the log-likelihood of a bit is the quasi-Poisson one, in nats:

    l(c) = 1/F sum_j sum_q ( y[q, j] ln lambda[q, c, j] - lambda[q, c, j] )

F is measured on decided bits, in two ways, of which the larger counts: by the events of whole bits (too many or too few
of an edge), and by those of quarters of a bit (an edge that comes early or late as a whole, so that its events do not
err one by one)::

    F = max( mean (y - lambda)^2 / lambda  of bits,  the same of quarters )

A change may also be lost whole, with a share d of them: then its bit looks as if nothing had changed (c~ is c with the
bit before in place of the bit itself), and its likelihood is

    max( ln(1 - d) + l(c),  ln d + l(c~) )

d is learned too, once text is followed (a cold start believes no change that it does not see).

The share of lambda that comes from a lit LED's motion is corrected after each character (`heliograph.link.uart_glow`).

A table in place of one kernel that is shifted and added: the real response is not linear (a pixel that has just fired
is refractory, the read-out saturates), and each polarity's own delay is in the table by itself.

Learning: counts over decided bits, with a forgetting factor a character. A context seen seldom leans on the contexts
that end in the same 4, 3, 2 bits (each level is shrunk towards the shorter one by the weight of `SHRINK_BITS` bits),
and in the end on a parametric response: an exponential tail after each change of level, the same for both polarities.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.uart_glow import SHAPE, correction, lit_events
from heliograph.link.uart_layout import CONTEXT_BITS, CONTEXTS

Counts = npt.NDArray[np.int32]
Table = npt.NDArray[np.float64]
# ln(lambda) / F (2, 16, 32); sum_q lambda / F (16, 32); that summed over sub-bins (32,); and (4,): of an LED that has
# idled for long, ln(lambda) / F and sum_q lambda / F of any sub-bin; ln d and ln(1 - d), d the share of lost changes
Tables = tuple[Table, Table, Table, Table]

SUB_BINS: Final = 16  # sub-bins a bit: finer ones read no better, and each halving doubles the work

# Where in its bit's sub-bins a change of level is, before anything is learned: in the middle, so that edges that come
# early or late stay in the bit that tells of them.
CHANGE_AT: Final = SUB_BINS // 4

# Tail of the response assumed before anything is learned, in bits. Read from the start, .6 takes a space for a 0 where
# the tail is long; 1.0 reads slow LEDs and, since only the order of the bits' likelihoods matters, sharp ones too.
COLD_TAIL_BITS: Final = 1.0
# Share of a transition's events that may come in any bit for no reason: bounds what one stray event can say (3.9 nats).
FLOOR: Final = 0.02
# A character learned 300 characters ago counts 1/e: long beside the seldom contexts (one in a few characters), short
# beside a beacon that comes nearer.
FORGET: Final = 1.0 - 1.0 / 300.0
SHRINK_BITS: Final = 4.0
# A sensor that is read out in scans shows a change at any of several sub-bins, and the few changes seen so far leave
# gaps between them; a change that then falls into a gap would be impossible. Spread by sqrt(4 / 2) sub-bins = .09 bit,
# synthetic scans of a fifth of a bit are read without an error from the first character on (0 to 4 errors in 150
# characters without); more spreading costs little.
SMOOTHING: Final = 4
# Overdispersion before anything is learned: a change of level is never believed more than ten independent events
# (real sensors: F = 3 to 30 at 200 events a change); and how many bits this guess weighs.
COLD_WITNESSES: Final = 10.0
COLD_F_BITS: Final = 44.0
# Parts of a bit in which events are too many or too few where an edge comes early or late.
PARTS: Final = 4
# Share of changes lost before any was missed, and how many changes that guess weighs; the most that is believed.
LOST_START: Final = 1e-3
LOST_WEIGHT: Final = 500.0
LOST_MAX: Final = 0.2
NO_LOSS: Final = -1e300
F_MAX: Final = 400.0
# Of the mean change's events, the least that a kind of change (after one bit or after more, on or off) must show.
# The recordings: .76 and more; synthetic light with few events: .65.
CHANGE_MIN: Final = 0.25

_RISES: Final = np.arange(1, CONTEXTS, 4)  # contexts that end in 0 1
_FALLS: Final = np.arange(2, CONTEXTS, 4)  # and in 1 0


def cold_rates(events_per_transition: float) -> Table:
    """Return (2, 32, 16) float64, events a sub-bin: the response assumed before anything is learned."""
    return _cold_tails() * events_per_transition


@cache
def _cold_tails() -> Table:
    """Return `cold_rates` for one event a transition."""
    rates = np.zeros((2, CONTEXTS, SUB_BINS))
    at = (np.arange(SUB_BINS) + 0.5 - CHANGE_AT) / SUB_BINS
    for context in range(CONTEXTS):
        for newest, own in ((0, at >= 0.0), (1, at < 0.0)):
            level = (context >> newest) & 1
            age = 0  # whole bits since the last change, as far as the context reaches
            while age + newest < CONTEXT_BITS - 1 and (context >> (age + newest + 1)) & 1 == level:
                age += 1
            tail = np.exp(-(at[own] + newest + age) / COLD_TAIL_BITS) / COLD_TAIL_BITS / SUB_BINS
            rates[0 if level else 1, context, own] = tail
    return rates


@numba.njit(cache=True, nogil=True)
def _smooth(mean: Table) -> None:
    """Spread each context's events over neighbouring sub-bins, SMOOTHING times by 1/4, 1/2, 1/4, within the bit."""
    contexts, sub = mean.shape
    for _ in range(SMOOTHING):
        for c in range(contexts):
            left = mean[c, 0]
            for j in range(sub):
                here = mean[c, j]
                right = mean[c, min(j + 1, sub - 1)]
                mean[c, j] = 0.25 * left + 0.5 * here + 0.25 * right
                left = here


@numba.njit(cache=True, nogil=True)
def _log_tables(
    seen: Table, sums: Table, cold: Table, shrink: float, floor: float, f: float, glow: Table, log_rate: Table,
    rate: Table, total: Table,
) -> None:  # fmt: skip
    """Fill log_rate (2, 16, 32) = ln(lambda) / F, rate (16, 32) = sum_q lambda / F and total (32,) = sum_j rate."""
    contexts, sub = sums.shape[1], sums.shape[2]
    bits = 0
    while (1 << bits) < contexts:
        bits += 1
    level_seen = np.zeros(contexts)
    level_sums = np.zeros((contexts, sub))
    rate[:] = 0.0
    for q in range(2):
        mean = cold[q].copy()
        for length in range(2, bits + 1):
            mask = (1 << length) - 1
            weight_shorter = SHRINK_BITS if length == 2 else shrink
            level_seen[:] = 0.0
            level_sums[:] = 0.0
            for c in range(contexts):
                level_seen[c & mask] += seen[c]
                for j in range(sub):
                    level_sums[c & mask, j] += sums[q, c, j]
            for c in range(contexts):
                weight = 1.0 / (level_seen[c & mask] + weight_shorter)
                for j in range(sub):
                    mean[c, j] = (level_sums[c & mask, j] + weight_shorter * mean[c, j]) * weight
        _smooth(mean)
        for c in range(contexts):
            for j in range(sub):
                lit = c & 1 if j >= CHANGE_AT else (c >> 1) & 1
                value = max(mean[c, j] + lit * glow[q], 0.0) + floor
                log_rate[q, j, c] = np.log(value) / f
                rate[j, c] += value / f
    for c in range(contexts):
        total[c] = 0.0
        for j in range(sub):
            total[c] += rate[j, c]


@numba.njit(cache=True, nogil=True)
def _lost(counts: Counts, at: int, context: int, tables: Tables) -> bool:
    """Return whether the change at the beginning of this bit was likelier lost than seen."""
    log_rate, _, total, rest = tables
    if rest[2] == NO_LOSS or ((context ^ (context >> 1)) & 1) == 0:
        return False
    without = context ^ 1
    gain = rest[2] - rest[3] + total[context] - total[without]
    for j in range(log_rate.shape[1]):
        for q in range(2):
            if counts[at + j, q]:
                gain += counts[at + j, q] * (log_rate[q, j, without] - log_rate[q, j, context])
    return bool(gain > 0.0)


@numba.njit(cache=True, nogil=True)
def _changes(
    counts: Counts, start: int, slots: npt.NDArray[np.int64], word: int, before: int, tables: Tables
) -> tuple[int, int, bool]:
    """Return how many changes a decided word has, how many of them were lost, and whether the last of them was."""
    context = before
    bits = slots.shape[0]
    changes, lost, last = 0, 0, False
    for n in range(bits):
        context = ((context << 1) | ((word >> (bits - 1 - n)) & 1)) & (tables[2].shape[0] - 1)
        if (context ^ (context >> 1)) & 1:
            last = _lost(counts, start + slots[n], context, tables)
            changes += 1
            lost += last
    return changes, lost, last


@numba.njit(cache=True, nogil=True)
def _learn(
    counts: Counts, start: int, slots: npt.NDArray[np.int64], word: int, before: int, seen: Table, sums: Table
) -> None:
    """Add a decided word of as many bits as there are slots."""
    context = before
    bits = slots.shape[0]
    for n in range(bits):
        context = ((context << 1) | ((word >> (bits - 1 - n)) & 1)) & (seen.shape[0] - 1)
        at = start + slots[n]
        for j in range(sums.shape[2]):
            sums[0, context, j] += counts[at + j, 0]
            sums[1, context, j] += counts[at + j, 1]
        seen[context] += 1.0


@numba.njit(cache=True, nogil=True)
def _residual(
    counts: Counts, start: int, slots: npt.NDArray[np.int64], word: int, before: int, rate: Table, f: float
) -> tuple[float, float]:
    """Return a decided word's summed Pearson residuals (y - lambda)^2 / lambda: of bits, and (mean) of their parts."""
    context = before
    bits = slots.shape[0]
    whole, parts = 0.0, 0.0
    part = SUB_BINS // PARTS
    for n in range(bits):
        context = ((context << 1) | ((word >> (bits - 1 - n)) & 1)) & (rate.shape[1] - 1)
        at = start + slots[n]
        y_bit, expected_bit = 0.0, 0.0
        for i in range(PARTS):
            y, expected = 0.0, 0.0
            for j in range(i * part, (i + 1) * part):
                y += counts[at + j, 0] + counts[at + j, 1]
                expected += rate[j, context] * f
            y_bit += y
            expected_bit += expected
            parts += (y - expected) ** 2 / expected / PARTS
        whole += (y_bit - expected_bit) ** 2 / expected_bit
    return whole, parts


class StepResponse:
    """The learned response of one track's LED.

    Args:
        events_per_transition: what to expect before anything is learned; > 0.
        shrink_bits: weight, in bits, of the shorter context against a longer one of three bits or more.
    """

    def __init__(self, events_per_transition: float, shrink_bits: float = SHRINK_BITS) -> None:
        self.events_per_transition = events_per_transition
        self.log_rate: Table = np.empty((2, SUB_BINS, CONTEXTS))  # ln(lambda) / F
        self.rate: Table = np.empty((SUB_BINS, CONTEXTS))  # sum over polarities of lambda / F
        self.total: Table = np.empty(CONTEXTS)  # sum over a bit's sub-bins of rate
        self.rest: Table = np.array([0.0, 0.0, NO_LOSS, 0.0])
        self.f = max(1.0, events_per_transition / COLD_WITNESSES)
        self._cold = cold_rates(events_per_transition)
        self._floor = FLOOR * events_per_transition / SUB_BINS
        self._seen = np.zeros(CONTEXTS)
        self._shrink = shrink_bits
        self._sums = np.zeros((2, CONTEXTS, SUB_BINS))
        self._changes = np.zeros(2)
        self._residual = self.f * COLD_F_BITS
        self._displaced = self._residual
        self._residual_bits = COLD_F_BITS
        self._lit = (0, 0)  # events and sub-bins of the last character's lit bits (uart_glow.lit_events)
        self._glow = np.zeros(2)
        self.refresh()

    @property
    def tables(self) -> Tables:
        """The tables, as the kernels take them; `refresh` changes them in place."""
        return self.log_rate, self.rate, self.total, self.rest

    def learn(self, counts: Counts, start: int, slots: npt.NDArray[np.int64], word: int, before: int) -> None:
        """Take in a decided word; call `refresh` to use it.

        Args:
            counts: (n, 2) int32, events a sub-bin, ON and OFF.
            start: sub-bin of the word's first bit.
            slots: (bits,) int64, offsets of the bits' first sub-bins.
            word: the bits, first on the air = most significant.
            before: context of the bit before the word.
        """
        _learn(counts, start, slots, word, before, self._seen, self._sums)

    def measure(self, counts: Counts, start: int, slots: npt.NDArray[np.int64], word: int, before: int) -> None:
        """Measure the overdispersion on a decided word (arguments as in `learn`); `refresh` uses it."""
        whole, parts = _residual(counts, start, slots, word, before, self.rate, self.f)
        self._residual += whole
        self._displaced += parts
        self._residual_bits += len(slots)

    def admit_losses(self) -> None:
        """Believe from now on that changes may be lost whole; call `refresh` to use it."""
        self.rest[2] = np.log(LOST_START)
        self._changes[:] = 0.0

    def changes(
        self, counts: Counts, start: int, slots: npt.NDArray[np.int64], word: int, before: int
    ) -> tuple[int, int, bool]:
        """Return how many changes a word (arguments as in `learn`) has, how many were lost, whether the last was."""
        changes, lost, last = _changes(counts, start, slots, word, before, self.tables)
        return changes, lost, bool(last)

    def count(self, counts: Counts, start: int, slots: npt.NDArray[np.int64], word: int, before: int) -> None:
        """Learn from a decided word (arguments as in `learn`) how many changes are lost; `refresh` uses it."""
        changes, lost, _ = _changes(counts, start, slots, word, before, self.tables)
        self._changes *= FORGET
        self._changes += changes, lost

    def follow_glow(self, counts: Counts, start: int, slots: npt.NDArray[np.int64], word: int, before: int) -> None:
        """Note how bright a decided word (arguments as in `learn`) was where it was lit; `refresh` uses it."""
        self._lit = lit_events(counts, start, slots, word, before, SUB_BINS)

    def forget(self) -> None:
        """Let what was learned fade by one character."""
        self._seen *= FORGET
        self._sums *= FORGET
        self._residual *= FORGET
        self._displaced *= FORGET
        self._residual_bits *= FORGET

    def refresh(self) -> None:
        """Bring the tables up to what has been learned."""
        self.f = min(max(max(self._residual, self._displaced) / self._residual_bits, 1.0), F_MAX)
        correction(self._seen, self._sums, *self._lit, self.f, SHAPE, self._glow)
        _log_tables(
            self._seen, self._sums, self._cold, self._shrink, self._floor, self.f, self._glow,
            self.log_rate, self.rate, self.total,
        )  # fmt: skip
        self.rest[:2] = np.log(self._floor) / self.f, 2.0 * self._floor / self.f
        if self.rest[2] != NO_LOSS:
            lost = float(self._changes[1] + LOST_START * LOST_WEIGHT) / float(self._changes[0] + LOST_WEIGHT)
            lost = min(lost, LOST_MAX)
            self.rest[2:] = np.log(lost), np.log(1.0 - lost)

    def relearn(self, shrink_bits: float) -> StepResponse:
        """Return an unlearned response that expects as many events: the next round of learning starts from it."""
        return StepResponse(self.events_per_transition, shrink_bits)

    def plausible(self) -> bool:
        """Return whether each kind of change that was seen looks like one: a rise by ON events, a fall by OFF events.

        A periodic signal is consistent with words that it does not send, where the response is learned to fit: some
        of their changes then come without events. Polarities are balanced (`heliograph.link.turns`).
        """
        by_polarity = self._sums.sum(axis=2)
        on, off = by_polarity.sum(axis=1)
        signed = by_polarity[0] * (off / max(on, 1.0)) - by_polarity[1]
        seen = self._seen.reshape(-1, 8).sum(axis=0)
        per_change = signed.reshape(-1, 8).sum(axis=0) / np.maximum(seen, 1.0)
        changes = [(1.0, 0b001), (1.0, 0b101), (-1.0, 0b010), (-1.0, 0b110)]
        sizes = [sign * float(per_change[c]) for sign, c in changes if seen[c] >= 1.0]
        return bool(sizes) and min(sizes) > CHANGE_MIN * sum(sizes) / len(sizes)

    def change_centre(self) -> float:
        """Return the mean sub-bin (0 to 16) of the events in bits whose level differs from the bit before."""
        by_sub_bin = self._sums[0, _RISES].sum(axis=0) + self._sums[1, _FALLS].sum(axis=0)
        total = float(by_sub_bin.sum())
        return float(by_sub_bin @ (np.arange(SUB_BINS) + 0.5)) / total if total > 0.0 else SUB_BINS / 2
