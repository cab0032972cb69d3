"""From the likelihoods of slots to a packet: sync, soft bits, decision, check.

Slots. Slot i of a packet is the bit-long interval about the boundary before its bit i, with the likelihoods l_i[a b c]
of the two bits before it and of bit i (`heliograph.link.packet_response`); tempered as in `heliograph.link.likelihood`,
for whole transitions get lost (MISSED) and bursts come from elsewhere (SPURIOUS)::

    l[a b c] <- (1 - MISSED) l[a b c] + MISSED l[a b b]          b != c
    l[a b b] <- (1 - SPURIOUS) l[a b b] + SPURIOUS l[a b ~b]
    l[a b c] <- (1 - MISSED) l[a b c] + MISSED l[b b c]          a != b, after the above
    l        <- max(l / max l, FLOOR);  before, l[000] and l[111] differ by no more than LEVEL

Sync. Its evidence is that of the word s against arbitrary bits, each as likely; a bit position of random bits passes a
threshold of T nats with a chance of at most exp(-T) (Markov), whatever the light is like::

    E = ln sum over what was before of prod_i l_i[s_i-2 s_i-1 s_i] - ln mean over all bits of prod_i l_i[...]

Soft bits. Levels are a chain: a rise says that it was dark before and is lit behind. A dropped transition leaves two of
one polarity in a row, and the chain knows that the level changed between them, though not where. So bit i is judged
on all slots of its packet: forward-backward over the pairs of bits, those of the sync known::

    f_i[b c] = sum_a f_i-1[a b] l_i[a b c]        g_i-1[a b] = sum_c l_i[a b c] g_i[b c]
    soft_i = ln sum_b f_i[b 0] g_i[b 0] - ln sum_b f_i[b 1] g_i[b 1]

Decision: de-scrambled, de-interleaved, `heliograph.link.viterbi`; then the packet's evidence, E as above
of all its bits as decided. Whoever asks compares the CRC, and asks for EVIDENCE_LEAST.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from heliograph.link.clock import Floats
from heliograph.link.likelihood import LEVEL, SPURIOUS
from heliograph.link.packet_layout import Ints
from heliograph.link.viterbi import Octets, encode_into, viterbi

# One transition in twenty is lost: what the link is made for.
MISSED: Final = 0.05
# exp(-10), as for words: two slots of contrary evidence are never outweighed by one more.
FLOOR: Final = 4.5e-5
# Soft bits beyond it are all the same to the decision; one that is wrong must be outvoted by the others.
SOFT_LIMIT: Final = 10.0
# A packet whose bits suit its events less than this many nats better than arbitrary ones may be made by chance: 2^-32
# is worth 22. Packets that are read show some 200, and 190 where a tenth of the transitions is lost.
EVIDENCE_LEAST: Final = 22.0


@numba.njit(nogil=True)
def temper(loglikelihood: Floats, out: Floats) -> None:
    """Set out (8,) to a slot's tempered likelihoods, the largest 1."""
    top = loglikelihood.max()
    plain = np.exp(loglikelihood - top)
    dark, lit = plain[0], plain[7]
    plain[0], plain[7] = max(dark, LEVEL * lit), max(lit, LEVEL * dark)
    for x in range(8):
        a, b, c = x >> 2, x >> 1 & 1, x & 1
        still = 4 * a + 3 * b  # a, b, b: the transition to c was lost, or is none
        if b != c:
            value = (1.0 - MISSED) * plain[x] + MISSED * plain[still]
        else:
            value = (1.0 - SPURIOUS) * plain[x] + SPURIOUS * plain[4 * a + 2 * b + 1 - c]
        if a != b:
            # What a lost transition before this one leaves behind is nothing.
            value = (1.0 - MISSED) * value + MISSED * plain[6 * b + c]
        out[x] = value
    top = out.max()
    for x in range(8):
        out[x] = max(out[x] / top, FLOOR)


@numba.njit(nogil=True)
def evidence(ring: Floats, first: int, word: Octets) -> float:
    """Return E of a word whose first slot is `first` (mod the ring's length), in nats.

    Args:
        ring: (slots, 8) tempered likelihoods.
        first: index of the slot before its first bit.
        word: (n,) bits, n > 1.
    """
    size = ring.shape[0]
    # By the last two bits: of anything, and of the word whatever was before it.
    anything, after = np.full(4, 0.25), np.empty(4)
    before = np.full(4, 0.25)
    as_sent, scale = 0.0, 0.0
    known0, known1 = 0.0, 0.0
    for i in range(len(word)):
        slot = ring[(first + i) % size]
        for bc in range(4):
            b = bc >> 1
            after[bc] = 0.5 * (anything[b] * slot[bc] + anything[2 + b] * slot[4 + bc])
        whole = after.sum()
        scale += np.log(whole)
        anything[:] = after / whole
        if i == 0:
            # a b unknown: what is left of them is b.
            c = word[0]
            known0 = before[0] * slot[c] + before[2] * slot[4 + c]
            known1 = before[1] * slot[2 + c] + before[3] * slot[6 + c]
        elif i == 1:
            bc = 2 * word[0] + word[1]
            as_sent += np.log(known0 * slot[bc] + known1 * slot[4 + bc])
        else:
            as_sent += np.log(slot[4 * word[i - 2] + 2 * word[i - 1] + word[i]])
    return float(as_sent - scale)


