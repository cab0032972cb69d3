"""How the demodulator of scanned light begins: scans, turns and response of the window in which its clock was found.

The bits between the window's turns are known, if only nearly (a turn may have been missed, a burst's end be taken for
one). They give a first response (`heliograph.link.scan_response`), the response better bits (Viterbi over the window,
any bits equally likely), and these a better response, until the bits stay as they are, at most ROUNDS times. Scans of
equal sub-bin and counts are equally likely in each context, so that this is computed once for all of a *kind*.

Behind scans of half a bit a light may show no rises at all where edges and scans coincide, for a third of the slow beat
of bits and scans. What is read there by itself is a guess that learns itself. So the window is read once more as frames
that are all equal: bits n apart are one bit, guessed by majority, their likelihoods multiplied. It is believed where it
tells the window in fewer nats (minimum description length), a bit costing ln 2::

    fit = sum_j log L(scan j | bits, response) - (n or slots) ln 2

How likely the window's scans are by the mean rates tells clocks apart that are all read
(`heliograph.link.beginning`): one that is a little off blurs the response.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, cast

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags
from heliograph.link import clock, scan_demodulator, scan_response, scan_state, scans
from heliograph.link import state as state_module
from heliograph.link.clock import SUB, Floats
from heliograph.link.scan_response import CONTEXTS
from heliograph.link.stamp import stamp

ROUNDS: Final = 4
# Fewest frames of a window that may be told to be equal.
FRAMES: Final = 4
# Slots of a window, at most: 256 bits and what a fast clock adds.
_SLOTS: Final = 300
Ints = npt.NDArray[np.int64]


@numba.njit(nogil=True)
def _levels(turn_t: Floats, turn_on: Flags, first: float, period: float, bits: Ints) -> None:
    """Set bits (slots + 1,) to the level between turns: that before slot 0, then that behind each slot."""
    at, n = 0, len(turn_t)
    for s in range(len(bits)):
        # The bit before slot s ends at its boundary; turns lie about boundaries.
        while at < n and turn_t[at] < first + (s - 0.5) * period:
            at += 1
        bits[s] = (0 if turn_on[0] else 1) if at == 0 else (1 if turn_on[at - 1] else 0)


@numba.njit(nogil=True)
def _viterbi(likely: Floats, bits: Ints) -> None:
    """Set bits (slots + 1,) to the likeliest, given (slots, 16) log-likelihoods."""
    slots = likely.shape[0]
    best, after = np.zeros(8), np.empty(8)
    came = np.zeros((slots, 8), np.int64)
    for s in range(slots):
        after[:] = -1e300
        for x in range(CONTEXTS):
            value = best[x >> 1] + likely[s, x]
            if value > after[x & 7]:
                after[x & 7] = value
                came[s, x & 7] = x >> 1
        best[:] = after - after.max()
    at = int(np.argmax(best))
    for s in range(slots - 1, -1, -1):
        bits[s + 1] = at & 1
        at = came[s, at]
    bits[0] = at & 1


@numba.njit(nogil=True)
def _fold_bits(bits: Ints, n: int) -> None:
    """Set each bit (slots + 1,) to what most of those whole frames of n apart are."""
    for r in range(min(n, len(bits))):
        ones, count = 0, 0
        for s in range(r, len(bits), n):
            ones += bits[s]
            count += 1
        for s in range(r, len(bits), n):
            bits[s] = 1 if 2 * ones > count else 0


@numba.njit(nogil=True)
def _fold(likely: Floats, n: int) -> None:
    """Set each slot's log-likelihoods (slots, 16) to the sum over those whole frames of n apart."""
    slots = likely.shape[0]
    for r in range(min(n, slots)):
        for s in range(r + n, slots, n):
            likely[r] += likely[s]
        for s in range(r + n, slots, n):
            likely[s] = likely[r]


@numba.njit(nogil=True)
def _kinds(placed: Floats, kind: Ints) -> Ints:
    """Set kind (n,) of scans (n, 4) that are equal but for their slot; return (kinds,) the place of one of each."""
    n = len(placed)
    base = int(placed[:, 2:].max()) + 1 if n else 1
    key = np.empty(n, np.int64)
    for j in range(n):
        key[j] = (int(placed[j, 1]) * base + int(placed[j, 2])) * base + int(placed[j, 3])
    order = np.argsort(key)
    example = np.empty(n, np.int64)
    kinds = 0
    for i in range(n):
        if i == 0 or key[order[i]] != key[order[i - 1]]:
            example[kinds] = order[i]
            kinds += 1
        kind[order[i]] = kinds - 1
    return example[:kinds]


