"""The kernel of the scanned read-out: what `scan.py` describes, event by event and column by column.

A pixel waits while `held` is not 0: its sign is the polarity, its size the crossings behind it. Each column keeps a
list of its pixels that may wait (`first` of the column, `following` of the pixel), so that a scan costs what it reads.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba

# Places of the parameters, of the state and of the counts in their arrays.
WIDTH, GROUP_PX, GROUP_NS, COLUMN_NS, NEXT_NS, DETECT_NS, FIXED_NS, STRETCH_NS, LATCH, SAMPLE, STAMP = range(11)
START, PHASE, COLUMN, NOW, SCAN_BEGINS, END = range(6)
IN, READ, MERGED, CANCELLED, BEFORE_RESET, NO_TIME, WAITING, SCANS = range(8)

DETECTING, READING, ENDING = range(3)
FIRST, NET, STEP = range(3)
AT_HOLD, AT_COLUMN = range(2)
AT_START, AT_TURN, AT_END = range(3)
# Up to here insertion is faster than a call of sort; a beacon has some ten rows in a column.
SHORT = 24


class Pixels(NamedTuple):
    """What the pixels hold.

    Args:
        held: (pixels,) int32.
        label: (pixels,) int16, cause of what is held.
        reset_ns: (pixels,) int64, when the pixel was read last.
        first: (width,) int32, a pixel of the column that may wait; -1: none.
        following: (pixels,) int32, the next one of its column; -1: none.
        listed: (pixels,) bool.
        rows: (height,) int32, room for a column's active rows.
    """

    held: Any
    label: Any
    reset_ns: Any
    first: Any
    following: Any
    listed: Any
    rows: Any


class Output(NamedTuple):
    """Room for events: t_us int64, x_px and y_px uint16, on bool, labels int16, all of one length."""

    t_us: Any
    x_px: Any
    y_px: Any
    on: Any
    labels: Any


class Crossings(NamedTuple):
    """The pixels' events: t_us float64, pixel int64, on bool, cause int16, all of one length."""

    t_us: Any
    pixel: Any
    on: Any
    cause: Any


@numba.njit(nogil=True)
def _list(p: Any, x: Any, pixels: Any) -> None:
    pixels.listed[p], pixels.following[p], pixels.first[x] = True, pixels.first[x], p


@numba.njit(nogil=True)
def _cross(p: Any, on: Any, cause: Any, ns: Any, par: Any, counts: Any, pixels: Any) -> None:
    """Let pixel p cross a threshold."""
    counts[IN] += 1
    if ns < pixels.reset_ns[p]:
        counts[BEFORE_RESET] += 1
        return
    before, step = pixels.held[p], 1 if on else -1
    if par[LATCH] == FIRST and before != 0:
        counts[MERGED] += 1
        return
    pixels.held[p] = before + step
    if before * step < 0:
        counts[CANCELLED] += 2
        counts[WAITING] -= 1
        return
    counts[WAITING] += 1
    if before == 0:
        pixels.label[p] = cause
        if not pixels.listed[p]:
            _list(p, p % par[WIDTH], pixels)


@numba.njit(nogil=True)
def _active_rows(x: Any, width: Any, pixels: Any) -> Any:
    """Empty a column's list into `rows`, sorted; return how many have an event."""
    rows, n, p = pixels.rows, 0, pixels.first[x]
    pixels.first[x] = -1
    while p >= 0:
        pixels.listed[p] = False
        if pixels.held[p] != 0:
            rows[n] = p // width
            n += 1
        p = pixels.following[p]
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


@numba.njit(nogil=True)
def _column_ns(n: Any, par: Any, rows: Any) -> Any:
    """Return what a column costs whose active pixels are `rows`[:n], sorted."""
    groups, last = 0, -1
    for k in range(n):
        group = rows[k] // par[GROUP_PX]
        if group != last:
            groups, last = groups + 1, group
    return max(par[NEXT_NS], par[COLUMN_NS] + groups * par[GROUP_NS])


