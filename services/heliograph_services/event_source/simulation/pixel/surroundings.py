"""Pixels that no light rules: one comparison each an interval, and the exact law only for the few that may act.

Between views u goes on a straight line, and v lies among the values that u has had: so while u + drift t stays between
`low` and `high`, a pixel cannot act, and nothing of it is computed. A pixel that is to be looked at is first brought up
to date through the last HISTORY views. One that slept longer began at the oldest of them in the steady state of a ramp,
v = u - s tau; the error is what is left of older changes of slope, exp(-(HISTORY - 1) intervals / tau).

In a still view even the comparison is made once for all time to a horizon; what it finds is looked at every interval.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numba
import numpy as np

from heliograph_services.event_source.simulation.contract import BACKGROUND, LEAK, Floats, Ints
from heliograph_services.event_source.simulation.pixel.leaf import leaf
from heliograph_services.event_source.simulation.pixel.model import (
    BASE,
    CLAIMED,
    DEAD,
    DRIFT,
    LIGHT,
    OFF,
    ON,
    REF,
    TAU_LIGHT,
    TAU_MIN,
    Floats32,
    Indices,
    Pixels,
    T,
    Tables,
    U,
    V,
)
from heliograph_services.event_source.simulation.pixel.response import RESERVE, advance, fade, grow

HISTORY: Final = 8
# Pixels that are compared at once, by vector instructions; only where one of them may act are they looked at singly.
BLOCK: Final = 64
# `low` and `high` are float32: so much tighter than what they round.
MARGIN: Final = 1e-5
# Change of u over which tau, which goes with the light, is taken as that of the middle: it then errs by an eighth.
PIECE: Final = 0.25
PIECES: Final = 8
# An ON event of a pixel whose input and output stand still is the leak's.
STILL: Final = 1e-3

# Of a step, e^-20 is 2e-9: what lies further back than so many time constants does not matter.
FORGOTTEN: Final = 20.0


class Past(NamedTuple):
    """The last HISTORY views.

    Args:
        times: (HISTORY,) us, the present interval's beginning last.
        rows: (HISTORY,) int64, where each is in `views`.
        views: (HISTORY + 1, pixels) float32.
    """

    times: Floats
    rows: Ints
    views: Tables


@leaf
def set_bounds(state: Floats, law: Floats, low: Floats32, high: Floats32, p: int) -> None:
    """Write what u + drift (t - BASE) must stay between for the pixel to sleep."""
    if state[p, DEAD] > state[p, T]:
        high[p], low[p] = -np.inf, np.inf
        return
    ref = state[p, REF] - law[DRIFT] * law[BASE]
    high[p] = ref + state[p, ON] - MARGIN
    low[p] = ref - state[p, OFF] + MARGIN


@leaf
def rebase(state: Floats, law: Floats, low: Floats32, high: Floats32, t_us: float) -> None:
    """Let all bounds refer to t_us: float32 would lose what an hour's drift adds."""
    law[BASE] = t_us
    for p in range(len(high)):
        if state[p, CLAIMED] == 0.0:
            set_bounds(state, law, low, high, p)


@leaf
def candidates(
    law: Floats, low: Floats32, high: Floats32, view0: Floats32, view1: Floats32, t0_us: float, t1_us: float,
    out: Indices,
) -> int:  # fmt: skip
    """Write the pixels that may act in [t0_us, t1_us] in rising order; return how many."""
    d0 = np.float32(law[DRIFT] * (t0_us - law[BASE]))
    d1 = np.float32(law[DRIFT] * (t1_us - law[BASE]))
    n = len(high)
    found = 0
    for start in range(0, n, BLOCK):
        end = min(start + BLOCK, n)
        any_of_them = np.int32(0)
        a, b, over, under = view0[start:end], view1[start:end], high[start:end], low[start:end]
        for p in range(end - start):
            # All in int32, no branches: that is what becomes vector instructions.
            any_of_them |= (
                np.int32(a[p] + d1 >= over[p]) | np.int32(b[p] + d1 >= over[p])
                | np.int32(a[p] + d0 <= under[p]) | np.int32(b[p] + d0 <= under[p])
            )  # fmt: skip
        if any_of_them:
            for p in range(start, end):
                u_high, u_low = max(view0[p], view1[p]), min(view0[p], view1[p])
                if u_high + d1 >= high[p] or u_low + d0 <= low[p]:
                    out[found] = p
                    found += 1
    return found


