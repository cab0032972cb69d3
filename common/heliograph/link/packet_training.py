"""The response learned from a stretch of slots whose bits nobody knows yet: Baum-Welch over two levels.

At lock the response (`heliograph.link.response`) is a guess; it learns from packets that were read, and a guess that is
too poor to read the first would stay one. But bits are a chain: with the slots' likelihoods l_i under the guess,

    gamma_i[x] = f_i-1[a] l_i[a, b] g_i[b] / sum        x = 2 a + b; f, g as in `heliograph.link.packet_soft`
    rate[x] <- (sum_i gamma_i[x] n_i + KEPT_SLOTS rate[x]) / (sum_i gamma_i[x] + KEPT_SLOTS)

a few times, the likelihoods taken anew under the new rates. A rise stays a rise, for the guess knows its polarity.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from heliograph.link import response
from heliograph.link.packet_soft import temper
from heliograph.link.packet_state import PacketState

# What the guess weighs, in slots of each pair of levels: a window of 64 bits holds 16 of each.
KEPT_SLOTS: Final = 1.0
# Events of a burst are no independent witnesses (all pixels see one edge, and a scan bunches them): no transition is
# believed more than so many, as in `heliograph.link.step_response`.
WITNESSES: Final = 10.0
# The fourth changes rates by a hundredth or so.
ROUNDS: Final = 4


@numba.njit(nogil=True)
def likelihoods(state: PacketState, at: int) -> None:
    """Set the tempered likelihoods of the slot at a place in the ring, under the rates as they are."""
    loglikelihood = np.empty(4)
    response.loglikelihoods(state.counts[at], state.logs, state.total, loglikelihood)
    loglikelihood /= max(1.0, state.figures[0] / WITNESSES)
    temper(loglikelihood, state.ring[at])


@numba.njit(nogil=True)
def relook(state: PacketState, first: int, n: int) -> None:
    """Take the tempered likelihoods of n slots anew, under the rates as they are."""
    size = state.ring.shape[0]
    for i in range(first, first + n):
        likelihoods(state, i % size)


@numba.njit(nogil=True)
def train(state: PacketState, first: int, n: int) -> None:
    """Learn the response from n slots; their tempered likelihoods are left as the new response has them."""
    size = state.ring.shape[0]
    forward = np.empty((n + 1, 2))
    total, weight, gamma = np.empty_like(state.model), np.empty(4), np.empty(4)
    for _ in range(ROUNDS):
        relook(state, first, n)
        forward[0] = 0.5
        for i in range(n):
            slot = state.ring[(first + i) % size]
            f0 = forward[i, 0] * slot[0] + forward[i, 1] * slot[2]
            f1 = forward[i, 0] * slot[1] + forward[i, 1] * slot[3]
            forward[i + 1, 0], forward[i + 1, 1] = f0 / (f0 + f1), f1 / (f0 + f1)
        for x in range(4):
            weight[x] = KEPT_SLOTS
            total[x] = KEPT_SLOTS * state.model[x]
        g0, g1 = 0.5, 0.5
        for i in range(n - 1, -1, -1):
            slot, counts = state.ring[(first + i) % size], state.counts[(first + i) % size]
            gamma[0], gamma[1] = forward[i, 0] * slot[0] * g0, forward[i, 0] * slot[1] * g1
            gamma[2], gamma[3] = forward[i, 1] * slot[2] * g0, forward[i, 1] * slot[3] * g1
            whole = gamma.sum()
            for x in range(4):
                share = gamma[x] / whole
                weight[x] += share
                if share > 0.001:
                    for p in range(2):
                        for k in range(counts.shape[1]):
                            total[x, p, k] += share * counts[p, k]
            g0, g1 = slot[0] * g0 + slot[1] * g1, slot[2] * g0 + slot[3] * g1
            whole = g0 + g1
            g0, g1 = g0 / whole, g1 / whole
        for x in range(4):
            state.model[x] = total[x] / weight[x]
        response.tabulate(state.model, state.logs, state.total, state.core, state.share, state.figures)
    relook(state, first, n)
