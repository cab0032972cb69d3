"""The state of the demodulator of scanned light (`heliograph.link.scan_demodulator`), beside that of every track.

Times are in nominal bits since the lock's origin, as in `heliograph.link.state`, whose `floats`, `ints`, `ring`,
`facts`, `sums` and `out` serve here too: slot `ints[SLOT]` there is the next to be judged, LAG behind the open one.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from heliograph.link.clock import SUB, Floats
from heliograph.link.scan_response import CONTEXTS
from heliograph.link.state import RING

# Slots that a slot's bits are judged by besides the ones before: a fall shows for a bit and more.
LAG: Final = 3
# Scans of a slot: where a bit has more, the light needs no scans (`heliograph.link.scans.LEAST`).
ROOM: Final = 16

# Places in `floats`.
QUANTUM: Final = 0  # length of a scan
SCAN: Final = 1  # time of the newest scan
OFF_EVENTS: Final = 2  # of the newest scan, as long as it may grow
ON_EVENTS: Final = 3
OPEN: Final = 4  # 1 while it may grow
BURST: Final = 5  # events of a burst's scan
END: Final = 6  # of the stream: no scan behind it says anything, not even that it is silent
FLOATS: Final = 7


class ScanState(NamedTuple):
    """Arrays that the kernels change in place.

    Args:
        floats: (FLOATS,).
        turn: (8,) of `heliograph.link.scans`: where the light turned last.
        n: (RING,) int64, scans of the slots.
        scans: (RING, ROOM, 3) sub-bin, OFF events, ON events.
        turned: (RING, 2) of the slots: 1 where the light turned up, -1 down, 0 not; how far behind the boundary.
        before: (RING, 8) how likely the three bits before a slot's boundary are, by all slots before it.
        likely: (RING, 16) likelihoods of the slots.
        rate, mean, shape, least: (16, 2, SUB) and weight, scale: (16, SUB), see `heliograph.link.scan_response`.
    """

    floats: Floats
    turn: Floats
    n: np.ndarray[tuple[int], np.dtype[np.int64]]
    scans: Floats
    turned: Floats
    before: Floats
    likely: Floats
    rate: Floats
    weight: Floats
    mean: Floats
    shape: Floats
    least: Floats
    scale: Floats


def new_scan_state() -> ScanState:
    """Return the state of a track that no scanned light has been found of yet (190 kB)."""
    return ScanState(
        floats=np.zeros(FLOATS),
        turn=np.zeros(8),
        n=np.zeros(RING, np.int64),
        scans=np.zeros((RING, ROOM, 3)),
        turned=np.zeros((RING, 2)),
        before=np.full((RING, 8), 0.125),
        likely=np.ones((RING, CONTEXTS)),
        rate=np.zeros((CONTEXTS, 2, SUB)),
        weight=np.zeros((CONTEXTS, SUB)),
        mean=np.zeros((CONTEXTS, 2, SUB)),
        shape=np.ones((CONTEXTS, 2, SUB)),
        least=np.zeros((CONTEXTS, 2, SUB)),
        scale=np.zeros((CONTEXTS, SUB)),
    )
