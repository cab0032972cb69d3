"""The network by words of 64 pixels, for weights of 0 and 1 and l_tau = 0; the same spikes as the equations.

The images of the last 11 ticks are bit planes. For each word of outputs in whose reach anything is set, the 5 x 11 x 5
shifted words around it are made once; a neuron's potential for 64 pixels at a time is the count of its 25 of them,
summed bit by bit by carry-save adders, and compared bit by bit with the threshold. Work grows with the words that are
touched, and ends at the frame: full frames need no other form.

A neuron whose longest delay is D cannot fire where fewer than v_th pixels in reach were active in the last D + 1 ticks.
That bound is one count for all neurons of the same D, and spares sparse noise nearly all of the work.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.flow.network import NEURONS, REACH, SIDE, SYNAPSES, FlowNetwork
from heliograph_services.tracker.flow.spikes import NO_PIXELS, NO_SPIKES, SPIKES_AT_FIRST, TICKS, Ints, Spikes
from heliograph_services.tracker.jit import kernel

Words = npt.NDArray[np.uint64]

# A de Bruijn sequence tells the place of a word's only bit; numba has no instruction for it.
_DE_BRUIJN: Final = np.uint64(0x03F79D71B4CB0A89)
_BIT_PLACE: Final = np.zeros(64, np.int64)
for _place in range(64):
    _BIT_PLACE[((int(_DE_BRUIJN) << _place) & (2**64 - 1)) >> 58] = _place
_SHIFTED: Final = SIDE * TICKS * SIDE


@kernel
def _set_bits(plane: Words, x: Any, y: Any) -> None:
    for i in range(len(x)):
        plane[y[i] + REACH, (x[i] >> 6) + 1] |= np.uint64(1) << np.uint64(x[i] & 63)


@kernel
def _add(a: Any, b: Any, c: Any) -> Any:
    """Return the sum's and the carry's bits of three words."""
    u = a ^ b
    return u ^ c, (a & b) | (u & c)


@kernel
def _eight(shifted: Words, index: Any, j: int) -> Any:
    """Return the four bit planes of the count of synapses j .. j + 7."""
    s1, c1 = _add(shifted[index[j]], shifted[index[j + 1]], shifted[index[j + 2]])
    s2, c2 = _add(shifted[index[j + 3]], shifted[index[j + 4]], shifted[index[j + 5]])
    s3, c3 = _add(s1, s2, shifted[index[j + 6]])
    last = shifted[index[j + 7]]
    c4 = s3 & last
    ones = s3 ^ last
    t1, d1 = _add(c1, c2, c3)
    d2 = t1 & c4
    return ones, t1 ^ c4, d1 ^ d2, d1 & d2


@kernel
def _count(shifted: Words, index: Any) -> Any:
    """Return the five bit planes of the count of all 25 synapses."""
    a0, a1, a2, a3 = _eight(shifted, index, 0)
    b0, b1, b2, b3 = _eight(shifted, index, 8)
    e0, e1, e2, e3 = _eight(shifted, index, 16)
    s0, k1 = _add(a0, b0, e0)
    last = shifted[index[24]]
    c0 = s0 ^ last
    k2 = s0 & last
    # Twos: five words of weight 2.
    s1, m1 = _add(a1, b1, e1)
    c1, m2 = _add(s1, k1, k2)
    # Fours: five.
    s2, n1 = _add(a2, b2, e2)
    c2, n2 = _add(s2, m1, m2)
    # Eights: five; their carries are sixteens, and 25 is below 32.
    s3, o1 = _add(a3, b3, e3)
    c3, o2 = _add(s3, n1, n2)
    return c0, c1, c2, c3, o1 | o2


@kernel
def _shift(planes: Words, head: int, row: int, word: int, shifted: Words) -> None:
    """Fill shifted: for (dy, delay, dx) the 64 pixels of a word of outputs, seen through that synapse and delay."""
    one = np.uint64(1)
    two = np.uint64(2)
    for dy in range(SIDE):
        for delay in range(TICKS):
            plane = head - delay
            if plane < 0:
                plane += TICKS
            left = planes[plane, row + dy, word]
            here = planes[plane, row + dy, word + 1]
            right = planes[plane, row + dy, word + 2]
            i = (dy * TICKS + delay) * SIDE
            if left | here | right == np.uint64(0):
                for dx in range(SIDE):
                    shifted[i + dx] = np.uint64(0)
                continue
            shifted[i] = (here << two) | (left >> np.uint64(62))
            shifted[i + 1] = (here << one) | (left >> np.uint64(63))
            shifted[i + 2] = here
            shifted[i + 3] = (here >> one) | (right << np.uint64(63))
            shifted[i + 4] = (here >> two) | (right << np.uint64(62))


@kernel
def _any(planes: Words, head: int, delays: Any, seen: Words) -> None:
    """Fill seen (levels, rows, words): what was active in the last delays[level] + 1 ticks; delays rise."""
    for row in range(planes.shape[1]):
        for word in range(planes.shape[2]):
            so_far = np.uint64(0)
            delay = 0
            for level in range(len(delays)):
                while delay <= delays[level]:
                    so_far |= planes[(head - delay) % TICKS, row, word]
                    delay += 1
                seen[level, row, word] = so_far


@kernel
def _within(seen: Words, row: int, word: int, shifted: Words) -> None:
    """Fill shifted (25) with what each synapse sees of one plane, for a word of outputs."""
    one = np.uint64(1)
    two = np.uint64(2)
    for dy in range(SIDE):
        left = seen[row + dy, word]
        here = seen[row + dy, word + 1]
        right = seen[row + dy, word + 2]
        i = dy * SIDE
        shifted[i] = (here << two) | (left >> np.uint64(62))
        shifted[i + 1] = (here << one) | (left >> np.uint64(63))
        shifted[i + 2] = here
        shifted[i + 3] = (here >> one) | (right << np.uint64(63))
        shifted[i + 4] = (here >> two) | (right << np.uint64(62))


@kernel
def _reached(c: Any, at_least: int, fire: Any) -> Any:
    """Return where a count of five bit planes is at least so much, of the pixels in fire."""
    inside = fire
    fire = c[0] & fire if at_least & 1 else c[0] | fire
    fire = c[1] & fire if at_least & 2 else c[1] | fire
    fire = c[2] & fire if at_least & 4 else c[2] | fire
    fire = c[3] & fire if at_least & 8 else c[3] | fire
    fire = c[4] & fire if at_least & 16 else c[4] | fire
    return fire & inside


@kernel
def _candidates(seen: Words, row: int, word: int, at_least: int, shifted: Words, all_: Any, out: Words) -> bool:
    """Fill out (levels): the outputs of a word that any neuron of a level may fire at; return whether there are any."""
    found = False
    top = len(out) - 1
    around = np.uint64(0)
    for dy in range(SIDE):
        around |= seen[top, row + dy, word + 1]
        around |= (seen[top, row + dy, word] >> np.uint64(62)) | (seen[top, row + dy, word + 2] << np.uint64(62))
    if around == np.uint64(0):
        return False
    # From the longest delays down: what no longer one reaches no shorter one does.
    for level in range(top, -1, -1):
        _within(seen[level], row, word, shifted)
        out[level] = _reached(_count(shifted, all_), at_least, ~np.uint64(0))
        found |= out[level] != np.uint64(0)
        if out[level] == np.uint64(0):
            for lower in range(level):
                out[lower] = np.uint64(0)
            break
    return found


@kernel
def _word_step(
    planes: Words, head: int, width: int, index: Any, level: Any, delays: Any, at_least: int, seen: Words,
    shifted: Words, may: Words, place: Any, wanted: Any, out: Ints,
) -> int:  # fmt: skip
    """Write rows (x, y, k, s) of the wanted spikes to out (4, capacity); return how many there are, written or not."""
    height = planes.shape[1] - 2 * REACH
    words = planes.shape[2] - 2
    zero = np.uint64(0)
    one = np.uint64(1)
    all_ = np.arange(SYNAPSES)
    _any(planes, head, delays, seen)
    n = 0
    for row in range(height):
        for word in range(words):
            # Counts end at 25, and their five bits at 31.
            need = min(31, max(at_least, int(wanted[row, word])))
            if wanted[row, word] == 0 or not _candidates(seen, row, word, need, shifted, all_, may):
                continue
            _shift(planes, head, row, word, shifted)
            inside = ~zero
            if 64 * word + 64 > width:
                inside = (one << np.uint64(width - 64 * word)) - one
            for k in range(NEURONS):
                if may[level[k]] & inside == zero:
                    continue
                c = _count(shifted, index[k])
                fire = _reached(c, need, inside)
                while fire != zero:
                    bit = place[((fire & (~fire + one)) * _DE_BRUIJN) >> np.uint64(58)]
                    fire &= fire - one
                    if n < out.shape[1]:
                        b = np.uint64(bit)
                        out[0, n] = 64 * word + bit
                        out[1, n] = row
                        out[2, n] = k
                        s = ((c[0] >> b) & one) + (((c[1] >> b) & one) << one) + (((c[2] >> b) & one) << np.uint64(2))
                        s += (((c[3] >> b) & one) << np.uint64(3)) + (((c[4] >> b) & one) << np.uint64(4))
                        out[3, n] = s
                    n += 1
    return n


class WordRuntime:
    """64 pixels at a time; weights of 0 and 1, l_tau = 0.

    Args:
        network: parameters.
        width: columns.
        height: rows.
    """

    def __init__(self, network: FlowNetwork, width: int, height: int) -> None:
        self._planes = np.zeros((TICKS, height + 2 * REACH, -(-width // 64) + 2), np.uint64)
        # A neuron that no synapse feeds counts as one without delay.
        longest = np.where(network.weight == 1, network.delay, 0).max(axis=1)
        delays, self._level = np.unique(longest, return_inverse=True)
        self._delays = delays.astype(np.int64)
        self._seen = np.zeros((len(delays), *self._planes.shape[1:]), np.uint64)
        self._may = np.zeros(len(delays), np.uint64)
        # The last word is always 0: synapses of weight 0 read it.
        self._shifted = np.zeros(_SHIFTED + 1, np.uint64)
        j = np.arange(SYNAPSES)
        index = (j // SIDE * TICKS + network.delay) * SIDE + j % SIDE
        self._index = np.where(network.weight == 1, index, _SHIFTED).astype(np.int64)
        threshold = int(np.ceil(network.v_th))
        self._at_least = threshold + (network.h == "step_above" and threshold == network.v_th)
        self._width = width
        self._all = np.ones((height, self._planes.shape[2] - 2), np.uint8)
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
        _set_bits(self._planes[self._head], x.astype(np.int64), y.astype(np.int64))
        while True:
            n = _word_step(
                self._planes, self._head, self._width, self._index, self._level, self._delays, self._at_least,
                self._seen, self._shifted, self._may, _BIT_PLACE, self._all if wanted is None else wanted, self._out,
            )  # fmt: skip
            if n <= self._out.shape[1]:
                break
            self._out = np.empty((4, 2 * n), np.int32)
        return Spikes(self._out[0, :n], self._out[1, :n], self._out[2, :n], self._out[3, :n])

    def skip(self, ticks: int) -> list[Spikes]:
        """Pass so many ticks without input; return the spikes of the first that can have any."""
        return [self.step(NO_PIXELS, NO_PIXELS).copy() for _ in range(min(ticks, TICKS))]
