"""How a whole stretch is explained: numba kernels of the text receiver.

A stretch is explained by characters, idle time of any length, and junk (free bits, at a price): the path of highest
likelihood over sub-bins (dynamic programming). A character may follow another up to 1/8 bit early or late; after junk
it costs less where the characters before it would have gone on.

Most of the work is the search for characters, and most of what is heard is none. So a character that would end at g is
looked for only where it could matter: where the sum of its bits' likeliest contexts beats idle time and junk at g. That
changes nothing in the path, and leaves a third of the work in noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, cast

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link import uart_words
from heliograph.link.stamp import stamp
from heliograph.link.step_response import Counts, Table, Tables
from heliograph.link.uart_words import NOWHERE, SLACK_SIGMA, Slots, bit_row, parity

Line = npt.NDArray[np.float64]
Marks = npt.NDArray[np.int8]
Explain = Callable[[Counts, int, int, Slots, int, float, Tables, Slots], int]

IDLE: Final = -1
JUNK: Final = -2
ENTERED: Final = -1  # a chain of free bits begins after something else
FIRST: Final = -2  # a chain of free bits begins the stretch
IDLE_BITS: Final = 4  # from then on the LED has idled for longer than it is lit within any two characters' seam

CHAIN_SLACK: Final = 2  # how far off its clock a character may begin, in sub-bins
# What a free bit costs against a bit of a character (nats), and what leaving junk costs. A character's eleven bits
# hold four that are not free, 4 ln 2 / 11 = .25 nats a bit; four times that, since one broken character between two
# good ones should stay one broken character. Junk is rare (7 nats: once in a thousand characters); a lower price lets
# it slip off the bit grid wherever that fits the noise.
JUNK_BIT: Final = 1.0
LEAVE_JUNK: Final = 7.0
# Characters that followed each other at once go on at the same places after a broken one. Another place, one of the 176
# that a character can begin at, costs that prior, ln(176 / 9) = 3, and the odds of 50 to 1 that none was left out.
OTHER_PLACE: Final = 7.0
PLACE_SLACK: Final = 4.0  # how far off its place a character counts as being there: 9 sub-bins
# Sums in another order differ by less than this (1e6 nats hold 1e-10).
ROUNDING: Final = 1e-6


@numba.njit(nogil=True)
def _idle_bin(on: int, off: int, age: int, before: int, tables: Tables) -> float:
    """Return l of a sub-bin of idle time, age sub-bins after the bit of context `before`."""
    log_rate, rate, _, quiet = tables
    sub, contexts = rate.shape
    whole, part = age // sub, age % sub
    c = contexts - 1 if whole >= IDLE_BITS else ((before << (whole + 1)) | ((2 << whole) - 1)) & (contexts - 1)
    likelihood: float = on * log_rate[0, part, c] + off * log_rate[1, part, c] - rate[part, c]
    # What rings after a run of ones is learned from characters; after a longer time it is quieter still.
    calm: float = (on + off) * quiet[0] - quiet[1]
    return max(likelihood, calm) if whole >= IDLE_BITS else likelihood


@numba.njit(nogil=True)
def _extend_junk(rows: Table, g: int, sub: int, junk: Table, came: Marks) -> None:
    """Extend the chains of free bits that end at g by the bit [g, g + sub)."""
    half = rows.shape[1] >> 1
    for p in range(half):
        low, high = junk[g, p], junk[g, p | half]
        mark = high > low
        best = high if mark else low
        junk[g + sub, 2 * p] = best + rows[g, 2 * p] - JUNK_BIT
        junk[g + sub, 2 * p + 1] = best + rows[g, 2 * p + 1] - JUNK_BIT
        came[g + sub, 2 * p] = mark
        came[g + sub, 2 * p + 1] = mark


@numba.njit(nogil=True)
def _trace(n: int, c: int, sub: int, source: Slots, kind: Slots, came: Marks, path: Slots) -> int:
    """Fill path, in order of time, with the way to the chain of free bits that ends at n in context c."""
    steps = 0
    g, half = n, came.shape[1] >> 1
    in_junk = True
    while g > 0:
        if in_junk:
            if came[g, c] == FIRST:
                break
            if came[g, c] == ENTERED:
                in_junk = False
                continue
            c = (c >> 1) | (came[g, c] * half)
            g -= sub
            path[steps, 0], path[steps, 1] = g, JUNK
        elif kind[g] == JUNK:
            in_junk = True
            c = source[g]
            continue
        else:
            path[steps, 1] = kind[g]
            g = source[g]
            path[steps, 0] = g
        steps += 1
    for i in range(steps // 2):
        for k in range(2):
            path[i, k], path[steps - 1 - i, k] = path[steps - 1 - i, k], path[i, k]
    return steps


@numba.njit(nogil=True)
def _last(rows: Table, junk: Table, sub: int) -> tuple[int, int]:
    """Return where, and in which context, the best chain of free bits ends that leaves less than a bit over."""
    n = junk.shape[0] - 1
    spare = rows[n - sub].max() - JUNK_BIT
    best, last, context = NOWHERE, n, 0
    for g in range(n - sub + 1, n + 1):
        c = junk[g].argmax()
        value = junk[g, c] + spare * (n - g) / sub
        if value > best:
            best, last, context = value, g, c
    return last, context


@numba.njit(nogil=True)
def _rows(counts: Counts, start: int, n: int, tables: Tables) -> Table:
    rows = np.empty((n, tables[2].shape[0]))
    for g in range(n):
        bit_row(counts, start + g, tables, rows[g])
    return rows


@numba.njit(nogil=True)
def _best_bits(rows: Table) -> Table:
    """Return (n, 3): of each row the largest l of all contexts, of those that end in 1, of those that end in 1 1."""
    best = np.empty((rows.shape[0], 3))
    for g in range(rows.shape[0]):
        dark = lit = longer = NOWHERE
        for c in range(0, rows.shape[1], 4):
            dark = max(dark, rows[g, c], rows[g, c + 2])
            lit = max(lit, rows[g, c + 1])
            longer = max(longer, rows[g, c + 3])
        lit = max(lit, longer)
        best[g, 0], best[g, 1], best[g, 2] = max(dark, lit), lit, longer
    return best


@numba.njit(nogil=True)
def _merge(row: Table, old: Table, old_word: Slots, new: Table, new_word: Slots) -> None:
    """Extend words of at least five data bits by one; of those that share parity and last four bits keep the likeliest.

    Words are numbered 16 parity + last four bits.
    """
    for bit in range(2):
        for odd in range(2):
            for m in range(8):
                low, high = 16 * (odd ^ bit) + m, 16 * (odd ^ bit) + 8 + m
                a, b = old[low] + row[2 * m + bit], old[high] + row[16 + 2 * m + bit]
                take = high if b > a or (b == a and old_word[high] < old_word[low]) else low
                to = 16 * odd + 2 * m + bit
                new[to] = max(a, b)
                new_word[to] = 2 * old_word[take] + bit


@numba.njit(nogil=True)
def _likeliest(rows: Table, at: int, slots: Slots, before: int, score: Table, words: Slots) -> tuple[int, float]:
    """Return code and l of `_best_character`.

    What a bit looks like depends on the four before it, and the last three depend on nothing else but the parity: of
    words that share both only the likeliest goes on. Of equal ones it is the lowest.

    Args:
        rows: l by sub-bin and context.
        at: sub-bin of the start bit.
        slots: (11,) offsets of the bits.
        before: context of the bit before.
        score: (2, 32) space to work in.
        words: (2, 32) space to work in.
    """
    mask = rows.shape[1] - 1
    tree = score[0]
    tree[0] = rows[at, (before << 1) & mask]
    for n in range(1, 6):
        row = rows[at + slots[n]]
        for p in range((1 << n) - 1, -1, -1):
            tree[p] = tree[p >> 1] + row[((before << (n + 1)) | p) & mask]
    for p in range(32):
        to = 16 * parity(p) + (p & 15)
        score[1, to] = tree[p]
        words[1, to] = p
    _merge(rows[at + slots[6]], score[1], words[1], score[0], words[0])
    _merge(rows[at + slots[7]], score[0], words[0], score[1], words[1])
    best = NOWHERE
    code = 0
    checked, stop, last = rows[at + slots[8]], rows[at + slots[9]], rows[at + slots[10]]
    for state in range(32):
        word = 2 * (state & 15) + (state >> 4)
        s = score[1, state] + checked[word] + stop[(2 * word + 1) & mask] + last[(4 * word + 3) & mask]
        if s > best or (s == best and words[1, state] < code):
            best, code = s, words[1, state]
    return code, best


@numba.njit(nogil=True)
def _bound(rows: Table, likely: Table, at: int, slots: Slots, before: int) -> float:
    """Return what no character that begins at `at` exceeds: of each bit the likeliest of its contexts."""
    most: float = rows[at, (before << 1) & (rows.shape[1] - 1)] + likely[at + slots[9], 1] + likely[at + slots[10], 2]
    for n in range(1, 9):
        most += likely[at + slots[n], 0]
    return most + ROUNDING


# The two that follow are called at every sub-bin; calls that pass so many arrays cost half as much again.
@numba.njit(nogil=True, inline="always")
def _lead(context: int, age: int, sub: int, contexts: int) -> int:
    """Return the context of the last bit of idle time, age sub-bins after the bit of `context`."""
    ones = min(age // sub, IDLE_BITS)
    return contexts - 1 if ones == IDLE_BITS else ((context << ones) | ((1 << ones) - 1)) & (contexts - 1)


@numba.njit(nogil=True, inline="always")
def _character_to(
    g: int, otherwise: float, rows: Table, slots: Slots, value: Line, bound: Line, leads: Slots, codes: Slots,
    score: Table, words: Slots,
) -> tuple[float, int]:  # fmt: skip
    """Return the best value of a character that ends at g, and where it begins; NOWHERE if it is not above otherwise.

    Args:
        g: sub-bin.
        otherwise: what else ends there.
        rows: l by sub-bin and context.
        slots: (11,) offsets of the bits.
        value: (n + 1,) of the best path to each sub-bin before g.
        bound: (n + 1,) of a character that begins there, with its way; from when codes is set, its own value.
        leads: (n + 1,) context of the bit before what begins there.
        codes: (n + 1,) the character that begins there; -1: not looked at.
        score: (2, 32) space to work in.
        words: (2, 32) space to work in.
    """
    length = round((slots[-1] * slots.shape[0]) / (slots.shape[0] - 1.0))
    best, at = NOWHERE, 0
    for a in range(max(g - length - CHAIN_SLACK, 0), g - length + CHAIN_SLACK + 1):
        slack = 0.5 * ((g - a - length) / SLACK_SIGMA) ** 2
        if bound[a] == NOWHERE or bound[a] - slack < max(otherwise, best):
            continue
        if codes[a] < 0:
            codes[a], likelihood = _likeliest(rows, a, slots, leads[a], score, words)
            bound[a] = value[a] + likelihood
        if bound[a] - slack > best:
            best, at = bound[a] - slack, a
    return best, at


@numba.njit(nogil=True)
def _leave(g: int, place: float, length: float) -> float:
    """Return what it costs to leave junk at g, where characters would begin at place + k length; place may be nan."""
    if np.isnan(place):
        return LEAVE_JUNK
    off = (g - place) % length
    return LEAVE_JUNK if min(off, length - off) <= PLACE_SLACK else LEAVE_JUNK + OTHER_PLACE


@numba.njit(nogil=True)
def _explain(
    counts: Counts, start: int, n: int, slots: Slots, before: int, place: float, tables: Tables, path: Slots
) -> int:
    sub, contexts = tables[1].shape
    length = slots[-1] * slots.shape[0] / (slots.shape[0] - 1.0)
    rows = _rows(counts, start, n - sub + 1, tables)
    likely = _best_bits(rows)
    value = np.full(n + 1, NOWHERE)  # of the best path on which a character, idle time or junk ends here
    source = np.zeros(n + 1, np.int64)  # where that began; for junk, the context in which it ends
    kind = np.full(n + 1, IDLE)
    context = np.full(n + 1, contexts - 1)  # of the bit before the idle time
    age = np.zeros(n + 1, np.int64)  # sub-bins of idle time
    leads, codes, bound = np.zeros(n + 1, np.int64), np.full(n + 1, -1), np.full(n + 1, NOWHERE)  # _character_to
    junk = np.full((n + 1, contexts), NOWHERE)
    came = np.full((n + 1, contexts), ENTERED, np.int8)
    score, words = np.empty((2, 32)), np.empty((2, 32), np.int64)
    value[0] = 0.0
    if before < 0:
        junk[:sub] = 0.0
        came[:sub] = FIRST
    else:
        context[0] = before
    for g in range(n + 1):
        best = junk[g].argmax()
        left, a = junk[g, best] - _leave(g, place, length), g - 1
        idle = NOWHERE
        if g > 0 and value[a] != NOWHERE:
            idle = value[a] + _idle_bin(counts[start + a, 0], counts[start + a, 1], age[a], context[a], tables)
        after, at = _character_to(g, max(idle, left), rows, slots, value, bound, leads, codes, score, words)
        if after > value[g]:
            value[g], source[g], kind[g] = after, at, codes[at]
            context[g] = ((codes[at] << 3) | (parity(codes[at]) << 2) | 3) & (contexts - 1)
        if idle > value[g]:
            value[g], source[g], kind[g] = idle, a, IDLE
            context[g], age[g] = context[a], min(age[a] + 1, (IDLE_BITS + 1) * sub)
        if left > value[g]:
            value[g], source[g], kind[g], context[g], age[g] = left, best, JUNK, best, 0
        b = _lead(context[g], age[g], sub, contexts)
        if value[g] > junk[g, b]:
            junk[g, b], came[g, b] = value[g], ENTERED
        if g + sub <= n:
            _extend_junk(rows, g, sub, junk, came)
        if value[g] != NOWHERE and g + slots[-1] + sub <= n:
            leads[g] = b
            bound[g] = value[g] + _bound(rows, likely, g, slots, b)
    last, c = _last(rows, junk, sub)
    return _trace(last, c, sub, source, kind, came, path)


def _entry(sources: int) -> Explain:
    @numba.njit(cache=True, nogil=True)
    def kernel(
        counts: Counts, start: int, n: int, slots: Slots, before: int, place: float, tables: Tables, path: Slots
    ) -> int:
        return _explain(counts, start, n, slots, before, place, tables, path) if sources >= 0 else 0

    return cast("Explain", kernel)


_KERNEL: Final = _entry(stamp(uart_words))


def explain(
    counts: Counts, start: int, n: int, slots: Slots, before: int, tables: Tables, path: Slots, place: float = np.nan
) -> int:
    """Explain the sub-bins [start, start + n) by characters, idle time and junk (a chain of free bits).

    Args:
        counts: (m, 2) int32.
        start: row of counts.
        n: at least 16.
        slots: (11,) offsets of a character's bits.
        before: context of the bit before start; -1 if nothing is known, not even where a bit begins.
        tables: the response (`StepResponse.tables`).
        path: (n, 2) filled with (sub-bin, code or IDLE or JUNK), one entry a character, a sub-bin of idle time or a
            bit of junk, in order of time. A last part of a bit is left out, and a first one if before is -1.
        place: a sub-bin, from start, at which a character would begin had none been broken; nan where that is unknown.

    Returns:
        The number of entries.
    """
    return int(_KERNEL(counts, start, n, slots, before, place, tables, path))