@numba.njit(nogil=True)
def _tell(
    placed: Floats, row_of: Ints, bits: Ints, burst: float, mean: Floats, known: tuple[Floats, Floats, Floats],
    fit: Floats, told: float,
) -> float:  # fmt: skip
    """Return told and the scans' log-likelihood by rates known as well as seen; add to fit that by the mean rates.

    Args:
        placed: (m, 4) slot, sub-bin, OFF, ON events.
        row_of: (m,) their places in fit.
        bits: (slots + 1,).
        burst: events of a burst's scan.
        mean: (16, 2, SUB), as `known`, shape, least and scale, of `scan_response.tabulate`.
        known: see mean.
        fit: of each scan of the window, in nats; changed.
        told: what the bits cost, in nats.
    """
    shape, least, scale = known
    f = max(1.0, burst / scan_response.WITNESSES)
    stray = scan_response.STRAY_SHARE * burst + scan_response.STRAY_EVENTS
    for j in range(len(placed)):
        s, k = int(placed[j, 0]), int(placed[j, 1])
        if s >= 2:
            x = 8 * bits[s - 2] + 4 * bits[s - 1] + 2 * bits[s] + bits[s + 1]
            off, on = placed[j, 2] / f, placed[j, 3] / f
            told += scan_response.likelihood(off, on, x, k, shape, least, scale)
            told -= math.lgamma(off + 1.0) + math.lgamma(on + 1.0)
            for p in range(2):
                full = mean[x, p, k] + stray
                fit[row_of[j]] += (placed[j, 2 + p] * np.log(full) - full) / f
    return told


@numba.njit(nogil=True)
def _weigh(
    slot_scans: tuple[Ints, Ints, Floats, Ints], kind: Ints, example: Ints, known: tuple[Floats, Floats, Floats],
    burst: float, of_kind: Floats, likely: Floats,
) -> None:  # fmt: skip
    """Set likely (slots, 16) to each slot's tempered log-likelihoods, each kind of scan computed once.

    Args:
        slot_scans: see `_settle`.
        kind: (m,) of each scan.
        example: (kinds,) the place of one of each.
        known: shape, least and scale, of `scan_response.tabulate`.
        burst: events of a burst's scan.
        of_kind: (kinds, 16) scratch.
        likely: out.
    """
    grouped, per_slot, placed, _ = slot_scans
    shape, least, scale = known
    for i in range(len(example)):
        one = placed[example[i] : example[i] + 1, 1:]
        scan_response.likelihoods(one, 1, shape, least, scale, burst, of_kind[i])
    loglikelihood = np.empty(CONTEXTS)
    for s in range(len(per_slot)):
        loglikelihood[:] = 0.0
        for i in range(per_slot[s]):
            loglikelihood += of_kind[kind[grouped[s, i]]]
        scan_demodulator.temper(loglikelihood, likely[s])
    likely[:] = np.log(likely)


@numba.njit(nogil=True)
def _settle(
    slot_scans: tuple[Ints, Ints, Floats, Ints],
    n: int,
    q: float,
    bits: Ints,
    learned: tuple[Floats, Floats],
    fit: Floats,
) -> tuple[float, float]:
    """Learn response and bits of a window from each other.

    Args:
        slot_scans: (slots, ROOM) and (slots,) which scans a slot has and how many; (m, 4) slot, sub-bin, OFF, ON
            events of all, and (m,) their places in fit.
        n: bits of a frame if all frames are to be equal, else 0.
        q: length of a scan.
        bits: (slots + 1,) guessed; changed.
        learned: rate and weight, out.
        fit: out, of each scan: log-likelihood by the mean rates, in nats, less its part of what the bits cost.

    Returns:
        Events of a burst's scan, and log-likelihood by rates known as well as seen, less what the bits cost.
    """  # fmt: skip
    _, per_slot, placed, row_of = slot_scans
    rate, weight = learned
    slots = len(per_slot)
    mean, shape, least = np.empty(rate.shape), np.empty(rate.shape), np.empty(rate.shape)
    scale, likely = np.empty(weight.shape), np.empty((slots, CONTEXTS))
    kind, before = np.empty(len(placed), np.int64), np.empty(len(bits), np.int64)
    example = _kinds(placed, kind)
    of_kind = np.empty((len(example), CONTEXTS))
    burst = 0.0
    if n > 0:
        _fold_bits(bits, n)
    for last in range(ROUNDS + 1):
        scan_response.guess(bits, 2, placed, rate, weight)
        burst = scan_response.tabulate(rate, weight, q, mean, shape, least, scale)
        if last == ROUNDS:
            break
        _weigh(slot_scans, kind, example, (shape, least, scale), burst, of_kind, likely)
        if n > 0:
            _fold(likely, n)
        before[:] = bits
        _viterbi(likely, bits)
        if np.array_equal(before, bits):
            break  # every further round would do the same
    told = -(n if n > 0 else slots) * np.log(2.0)
    fit[:] = told / len(fit)
    told = _tell(placed, row_of, bits, burst, mean, (shape, least, scale), fit, told)
    return float(burst), float(told)


