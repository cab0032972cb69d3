"""From the likelihoods of slots to a packet: sync, soft bits, decision, check.

Slots. As in `heliograph.link.likelihood`, slot i of a packet is the bit-long interval about the boundary before its bit
i, with the likelihoods l_i[x] of the four pairs of levels, x = 2 before + after; tempered, for whole transitions get
lost (MISSED), and bursts come from elsewhere.

Sync. Its evidence is that of the word s against arbitrary bits, each as likely; a bit position of random bits passes a
threshold of T nats with a chance of at most exp(-T) (Markov), whatever the light is like::

    E = ln prod_i l_i[s_i-1, s_i] - ln mean over all bits of prod_i l_i[b_i-1, b_i]        (before s_0: either)

Soft bits. Levels are a chain: a rise says that it was dark before and is lit behind. A dropped transition leaves two of
one polarity in a row, and the chain knows that the level changed between them, though not where. So bit i is judged
on all slots of its packet (forward-backward over two levels, the bits of the sync known)::

    f_i[b] = sum_a f_i-1[a] l_i[a, b]      g_i[b] = sum_c l_i+1[b, c] g_i+1[c]
    soft_i = ln f_i[0] g_i[0] - ln f_i[1] g_i[1]

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

# One transition in twenty is lost: what the link is made for. With a hundredth the same packets are read on a light
# that loses none, and fewer on one that does (bench/study_packet.py).
MISSED: Final = 0.05
# exp(-10), as for words: two slots of contrary evidence are never outweighed by one more.
FLOOR: Final = 4.5e-5
# Soft bits beyond it are all the same to the decision; one that is wrong must be outvoted by the others.
SOFT_LIMIT: Final = 10.0
# A packet whose bits suit its events less than this many nats better than arbitrary ones was made by chance: 2^-32 is
# worth 22. Packets that are read with every second transition lost have more than 60.
EVIDENCE_LEAST: Final = 22.0


@numba.njit(nogil=True)
def temper(loglikelihood: Floats, out: Floats) -> None:
    """Set out (4,) to a slot's tempered likelihoods, the largest 1."""
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
def evidence(ring: Floats, first: int, word: Octets) -> float:
    """Return E of a word whose first slot is `first` (mod the ring's length), in nats.

    Args:
        ring: (slots, 4) tempered likelihoods.
        first: index of the slot before its first bit.
        word: (n,) bits.
    """
    size = ring.shape[0]
    slot = ring[first % size]
    any0, any1 = 0.25 * (slot[0] + slot[2]), 0.25 * (slot[1] + slot[3])
    as_sent = np.log(0.5 * (slot[1] + slot[3]) if word[0] else 0.5 * (slot[0] + slot[2]))
    scale = 0.0
    for i in range(1, len(word)):
        slot = ring[(first + i) % size]
        as_sent += np.log(slot[2 * word[i - 1] + word[i]])
        any0, any1 = 0.5 * (any0 * slot[0] + any1 * slot[2]), 0.5 * (any0 * slot[1] + any1 * slot[3])
        if i % 16 == 0:
            whole = any0 + any1
            scale += np.log(whole)
            any0, any1 = any0 / whole, any1 / whole
    return float(as_sent - scale - np.log(any0 + any1))


@numba.njit(nogil=True)
def soft_bits(ring: Floats, first: int, sync: Octets, soft: Floats) -> None:
    """Set soft (n,) to ln P(0) / P(1) of the bits behind a sync.

    Args:
        ring: (slots, 4) tempered likelihoods.
        first: index of the slot before the sync's first bit.
        sync: (s,) its bits.
        soft: (n,) out.
    """
    size, n, start = ring.shape[0], len(soft), first + len(sync)
    forward = np.empty((n, 2))
    f0, f1 = (0.0, 1.0) if sync[-1] else (1.0, 0.0)
    for i in range(n):
        slot = ring[(start + i) % size]
        f0, f1 = f0 * slot[0] + f1 * slot[2], f0 * slot[1] + f1 * slot[3]
        whole = f0 + f1
        f0, f1 = f0 / whole, f1 / whole
        forward[i, 0], forward[i, 1] = f0, f1
    slot = ring[(start + n) % size]
    g0, g1 = slot[0] + slot[1], slot[2] + slot[3]
    for i in range(n - 1, -1, -1):
        whole = g0 + g1
        g0, g1 = g0 / whole, g1 / whole
        p0, p1 = forward[i, 0] * g0, forward[i, 1] * g1
        value = np.log(max(p0, 1e-30)) - np.log(max(p1, 1e-30))
        soft[i] = min(max(value, -SOFT_LIMIT), SOFT_LIMIT)
        slot = ring[(start + i) % size]
        g0, g1 = slot[0] * g0 + slot[1] * g1, slot[2] * g0 + slot[3] * g1


@numba.njit(nogil=True)
def decide(
    ring: Floats, first: int, sync: Octets, mother: Ints, flip: Octets, signs: Floats, data: Octets, sent: Octets
) -> float:
    """Decide a packet; return its evidence.

    Args:
        ring: (slots, 4) tempered likelihoods; the packet's last slot is first + s + N.
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
