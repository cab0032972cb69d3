"""Pixels that lights rule: taken from instant to instant, and let go when they are dark and settled.

A light takes a pixel when it first lights it. From then on the pixel is computed exactly at every instant of the lights
that reach it and at every end of an interval, until no light reaches it and its output has come to rest, or RELEASE_US
have gone by: then it sleeps again (`surroundings`), with its state as it is.
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np

from heliograph_services.event_source.simulation.contract import BACKGROUND, Floats, Ints
from heliograph_services.event_source.simulation.pixel.leaf import leaf
from heliograph_services.event_source.simulation.pixel.model import (
    CLAIMED,
    DEAD,
    DRIFT,
    EXTRA,
    LIGHT,
    OFF,
    ON,
    OWNER,
    REF,
    SKY,
    TOUCHED,
    VIEW,
    Floats32,
    Indices,
    Pixels,
    T,
    U,
    V,
)
from heliograph_services.event_source.simulation.pixel.response import RESERVE, advance, grow
from heliograph_services.event_source.simulation.pixel.spots import (
    CHUNK,
    FLUX,
    LEAST,
    LEVEL,
    NOW,
    SIGMA,
    Chunk,
    Lights,
    X,
    Y,
    arrange,
    at_node,
    step_us,
)
from heliograph_services.event_source.simulation.pixel.surroundings import Past, catch_up, set_bounds

RELEASE_US: Final = 20_000.0
# At rest: nearer to its input than this share of its threshold.
REST: Final = 0.1
# What is left of a sum of light of which everything was taken away again.
NOTHING: Final = 1e-12
# No place in a box.
DONE: Final = (-1, -1)


@leaf
def _claim(px: Pixels, p: int, past: Past, mine: Indices, n_mine: int) -> int:
    catch_up(px.state, px.law, p, past)
    px.state[p, CLAIMED] = 1.0
    px.high[p], px.low[p] = np.inf, -np.inf
    mine[n_mine] = p
    return n_mine + 1


@leaf
def _sky(state: Floats, p: int, view: float) -> float:
    """Return exp(view)."""
    if view != state[p, VIEW]:
        state[p, VIEW], state[p, SKY] = view, math.exp(view)
    return float(state[p, SKY])


@leaf
def _touch(
    state: Floats, law: Floats, seed: int, out: Floats, n: int, p: int, i: int, t_us: float, view: float, still: bool,
    old: float, before: float, after: float,
) -> int:  # fmt: skip
    """Let light i, which gave a pixel `old`, have come to `before` by t_us, and give it `after` from then on."""
    lit = state[p, EXTRA] - old + before
    if lit < NOTHING * (old + before):
        lit = 0.0
    u, light = state[p, U], state[p, LIGHT]
    surroundings = -1.0
    if not (still and before == old):
        surroundings = _sky(state, p, view)
        light = surroundings + lit
        u = math.log(light) if lit > 0.0 else view
    n = advance(state, law, seed, out, n, p, t_us, u, light, int(state[p, OWNER]))
    state[p, OWNER] = i
    state[p, TOUCHED] = t_us
    if after != before:
        lit = lit - before + after
        if lit < NOTHING * (before + after):
            lit = 0.0
        if surroundings < 0.0:
            surroundings = _sky(state, p, view)
        state[p, LIGHT] = surroundings + lit
        state[p, U] = math.log(surroundings + lit) if lit > 0.0 else view
    state[p, EXTRA] = lit
    return n


@leaf
def _weight(wx: Floats, wy: Floats, box: Indices, column: int, row: int, least: float) -> float:
    if column < box[0] or column >= box[1] or row < box[2] or row >= box[3]:
        return 0.0
    w = wx[column - box[0]] * wy[row - box[2]]
    return w if w >= least else 0.0


@leaf
def _both(old: Indices, new: Indices) -> tuple[int, int, int, int]:
    """Return the box that holds two boxes; an empty one adds nothing."""
    if old[1] <= old[0] or old[3] <= old[2]:
        return new[0], new[1], new[2], new[3]
    if new[1] <= new[0] or new[3] <= new[2]:
        return old[0], old[1], old[2], old[3]
    return min(old[0], new[0]), max(old[1], new[1]), min(old[2], new[2]), max(old[3], new[3])


@leaf
def _paint(
    px: Pixels, lights: Lights, out: Floats, n: int, i: int, t_us: float, moved: bool, least: float,
    now: tuple[float, float], line: tuple[Floats32, Floats32, float], since: tuple[float, float], past: Past,
    mine: Indices, n_mine: int, width: int, at: tuple[int, int],
) -> tuple[int, int, tuple[int, int]]:  # fmt: skip
    """Bring light i to the pixels of its old and new box, from row and column `at` on, as long as there is room."""
    state, law, seed = px.state, px.law, px.seed
    old_box, old_x, old_y = lights.box[i], lights.wx[i], lights.wy[i]
    new_box, new_x, new_y = old_box, old_x, old_y
    if moved:
        new_box, new_x, new_y = lights.new_box, lights.new_x, lights.new_y
    was, old_least = lights.place[i, NOW], lights.place[i, LEAST]
    before, after = now
    view0, view1, share = line
    x0, x1, y0, y1 = _both(old_box, new_box) if was > 0.0 else _both(new_box, new_box)
    row, column = max(at[0], y0), max(at[1], x0)
    while row < y1:
        while column < x1:
            w = _weight(new_x, new_y, new_box, column, row, least)
            w_old = w if not moved else _weight(old_x, old_y, old_box, column, row, old_least)
            p = row * width + column
            column += 1
            if w == 0.0 and (w_old == 0.0 or was == 0.0):
                continue
            if n + 2 * RESERVE > len(out):
                return n, n_mine, (row, column - 1)
            if state[p, CLAIMED] == 0.0:
                n_mine = _claim(px, p, past, mine, n_mine)
            old = was * w_old
            # A pixel that enters the image: until this step began, nothing of it was here.
            enters = old == 0.0 and before * w > 0.0 and state[p, T] < since[0]
            for stage in range(0 if enters else 1, 2):
                at_us, part = since if stage == 0 else (t_us, share)
                view = np.float64(view0[p])
                still = view0[p] == view1[p]
                if not still:
                    view += (view1[p] - view) * part
                then, next_ = (before * w, after * w) if stage == 1 else (old, old)
                n = _touch(state, law, seed, out, n, p, i, at_us, view, still, old, then, next_)
        row, column = row + 1, x0
    return n, n_mine, DONE


@numba.njit(nogil=True)
def _change(
    px: Pixels, lights: Lights, out: Floats, n: int, i: int, t_us: float, moved: bool, least: float,
    now: tuple[float, float], line: tuple[Floats32, Floats32, float], since: tuple[float, float], past: Past,
    mine: Indices, n_mine: int, width: int,
) -> tuple[Floats, int, int]:  # fmt: skip
    """Bring light i to all pixels of its old and new box.

    If it has `moved`, the scratch holds its weights at the new place, `least` the least of them; `now` is its light
    there before and after t_us; `line` the views at the interval's ends and how far between them t_us is; `since`, when
    this step of its motion began, and how far between the ends that is.
    """
    at = (0, 0)
    while True:
        n, n_mine, at = _paint(
            px, lights, out, n, i, t_us, moved, least, now, line, since, past, mine, n_mine, width, at
        )  # fmt: skip
        if at == DONE:
            return out, n, n_mine
        out = grow(out)


@numba.njit(nogil=True)
def _keep(lights: Lights, i: int, x: float, y: float, sigma: float, flux: float, least: float, chunk_us: float) -> None:
    place = lights.place[i]
    place[X], place[Y], place[SIGMA], place[FLUX], place[LEAST], place[CHUNK] = x, y, sigma, flux, least, chunk_us
    box = lights.new_box
    for k in range(4):
        lights.box[i, k] = box[k]
    for k in range(box[1] - box[0]):
        lights.wx[i, k] = lights.new_x[k]
    for k in range(box[3] - box[2]):
        lights.wy[i, k] = lights.new_y[k]


@numba.njit(nogil=True)
def play(
    px: Pixels, lights: Lights, chunk: Chunk, when: Floats, who: Ints, what: Floats, out: Floats, n: int,
    view0: Floats32, view1: Floats32, t0_us: float, t1_us: float, past: Past,
    mine: Indices, n_mine: int, width: int,
) -> tuple[Floats, int, int]:  # fmt: skip
    """Take the lights through their instants.

    Args:
        px: all pixels.
        lights: the lights as they are in them.
        chunk: that the interval lies in.
        when: instants (us since the chunk began), as `who` and `what` from `spots.instants`.
        who: the lights.
        what: their levels, or -1.
        out: events.
        n: so many.
        view0: (pixels,) the view at t0_us.
        view1: (pixels,) the view at t1_us.
        t0_us: beginning of the interval.
        t1_us: its end.
        past: the last views.
        mine: (pixels,) the claimed pixels.
        n_mine: so many.
        width: of the sensor.

    Returns:
        The events, perhaps elsewhere; how many; how many pixels are claimed.
    """
    height = len(view0) // width
    for k in range(len(when)):
        i = who[k]
        place = lights.place[i]
        t = when[k]
        t_us = min(chunk.t0_us + t, t1_us)
        x, y = at_node(chunk.x_px, i, t), at_node(chunk.y_px, i, t)
        sigma, flux = at_node(chunk.sigma_px, i, t), at_node(chunk.flux_w_m2, i, t)
        level = place[LEVEL]
        after = what[k] if what[k] >= 0.0 else level
        place[LEVEL] = after
        same = x == place[X] and y == place[Y] and sigma == place[SIGMA] and flux == place[FLUX]
        moved = not (same and place[CHUNK] == chunk.t0_us)
        least = place[LEAST]
        if moved:
            least = arrange(lights, x, y, sigma, flux, view0, width, height)
        line = (view0, view1, (t_us - t0_us) / (t1_us - t0_us))
        begun = max(t_us - step_us(chunk, i, t), t0_us)
        since = (begun, (begun - t0_us) / (t1_us - t0_us))
        now = (level * flux, after * flux)
        out, n, n_mine = _change(
            px, lights, out, n, i, t_us, moved, least, now, line, since, past, mine, n_mine, width
        )  # fmt: skip
        place[NOW] = after * flux
        if moved:
            _keep(lights, i, x, y, sigma, flux, least, chunk.t0_us)
    return out, n, n_mine


@leaf
def _settle(
    px: Pixels, out: Floats, n: int, mine: Indices, n_mine: int, view0: Floats32, view1: Floats32, t1_us: float,
    horizon_us: float, watch: Indices, n_watch: int, at: tuple[int, int],
) -> tuple[int, int, tuple[int, int]]:  # fmt: skip
    """Settle the pixels mine[at[0]:], of which those kept go to mine[at[1]:], as long as there is room."""
    state, law, seed, low, high = px.state, px.law, px.seed, px.low, px.high
    k, kept = at
    while k < n_mine and n + RESERVE <= len(out):
        p = mine[k]
        k += 1
        u, light, lit = state[p, U], state[p, LIGHT], state[p, EXTRA]
        if view0[p] != view1[p]:
            u = np.float64(view1[p])
            light = math.exp(u) + lit
            if lit > 0.0:
                u = math.log(light)
        n = advance(state, law, seed, out, n, p, t1_us, u, light, int(state[p, OWNER]))
        rest = abs(state[p, V] - u) < REST * state[p, ON] and state[p, DEAD] <= t1_us
        if lit > 0.0 or not (rest or t1_us - state[p, TOUCHED] > RELEASE_US):
            mine[kept] = p
            kept += 1
            continue
        state[p, CLAIMED] = 0.0
        state[p, OWNER] = BACKGROUND
        set_bounds(state, law, low, high, p)
        above = state[p, REF] + state[p, ON] - law[DRIFT] * horizon_us
        below = state[p, REF] - state[p, OFF] - law[DRIFT] * t1_us
        if u >= above or u <= below or state[p, DEAD] > t1_us:
            if n_watch < len(watch):
                watch[n_watch] = p
            n_watch += 1
    return n, n_watch, (k, kept)


@numba.njit(nogil=True)
def settle(
    px: Pixels, out: Floats, n: int, mine: Indices, n_mine: int, view0: Floats32, view1: Floats32, t1_us: float,
    horizon_us: float, watch: Indices, n_watch: int,
) -> tuple[Floats, int, int, int]:  # fmt: skip
    """Take all claimed pixels to the interval's end, and let go those that are dark and at rest.

    Args:
        px: all pixels.
        out: events.
        n: so many.
        mine: the claimed pixels; those that stay so are kept, in their order.
        n_mine: so many.
        view0: (pixels,) the view at the interval's beginning.
        view1: (pixels,) at its end.
        t1_us: its end.
        horizon_us: those let go that may act before this time go to `watch`.
        watch: pixels to be looked at every interval.
        n_watch: so many; more than its length: it overflowed.

    Returns:
        The events, perhaps elsewhere; how many; how many pixels are claimed; how many to be watched.
    """
    at = (0, 0)
    while True:
        n, n_watch, at = _settle(px, out, n, mine, n_mine, view0, view1, t1_us, horizon_us, watch, n_watch, at)
        if at[0] == n_mine:
            return out, n, at[1], n_watch
        out = grow(out)
