"""The state of one track's demodulator: arrays in one tuple, shared by the compiled stages.

Times in it are in nominal bits since the lock's origin. The open slot is number `ints[SLOT]`; slot m lives at m % RING.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from heliograph.link import response
from heliograph.link.clock import SUB, Floats
from heliograph.link.frames import CyclicCode, bits_of
from heliograph.link.likelihood import NEXT

Ints = npt.NDArray[np.int64]

# Slots remembered: ten frames of the longest word (32 bits), what a search of eight frames looks back on.
RING: Final = 320

# Places in `floats`.
BOUNDARY: Final = 0  # b_m of the open slot
PERIOD: Final = 1  # T
HALF: Final = 2  # mu_on = -mu_off
JITTER2: Final = 3  # mean square of the timing error e
LAST_END: Final = 4  # end of the last published frame
TRUST: Final = 5  # A of the aligned position
NEXT_ONE: Final = 6  # how likely the bit after a frame is a one
READ_OUT: Final = 7  # length of the sensor's scans, 0 where its events are none
FLOATS: Final = 8

# Places in `ints`.
SLOT: Final = 0  # slots closed since the lock
ALIGNED: Final = 1  # position of the frames, or -1
SEARCHED: Final = 2  # slots since the search began; 0 when aligned
SILENT: Final = 3  # slots since the last transition
OUT: Final = 4  # records in `out`
EDGES: Final = 5  # transitions since the lock
RUN: Final = 6  # longest legal run
GRID_WORD: Final = 7  # the word whose frames `grid` sums, or -1
GRID_FRAMES: Final = 8
INTS: Final = 9

# Columns of `facts`.
AT: Final = 0  # the boundary b_m
EDGE: Final = 1  # probability of a transition
EVENTS: Final = 2
OUTSIDE: Final = 3  # events where no transition's are expected
NUMBER: Final = 4  # events over the background, OFF and then ON
MOMENT: Final = 6  # the sum of how far those lie behind the boundary, OFF and then ON
SQUARE: Final = 8  # and of its square
FACTS: Final = 10

# Columns of a record in `out`.
OUT_END: Final = 0  # end of the frame
OUT_CODE: Final = 1  # payload, or why it was refused
OUT_SCORE: Final = 2
OUT_MARGIN: Final = 3
OUT_SLOT: Final = 4  # the slot at its end, counted from the lock
OUT_GRID: Final = 5  # what its row's grid bears witness of (`heliograph.link.one_phase`)
OUT_FIELDS: Final = 6
# One slot publishes at most RING / 4 frames at once; the kernel returns to be emptied from OUT_FULL on.
OUT_ROOM: Final = 256
OUT_FULL: Final = 128

# Codes below 0; from HARD downwards the bits themselves: HARD - word.
WEAK: Final = -1
OCCLUSION: Final = -2
OFF_GRID: Final = -3
HARD: Final = -10


class State(NamedTuple):
    """Arrays that the kernels change in place.

    Args:
        words: (W, n) uint8, the code.
        floats: (FLOATS,).
        ints: (INTS,).
        ring: (RING, 4) tempered likelihoods of the slots (`heliograph.link.likelihood`).
        facts: (RING, FACTS).
        counts: (RING, 2, SUB) events of the slots, by polarity (OFF, ON) and sub-bin.
        sums: (n,) A_r of the search (`heliograph.link.alignment`).
        grid: (n, 2, 3) number, moment and square of the events at each boundary of the word, OFF and ON
            (`heliograph.link.one_phase`).
        model: (4, 2, SUB) rates (`heliograph.link.response`).
        seen: (4,) slots learned of each kind.
        logs: (4, 2, SUB), total: (4,), core and share: (2, SUB), figures: what `response.tabulate` makes of the model.
        out: (OUT_ROOM, OUT_FIELDS) records.
    """

    words: npt.NDArray[np.uint8]
    floats: Floats
    ints: Ints
    ring: Floats
    facts: Floats
    counts: npt.NDArray[np.int32]
    sums: Floats
    grid: Floats
    model: Floats
    seen: Ints
    logs: Floats
    total: Floats
    core: npt.NDArray[np.bool_]
    share: Floats
    figures: Floats
    out: Floats


@lru_cache
def _words(words: tuple[int, ...], bits: int) -> npt.NDArray[np.uint8]:
    """Return the words' bits, which no kernel changes: a track that is born every few ms does not unpack them again."""
    return np.array([bits_of(word, bits) for word in words], np.uint8)


def new_state(code: CyclicCode) -> State:
    """Return the state of a track that has no clock yet (55 kB)."""
    return State(
        words=_words(code.words, code.bits),
        floats=np.zeros(FLOATS),
        ints=np.zeros(INTS, np.int64),
        ring=np.ones((RING, 4)),
        facts=np.zeros((RING, FACTS)),
        counts=np.zeros((RING, 2, SUB), np.int32),
        sums=np.zeros(code.bits),
        grid=np.zeros((code.bits, 2, 3)),
        model=np.zeros((4, 2, SUB)),
        seen=np.zeros(4, np.int64),
        logs=np.zeros((4, 2, SUB)),
        total=np.zeros(4),
        core=np.zeros((2, SUB), np.bool_),
        share=np.zeros((2, SUB)),
        figures=np.zeros(response.FIGURES),
        out=np.zeros((OUT_ROOM, OUT_FIELDS)),
    )


def start(
    state: State, folded: Floats | None, found: Floats, last_end: float, read_out: float, code: CyclicCode
) -> None:
    """Begin with a new lock.

    Args:
        state: to be set.
        folded: (2, SUB) of `heliograph.link.clock.grid`; None where the model is set already (`heliograph.link.level`).
        found: (4,) of `heliograph.link.clock.grid`.
        last_end: end of the last published frame, in bits from the new origin.
        read_out: length of the sensor's scans in bits, 0 where its events come in none.
        code: its words, as in `new_state`.
    """
    start_code, start_bits = code.start
    next_one = NEXT if start_bits and start_code >> (start_bits - 1) else 0.5
    state.floats[:] = (found[0], found[1], found[2], 0.0, last_end, 0.0, next_one, read_out)
    state.ints[:] = 0
    state.ints[ALIGNED] = -1
    state.ints[GRID_WORD] = -1
    state.ints[RUN] = code.longest_run
    state.ring[:] = 1.0
    state.facts[:] = 0.0
    state.counts[:] = 0
    state.sums[:] = 0.0
    if folded is not None:
        response.start(folded, found[3], read_out, state.model, state.seen)
    response.tabulate(state.model, state.logs, state.total, state.core, state.share, state.figures)
