"""What one scan of a scanned sensor shows, by where it lies in its bit and by four bits.

A scan that ends at t_j shows what the light has done since the scan before. An edge's burst goes on for several scans
(a pixel that falls is slow), often for more than a bit, and what a rise shows depends on how far the pixels had come
down. So the counts n_p of scan j, which lies at sub-bin k of the slot about the boundary between bits c and d, depend
on the two bits before these too, x = 8 a + 4 b + 2 c + d::

    n_p ~ Poisson(rate[x, p, k])                 of a scan at k, not of a sub-bin: a scan without events says something
    log L_x = 1/F sum_j,p (n_p log(rate[x, p, k_j] + stray) - rate[x, p, k_j] - stray)

F, at least 1, is the events of a burst's scan over WITNESSES: all pixels see the same edge in the same scan, so that no
scan is believed more than so many independent events.

Rates are first learned from a window whose bits are guessed (`guess`), the shorter contexts standing in for the longer
ones; then each slot of an accepted frame moves its own row (`learn`).
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.clock import SUB, Floats

CONTEXTS: Final = 16
WITNESSES: Final = 10.0
# Weight of a shorter context's rate, in scans, against what was seen of the longer one.
BACK_OFF: Final = 1.0
# Longest memory of a rate, in scans at its own sub-bin: the phase between bits and scans drifts, and comes back.
MEMORY: Final = 48.0
# Weight of what a scan shows for the sub-bins beside its own: they differ by a sixteenth of a bit.
BESIDE: Final = 0.5
# What comes from nowhere in a scan: of a burst's events, and events.
STRAY_SHARE: Final = 0.01
STRAY_EVENTS: Final = 0.02


@numba.njit(nogil=True)
def guess(bits: npt.NDArray[np.int64], first: int, scans: Floats, rate: Floats, weight: Floats) -> None:
    """Set the rates by the scans of a window whose bits are guessed.

    Args:
        bits: (slots + 1,) the bit before slot 0, then the one behind each slot.
        first: the first slot that counts; its three bits before are known.
        scans: (n, 4) slot, sub-bin, OFF events, ON events of each scan.
        rate: (16, 2, SUB) out.
        weight: (16, SUB) out: scans that each is made of, at most MEMORY.
    """
    total = np.zeros((CONTEXTS, 2, SUB))
    seen = np.zeros((CONTEXTS, SUB))
    for j in range(scans.shape[0]):
        slot, k = int(scans[j, 0]), int(scans[j, 1])
        if slot < max(first, 2) or slot + 1 >= bits.shape[0]:
            continue
        x = 8 * bits[slot - 2] + 4 * bits[slot - 1] + 2 * bits[slot] + bits[slot + 1]
        for near in range(max(k - 2, 0), min(k + 3, SUB)):
            share = 1.0 - abs(near - k) / 3.0
            seen[x, near] += share
            total[x, 0, near] += share * scans[j, 2]
            total[x, 1, near] += share * scans[j, 3]
    for p in range(2):
        for k in range(SUB):
            _back_off(total[:, p, k], seen[:, k], rate[:, p, k])
    for x in range(CONTEXTS):
        for k in range(SUB):
            weight[x, k] = min(seen[x, k] + BACK_OFF, MEMORY)


@numba.njit(nogil=True)
def _back_off(total: Floats, seen: Floats, rate: Floats) -> None:
    """Set the rate of each context (16,) by its total and the scans seen, the shorter contexts standing in."""
    shorter, longer = np.empty(CONTEXTS), np.empty(CONTEXTS)
    for low in range(4):
        shorter[low] = total.sum() / max(seen.sum(), 1e-9)
    for length in range(2, 5):
        size = 1 << length
        for low in range(size):
            n, s = BACK_OFF, BACK_OFF * shorter[low & (size // 2 - 1)]
            for x in range(low, CONTEXTS, size):
                n += seen[x]
                s += total[x]
            longer[low] = s / n
        for low in range(size):
            shorter[low] = longer[low]
    for x in range(CONTEXTS):
        rate[x] = shorter[x]


@numba.njit(nogil=True)
def learn(x: int, scans: npt.NDArray[np.float64], n: int, rate: Floats, weight: Floats) -> None:
    """Move the rates of x towards the first n of a slot's scans (room, 3): sub-bin, OFF events, ON events."""
    for j in range(n):
        k = int(scans[j, 0])
        for near in range(max(k - 1, 0), min(k + 2, SUB)):
            gain = 1.0 if near == k else BESIDE
            # What differs in the oldest bit alone is much alike; it follows until it has been seen itself.
            for row in (x, x ^ (CONTEXTS >> 1)):
                share = gain / (weight[row, near] + gain)
                if row != x:
                    share *= BACK_OFF / (weight[row, near] + BACK_OFF)
                for p in range(2):
                    rate[row, p, near] += share * (scans[j, 1 + p] - rate[row, p, near])
            weight[x, near] = min(weight[x, near] + gain, MEMORY)


@numba.njit(nogil=True)
def tabulate(rate: Floats, full: Floats, logs: Floats) -> float:
    """Set rates with stray events (16, 2, SUB) and their logarithms; return the events of a burst's scan."""
    burst = 0.0
    for p in range(2):
        # Rises make ON events, falls OFF events.
        for k in range(SUB):
            top = 0.0
            for a in range(4):
                top += 0.25 * rate[4 * a + (1 if p == 1 else 2), p, k]
            burst += 0.5 * top / SUB
    stray = STRAY_SHARE * burst + STRAY_EVENTS
    for x in range(CONTEXTS):
        for p in range(2):
            for k in range(SUB):
                full[x, p, k] = rate[x, p, k] + stray
                logs[x, p, k] = np.log(full[x, p, k])
    return burst


@numba.njit(nogil=True)
def likelihoods(scans: Floats, n: int, full: Floats, logs: Floats, burst: float, out: Floats) -> None:
    """Set out (16,) to log L_x of the first n of a slot's scans (room, 3): sub-bin, OFF events, ON events."""
    f = max(1.0, burst / WITNESSES)
    out[:] = 0.0
    for j in range(n):
        k = int(scans[j, 0])
        for p in range(2):
            count = scans[j, 1 + p]
            for x in range(CONTEXTS):
                out[x] += count * logs[x, p, k] - full[x, p, k]
    out /= f