@numba.njit(nogil=True)
def soft_bits(ring: Floats, first: int, sync: Octets, soft: Floats) -> None:
    """Set soft (n,) to ln P(0) / P(1) of the bits behind a sync.

    Args:
        ring: (slots, 8) tempered likelihoods.
        first: index of the slot before the sync's first bit.
        sync: (s,) its bits, s > 1.
        soft: (n,) out.
    """
    size, n, start = ring.shape[0], len(soft), first + len(sync)
    forward = np.empty((n + 1, 4))
    forward[0] = 0.0
    forward[0, 2 * sync[-2] + sync[-1]] = 1.0
    for i in range(n):
        step(forward[i], ring[(start + i) % size], forward[i + 1])
    behind, after = np.empty(4), np.ones(4)
    step_back(ring[(start + n) % size], after, behind)
    for i in range(n - 1, -1, -1):
        p0 = forward[i + 1, 0] * behind[0] + forward[i + 1, 2] * behind[2]
        p1 = forward[i + 1, 1] * behind[1] + forward[i + 1, 3] * behind[3]
        value = np.log(max(p0, 1e-30)) - np.log(max(p1, 1e-30))
        soft[i] = min(max(value, -SOFT_LIMIT), SOFT_LIMIT)
        after[:] = behind
        step_back(ring[(start + i) % size], after, behind)


@numba.njit(nogil=True)
def step(before: Floats, slot: Floats, after: Floats) -> None:
    """Set after (4,), by the two newest bits, to what before (4,) and a slot's likelihoods make of it; its sum is 1."""
    for bc in range(4):
        b = bc >> 1
        after[bc] = before[b] * slot[bc] + before[2 + b] * slot[4 + bc]
    after /= after.sum()


@numba.njit(nogil=True)
def step_back(slot: Floats, after: Floats, before: Floats) -> None:
    """Set before (4,) to what after (4,) and the slot between make of it; its sum is 1."""
    for ab in range(4):
        b = ab & 1
        before[ab] = slot[2 * ab] * after[2 * b] + slot[2 * ab + 1] * after[2 * b + 1]
    before /= before.sum()


@numba.njit(nogil=True)
def decide(
    ring: Floats, first: int, sync: Octets, mother: Ints, flip: Octets, signs: Floats, data: Octets, sent: Octets
) -> float:
    """Decide a packet; return its evidence.

    Args:
        ring: (slots, 8) tempered likelihoods; the packet's last slot is first + s + N.
        first: index of the slot before the sync's first bit.
        sync: and the two after it, of `heliograph.link.packet_layout.Tables`.
        mother: which bit of the mother code is on the air.
        flip: whether it is inverted.
        signs: `heliograph.link.viterbi.SIGNS`.
        data: (steps,) out: HEADER, DATA, CRC, TAIL.
        sent: (s + N,) out: the bits on the air that this would have been.
    """
    n = len(mother)
    soft = np.empty(n)
    soft_bits(ring, first, sync, soft)
    code = np.zeros(2 * len(data))
    for j in range(n):
        code[mother[j]] = -soft[j] if flip[j] else soft[j]
    viterbi(code, signs, data)
    bits = np.empty(2 * len(data), np.uint8)
    encode_into(data, bits)
    sent[: len(sync)] = sync
    for j in range(n):
        sent[len(sync) + j] = bits[mother[j]] ^ flip[j]
    return evidence(ring, first, sent)


@numba.njit(nogil=True)
def checks(data: Octets, n_bytes: int, whole: Octets) -> bool:
    """Pack the data into bytes; return whether their last four are the CRC of the others.

    Args:
        data: (steps,) bits, at least 8 n_bytes.
        n_bytes: HEADER, DATA and CRC.
        whole: (n_bytes,) out.
    """
    for i in range(n_bytes):
        byte = 0
        for k in range(8):
            byte = 2 * byte + data[8 * i + k]
        whole[i] = byte
    # CRC-32/ISO-HDLC is defined on bits that come least significant first, hence the reversed polynomial.
    crc = 0xFFFFFFFF
    for i in range(n_bytes - 4):
        crc ^= whole[i]
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    crc ^= 0xFFFFFFFF
    read = 0
    for i in range(n_bytes - 4, n_bytes):
        read = (read << 8) | whole[i]
    return bool(crc == read)
