"""Likelihoods of characters, of silence, and of a whole stretch: the numba kernels of the text receiver.

With l(g, c) the log-likelihood (nats) that a bit of context c begins at sub-bin g (`step_response`):

* a *character* w at g after the context b:  l_w(g) = sum_n l(g + slot_n, context of bit n of b w),
* a *free word*: the best of all 2^11 words at g, whatever its start, parity and stop bits; what it gains over the best
  character (the deficit) tells whether there is a character at all, and its bits why not,
* a *stretch* is explained by characters, idle time of any length, and junk (free bits, at a price): the path of
  highest likelihood over sub-bins (dynamic programming). A character may follow another up to 1/8 bit early or late.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.step_response import Counts, Table, Tables
from heliograph.link.uart_layout import CHARACTER_BITS

Slots = npt.NDArray[np.int64]
Marks = npt.NDArray[np.int8]

IDLE: Final = -1
JUNK: Final = -2
NOWHERE: Final = -1e300
ENTERED: Final = -1  # a chain of free bits begins after something else
FIRST: Final = -2  # a chain of free bits begins the stretch
IDLE_BITS: Final = 4  # from then on the LED has idled for longer than it is lit within any two characters' seam

# What a path pays for a character that begins d sub-bins off its clock: (d / 2)^2 / 2 nats, at most d = 2 in a chain.
SLACK_SIGMA: Final = 2.0
CHAIN_SLACK: Final = 2
# What a free bit costs against a bit of a character (nats), and what leaving junk costs. A character's eleven bits
# hold four that are not free, 4 ln 2 / 11 = .25 nats a bit; four times that, since one broken character between two
# good ones should stay one broken character. Junk is rare (7 nats: once in a thousand characters); a lower price lets
# it slip off the bit grid wherever that fits the noise.
JUNK_BIT: Final = 1.0
LEAVE_JUNK: Final = 7.0
# Sums in another order differ by less than this (1e6 nats hold 1e-10).
ROUNDING: Final = 1e-6


@numba.njit(cache=True, nogil=True)
def _bit_row(counts: Counts, at: int, tables: Tables, row: Table) -> None:
    """Fill row (32,) with l(at, c)."""
    log_rate, _, total, _ = tables
    contexts = total.shape[0]
    for c in range(contexts):
        row[c] = -total[c]
    for j in range(log_rate.shape[1]):
        on, off = counts[at + j, 0], counts[at + j, 1]
        if on:
            for c in range(contexts):
                row[c] += on * log_rate[0, j, c]
        if off:
            for c in range(contexts):
                row[c] += off * log_rate[1, j, c]


@numba.njit(cache=True, nogil=True)
def _best_character(rows: Table, at: int, slots: Slots, before: int, score: Table) -> tuple[int, float, float]:
    """Return the likeliest character whose bits are rows[at + slots[n]]: code, l, and l of the runner-up."""
    mask = rows.shape[1] - 1
    score[0] = rows[at, (before << 1) & mask]
    for n in range(1, 8):
        row = rows[at + slots[n]]
        for p in range((1 << n) - 1, -1, -1):
            score[p] = score[p >> 1] + row[((before << (n + 1)) | p) & mask]
    best = second = NOWHERE
    code = 0
    for p in range(128):
        word = (p << 1) | _parity(p)
        s = score[p] + rows[at + slots[8], word & mask]
        word = (word << 1) | 1
        s += rows[at + slots[9], word & mask]
        s += rows[at + slots[10], ((word << 1) | 1) & mask]
        if s > best:
            second = best
            best = s
            code = p
        elif s > second:
            second = s
    return code, best, second


@numba.njit(cache=True, nogil=True)
def _parity(code: int) -> int:
    return (code ^ (code >> 1) ^ (code >> 2) ^ (code >> 3) ^ (code >> 4) ^ (code >> 5) ^ (code >> 6)) & 1


@numba.njit(cache=True, nogil=True)
def _free_word(rows: Table, at: int, slots: Slots, before: int) -> tuple[float, int]:
    """Return the likeliest word of all, by the Viterbi algorithm over contexts: l and its bits."""
    contexts = rows.shape[1]
    old = np.full(contexts, NOWHERE)
    old_word = np.zeros(contexts, np.int64)
    new = np.empty(contexts)
    new_word = np.zeros(contexts, np.int64)
    old[before] = 0.0
    for n in range(slots.shape[0]):
        row = rows[at + slots[n]]
        for c in range(contexts):
            low, high = c >> 1, (c >> 1) | (contexts >> 1)
            source = low if old[low] >= old[high] else high
            new[c] = old[source] + row[c]
            new_word[c] = ((old_word[source] << 1) | (c & 1)) & 0x7FF
        old, new = new, old
        old_word, new_word = new_word, old_word
    best = old.argmax()
    return old[best], old_word[best]


@numba.njit(cache=True, nogil=True)
def near(
    counts: Counts, start: int, reach: int, slots: Slots, before: int, tables: Tables
) -> tuple[int, int, float, float, float, int, float]:
    """Find the likeliest character that begins within reach sub-bins of start.

    Reads counts from start - reach to start + reach + slots[10] + 16.

    Returns:
        Its offset d from start, its code, l, l of the runner-up, l of the free word there, the free word's bits, and
        d refined by a parabola through the neighbours.
    """
    span = 2 * reach + 1
    rows = np.empty((span + slots[-1], tables[2].shape[0]))
    done = np.zeros(span + slots[-1], np.bool_)
    score = np.empty(128)
    value = np.empty(span)
    best = NOWHERE
    at = code = 0
    likelihood = second = NOWHERE
    for d in range(span):
        for n in range(slots.shape[0]):
            g = d + slots[n]
            if not done[g]:
                _bit_row(counts, start - reach + g, tables, rows[g])
                done[g] = True
        c, s, r = _best_character(rows, d, slots, before, score)
        value[d] = s - 0.5 * ((d - reach) / SLACK_SIGMA) ** 2
        if value[d] > best:
            best, at, code, likelihood, second = value[d], d, c, s, r
    free, word = _free_word(rows, at, slots, before)
    refined = float(at - reach)
    if 0 < at < span - 1:
        curve = value[at - 1] - 2 * value[at] + value[at + 1]
        if curve < 0.0:
            refined += 0.5 * (value[at - 1] - value[at + 1]) / curve
    return at - reach, code, likelihood, second, free, word, refined


@numba.njit(cache=True, nogil=True)
def skip_idle(counts: Counts, start: int, stop: int, tables: Tables) -> int:
    """Return the first sub-bin in [start, stop) at which a start bit is likelier than idling on; stop if none is.

    Reads counts up to stop + 15.
    """
    _, rate, total, quiet = tables
    row = np.empty(total.shape[0])
    idle = total.shape[0] - 1
    for g in range(start, stop):
        _bit_row(counts, g, tables, row)
        calm = 0.0
        for j in range(rate.shape[0]):
            calm += (counts[g + j, 0] + counts[g + j, 1]) * quiet[0] - quiet[1]
        if row[idle - 1] > max(row[idle], calm):
            return g
    return stop


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
def _rows(counts: Counts, start: int, n: int, tables: Tables) -> Table:
    rows = np.empty((n, tables[2].shape[0]))
    for g in range(n):
        _bit_row(counts, start + g, tables, rows[g])
    return rows


@numba.njit(cache=True, nogil=True)
def _best_bits(rows: Table) -> Table:
    """Return (n, 3): of each row the largest l of all contexts, of those that end in 1, and of those that end in 1 1."""
    best = np.empty((rows.shape[0], 3))
    for g in range(rows.shape[0]):
        dark = lit = longer = NOWHERE
        for c in range(0, rows.shape[1], 4):
            dark = max(dark, max(rows[g, c], rows[g, c + 2]))
            lit = max(lit, rows[g, c + 1])
            longer = max(longer, rows[g, c + 3])
        lit = max(lit, longer)
        best[g, 0], best[g, 1], best[g, 2] = max(dark, lit), lit, longer
    return best


@numba.njit(cache=True, nogil=True)
def _merge(row: Table, old: Table, old_word: Slots, new: Table, new_word: Slots) -> None:
    """Extend words of at least five data bits by one; of those that share parity and last four bits keep the likeliest.

    Words are numbered 16 parity + last four bits.
    """
    for bit in range(2):
        for parity in range(2):
            for m in range(8):
                low, high = 16 * (parity ^ bit) + m, 16 * (parity ^ bit) + 8 + m
                a, b = old[low] + row[2 * m + bit], old[high] + row[16 + 2 * m + bit]
                take = high if b > a or (b == a and old_word[high] < old_word[low]) else low
                to = 16 * parity + 2 * m + bit
                new[to] = max(a, b)
                new_word[to] = 2 * old_word[take] + bit


@numba.njit(cache=True, nogil=True)
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
        to = 16 * _parity(p) + (p & 15)
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


@numba.njit(cache=True, nogil=True)
def _bound(rows: Table, likely: Table, at: int, slots: Slots, before: int) -> float:
    """Return what no character that begins at `at` exceeds: of each bit the likeliest of its contexts."""
    most = rows[at, (before << 1) & (rows.shape[1] - 1)] + likely[at + slots[9], 1] + likely[at + slots[10], 2]
    for n in range(1, 9):
        most += likely[at + slots[n], 0]
    return most + ROUNDING


@numba.njit(cache=True, nogil=True)
def explain(counts: Counts, start: int, n: int, slots: Slots, before: int, tables: Tables, path: Slots) -> int:
    """Explain the sub-bins [start, start + n) by characters, idle time and junk (a chain of free bits).

    A character is looked for only where it could matter: a bound on its likelihood (of each bit the likeliest context)
    must beat the other ways to its end. That changes nothing in the path.

    Args:
        counts: (m, 2) int32.
        start: row of counts.
        n: at least 16.
        slots: (11,) offsets of a character's bits.
        before: context of the bit before start; -1 if nothing is known, not even where a bit begins.
        tables: the response (`StepResponse.tables`).
        path: (n, 2) filled with (sub-bin, code or IDLE or JUNK), one entry a character, a sub-bin of idle time or a
            bit of junk, in order of time. A last part of a bit is left out, and a first one if before is -1.

    Returns:
        The number of entries.
    """
    sub, contexts = tables[1].shape
    rows = _rows(counts, start, n - sub + 1, tables)
    likely = _best_bits(rows)
    value = np.full(n + 1, NOWHERE)  # of the best path on which a character, idle time or junk ends here
    source = np.zeros(n + 1, np.int64)  # where that began; for junk, the context in which it ends
    kind = np.full(n + 1, IDLE)
    context = np.full(n + 1, contexts - 1)  # of the bit before the idle time
    age = np.zeros(n + 1, np.int64)  # sub-bins of idle time
    leads = np.zeros(n + 1, np.int64)  # context of the bit before whatever begins here
    bound = np.full(n + 1, NOWHERE)  # of a character that begins here, with its way up to here; later the character's
    codes = np.full(n + 1, -1)  # the character that begins here; -1: not looked at
    junk = np.full((n + 1, contexts), NOWHERE)
    came = np.full((n + 1, contexts), ENTERED, np.int8)
    score, words = np.empty((2, 32)), np.empty((2, 32), np.int64)
    value[0] = 0.0
    if before < 0:
        junk[:sub] = 0.0
        came[:sub] = FIRST
    else:
        context[0] = before
    length = round((slots[-1] * slots.shape[0]) / (slots.shape[0] - 1.0))
    for g in range(n + 1):
        best = junk[g].argmax()
        otherwise = junk[g, best] - LEAVE_JUNK
        idle = NOWHERE
        if g > 0 and value[g - 1] != NOWHERE:
            a = g - 1
            idle = value[a] + _idle_bin(counts[start + a, 0], counts[start + a, 1], age[a], context[a], tables)
            otherwise = max(otherwise, idle)
        for a in range(max(g - length - CHAIN_SLACK, 0), g - length + CHAIN_SLACK + 1):
            slack = 0.5 * ((g - a - length) / SLACK_SIGMA) ** 2
            if bound[a] - slack < max(otherwise, value[g]):
                continue
            if codes[a] < 0:
                codes[a], likelihood = _likeliest(rows, a, slots, leads[a], score, words)
                bound[a] = value[a] + likelihood
            after = bound[a] - slack
            if after > value[g]:
                value[g], source[g], kind[g], age[g] = after, a, codes[a], 0
                context[g] = ((codes[a] << 3) | (_parity(codes[a]) << 2) | 3) & (contexts - 1)
        if idle > value[g]:
            value[g], source[g], kind[g] = idle, g - 1, IDLE
            context[g], age[g] = context[g - 1], min(age[g - 1] + 1, (IDLE_BITS + 1) * sub)
        if junk[g, best] - LEAVE_JUNK > value[g]:
            value[g], source[g], kind[g], context[g], age[g] = junk[g, best] - LEAVE_JUNK, best, JUNK, best, 0
        ones = min(age[g] // sub, IDLE_BITS)
        b = contexts - 1 if ones == IDLE_BITS else ((context[g] << ones) | ((1 << ones) - 1)) & (contexts - 1)
        if value[g] > junk[g, b]:
            junk[g, b], came[g, b] = value[g], ENTERED
        if g + sub <= n:
            _extend_junk(rows, g, sub, junk, came)
        if value[g] != NOWHERE and g + slots[-1] + sub <= n:
            leads[g] = b
            bound[g] = value[g] + _bound(rows, likely, g, slots, b)
    last, c = _last(rows, junk, sub)
    return _trace(last, c, sub, source, kind, came, path)


def slots_of(bit_bins: float) -> Slots:
    """Return (11,) int64: the sub-bins at which a character's bits begin, for bits of bit_bins sub-bins."""
    return np.round(np.arange(CHARACTER_BITS) * bit_bins).astype(np.int64)
