"""The kernel of the scanned read-out: what `scan.py` describes, event by event and column by column.

A pixel waits while `held` is not 0: its sign is the polarity, its size the crossings behind it. Each column keeps a
list of its pixels that may wait (`first` of the column, `following` of the pixel), so that a scan costs what it reads.
`rows` is room for a column's active rows.
"""

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np

# Places of the parameters, of the state and of the counts in their arrays.
WIDTH, GROUP_PX, GROUP_NS, COLUMN_NS, NEXT_NS, DETECT_NS, FIXED_NS, STRETCH_NS, LATCH, SAMPLE, STAMP = range(11)
START, PHASE, COLUMN, NOW, END = range(5)
IN, READ, MERGED, CANCELLED, BEFORE_RESET, NO_TIME, WAITING, SCANS = range(8)

DETECTING, READING, ENDING = range(3)
FIRST, NET, STEP = range(3)
AT_HOLD, AT_COLUMN = range(2)
AT_START, AT_TURN, AT_END = range(3)
# Up to here insertion is faster than a call of sort; a beacon has some ten rows in a column.
SHORT = 24


# A pixel: crossings held (sign: polarity), their cause, when it was read last, the next pixel of its column that may
# wait (-1: none), and whether it is in that list. One record a pixel: what is used together lies together.
PIXEL: Final = np.dtype(
    [("reset_ns", np.int64), ("held", np.int32), ("following", np.int32), ("label", np.int16), ("listed", np.bool_)],
    align=True,
)
# An event read.
EVENT: Final = np.dtype(
    [("t_us", np.int64), ("x_px", np.uint16), ("y_px", np.uint16), ("label", np.int16), ("on", np.bool_)], align=True
)


@numba.njit(nogil=True, inline="always")
def _list(p: Any, x: Any, pixels: Any, first: Any) -> None:
    pixels[p].listed, pixels[p].following, first[x] = True, first[x], p


@numba.njit(nogil=True, inline="always")
def _cross(p: Any, on: Any, cause: Any, ns: Any, par: Any, counts: Any, pixels: Any, first: Any) -> None:
    """Let pixel p cross a threshold."""
    counts[IN] += 1
    if ns < pixels[p].reset_ns:
        counts[BEFORE_RESET] += 1
        return
    before, step = pixels[p].held, 1 if on else -1
    if par[LATCH] == FIRST and before != 0:
        counts[MERGED] += 1
        return
    pixels[p].held = before + step
    if before * step < 0:
        counts[CANCELLED] += 2
        counts[WAITING] -= 1
        return
    counts[WAITING] += 1
    if before == 0:
        pixels[p].label = cause
        if not pixels[p].listed:
            _list(p, p % par[WIDTH], pixels, first)


@numba.njit(nogil=True, inline="always")
def _active_rows(x: Any, width: Any, pixels: Any, first: Any, rows: Any) -> Any:
    """Empty a column's list into `rows`, sorted; return how many have an event."""
    n, p = 0, first[x]
    first[x] = -1
    while p >= 0:
        pixels[p].listed = False
        if pixels[p].held != 0:
            rows[n] = p // width
            n += 1
        p = pixels[p].following
    if n > SHORT:
        rows[:n].sort()
        return n
    for k in range(1, n):
        row, j = rows[k], k
        while j > 0 and rows[j - 1] > row:
            rows[j] = rows[j - 1]
            j -= 1
        rows[j] = row
    return n


@numba.njit(nogil=True, inline="always")
def _column_ns(n: Any, par: Any, rows: Any) -> Any:
    """Return what a column costs whose active pixels are `rows`[:n], sorted."""
    groups, last = 0, -1
    for k in range(n):
        group = rows[k] // par[GROUP_PX]
        if group != last:
            groups, last = groups + 1, group
    return max(par[NEXT_NS], par[COLUMN_NS] + groups * par[GROUP_NS])


@numba.njit(cache=True, nogil=True)
def quiet_ns(par: Any) -> Any:
    """Return how long a scan takes that has nothing to read."""
    if par[FIXED_NS] > 0:
        return par[FIXED_NS] + par[STRETCH_NS]
    return par[DETECT_NS] + par[WIDTH] * max(par[NEXT_NS], par[COLUMN_NS]) + par[STRETCH_NS]


