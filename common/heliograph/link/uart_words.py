"""Likelihoods of characters and of silence: numba kernels of the text receiver.

With l(g, c) the log-likelihood (nats) that a bit of context c begins at sub-bin g (`step_response`):

* a *character* w at g after the context b:  l_w(g) = sum_n l(g + slot_n, context of bit n of b w),
* a *free word*: the best of all 2^11 words at g, whatever its start, parity and stop bits; what it gains over the best
  character (the deficit) tells whether there is a character at all, and its bits why not,
* *any word*: the sum over all 2^11 words: what a character's likelihood is worth against random bits.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.step_response import NO_LOSS, Counts, Table, Tables
from heliograph.link.uart_layout import CHARACTER_BITS

Slots = npt.NDArray[np.int64]
Marks = npt.NDArray[np.int8]

NOWHERE: Final = -1e300

# What a path pays for a character that begins d sub-bins off its clock: (d / 2)^2 / 2 nats, at most d = 2 in a chain.
SLACK_SIGMA: Final = 2.0


@numba.njit(cache=True, nogil=True)
def bit_row(counts: Counts, at: int, tables: Tables, row: Table) -> None:
    """Fill row (32,) with l(at, c)."""
    log_rate, _, total, rest = tables
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
    if rest[2] != NO_LOSS:
        for c in range(contexts):
            if (c ^ (c >> 1)) & 1:
                row[c] = max(row[c] + rest[3], row[c ^ 1] + rest[2])


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
        word = (p << 1) | parity(p)
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
def parity(code: int) -> int:
    """Return whether an odd number of a character's data bits is 1."""
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
def any_word(counts: Counts, start: int, slots: Slots, before: int, tables: Tables) -> float:
    """Return the logarithm of the summed likelihoods of all 2^11 words that begin at start."""
    contexts = tables[2].shape[0]
    row = np.empty(contexts)
    old = np.full(contexts, NOWHERE)
    new = np.empty(contexts)
    old[before] = 0.0
    for n in range(slots.shape[0]):
        bit_row(counts, start + slots[n], tables, row)
        for c in range(contexts):
            a, b = old[c >> 1], old[(c >> 1) | (contexts >> 1)]
            top = max(a, b)
            new[c] = top + np.log1p(np.exp(min(a, b) - top)) + row[c]
        old, new = new, old
    top = old.max()
    total: float = top + np.log(np.exp(old - top).sum())
    return total


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
                bit_row(counts, start - reach + g, tables, rows[g])
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
        bit_row(counts, g, tables, row)
        calm = 0.0
        for j in range(rate.shape[0]):
            calm += (counts[g + j, 0] + counts[g + j, 1]) * quiet[0] - quiet[1]
        if row[idle - 1] > max(row[idle], calm):
            return g
    return stop


def slots_of(bit_bins: float) -> Slots:
    """Return (11,) int64: the sub-bins at which a character's bits begin, for bits of bit_bins sub-bins."""
    return np.round(np.arange(CHARACTER_BITS) * bit_bins).astype(np.int64)
