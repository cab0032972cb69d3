"""The compiled entries, each cached under the sources of all that it calls (`heliograph.link.stamp`)."""

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np

from heliograph.events import Flags
from heliograph.link.stamp import stamp
from heliograph_services.event_source.simulation import random
from heliograph_services.event_source.simulation.contract import HOT_PIXEL, SHOT_NOISE, Floats, Ints, Labels
from heliograph_services.event_source.simulation.pixel import (
    claims,
    leaf,
    model,
    noise,
    order,
    response,
    spots,
    surroundings,
)
from heliograph_services.event_source.simulation.pixel.claims import play, settle
from heliograph_services.event_source.simulation.pixel.model import Indices, Pixels
from heliograph_services.event_source.simulation.pixel.noise import sprinkle
from heliograph_services.event_source.simulation.pixel.order import ordered
from heliograph_services.event_source.simulation.pixel.spots import Chunk, Lights, instants
from heliograph_services.event_source.simulation.pixel.surroundings import Past, candidates, look, rebase

_SOURCES: Final = stamp(claims, leaf, model, noise, order, random, response, spots, surroundings)


def _entry(sources: int) -> tuple[Any, Any, Any]:
    @numba.njit(cache=True, nogil=True)
    def lit(
        px: Pixels, lights: Lights, chunk: Chunk, out: Floats, n: int, t0_us: float, t1_us: float, horizon_us: float,
        past: Past, row: int, mine: Indices, n_mine: int, watch: Indices, n_watch: int,
        width: int,
    ) -> tuple[Floats, int, int, int]:  # fmt: skip
        view0, view1 = past.views[past.rows[len(past.rows) - 1]], past.views[row if sources >= 0 else 0]
        when, who, what = instants(chunk, lights, t0_us - chunk.t0_us, t1_us - chunk.t0_us)
        out, n, n_mine = play(
            px, lights, chunk, when, who, what, out, n, view0, view1, t0_us, t1_us, past, mine, n_mine, width
        )
        return settle(px, out, n, mine, n_mine, view0, view1, t1_us, horizon_us, watch, n_watch)

    @numba.njit(cache=True, nogil=True)
    def unlit(
        px: Pixels, out: Floats, n: int, t0_us: float, t1_us: float, until_us: float, base_us: float, search: bool,
        past: Past, row: int, watch: Indices, n_watch: int,
    ) -> tuple[Floats, int, int]:  # fmt: skip
        view0, view1 = past.views[past.rows[len(past.rows) - 1]], past.views[row if sources >= 0 else 0]
        if base_us != px.law[model.BASE]:
            rebase(px.state, px.law, px.low, px.high, base_us)
        if search:
            n_watch = candidates(px.law, px.low, px.high, view0, view1, t0_us, until_us, watch)
        out, n = look(px, out, n, watch, n_watch, t1_us, view1, past)
        return out, n, n_watch

    @numba.njit(cache=True, nogil=True)
    def finish(
        out: Floats, n: int, seed: int, t0_us: float, t1_us: float, block0: int, block1: int, shot_hz: float,
        pixels: int, hot_hz: float, hot: Ints,
    ) -> tuple[Floats, int, Floats, Ints, Flags, Labels]:  # fmt: skip
        none = np.empty(0, np.int64)
        begin = n if sources >= 0 else 0
        for block in range(block0, block1):
            out, n = sprinkle(out, n, seed, random.SHOT, SHOT_NOISE, shot_hz, none, pixels, block)
            out, n = sprinkle(out, n, seed, random.HOT_EVENT, HOT_PIXEL, hot_hz, hot, len(hot), block)
        # A stream may begin within a block.
        kept = begin
        for k in range(begin, n):
            if out[k, 0] >= t0_us:
                out[kept, 0], out[kept, 1] = out[k, 0], out[k, 1]
                kept += 1
        held, t_us, pixel, on, cause = ordered(out, kept, t0_us, t1_us)
        return out, held, t_us, pixel, on, cause

    return lit, unlit, finish


LIT, UNLIT, FINISH = _entry(_SOURCES)
