"""Where a light turns: from its events to its changes, without a bit rate.

With S the sum of the signed events so far (ON +1, OFF -1), the light turns up where S has risen by h above its last
least value since it turned down, and down where it has fallen by h below its last greatest. Lone events, and tails of
the other polarity, turn nothing. h is a share of the usual swing: that to which half of all that S moves between its
turns belongs; it is measured with h = 1 at first, then with what that gave.

A light rises as often as it falls, but a fall may make several times as many events (a pixel goes on firing while it
darkens). S then sinks, and the whole stretch is one swing. *Balanced*, n_on ON and n_off OFF events weigh ::

    +(n_on + n_off) / (2 n_on)     and     -(n_on + n_off) / (2 n_off)
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import Flags

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Noise that splits swings at h = 1 no longer does at the third.
ROUNDS: Final = 3


@numba.njit(cache=True, nogil=True)
def _turns(
    on: Flags, up: float, down: float, least: float, by_first: bool, at: npt.NDArray[np.int64], swing: Floats
) -> int:
    """Find where S turns by `least` or more; see the module.

    Args:
        on: (n,) polarities.
        up: what an ON event adds to S.
        down: what an OFF event takes from it.
        least: h.
        by_first: a turn is where its first event is; otherwise where it is complete.
        at: (n,) out: the event of each turn; turns alternate.
        swing: (n,) out: what S moves from it to the next turn, > 0 where that is a rise.

    Returns:
        The number of turns.
    """
    total = low = high = 0.0
    low_at = high_at = -1
    rising = falling = False
    turns = 0
    for i in range(len(on)):
        total += up if on[i] else -down
        if not rising and total - low >= least:
            if falling:
                swing[turns - 1] = low - high
            at[turns] = low_at + 1 if by_first else i
            turns, rising, falling = turns + 1, True, False
            high, high_at = total, i
        elif not falling and high - total >= least:
            if rising:
                swing[turns - 1] = high - low
            at[turns] = high_at + 1 if by_first else i
            turns, rising, falling = turns + 1, False, True
            low, low_at = total, i
        if not falling and total >= high:
            high, high_at = total, i
        if not rising and total <= low:
            low, low_at = total, i
    if turns:
        swing[turns - 1] = high - low if rising else low - high
    return turns


def _weights(on: Flags) -> tuple[float, float]:
    rises, n = int(np.count_nonzero(on)), len(on)
    return (n / (2.0 * rises), n / (2.0 * (n - rises))) if 0 < rises < n else (1.0, 1.0)


def turns(on: Flags, share: float, *, by_first: bool, balanced: bool = False) -> tuple[Ints, Floats]:
    """Return the turns of a light.

    Args:
        on: (n,) polarities of its events, in order of time.
        share: h, in usual swings.
        by_first: a turn is where its first event is; otherwise where it is complete.
        balanced: the rarer polarity weighs more (see the module).

    Returns:
        (m,) the event of each turn, and (m,) what S moves from it to the next one, > 0 where it rises; they alternate.
    """
    # A kernel is compiled anew for arrays that may not be written, such as those that came over a wire.
    on = np.require(on, requirements=("C", "W"))
    at, swing = np.empty(len(on), np.int64), np.empty(len(on))
    up, down = _weights(on) if balanced else (1.0, 1.0)
    least, n = 1.0, 0
    for _ in range(ROUNDS):
        n = _turns(on, up, down, least, by_first, at, swing)
        if n == 0:
            break
        sizes = np.sort(np.abs(swing[:n]))[::-1]
        moved = np.cumsum(sizes)
        least = max(1.0, share * float(sizes[np.searchsorted(moved, 0.5 * moved[-1])]))
    return at[:n], swing[:n]