def _entry(sources: int) -> Callable[..., tuple[float, Floats]]:
    """Return `learn`, cached under these sources (`heliograph.link.stamp`)."""

    @numba.njit(cache=True, nogil=True)
    def kernel(
        rows: Floats,
        turn_t: Floats,
        turn_on: Flags,
        first: float,
        period: float,
        q: float,
        frame_bits: int,
        learned: tuple[Floats, Floats],
        table: tuple[Floats, Floats, Floats, Floats],
    ) -> tuple[float, Floats]:
        """See `begin`; rows (n, 3) are all scans of the window. Return a burst's events and each's log-likelihood.

        Sets rate and weight, and of these the table: mean, shape, least and scale.
        """
        rate, weight = learned
        slots = min(int((rows[-1, 0] - first) / period + 0.5) + 1, _SLOTS) if sources >= 0 else 0
        placed = np.empty((len(rows), 4))
        row_of = np.empty(len(rows), np.int64)
        n = 0
        per_slot = np.zeros(slots, np.int64)
        grouped = np.zeros((slots, scan_state.ROOM), np.int64)
        for j in range(len(rows)):
            place = (rows[j, 0] - first) / period + 0.5
            s = int(np.floor(place))
            if s < 0 or s >= slots:
                continue
            k = min(int((place - s) * SUB), SUB - 1)
            placed[n, 0], placed[n, 1], placed[n, 2], placed[n, 3] = s, k, rows[j, 1], rows[j, 2]
            row_of[n] = j
            if per_slot[s] < scan_state.ROOM:
                grouped[s, per_slot[s]] = n
                per_slot[s] += 1
            n += 1
        bits = np.zeros(slots + 1, np.int64)
        _levels(turn_t, turn_on, first, period, bits)
        repeated = bits.copy()
        fit = np.empty(len(rows))
        window = (grouped, per_slot, placed[:n], row_of[:n])
        burst, told = _settle(window, 0, q, bits, (rate, weight), fit)
        if slots >= FRAMES * frame_bits:
            other_rate, other_weight, other = np.empty(rate.shape), np.empty(weight.shape), np.empty(len(rows))
            other_burst, other_told = _settle(window, frame_bits, q, repeated, (other_rate, other_weight), other)
            if other_told > told:
                rate[:] = other_rate
                weight[:] = other_weight
                burst, fit = other_burst, other
        scan_response.tabulate(rate, weight, q, table[0], table[1], table[2], table[3])
        return burst, fit

    return cast("Callable[..., tuple[float, Floats]]", kernel)


_KERNEL: Final = _entry(stamp(clock, scan_demodulator, scan_response, scan_state, scans, state_module))


def begin(
    scanned: scan_state.ScanState, t: Floats, on: Flags, until: float, found: Floats, turns: tuple[Floats, Flags],
    frame_bits: int,
) -> Floats | None:  # fmt: skip
    """Begin with a clock that turns have shown.

    Args:
        scanned: to be set.
        t: (n,) event times of the window in nominal bits from the lock's origin, rising.
        on: (n,) polarities.
        until: end of the window.
        found: (4,) of `heliograph.link.clock.grid`.
        turns: (m,) times of the turns in the window, and (m,) True where the light turned up.
        frame_bits: of the code.

    Returns:
        How likely each of the window's scans is, in nats, up to a constant of its own: (m,), the same scans for every
        clock. None where the events are no scans; then nothing is set.
    """
    at, counts = np.empty(len(t)), np.empty((len(t), 2))
    n = scans.group(t, on, at, counts)
    at, counts = at[:n], counts[:n]
    q = scans.quantum(at) or scans.quantum(at, rare=True)
    if q == 0.0 or len(turns[0]) == 0:
        return None
    rows = scans.all_scans(at, counts, q, until)
    first, period = float(found[0]), float(found[1])
    learned, table = (scanned.rate, scanned.weight), (scanned.mean, scanned.shape, scanned.least, scanned.scale)
    burst, fit = _KERNEL(rows, turns[0], turns[1], first, period, q, frame_bits, learned, table)
    scanned.floats[:] = 0.0
    scanned.floats[scan_state.QUANTUM] = q
    scanned.floats[scan_state.SCAN] = rows[0, 0] - q
    scanned.floats[scan_state.BURST] = burst
    scanned.floats[scan_state.END] = np.inf
    scanned.n[:] = 0
    scanned.turned[:] = 0.0
    scanned.before[:] = 0.125
    scanned.likely[:] = 1.0
    return fit