@numba.njit(nogil=True, inline="always")
def _skip_scans(next_ns: Any, until_ns: Any, par: Any, state: Any, counts: Any) -> None:
    """Pass over whole scans in which nothing can be: no pixel waits, and no event comes before they end."""
    ahead = int((min(next_ns, until_ns) - state[START]) // quiet_ns(par))
    if ahead > 0:
        state[START] += ahead * quiet_ns(par)
        counts[SCANS] += ahead


@numba.njit(nogil=True, inline="always")
def _skip_columns(par: Any, state: Any, first: Any) -> None:
    """Pass over columns that have nothing, up to the last one; all pixels have been sampled."""
    x, empty_ns = state[COLUMN], max(par[NEXT_NS], par[COLUMN_NS])
    while x < par[WIDTH] - 1 and first[x] < 0:
        x += 1
    state[NOW] += (x - state[COLUMN]) * empty_ns
    state[COLUMN] = x


@numba.njit(nogil=True, inline="always")
def _read(x: Any, n: Any, par: Any, state: Any, counts: Any, pixels: Any, first: Any, rows: Any, out: Any,
          written: Any) -> Any:  # fmt: skip
    """Read the n pixels in `rows` of column x at state[NOW]; return how many events are written then."""
    at_us = (state[NOW] if par[STAMP] == AT_TURN else state[START] + par[DETECT_NS]) // 1000
    # Scan 0 may have begun before the scene did.
    at_us = max(0, at_us)
    for k in range(n):
        row = rows[k]
        p = row * par[WIDTH] + x
        held = pixels[p].held
        event = out[written]
        event.t_us, event.x_px, event.y_px, event.on, event.label = at_us, x, row, held > 0, pixels[p].label
        written += 1
        if par[LATCH] == STEP:
            pixels[p].held = held - 1 if held > 0 else held + 1
            counts[WAITING] -= 1
            if pixels[p].held != 0:
                _list(p, x, pixels, first)
        else:
            pixels[p].held = 0
            pixels[p].reset_ns = state[NOW]
            counts[WAITING] -= abs(held)
            counts[MERGED] += abs(held) - 1
    counts[READ] += n
    return written


@numba.njit(nogil=True, inline="always")
def _lose(x: Any, n: Any, par: Any, counts: Any, pixels: Any, rows: Any) -> None:
    """Forget what the n pixels in `rows` of column x hold."""
    for k in range(n):
        p = rows[k] * par[WIDTH] + x
        counts[NO_TIME] += abs(pixels[p].held)
        counts[WAITING] -= abs(pixels[p].held)
        pixels[p].held = 0


@numba.njit(nogil=True, inline="always")
def _column(par: Any, state: Any, counts: Any, pixels: Any, first: Any, rows: Any, out: Any, written: Any) -> Any:
    """Go through the next column; return how many events are written then."""
    if par[SAMPLE] == AT_HOLD:
        _skip_columns(par, state, first)
    x, stop_ns = state[COLUMN], state[START] + par[FIXED_NS]
    n = _active_rows(x, par[WIDTH], pixels, first, rows)
    cost_ns = _column_ns(n, par, rows)
    if par[FIXED_NS] > 0 and state[NOW] + cost_ns > stop_ns:
        _lose(x, n, par, counts, pixels, rows)
        # No later column is begun either.
        state[NOW] = max(state[NOW], stop_ns)
    else:
        written = _read(x, n, par, state, counts, pixels, first, rows, out, written)
        state[NOW] += cost_ns
    state[COLUMN] = x + 1
    if x + 1 == par[WIDTH]:
        state[PHASE] = ENDING
        state[END] = (stop_ns if par[FIXED_NS] > 0 else state[NOW]) + par[STRETCH_NS]
    return written


@numba.njit(nogil=True, inline="always")
def _needed_ns(par: Any, state: Any) -> Any:
    """Return up to when all events must be known for the next thing to be done."""
    if state[PHASE] == ENDING:
        return state[END]
    if state[PHASE] == READING and par[SAMPLE] == AT_COLUMN:
        return state[NOW]
    return state[START] + par[DETECT_NS]


@numba.njit(cache=True, nogil=True)
def run(t_us: Any, pixel: Any, on: Any, cause: Any, until_ns: Any, par: Any, state: Any, counts: Any, pixels: Any,
        first: Any, rows: Any, out: Any, written: Any) -> Any:  # fmt: skip
    """Go on with the scans as far as the events known before until_ns (float) allow.

    All events are taken in at once, whichever scan will read them: where it must pause, nothing but crossings can
    happen before until_ns. `written` events, of a scan begun, are in `out` already.

    Returns:
        Events in `out` of whole scans, and all events in it.
    """
    n, i, done = len(t_us), 0, 0
    while True:
        if state[PHASE] == DETECTING and counts[WAITING] == 0:
            _skip_scans(t_us[i] * 1000.0 if i < n else until_ns, until_ns, par, state, counts)
        needed_ns = _needed_ns(par, state)
        pausing = until_ns < needed_ns
        # What crosses after the last column belongs to the next scan, whose detection takes it in.
        while i < n and (pausing or (state[PHASE] != ENDING and t_us[i] * 1000.0 < needed_ns)):
            _cross(pixel[i], on[i], cause[i], t_us[i] * 1000.0, par, counts, pixels, first)
            i += 1
        if pausing:
            return done, written
        if state[PHASE] == DETECTING:
            state[PHASE], state[COLUMN], state[NOW] = READING, 0, needed_ns
        elif state[PHASE] == READING:
            written = _column(par, state, counts, pixels, first, rows, out, written)
        else:
            if par[STAMP] == AT_END:
                for k in range(done, written):
                    out[k].t_us = state[END] // 1000
            state[START], state[PHASE], done = state[END], DETECTING, written
            counts[SCANS] += 1
