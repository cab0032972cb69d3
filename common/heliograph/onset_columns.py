"""The columns of `Onsets` as bytes: what crosses a radio link, so a byte and a bit an active pixel and tick.

One zlib stream of, one after another (k ticks, n entries, m steps)::

    per_tick 2 k: u2, entries of each tick; their sum is n
    counts   n: u1, on_count + 16 off_count, each at most 15, which means 15 or more
    steps    m: u1, where the entries lie

Within a tick, entries rise by i = y W + x, with W = ceil(width / pool_px) pixels in a row. An entry is written as the
pixels that were skipped since the one before (since the row's first pixel of all, for a tick's first): i - i' - 1, or
i. A step of 255 skips as many and goes on with the next step; any other ends its entry. So with the running sums of
the steps, one entry behind each step that is not 255::

    at = cumsum(steps)[steps != 255] + arange(n)        i = at - (1 + at of the tick before's last entry)

Measured on 1 Mev/s of noise, moving texture and twenty beacons: 1.2 bytes an entry, where 16 bits for x and for y and
8 for each count leave 2.3; tiles, Morton order and pixels named once for all ticks of a message gain no more than 3 %.
"""

from __future__ import annotations

import zlib
from typing import Any, Final

import numpy as np
import numpy.typing as npt

COUNT_LIMIT: Final = 15
TICK_ENTRIES_LIMIT: Final = 65_535
# Level 6 packs 7 % smaller than level 1, in three times its time: .7 ms of a message of twenty beacons and 1 Mev/s,
# which a slow link is worth and one computer is not. Level 9 gains one percent more.
SMALLEST: Final = 6
QUICKEST: Final = 1
_SKIP: Final = 255

Ints = npt.NDArray[np.int64]


def pack_columns(
    per_tick: npt.NDArray[Any],
    x_px: npt.NDArray[Any],
    y_px: npt.NDArray[Any],
    on_count: npt.NDArray[Any],
    off_count: npt.NDArray[Any],
    row: int,
    level: int = QUICKEST,
) -> tuple[int, bytes]:
    """Return the number of steps and the packed columns.

    Args:
        per_tick: (k,) entries of each tick.
        x_px: (n,) below row; within a tick, entries rise by (y, x).
        y_px: (n,).
        on_count: (n,) events that became brighter; more than 15 are 15.
        off_count: (n,) events that became darker.
        row: W, pixels in a row.
        level: of zlib.

    Raises:
        ValueError: a tick has too many entries, or they do not rise.
    """
    if per_tick.size and per_tick.max() > TICK_ENTRIES_LIMIT:
        # Where more than 65535 pixels are active in a tick the sensor is flooded; pooling must be raised.
        raise ValueError(f"at most {TICK_ENTRIES_LIMIT} active pixels a tick fit the wire, not {per_tick.max()}")
    at = y_px.astype(np.int64) * row + x_px
    skipped = np.diff(at, prepend=-1) - 1
    first = _firsts(per_tick)
    skipped[first] = at[first]
    if len(skipped) and skipped.min() < 0:
        raise ValueError("entries of a tick must rise by (y, x)")
    whole, rest = np.divmod(skipped, _SKIP)
    ends = np.cumsum(whole + 1) - 1
    steps = np.full(int(ends[-1]) + 1 if len(ends) else 0, _SKIP, np.uint8)
    steps[ends] = rest
    counts = np.minimum(on_count, COUNT_LIMIT).astype(np.uint8)
    counts |= np.minimum(off_count, COUNT_LIMIT).astype(np.uint8) << 4
    raw = per_tick.astype("<u2").tobytes() + counts.tobytes() + steps.tobytes()
    return len(steps), zlib.compress(raw, level)


def unpack_columns(raw: bytes, ticks: int, n: int, row: int, rows: int) -> tuple[npt.NDArray[Any], ...]:
    """Return per_tick, x_px, y_px, on_count, off_count of unpacked columns.

    Args:
        raw: the columns without zlib, of the length that ticks, n and the number of steps ask for.
        ticks: k.
        n: entries.
        row: W.
        rows: pixels in a column.

    Raises:
        ValueError: the columns contradict one another, or an entry lies outside the sensor.
    """
    per_tick = np.frombuffer(raw, "<u2", ticks)
    counts = np.frombuffer(raw, np.uint8, n, 2 * ticks)
    steps = np.frombuffer(raw, np.uint8, -1, 2 * ticks + n) if len(raw) > 2 * ticks + n else np.empty(0, np.uint8)
    if int(per_tick.sum(dtype=np.int64)) != n:
        raise ValueError(f"per_tick must add up to n = {n}, not {per_tick.sum(dtype=np.int64)}")
    ends = np.flatnonzero(steps != _SKIP)
    if len(ends) != n or (n and ends[-1] != len(steps) - 1):
        raise ValueError(f"steps must end n = {n} entries, not {len(ends)}")
    at = np.cumsum(steps, dtype=np.int64)[ends] + np.arange(n)
    first = _firsts(per_tick)
    before = np.where(first > 0, at[first - 1] + 1, 0) if n else first
    at -= np.repeat(before, per_tick[per_tick > 0])
    if n and int(at.max()) >= row * rows:
        raise ValueError(f"pixel {at.max()} lies outside {row}x{rows}")
    y_px, x_px = np.divmod(at, row)
    return per_tick, x_px.astype(np.uint16), y_px.astype(np.uint16), counts & 15, counts >> 4


def _firsts(per_tick: npt.NDArray[Any]) -> Ints:
    """Return the index of the first entry of each tick that has any."""
    first: Ints = (np.cumsum(per_tick, dtype=np.int64) - per_tick)[per_tick > 0]
    return first
