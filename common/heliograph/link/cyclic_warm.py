"""Compiles the kernels of the default receiver of cyclic codes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heliograph.link import clock
from heliograph.link.cyclic import CyclicReceiver
from heliograph.link.cyclic_scans import AS_GOOD
from heliograph.link.frames import bits_of, seed11_code


def warm() -> None:
    """Compile (or load from the cache) all kernels: synthetic frames, sharp and scanned ones, through a receiver."""
    code = seed11_code()
    bits: list[int] = [bit for k in range(60) for bit in bits_of(code.words[(42, 50, 53)[k % 3]], code.bits)]
    levels = np.array([0, *bits, 0])
    edges = np.flatnonzero(np.diff(levels))
    t_us: npt.NDArray[np.int64] = np.repeat(edges * 1000, 4)
    rises: npt.NDArray[np.bool_] = np.diff(levels)[edges] > 0
    # Scans of .4 bit, three of which show an edge.
    late_us: npt.NDArray[np.int64] = np.repeat((edges * 1000 // 400 * 400)[:, None] + 400 * np.arange(3), 4, axis=1)
    for times_us, on in ((t_us, np.repeat(rises, 4)), (late_us.ravel(), np.repeat(rises, 12))):
        receiver = CyclicReceiver(code, 1000.0)
        order = np.argsort(times_us, kind="stable")
        receiver.feed(times_us[order], on[order], 700_000)
        receiver.flush()
    # What scans of half a bit ask for besides.
    clock.lobes(np.zeros((clock.LONG_BLOCKS, clock.SUMS)), AS_GOOD)