@numba.njit(nogil=True)
def _skip_scans(next_ns: Any, until_ns: Any, par: Any, state: Any, counts: Any) -> None:
    """Pass over whole scans in which nothing can be: no pixel waits, and no event comes before they end."""
    quiet_ns = par[FIXED_NS]
    if quiet_ns == 0:
        quiet_ns = par[DETECT_NS] + par[WIDTH] * max(par[NEXT_NS], par[COLUMN_NS])
    quiet_ns += par[STRETCH_NS]
    ahead = int((min(next_ns, until_ns) - state[START]) // quiet_ns)
    if ahead > 0:
        state[START] += ahead * quiet_ns
        counts[SCANS] += ahead


@numba.njit(nogil=True)
def _skip_columns(par: Any, state: Any, pixels: Any) -> None:
    """Pass over columns that have nothing, up to the last one; all pixels have been sampled."""
    x, empty_ns = state[COLUMN], max(par[NEXT_NS], par[COLUMN_NS])
    while x < par[WIDTH] - 1 and pixels.first[x] < 0:
        x += 1
    state[NOW] += (x - state[COLUMN]) * empty_ns
    state[COLUMN] = x


@numba.njit(nogil=True)
def _read(x: Any, n: Any, par: Any, state: Any, counts: Any, pixels: Any, out: Any, written: Any) -> Any:
    """Read the n pixels in `rows` of column x at state[NOW]; return how many events are written then."""
    at_us = (state[NOW] if par[STAMP] == AT_TURN else state[START] + par[DETECT_NS]) // 1000
    for k in range(n):
        row = pixels.rows[k]
        p = row * par[WIDTH] + x
        held = pixels.held[p]
        out.t_us[written], out.x_px[written], out.y_px[written] = at_us, x, row
        out.on[written], out.labels[written] = held > 0, pixels.label[p]
        written += 1
        if par[LATCH] == STEP:
            pixels.held[p] = held - 1 if held > 0 else held + 1
            counts[WAITING] -= 1
            if pixels.held[p] != 0:
                _list(p, x, pixels)
        else:
            pixels.held[p] = 0
            pixels.reset_ns[p] = state[NOW]
            counts[WAITING] -= abs(held)
            counts[MERGED] += abs(held) - 1
    counts[READ] += n
    return written


@numba.njit(nogil=True)
def _lose(x: Any, n: Any, par: Any, counts: Any, pixels: Any) -> None:
    """Forget what the n pixels in `rows` of column x hold."""
    for k in range(n):
        p = pixels.rows[k] * par[WIDTH] + x
        counts[NO_TIME] += abs(pixels.held[p])
        counts[WAITING] -= abs(pixels.held[p])
        pixels.held[p] = 0


@numba.njit(nogil=True)
def _column(par: Any, state: Any, counts: Any, pixels: Any, out: Any, written: Any) -> Any:
    """Go through the next column; return how many events are written then."""
    if par[SAMPLE] == AT_HOLD:
        _skip_columns(par, state, pixels)
    x, stop_ns = state[COLUMN], state[START] + par[FIXED_NS]
    n = _active_rows(x, par[WIDTH], pixels)
    cost_ns = _column_ns(n, par, pixels.rows)
    if par[FIXED_NS] > 0 and state[NOW] + cost_ns > stop_ns:
        _lose(x, n, par, counts, pixels)
        # No later column is begun either.
        state[NOW] = max(state[NOW], stop_ns)
    else:
        written = _read(x, n, par, state, counts, pixels, out, written)
        state[NOW] += cost_ns
    state[COLUMN] = x + 1
    if x + 1 == par[WIDTH]:
        state[PHASE] = ENDING
        state[END] = (stop_ns if par[FIXED_NS] > 0 else state[NOW]) + par[STRETCH_NS]
        if par[STAMP] == AT_END:
            out.t_us[state[SCAN_BEGINS] : written] = state[END] // 1000
    return written


@numba.njit(nogil=True)
def _needed_ns(par: Any, state: Any) -> Any:
    """Return up to when all events must be known for the next thing to be done."""
    if state[PHASE] == ENDING:
        return state[END]
    if state[PHASE] == READING and par[SAMPLE] == AT_COLUMN:
        return state[NOW]
    return state[START] + par[DETECT_NS]


@numba.njit(cache=True, nogil=True)
def run(events: Any, until_ns: Any, par: Any, state: Any, counts: Any, pixels: Any, out: Any, written: Any) -> Any:
    """Go on with the scans as far as the events known before until_ns (float) allow.

    All events are taken in at once, whichever scan will read them: where it must pause, nothing but crossings can
    happen before until_ns. `written` events, of a scan begun, are in `out` already.

    Returns:
        Events in `out` of whole scans, and all events in it.
    """
    n, i, done = len(events.t_us), 0, 0
    while True:
        if state[PHASE] == DETECTING and counts[WAITING] == 0:
            _skip_scans(events.t_us[i] * 1000.0 if i < n else until_ns, until_ns, par, state, counts)
        needed_ns = _needed_ns(par, state)
        pausing = until_ns < needed_ns
        # What crosses after the last column belongs to the next scan, whose detection takes it in.
        while i < n and (pausing or (state[PHASE] != ENDING and events.t_us[i] * 1000.0 < needed_ns)):
            _cross(events.pixel[i], events.on[i], events.cause[i], events.t_us[i] * 1000.0, par, counts, pixels)
            i += 1
        if pausing:
            return done, written
        if state[PHASE] == DETECTING:
            state[PHASE], state[COLUMN], state[NOW], state[SCAN_BEGINS] = READING, 0, needed_ns, written
        elif state[PHASE] == READING:
            written = _column(par, state, counts, pixels, out, written)
        else:
            state[START], state[PHASE], done = state[END], DETECTING, written
            counts[SCANS] += 1
