"""Which word was it? Maximum likelihood over the words of the code, and how sure.

Slots. The Poisson likelihoods of a slot (`heliograph.link.response`) trust the model too much: whole transitions get
lost (occlusion, a full bus) and bursts come from elsewhere. So each becomes a mixture, and a floor bounds what a single
slot can say::

    l_dark, l_lit differ by no more than LEVEL
    l_edge <- (1 - MISSED) l_edge + MISSED mean(l_dark, l_lit)
    l_flat <- (1 - SPURIOUS) l_flat + SPURIOUS mean(l_rise, l_fall)
    l_x    <- max(l_x / max_y l_y, FLOOR)

Words. A frame of bits b_0 .. b_n-1 has n + 1 slots; the bits before and after it are unknown (another frame, perhaps
with another payload), so both are averaged over. w_1 is one half, or NEXT where every frame begins with a one: the next
frame's start is the protocol's, not another payload's::

    L(b) = mean_a l_0[a, b_0] * prod_i=1..n-1 l_i[b_i-1, b_i] * sum_a w_a l_n[b_n-1, a]

A LED that moves shows its level, and does so no more where it turns: for many slots at once, which no mixture of single
slots allows. So where a slot looks dark rather than lit, a word's likelihood is that of a light that goes on moving, or
(AT_REST) of one at rest for this frame, whose lit slots are as the dark ones::

    L(b) <- (1 - AT_REST) L(b) + AT_REST L(b | l_lit = l_dark)

Sureness. Either a frame of the code was sent, each word as likely (prior 1 - OTHER), or n arbitrary bits (OTHER)::

    score = (1 - OTHER) / W L(best) / ((1 - OTHER) / W sum_w L(w) + OTHER / 2^n Z)       Z = sum over all 2^n bits

It is the probability that the best word is right. A flipped bit that is clearly seen loses against Z, so distance 2
detects it; with distance 4, the likelihood corrects it.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.clock import Floats

# One transition in a hundred is lost whole, one slot in a thousand holds a burst that is none: what a sensor near its
# limit does. Ten times more of either costs under one decibel; ten times less lets one slot overrule a frame.
MISSED: Final = 0.01
SPURIOUS: Final = 0.001
# The level alone (a lit LED that moves makes events, a dark one none) says at most 3 nats a slot: motion may cease.
LEVEL: Final = 0.05
# One frame in fifty of a light that moves is at a turn; the value hardly matters: there a word with five lit pairs of
# bits loses 15 nats without it, 4 with it.
AT_REST: Final = 0.02
# A slot says that nothing moves where dark is so much likelier than lit; the learned levels of a light at rest differ
# by less.
RESTS: Final = 0.5
# exp(-10): two slots of contrary evidence are never outweighed by one more.
FLOOR: Final = 4.5e-5
# A tenth of all windows that reach a decision are no frame of this code (foreign light, a wrong alignment).
OTHER: Final = 0.1
# A beacon sends frame after frame; one in twenty is followed by darkness.
NEXT: Final = 0.95
# Below this share of the best word's likelihood a word no longer matters to the sum (522 words: 5e-5 of it).
NEGLIGIBLE: Final = 1e-7

BEST: Final = 0  # columns of a verdict: the payload
SCORE: Final = 1
MARGIN: Final = 2  # nats to the runner-up
EVIDENCE: Final = 3  # nats for a frame here against arbitrary bits here
VERDICT_FIELDS: Final = 4


@numba.njit(nogil=True)
def slot(loglikelihood: Floats, out: Floats) -> None:
    """Set out (4,) to the slot's tempered likelihoods, the largest 1."""
    top = max(loglikelihood[0], loglikelihood[1], loglikelihood[2], loglikelihood[3])
    dark, rise = np.exp(loglikelihood[0] - top), np.exp(loglikelihood[1] - top)
    fall, lit = np.exp(loglikelihood[2] - top), np.exp(loglikelihood[3] - top)
    dark, lit = max(dark, LEVEL * lit), max(lit, LEVEL * dark)
    flat, edge = 0.5 * (dark + lit), 0.5 * (rise + fall)
    out[0] = (1.0 - SPURIOUS) * dark + SPURIOUS * edge
    out[1] = (1.0 - MISSED) * rise + MISSED * flat
    out[2] = (1.0 - MISSED) * fall + MISSED * flat
    out[3] = (1.0 - SPURIOUS) * lit + SPURIOUS * edge
    top = max(out[0], out[1], out[2], out[3])
    for x in range(4):
        out[x] = max(out[x] / top, FLOOR)