@leaf
def catch_up(state: Floats, law: Floats, p: int, past: Past) -> None:
    """Bring a sleeping pixel to the last time of the past."""
    times, rows, views = past.times, past.rows, past.views
    last = len(times) - 1
    t, now = state[p, T], times[last]
    if t >= now:
        return
    tau_light, tau_min = law[TAU_LIGHT], law[TAU_MIN]
    u_b = np.float64(views[rows[last], p])
    light = math.exp(u_b)
    first, forgotten = last, FORGOTTEN * max(tau_min, tau_light / light)
    while first > 0 and times[first] > t and now - times[first] < forgotten:
        first -= 1
    # Older than the past, or forgotten: in the steady state of the first ramp.
    known = times[first] <= t
    v = state[p, V]
    u_a = np.float64(views[rows[first], p])
    for k in range(first, last):
        u_b = np.float64(views[rows[k + 1], p])
        span = times[k + 1] - max(times[k], t)
        if span > 0.0:
            tau = max(tau_min, tau_light * math.exp(-0.5 * (u_a + u_b)))
            lag = (u_b - u_a) / (times[k + 1] - times[k]) * tau
            if not known:
                v, known = u_a - lag, True
            v = u_b - lag + (v - u_a + lag) * fade(span / tau)
        u_a = u_b
    # It slept: so it lay between its thresholds, whatever the steady state of a ramp would be.
    ref = state[p, REF] - law[DRIFT] * now
    state[p, V] = min(max(v, ref - state[p, OFF]), ref + state[p, ON])
    state[p, U], state[p, LIGHT], state[p, T] = u_b, light, now


@leaf
def _along(
    state: Floats, law: Floats, seed: int, out: Floats, n: int, p: int, t_us: float, u: float, cause: int
) -> int:
    """Take a pixel along a straight line to u, in pieces over which tau may be taken as constant."""
    t_a, u_a = state[p, T], state[p, U]
    pieces = min(int(abs(u - u_a) / PIECE) + 1, PIECES)
    for k in range(1, pieces + 1):
        part = k / pieces
        at, to = (t_a + (t_us - t_a) * part, u_a + (u - u_a) * part) if k < pieces else (t_us, u)
        light = math.exp(to) if to != u_a else state[p, LIGHT]
        n = advance(state, law, seed, out, n, p, at, to, light, cause)
    return n


@leaf
def _look(
    px: Pixels, out: Floats, n: int, found: Indices, k: int, count: int, t1_us: float, view1: Floats32, past: Past
) -> tuple[int, int]:  # fmt: skip
    state, law, low, high, seed = px.state, px.law, px.low, px.high, px.seed
    while k < count and n + PIECES * RESERVE <= len(out):
        p = found[k]
        k += 1
        # A claimed pixel's bounds are infinite, and only a claimed one's like this.
        if high[p] == np.inf or state[p, T] >= t1_us:
            continue
        catch_up(state, law, p, past)
        u = np.float64(view1[p])
        still = u == state[p, U]
        cause = LEAK if still and abs(state[p, V] - u) < STILL else BACKGROUND
        n = _along(state, law, seed, out, n, p, t1_us, u, cause)
        set_bounds(state, law, low, high, p)
    return k, n


@numba.njit(nogil=True)
def look(
    px: Pixels, out: Floats, n: int, found: Indices, count: int, t1_us: float, view1: Floats32, past: Past
) -> tuple[Floats, int]:  # fmt: skip
    """Take the pixels found[:count] to t1_us by the exact law.

    Args:
        px: all pixels.
        out: events.
        n: so many.
        found: pixels; those that lights rule by now are passed over.
        count: so many.
        t1_us: the interval's end.
        view1: (pixels,) the view there.
        past: the views before.

    Returns:
        The events, perhaps elsewhere, and how many there are.
    """
    k = 0
    while True:
        k, n = _look(px, out, n, found, k, count, t1_us, view1, past)
        if k == count:
            return out, n
        out = grow(out)
