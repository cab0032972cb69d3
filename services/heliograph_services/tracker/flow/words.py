"""The network by words of 64 pixels, for weights of 0 and 1 and l_tau = 0; the same spikes as the equations.

The images of the last 11 ticks are bit planes. For each word of outputs in whose reach anything is set, the 5 x 11 x 5
shifted words around it are made once; a neuron's potential for 64 pixels at a time is the count of its 25 of them,
summed bit by bit by carry-save adders, and compared bit by bit with the threshold. `LANES` words of outputs, wherever
they lie, are counted side by side in the processor's wide registers. Work grows with the words that are touched, and
ends at the frame: full frames need no other form.

A neuron whose longest delay is D cannot fire where fewer than v_th pixels in reach were active in the last D + 1 ticks.
That bound is one count for all neurons of the same D, and spares sparse noise nearly all of the work.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.flow.network import NEURONS, REACH, SIDE, SYNAPSES, FlowNetwork
from heliograph_services.tracker.flow.spikes import NO_PIXELS, NO_SPIKES, SPIKES_AT_FIRST, TICKS, Ints, Spikes
from heliograph_services.tracker.jit import inlined, kernel

Words = npt.NDArray[np.uint64]

# A de Bruijn sequence tells the place of a word's only bit; numba has no instruction for it.
_DE_BRUIJN: Final = np.uint64(0x03F79D71B4CB0A89)
_BIT_PLACE: Final = np.zeros(64, np.int64)
for _place in range(64):
    _BIT_PLACE[((int(_DE_BRUIJN) << _place) & (2**64 - 1)) >> 58] = _place
_SHIFTED: Final = SIDE * TICKS * SIDE
# Words of outputs counted at once: 512 bits.
LANES: Final = 8
_L: Final = LANES
_PLANES: Final = 5


@kernel
def _set_bits(plane: Words, stride: int, x: Any, y: Any) -> None:
    for i in range(len(x)):
        plane[(y[i] + REACH) * stride + (x[i] >> 6) + 1] |= np.uint64(1) << np.uint64(x[i] & 63)


@inlined
def _add(a: Any, b: Any, c: Any) -> Any:
    """Return the sum's and the carry's bits of three words."""
    u = a ^ b
    return u ^ c, (a & b) | (u & c)


@kernel
def _count(taps: Words, need: Words, lanes: int, counts: Words) -> None:
    """Fill counts (6, LANES): the five bit planes of how many of the 25 taps are set, and where that is enough.

    Args:
        taps: (25, LANES); as all arrays of lanes in one row of memory.
        need: (5, LANES): the planes of the least count that is asked for, inverted.
        lanes: LANES; as a constant it would make the compiler unroll the loop where it should vectorise it.
        counts: see above.
    """
    for i in range(lanes):
        a0, a1 = _add(taps[i], taps[_L + i], taps[2 * _L + i])
        b0, b1 = _add(taps[3 * _L + i], taps[4 * _L + i], taps[5 * _L + i])
        c0, c1 = _add(taps[6 * _L + i], taps[7 * _L + i], taps[8 * _L + i])
        d0, d1 = _add(taps[9 * _L + i], taps[10 * _L + i], taps[11 * _L + i])
        e0, e1 = _add(taps[12 * _L + i], taps[13 * _L + i], taps[14 * _L + i])
        f0, f1 = _add(taps[15 * _L + i], taps[16 * _L + i], taps[17 * _L + i])
        g0, g1 = _add(taps[18 * _L + i], taps[19 * _L + i], taps[20 * _L + i])
        h0, h1 = _add(taps[21 * _L + i], taps[22 * _L + i], taps[23 * _L + i])
        a0, i1 = _add(a0, b0, c0)
        d0, j1 = _add(d0, e0, f0)
        g0, k1 = _add(g0, h0, taps[24 * _L + i])
        ones, l1 = _add(a0, d0, g0)
        # Twelve words of weight 2.
        a1, a2 = _add(a1, b1, c1)
        d1, b2 = _add(d1, e1, f1)
        g1, c2 = _add(g1, h1, i1)
        j1, d2 = _add(j1, k1, l1)
        a1, e2 = _add(a1, d1, g1)
        twos = a1 ^ j1
        f2 = a1 & j1
        # Six of weight 4.
        a2, a4 = _add(a2, b2, c2)
        d2, b4 = _add(d2, e2, f2)
        fours = a2 ^ d2
        # Three of weight 8; 25 is below 32.
        eights, sixteens = _add(a4, b4, a2 & d2)
        counts[i] = ones
        counts[_L + i] = twos
        counts[2 * _L + i] = fours
        counts[3 * _L + i] = eights
        counts[4 * _L + i] = sixteens
        # Enough so far, from the lowest plane up: both bits of count and ~need say so, or one and the lower planes.
        _, fire = _add(ones, ~np.uint64(0), need[i])
        _, fire = _add(twos, fire, need[_L + i])
        _, fire = _add(fours, fire, need[2 * _L + i])
        _, fire = _add(eights, fire, need[3 * _L + i])
        _, fire = _add(sixteens, fire, need[4 * _L + i])
        counts[5 * _L + i] = fire


@kernel
def _through(planes: Words, first: int, at: Any, lanes: int, three: Words, out: Words, row: int) -> None:
    """Fill five rows of out (rows, LANES) from a row on: what each lane's 64 outputs see through dx = -2 .. 2.

    Args:
        planes: in one row of memory.
        first: where the row of words begins that the outputs of place 0 look at.
        at: (LANES,) the lanes' places: row times words a row, plus the word.
        lanes: see `_count`.
        three: (3, LANES), scratch: the word to the left, here, to the right.
        out: see above.
        row: see above.
    """
    for i in range(lanes):
        place = first + at[i]
        three[i] = planes[place]
        three[_L + i] = planes[place + 1]
        three[2 * _L + i] = planes[place + 2]
    o = row * _L
    for i in range(lanes):
        left = three[i]
        here = three[_L + i]
        right = three[2 * _L + i]
        out[o + i] = (here << np.uint64(2)) | (left >> np.uint64(62))
        out[o + _L + i] = (here << np.uint64(1)) | (left >> np.uint64(63))
        out[o + 2 * _L + i] = here
        out[o + 3 * _L + i] = (here >> np.uint64(1)) | (right << np.uint64(63))
        out[o + 4 * _L + i] = (here >> np.uint64(2)) | (right << np.uint64(62))


@kernel
def _any(planes: Words, head: int, delays: Any, seen: Words) -> None:
    """Fill seen (levels, words): what was active in the last delays[level] + 1 ticks; delays rise."""
    delay = 0
    for level in range(len(delays)):
        if level:
            seen[level] = seen[level - 1]
        else:
            seen[0] = planes[head]
            delay = 1
        while delay <= delays[level]:
            plane = (head - delay) % TICKS
            for word in range(planes.shape[1]):
                seen[level, word] |= planes[plane, word]
            delay += 1


@kernel
def _touched(seen: Words, stride: int, wanted: Any, at: Any) -> int:
    """Write the places of the wanted words of outputs that have anything in reach; return how many."""
    n = 0
    for row in range(wanted.shape[0]):
        for word in range(wanted.shape[1]):
            if wanted[row, word] == 0:
                continue
            around = np.uint64(0)
            for dy in range(SIDE):
                place = (row + dy) * stride + word
                around |= seen[place + 1] | (seen[place] >> np.uint64(62)) | (seen[place + 2] << np.uint64(62))
            if around != np.uint64(0):
                at[n] = row * stride + word
                n += 1
    return n


@kernel
def _needs(at: Any, n: int, stride: int, at_least: int, wanted: Any, need: Words) -> None:
    """Fill need (5, LANES), see `_count`, of the first n lanes."""
    for i in range(n):
        # Counts end at 25, and their five bits at 31.
        least = min(31, max(at_least, int(wanted[at[i] // stride, at[i] % stride])))
        for bit in range(_PLANES):
            need[bit * _L + i] = np.uint64(0) if (least >> bit) & 1 else ~np.uint64(0)


@kernel
def _candidates(
    seen: Words, stride: int, width: int, at_least: int, wanted: Any, lanes: int, at: Any, n: int, need: Words,
    three: Words, taps: Words, counts: Words, may: Words,
) -> int:  # fmt: skip
    """Keep of n places those that any neuron may fire at; fill may (places, levels) with where; return how many."""
    one = np.uint64(1)
    levels = len(seen)
    batch = np.zeros(_L, np.int64)
    kept = 0
    for begin in range(0, n, _L):
        some = min(_L, n - begin)
        # What is left of the last batch stays: lanes beyond are not read.
        batch[:some] = at[begin : begin + some]
        _needs(batch, some, stride, at_least, wanted, need)
        # From the longest delays down: what no longer one reaches no shorter one does.
        for level in range(levels - 1, -1, -1):
            for dy in range(SIDE):
                _through(seen[level], dy * stride, batch, lanes, three, taps, dy * SIDE)
            _count(taps, need, lanes, counts)
            reached = np.uint64(0)
            for i in range(some):
                reached |= counts[5 * _L + i]
                may[begin + i, level] = counts[5 * _L + i]
            if reached == np.uint64(0):
                may[begin : begin + some, :level] = 0
                break
        for i in range(some):
            word = batch[i] % stride
            inside = ~np.uint64(0)
            if 64 * word + 64 > width:
                inside = (one << np.uint64(width - 64 * word)) - one
            if may[begin + i, levels - 1] & inside != np.uint64(0):
                at[kept] = batch[i]
                for level in range(levels):
                    may[kept, level] = may[begin + i, level] & inside
                kept += 1
    return kept


@kernel
def _write(k: int, x: int, y: int, fire: Any, counts: Words, place: Any, out: Ints, n: int) -> int:
    """Write the spikes of a neuron among 64 outputs while they fit; return how many there are so far."""
    one = np.uint64(1)
    while fire != np.uint64(0):
        bit = place[((fire & (~fire + one)) * _DE_BRUIJN) >> np.uint64(58)]
        fire &= fire - one
        if n < out.shape[1]:
            b = np.uint64(bit)
            out[0, n] = x + bit
            out[1, n] = y
            out[2, n] = k
            s = ((counts[0] >> b) & one) | (((counts[_L] >> b) & one) << one)
            s |= (((counts[2 * _L] >> b) & one) << np.uint64(2)) | (((counts[3 * _L] >> b) & one) << np.uint64(3))
            out[3, n] = s | (((counts[4 * _L] >> b) & one) << np.uint64(4))
        n += 1
    return n


@kernel
def _word_step(
    planes: Words, head: int, stride: int, width: int, index: Any, level: Any, delays: Any, at_least: int, seen: Words,
    at: Any, may: Words, lane_words: Any, lanes: int, place: Any, wanted: Any, out: Ints,
) -> int:  # fmt: skip
    """Write rows (x, y, k, s) of the wanted spikes to out (4, capacity); return how many there are, written or not."""
    need, three, taps, counts, shifted = lane_words
    _any(planes, head, delays, seen)
    n = _touched(seen[-1], stride, wanted, at)
    n = _candidates(seen, stride, width, at_least, wanted, lanes, at, n, need, three, taps, counts[0], may)
    batch = np.zeros(_L, np.int64)
    spikes = 0
    for begin in range(0, n, _L):
        some = min(_L, n - begin)
        batch[:some] = at[begin : begin + some]
        _needs(batch, some, stride, at_least, wanted, need)
        for dy in range(SIDE):
            for delay in range(TICKS):
                row = (dy * TICKS + delay) * SIDE
                _through(planes[(head - delay) % TICKS], dy * stride, batch, lanes, three, shifted, row)
        for k in range(NEURONS):
            for j in range(SYNAPSES):
                source = index[k, j] * _L
                for i in range(_L):
                    taps[j * _L + i] = shifted[source + i]
            _count(taps, need, lanes, counts[k])
        for i in range(some):
            x, y = 64 * (batch[i] % stride), batch[i] // stride
            for k in range(NEURONS):
                fire = counts[k, 5 * _L + i] & may[begin + i, level[k]]
                if fire != np.uint64(0):
                    spikes = _write(k, x, y, fire, counts[k, i:], place, out, spikes)
    return spikes


class WordRuntime:
    """64 pixels at a time; weights of 0 and 1, l_tau = 0.

    Args:
        network: parameters.
        width: columns.
        height: rows.
    """

    def __init__(self, network: FlowNetwork, width: int, height: int) -> None:
        # A word on each side and two rows above and below, always 0.
        self._stride = -(-width // 64) + 2
        self._planes = np.zeros((TICKS, (height + 2 * REACH) * self._stride), np.uint64)
        # A neuron that no synapse feeds counts as one without delay.
        longest = np.where(network.weight == 1, network.delay, 0).max(axis=1)
        delays, self._level = np.unique(longest, return_inverse=True)
        self._delays = delays.astype(np.int64)
        self._seen = np.zeros((len(delays), self._planes.shape[1]), np.uint64)
        self._all = np.ones((height, self._stride - 2), np.uint8)
        self._at = np.empty(self._all.size, np.int64)
        self._may = np.zeros((self._all.size, len(delays)), np.uint64)
        # The last row of the shifted words is always 0: synapses of weight 0 read it.
        rows = _PLANES, 3, SYNAPSES, _SHIFTED + 1
        need, three, taps, shifted = (np.zeros(n * LANES, np.uint64) for n in rows)
        self._lane_words = need, three, taps, np.zeros((NEURONS, (_PLANES + 1) * LANES), np.uint64), shifted
        j = np.arange(SYNAPSES)
        index = (j // SIDE * TICKS + network.delay) * SIDE + j % SIDE
        self._index = np.where(network.weight == 1, index, _SHIFTED).astype(np.int64)
        threshold = int(np.ceil(network.v_th))
        self._at_least = threshold + (network.h == "step_above" and threshold == network.v_th)
        self._width = width
        self._head = 0
        self._silent = TICKS
        self._out = np.empty((4, SPIKES_AT_FIRST), np.int32)

    def step(self, x: npt.NDArray[Any], y: npt.NDArray[Any], wanted: npt.NDArray[np.uint8] | None = None) -> Spikes:
        """Take the next tick's active pixels; return its spikes: see `Runtime`."""
        self._head = (self._head + 1) % TICKS
        self._planes[self._head] = 0
        self._silent = 0 if len(x) else self._silent + 1
        # 25 synapses never reach more than 31.
        if self._silent >= TICKS or self._at_least > SYNAPSES:
            return NO_SPIKES
        _set_bits(self._planes[self._head], self._stride, x.astype(np.int64), y.astype(np.int64))
        while True:
            n = _word_step(
                self._planes, self._head, self._stride, self._width, self._index, self._level, self._delays,
                self._at_least, self._seen, self._at, self._may, self._lane_words, LANES, _BIT_PLACE,
                self._all if wanted is None else wanted, self._out,
            )  # fmt: skip
            if n <= self._out.shape[1]:
                break
            self._out = np.empty((4, 2 * n), np.int32)
        return Spikes(self._out[0, :n], self._out[1, :n], self._out[2, :n], self._out[3, :n])

    def skip(self, ticks: int) -> list[Spikes]:
        """Pass so many ticks without input; return the spikes of the first that can have any."""
        return [self.step(NO_PIXELS, NO_PIXELS).copy() for _ in range(min(ticks, TICKS))]