@numba.njit(nogil=True)
def decide(ring: Floats, first: int, words: npt.NDArray[np.uint8], next_one: float, verdict: Floats) -> None:
    """Decide the frame whose first slot is `first` (mod the ring's length).

    Args:
        ring: (slots, 4) tempered likelihoods.
        first: index of the slot of the frame's beginning.
        words: (W, n) bits.
        next_one: w_1.
        verdict: (VERDICT_FIELDS,) out.
    """
    size = ring.shape[0]
    count, n = words.shape
    opening, closing = ring[first % size], ring[(first + n) % size]
    begin0, begin1 = 0.5 * (opening[0] + opening[2]), 0.5 * (opening[1] + opening[3])
    end0 = (1.0 - next_one) * closing[0] + next_one * closing[1]
    end1 = (1.0 - next_one) * closing[2] + next_one * closing[3]
    rest_begin1, rest_end1 = 0.5 * (opening[1] + opening[0]), (1.0 - next_one) * closing[2] + next_one * closing[0]
    rest = _rests(ring, first, n)
    best, runner_up, total, which = 0.0, 0.0, 0.0, 0
    for w in range(count):
        word = words[w]
        likelihood = (1.0 - rest) * (begin1 if word[0] else begin0)
        resting = rest * (rest_begin1 if word[0] else begin0)
        for i in range(1, n):
            x = 2 * word[i - 1] + word[i]
            likelihood *= ring[(first + i) % size, x]
            resting *= ring[(first + i) % size, x if x < 3 else 0]
            if likelihood + resting < NEGLIGIBLE * best:
                break
        likelihood *= end1 if word[n - 1] else end0
        likelihood += resting * (rest_end1 if word[n - 1] else end0)
        total += likelihood
        if likelihood > best:
            best, runner_up, which = likelihood, best, w
        elif likelihood > runner_up:
            runner_up = likelihood
    any0, any1 = (1.0 - rest) * begin0, (1.0 - rest) * begin1
    rest0, rest1 = rest * begin0, rest * rest_begin1
    for i in range(1, n):
        x = ring[(first + i) % size]
        any0, any1 = any0 * x[0] + any1 * x[2], any0 * x[1] + any1 * x[3]
        rest0, rest1 = rest0 * x[0] + rest1 * x[2], rest0 * x[1] + rest1 * x[0]
    anything = (any0 * end0 + any1 * end1 + rest0 * end0 + rest1 * rest_end1) / 2.0**n
    verdict[BEST] = which
    verdict[SCORE] = (1.0 - OTHER) / count * best / ((1.0 - OTHER) / count * total + OTHER * anything)
    verdict[MARGIN] = np.log(best / max(runner_up, NEGLIGIBLE * best))
    verdict[EVIDENCE] = np.log(total / count / anything)


@numba.njit(nogil=True)
def _rests(ring: Floats, first: int, n: int) -> float:
    """Return the prior of a light at rest in a frame: 0 where no slot looks like it."""
    size = ring.shape[0]
    for i in range(n + 1):
        if ring[(first + i) % size, 3] < RESTS * ring[(first + i) % size, 0]:
            return AT_REST
    return 0.0


@numba.njit(nogil=True)
def plain_bits(ring: Floats, first: int, n: int) -> tuple[int, float]:
    """Return the most likely n bits of any kind, as a word, and their share of all likelihood (Viterbi)."""
    size = ring.shape[0]
    came = np.zeros((n, 2), np.uint8)
    opening, closing = ring[first % size], ring[(first + n) % size]
    top0, top1 = 0.5 * (opening[0] + opening[2]), 0.5 * (opening[1] + opening[3])
    any0, any1 = top0, top1
    for i in range(1, n):
        x = ring[(first + i) % size]
        any0, any1 = any0 * x[0] + any1 * x[2], any0 * x[1] + any1 * x[3]
        if top1 * x[2] > top0 * x[0]:
            came[i, 0] = 1
        if top1 * x[3] > top0 * x[1]:
            came[i, 1] = 1
        top0, top1 = max(top0 * x[0], top1 * x[2]), max(top0 * x[1], top1 * x[3])
    end0, end1 = 0.5 * (closing[0] + closing[1]), 0.5 * (closing[2] + closing[3])
    bit = 1 if top1 * end1 > top0 * end0 else 0
    share = max(top0 * end0, top1 * end1) / (any0 * end0 + any1 * end1)
    word = 0
    for i in range(n - 1, -1, -1):
        word |= bit << (n - 1 - i)
        bit = came[i, bit]
    return word, share
