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
    contexts = rows.shape[1]
    for c in range(contexts):
        low, high = c >> 1, (c >> 1) | (contexts >> 1)
        source = high if junk[g, high] > junk[g, low] else low
        if junk[g, source] > NOWHERE:
            junk[g + sub, c] = junk[g, source] + rows[g, c] - JUNK_BIT
            came[g + sub, c] = 1 if source == high else 0


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
def explain(counts: Counts, start: int, n: int, slots: Slots, before: int, tables: Tables, path: Slots) -> int:
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

    Returns:
        The number of entries.
    """
    sub, contexts = tables[1].shape
    rows = _rows(counts, start, n - sub + 1, tables)
    value = np.full(n + 1, NOWHERE)  # of the best path on which a character, idle time or junk ends here
    source = np.zeros(n + 1, np.int64)  # where that began; for junk, the context in which it ends
    kind = np.full(n + 1, IDLE)
    context = np.full(n + 1, contexts - 1)  # of the bit before the idle time
    age = np.zeros(n + 1, np.int64)  # sub-bins of idle time
    junk = np.full((n + 1, contexts), NOWHERE)
    came = np.full((n + 1, contexts), ENTERED, np.int8)
    score = np.empty(128)
    value[0] = 0.0
    if before < 0:
        junk[:sub] = 0.0
        came[:sub] = FIRST
    else:
        context[0] = before
    length = round((slots[-1] * slots.shape[0]) / (slots.shape[0] - 1.0))
    for g in range(n + 1):
        best = junk[g].argmax()
        if junk[g, best] - LEAVE_JUNK > value[g]:
            value[g], source[g], kind[g], context[g], age[g] = junk[g, best] - LEAVE_JUNK, best, JUNK, best, 0
        ones = min(age[g] // sub, IDLE_BITS)
        b = contexts - 1 if ones == IDLE_BITS else ((context[g] << ones) | ((1 << ones) - 1)) & (contexts - 1)
        if value[g] > junk[g, b]:
            junk[g, b], came[g, b] = value[g], ENTERED
        if g + sub <= n:
            _extend_junk(rows, g, sub, junk, came)
        if g == n or value[g] == NOWHERE:
            continue
        after = value[g] + _idle_bin(counts[start + g, 0], counts[start + g, 1], age[g], context[g], tables)
        if after > value[g + 1]:
            value[g + 1], source[g + 1], kind[g + 1] = after, g, IDLE
            context[g + 1], age[g + 1] = context[g], min(age[g] + 1, (IDLE_BITS + 1) * sub)
        if g + slots[-1] + sub > n:
            continue
        code, likelihood, _ = _best_character(rows, g, slots, b, score)
        for end in range(g + length - CHAIN_SLACK, min(g + length + CHAIN_SLACK, n) + 1):
            after = value[g] + likelihood - 0.5 * ((end - g - length) / SLACK_SIGMA) ** 2
            if after > value[end]:
                value[end], source[end], kind[end], age[end] = after, g, code, 0
                context[end] = ((code << 3) | (_parity(code) << 2) | 3) & (contexts - 1)
    last, c = _last(rows, junk, sub)
    return _trace(last, c, sub, source, kind, came, path)


def slots_of(bit_bins: float) -> Slots:
    """Return (11,) int64: the sub-bins at which a character's bits begin, for bits of bit_bins sub-bins."""
    return np.round(np.arange(CHARACTER_BITS) * bit_bins).astype(np.int64)
