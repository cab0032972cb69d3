"""Events that no light makes: shot noise, and hot pixels.

In every pixel a Poisson process of its own. All of them together are one Poisson process of the sum of their rates,
each of whose events falls to a pixel at random (superposition and marking; Kingman, Poisson Processes, 1993): so their
cost goes with the events, not with the pixels. Time is cut into blocks of BLOCK_US since 0; block b has
``poisson_count(b)`` events, the k-th at ``uniform(b, k)`` in a pixel ``uniform(b, k)`` with an even polarity. None
touches its pixel's reference. Latency and jitter would leave a Poisson process as it is: they are left out.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from heliograph_services.event_source.simulation.contract import Floats, Ints
from heliograph_services.event_source.simulation.pixel.response import TICKS, grow, write
from heliograph_services.event_source.simulation.random import bits, poisson_count, uniform

BLOCK_US: Final = 1_000


@numba.njit(nogil=True)
def sprinkle(
    out: Floats, n: int, seed: int, purpose: int, cause: int, rate_hz: float, pixels: Ints, count: int, block: int
) -> tuple[Floats, int]:
    """Write the events of a block.

    Args:
        out: events.
        n: so many.
        seed: of the random numbers.
        purpose: of them.
        cause: of the events.
        rate_hz: of a pixel.
        pixels: those concerned; empty: 0 to count - 1.
        count: how many are concerned.
        block: the number of the block.

    Returns:
        The events, perhaps elsewhere, and how many there are.
    """
    made = poisson_count(seed, purpose, block, -1, 0, rate_hz * count * (BLOCK_US * 1e-6))
    while n + made > len(out):
        out = grow(out)
    for k in range(made):
        which = min(int(uniform(seed, purpose, block, k, 0) * count), count - 1)
        t = (block + uniform(seed, purpose, block, k, 1)) * BLOCK_US
        t = np.floor(t * TICKS) / TICKS
        on = (bits(seed, purpose, block, k, 2) & np.uint64(1)) == np.uint64(1)
        n = write(out, n, t, pixels[which] if len(pixels) > 0 else which, on, cause)
    return out, n
