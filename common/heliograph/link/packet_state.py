"""The state of one track's packet demodulator: arrays in one tuple, shared by the compiled stages.

As in `heliograph.link.state`, whose places in `floats`, `ints` and `facts` hold here too, for the stages that both
share; slot m lives at m mod the ring's length, which holds a packet.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple, cast

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link import clock, packet_response, response
from heliograph.link import state as shared
from heliograph.link.clock import SUB, Floats
from heliograph.link.convolutional import TAIL
from heliograph.link.packet_layout import Ints, Layout
from heliograph.link.packet_response import FIGURES, ROWS
from heliograph.link.stamp import stamp
from heliograph.link.viterbi import SIGNS, Octets

# Further places in `ints`.
NEXT: Final = shared.INTS  # the slot before the packet that may follow the last one; -1 where none was read
INTS: Final = NEXT + 1

# A packet of n bits has n + 1 slots, and one more is open.
SLOTS_MORE: Final = 2

# Columns of a record in `out`.
OUT_END: Final = 0  # end of the packet
OUT_GOOD: Final = 1  # 1: read, 0: its check is wrong
OUT_EVIDENCE: Final = 2
OUT_FIELDS: Final = 3
# A slot writes one record at most; the kernel returns to be emptied when they are full.
OUT_ROOM: Final = 8


class PacketState(NamedTuple):
    """Arrays that the kernels change in place.

    Args:
        floats: (shared.FLOATS,).
        ints: (INTS,).
        ring: (slots, 8) tempered likelihoods.
        facts: (slots, shared.FACTS), of which the boundary and the probability of a transition are set.
        counts: (slots, 2, SUB) events, by polarity (OFF, ON) and sub-bin.
        model, seen, logs, total, figures: (8, ...) as in `heliograph.link.packet_response`.
        sync, mother, flip, signs: the packet (`heliograph.link.packet_soft.decide`).
        data, sent, whole: what was decided last: bits before the code, bits on the air, bytes.
        out: (OUT_ROOM, OUT_FIELDS) records.
        read: (OUT_ROOM, bytes) HEADER, DATA and CRC of each.
    """

    floats: Floats
    ints: Ints
    ring: Floats
    facts: Floats
    counts: npt.NDArray[np.int32]
    model: Floats
    seen: Ints
    logs: Floats
    total: Floats
    figures: Floats
    sync: Octets
    mother: Ints
    flip: Octets
    signs: Floats
    data: Octets
    sent: Octets
    whole: Octets
    out: Floats
    read: Octets


def new_state(layout: Layout) -> PacketState:
    """Return the state of a track that has no clock yet (70 kB with 16 bytes of data)."""
    slots, n_bytes = layout.bits + SLOTS_MORE, (layout.steps - TAIL) // 8
    tables = layout.tables()
    return PacketState(
        floats=np.zeros(shared.FLOATS),
        ints=np.zeros(INTS, np.int64),
        ring=np.ones((slots, ROWS)),
        facts=np.zeros((slots, shared.FACTS)),
        counts=np.zeros((slots, 2, SUB), np.int32),
        model=np.zeros((ROWS, 2, SUB)),
        seen=np.zeros(ROWS, np.int64),
        logs=np.zeros((ROWS, 2, SUB)),
        total=np.zeros(ROWS),
        figures=np.zeros(FIGURES),
        sync=tables.sync,
        mother=tables.mother,
        flip=tables.flip,
        signs=SIGNS.copy(),
        data=np.zeros(layout.steps, np.uint8),
        sent=np.zeros(layout.bits, np.uint8),
        whole=np.zeros(n_bytes, np.uint8),
        out=np.zeros((OUT_ROOM, OUT_FIELDS)),
        read=np.zeros((OUT_ROOM, n_bytes), np.uint8),
    )


def _entry(sources: int) -> Callable[[Floats, Floats, Floats, Floats], None]:
    """Return `packet_response.tabulate`, cached under these sources (`heliograph.link.stamp`)."""

    @numba.njit(cache=True, nogil=True)
    def kernel(rate: Floats, logs: Floats, total: Floats, figures: Floats) -> None:
        if sources >= 0:
            packet_response.tabulate(rate, logs, total, figures)

    return cast("Callable[[Floats, Floats, Floats, Floats], None]", kernel)


_TABULATE: Final = _entry(stamp(clock, packet_response, response))


def start(state: PacketState, folded: Floats | None, found: Floats) -> None:
    """Begin with a new lock.

    Args:
        state: to be set.
        folded: (2, SUB) of `heliograph.link.clock.grid`; None where the model is set already (`heliograph.link.level`).
        found: (4,) of `heliograph.link.clock.grid`.
    """
    state.floats[:] = 0.0
    state.floats[shared.BOUNDARY], state.floats[shared.PERIOD], state.floats[shared.HALF] = found[:3]
    state.ints[:] = 0
    state.ints[NEXT] = -1
    state.ring[:] = 1.0
    state.facts[:] = 0.0
    state.counts[:] = 0
    if folded is not None:
        pairs, seen = np.zeros((4, 2, SUB)), np.zeros(4, np.int64)
        response.start(folded, found[3], 0.0, pairs, seen)
        packet_response.from_pairs(pairs, state.model)
    state.seen[:] = 0
    _TABULATE(state.model, state.logs, state.total, state.figures)
